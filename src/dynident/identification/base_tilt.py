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
from dynident.identification.time_offset import trial_samples
from dynident.log import Motion, thinned
from dynident.models import HasGravity, Model, structure_of
from dynident.regression import EntryBlock, Regression, factorise

__all__ = ["BaseTilt", "find_base_tilt", "mounted"]

Array = NDArray[np.float64]
STEEPEST = 0.2  # rad: a larger tilt is intended mounting
EXACT = 1e-10  # of the largest entry: to what the rows must be affine in gravity
START = 1e-3  # rad: at zero tilt, masses that act only through a tilt have no effect


@dataclass(frozen=True)
class BaseTilt(Note):
    """The base tilt: rotations about the root link's x and y axes, in rad, with standard errors ``std``, and training
    error (%) ``before`` and ``after`` correction."""

    severity: ClassVar[Severity] = Severity.INFO
    x: float
    y: float
    std: tuple[float, float]
    before: float
    after: float


def mounted(model: Model, x: float, y: float) -> Model:
    """Return the model on a base that is tilted by x and y (rad) about the axes of its root link.

    Raises ConfigError where no term of the model has gravity.
    """
    from scipy.spatial.transform import Rotation

    back = Rotation.from_rotvec((-x, -y, 0.0))
    if not any(isinstance(term, HasGravity) for term in model.terms):
        raise ConfigError(f"{model.name}: no term has a gravity that could be rotated; only robot files have one.")
    return model.with_gravity(back.apply)


def find_base_tilt(
    model: Model, motions: Sequence[Motion], estimator: Estimator, min_speed: tuple[float, ...] | None = None
) -> BaseTilt:
    """Return the tilt of the base at which the estimator explains the torque of the motions best.

    Gauss-Newton steps on the residual, in which the estimator has eliminated all other parameters. Raises ConfigError
    where the best tilt exceeds 0.2 rad, and the errors of ``mounted``, ``Regression`` and the estimator.
    """
    from scipy.optimize import least_squares

    thin = thinned(motions, trial_samples(model))
    fast = quick(estimator)
    under = _affine(mounted(model, START, START), thin, min_speed)

    def residual(tilt: Array) -> Array:
        """Return what the fit leaves of the torque with the base so tilted."""
        turned = mounted(model, *tilt)
        regression = Regression(turned, thin, min_speed=min_speed)
        # few rows, needed twice: for the factors and for the residual
        blocks = list(regression.entries() if under is None else under(_gravity(turned)))
        regression.__dict__["triangular_factors"] = factorise(blocks, blocks[0].structure)
        value = fast(Problem(turned, thin, regression)).value
        parts = [(one.tau - one.torque(value)) * (1.0 if one.keep is None else one.keep) for one in blocks]
        return np.concatenate(parts, axis=1).ravel()

    level = residual(np.zeros(2))
    torque = np.sqrt(sum(float(np.sum(one.tau[one.mask] ** 2)) for one in thin))
    found = least_squares(residual, np.full(2, START), diff_step=0.1, x_scale=0.01, xtol=1e-3, ftol=1e-4, max_nfev=20)
    spread = np.sqrt(np.diag(np.linalg.pinv(found.jac.T @ found.jac)) * 2.0 * found.cost / max(level.size - 2, 1))
    seen = np.abs(found.x) > 2.0 * spread  # a tilt that the motion does not excite is zero
    x, y = (float(v) for v in found.x * seen)
    if max(abs(x), abs(y)) > STEEPEST:
        raise ConfigError(
            f"the base would be tilted by {np.rad2deg(x):.3g} deg about x and {np.rad2deg(y):.3g} deg about y, more "
            "than a mounting error; set `gravity`, and check the zeros and axes of the joints."
        )
    left = (float(np.linalg.norm(r)) for r in (level, residual(np.array([x, y]))))
    before, after = (100.0 * one / torque if torque > 0 else 0.0 for one in left)
    return BaseTilt(x, y, (float(spread[0]), float(spread[1])), before, after)


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
