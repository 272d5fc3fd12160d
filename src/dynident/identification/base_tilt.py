"""The tilt of the base, found before a fit.

The parameters of the model are eliminated at every trial value (variable projection; Golub and Pereyra 1973), so that
the search has two unknowns.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ConfigError, Note, Severity
from dynident.estimators import Estimator, Problem, quick
from dynident.estimators.linear import solve
from dynident.identification.cross_validation import FOLDS, Gain, factors_of, gained, predicted
from dynident.identification.time_offset import trial_samples
from dynident.log import Motion, thinned
from dynident.models import HasGravity, Model, structure_of
from dynident.regression import EntryBlock, Regression, TriangularFactors, factorise, merged, rank_of

__all__ = ["BaseTilt", "SteepBase", "find_base_tilt", "has_gravity", "mounted"]

Array = NDArray[np.float64]
STEEPEST = 0.2  # rad: a larger tilt is intended mounting
EXACT = 1e-10  # of the largest entry: to what the rows must be affine in gravity
LEAST = 2.0  # % of the squared cross-validated error that a tilt must remove
STRETCHES = 8  # of each motion, in a fold
EDGE = 0.1  # share of a stretch left out at either end
START = 1e-3  # rad: at zero tilt, masses that act only through a tilt have no effect


@dataclass(frozen=True)
class BaseTilt(Note):
    """The base tilt: rotations about the root link's x and y axes, in rad, with standard errors ``std``, and training
    error (%) ``before`` and ``after`` correction.

    ``gain`` is that of the best tilt in cross-validation, None where none is seen. A tilt that gains no more than one
    standard error, or 2 %, is zero; so is one above 0.2 rad, which is then in ``steep``.
    """

    severity: ClassVar[Severity] = Severity.INFO
    x: float
    y: float
    std: tuple[float, float]
    before: float
    after: float
    gain: Gain | None = None
    steep: tuple[float, float] | None = None


@dataclass(frozen=True)
class SteepBase(Note):
    """A base tilt by ``x`` and ``y`` (rad) would be more than a mounting error: the base is taken as level."""

    x: float
    y: float


def mounted(model: Model, x: float, y: float) -> Model:
    """Return the model on a base that is tilted by x and y (rad) about the axes of its root link.

    Raises ConfigError where no term of the model has gravity.
    """
    from scipy.spatial.transform import Rotation

    back = Rotation.from_rotvec((-x, -y, 0.0))
    if not any(isinstance(term, HasGravity) for term in model.terms):
        raise ConfigError(f"{model.name}: no term has a gravity that could be rotated; only robot files have one.")
    return model.with_gravity(back.apply)


def has_gravity(model: Model) -> bool:
    """Return whether any term has a gravity that a tilt would rotate."""
    return any(isinstance(term, HasGravity) and any(term.gravity) for term in model.terms)


def find_base_tilt(
    model: Model, motions: Sequence[Motion], estimator: Estimator, min_speed: tuple[float, ...] | None = None
) -> BaseTilt:
    """Return the tilt of the base at which the estimator explains the torque of the motions best.

    Gauss-Newton steps on the residual, in which the estimator has eliminated all other parameters; none are taken where
    a step of least squares shows that no tilt can gain much. The tilt is zero unless it lowers the cross-validated
    error by more than one standard error and 2 %, and where it exceeds 0.2 rad. Raises the errors of ``mounted``,
    ``Regression`` and the estimator.
    """
    thin = thinned(motions, trial_samples(model))
    near = _Linearised.at(model, thin, min_speed, (0.0, 0.0))
    if near.gain.share < 0.5 * LEAST:
        return BaseTilt(0.0, 0.0, near.std, near.error, near.error, near.gain)
    (x, y), std, error = _searched(model, thin, estimator, min_speed)
    before = error(0.0, 0.0)
    level = BaseTilt(0.0, 0.0, std, before, before)
    if not (x or y):  # a tilt that the motion does not excite
        return level
    gain = _Linearised.at(model, thin, min_speed, (x, y)).gain
    if not (gain.sure and gain.share > LEAST):
        return replace(level, gain=gain)
    if max(abs(x), abs(y)) > STEEPEST:
        return replace(level, gain=gain, steep=(x, y))
    return BaseTilt(x, y, std, before, error(x, y), gain)


def _searched(
    model: Model, thin: tuple[Motion, ...], estimator: Estimator, min_speed: tuple[float, ...] | None
) -> tuple[tuple[float, float], tuple[float, float], Callable[[float, float], float]]:
    """Return the best tilt (rad), zero within two standard errors, these, and the training error (%) by tilt."""
    from scipy.optimize import least_squares

    fast = quick(estimator)
    under = _affine(mounted(model, START, START), thin, min_speed)

    def residual(tilt: Array) -> Array:
        """Return what the fit leaves of the torque with the base so tilted."""
        turned = mounted(model, *tilt)
        regression = Regression(turned, thin, min_speed=min_speed)
        # few rows, needed twice: for the factors and for the residual
        blocks = list(regression.entries() if under is None else under(_gravity(turned)))
        regression = regression.with_factors(factorise(blocks, blocks[0].structure))
        value = fast(Problem(turned, thin, regression)).value
        parts = [(one.tau - one.torque(value)) * (1.0 if one.keep is None else one.keep) for one in blocks]
        return np.concatenate(parts, axis=1).ravel()

    torque = float(np.sqrt(sum(float(np.sum(one.tau[one.mask] ** 2)) for one in thin)))
    found = least_squares(residual, np.full(2, START), diff_step=0.1, x_scale=0.01, xtol=1e-3, ftol=1e-4, max_nfev=20)
    spread = np.sqrt(np.diag(np.linalg.pinv(found.jac.T @ found.jac)) * 2.0 * found.cost / max(found.fun.size - 2, 1))
    x, y = (float(v) for v in found.x * (np.abs(found.x) > 2.0 * spread))

    def error(x: float, y: float) -> float:
        return 100.0 * float(np.linalg.norm(residual(np.array([x, y])))) / torque if torque > 0 else 0.0

    return (x, y), (float(spread[0]), float(spread[1])), error


@dataclass(frozen=True)
class _Linearised:
    """What a tilt near another one gains in cross-validation over a level base, where the torque is linear in it; its
    standard errors, and the training error (%) of the level base."""

    gain: Gain
    std: tuple[float, float]
    error: float

    @classmethod
    def at(
        cls, model: Model, motions: tuple[Motion, ...], min_speed: tuple[float, ...] | None, tilt: tuple[float, float]
    ) -> _Linearised:
        """Linearise at a tilt and the parameters of least squares there.

        Each fold finds its own tilt, and parameters in the directions that a level base shows: others would be fitted
        to noise as long as the tilt is small.
        """
        turned = mounted(model, *tilt)
        folds = [tuple(_part(one, k) for one in motions) for k in range(FOLDS)]
        level = factors_of(model, motions, FOLDS, min_speed, _part)
        shown = rank_of(merged(level).stacked(), model.parameters).determined
        value = shown @ _solved(_along(Regression(turned, motions, None, min_speed).triangular_factors, shown))[0]
        slopes = _slopes(model, motions, value, tilt)
        level = [_along(one, shown) for one in level]
        tilted = [_along(_beside(turned, some, slopes, min_speed), shown) for some in folds]
        gain = gained(predicted(level, level), predicted(tilted, tilted))
        std, whole = _solved(merged(tilted))[1], merged(level)
        left, torque = whole.residual(_solved(whole)[0]).sum(), np.square(whole.factors[:, :, -1]).sum()
        error = 100.0 * float(np.sqrt(left / torque)) if torque > 0 else 0.0
        return cls(gain, (float(std[-2]), float(std[-1])), error)


def _solved(triangular: TriangularFactors) -> tuple[Array, Array]:
    """Return the least-squares solution (p) and its standard errors (p), inf where there are none."""
    fit = solve(triangular.stacked())
    return fit.value, np.sqrt(np.diag(fit.directions.covariance(fit.rss / max(triangular.total - fit.rank, 1))))


def _along(triangular: TriangularFactors, directions: Array) -> TriangularFactors:
    """Return the factors of coordinates along directions (p, r) of the first parameters, and of the rest."""
    p, r = directions.shape
    rest = triangular.factors.shape[2] - p
    into = np.zeros((p + rest, r + rest))
    into[:p, :r], into[p:, r:] = directions, np.eye(rest)
    return TriangularFactors(np.asarray(np.linalg.qr(triangular.factors @ into, mode="r")), triangular.rows)


def _part(motion: Motion, k: int, folds: int = FOLDS) -> Motion:
    """Return the motion with only the stretches of fold k in the mask, which have gaps between them.

    A fold has several stretches, evenly spread, so that the others excite what it does.
    """
    mask = np.zeros(len(motion), dtype=bool)
    for used in np.array_split(np.flatnonzero(motion.mask), folds * STRETCHES)[k::folds]:
        edge = int(EDGE * len(used))
        mask[used[edge : len(used) - edge]] = True
    return replace(motion, mask=mask)


def _slopes(model: Model, motions: Sequence[Motion], value: Array, tilt: tuple[float, float]) -> list[Array]:
    """Return for each motion what the torque (N, n) changes with the tilt, (2, N, n) in N m/rad."""
    found = []
    for motion in motions:
        ends = [
            [mounted(model, *(tilt + side * step)).torque(**motion.states(), theta=value) for side in (1, -1)]
            for step in START * np.eye(2)
        ]
        found.append(np.array([(late - early) / (2 * START) for late, early in ends]))
    return found


def _beside(
    model: Model, motions: Sequence[Motion], slopes: Sequence[Array], min_speed: tuple[float, ...] | None
) -> TriangularFactors:
    """Return the factors of the regression with two more columns, the ``slopes`` of the torque."""
    structure = model.structure.beside(2)
    moved = [
        Regression(model, tuple(replace(m, tau=s[k]) for m, s in zip(motions, slopes, strict=True)), None, min_speed)
        for k in range(2)
    ]

    def blocks() -> Iterator[EntryBlock]:
        plain = Regression(model, tuple(motions), None, min_speed).entries()
        for block, x, y in zip(plain, *(one.entries() for one in moved), strict=True):
            rows = [
                np.concatenate((block.entries[part], x.tau[[j]], y.tau[[j]]))
                for j, part in enumerate(block.structure.parts)
            ]
            yield EntryBlock(structure, np.concatenate(rows), block.tau, block.keep)

    return factorise(blocks(), structure)


def _gravity(model: Model) -> Array:
    """Return the gravity (k, 3) of the terms that have one."""
    return np.array([term.gravity for term in model.terms if isinstance(term, HasGravity)])


def _affine(
    model: Model, motions: tuple[Motion, ...], min_speed: tuple[float, ...] | None
) -> Callable[[Array], Iterator[EntryBlock]] | None:
    """Return a function from gravity (k, 3) to the rows: they are affine in it, so that four gravities tell all others.

    None where the terms differ in their gravity, or the rows under that of ``model`` are not those of the function.
    """
    now = _gravity(model)
    if not (now == now[0]).all() or not now.any():
        return None
    unit = float(np.linalg.norm(now[0]))
    known = [
        model.with_gravity(partial(np.add, one))
        for one in np.concatenate([np.zeros((1, 3)), unit * np.eye(3)]) - now[0]
    ]
    structure = structure_of(known)
    none, *along = (list(Regression(one, motions, min_speed=min_speed).entries(structure)) for one in known)
    slopes = [
        np.stack([one.entries - first.entries for one in some]) for first, *some in zip(none, *along, strict=True)
    ]

    pulled = [slope.any(axis=(0, 2)) for slope in slopes]  # gravity acts on masses and their centres alone
    slopes = [slope[:, rows] for slope, rows in zip(slopes, pulled, strict=True)]

    def under(gravity: Array) -> Iterator[EntryBlock]:
        share = gravity[0] / unit
        for block, slope, rows in zip(none, slopes, pulled, strict=True):
            entries = block.entries.copy()
            entries[rows] += np.tensordot(share, slope, 1)
            yield replace(block, entries=entries)

    exact = Regression(model, motions, min_speed=min_speed).entries(structure)
    pairs = zip(under(now), exact, strict=True)
    return (
        under if all(np.abs(a.entries - b.entries).max() <= EXACT * np.abs(b.entries).max() for a, b in pairs) else None
    )
