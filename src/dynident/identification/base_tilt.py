"""The tilt of the base, found before a fit.

The parameters of the model are eliminated at every trial value (variable projection; Golub and Pereyra 1973), so that
the search has two unknowns.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynident.estimators import Estimate, Estimator, Problem
from dynident.estimators.least_squares import joint_weights, solve_least_squares
from dynident.identification.calibration_std import calibration_std
from dynident.identification.cross_validation import FOLDS, Gain, factors_by_fold, gain_from_errors, prediction_errors
from dynident.identification.mounting import find_mounting, tilt_base
from dynident.identification.time_offset import WEIGHT_ITERATIONS, training_error, trial_samples
from dynident.models import Model, common_structure
from dynident.motion.log import Motion, thin_motions
from dynident.regression import (
    EVERYTHING,
    EntryBlock,
    Regression,
    Selection,
    TriangularFactors,
    factorise,
    fitted_mask,
    merge_factors,
    rank_of,
)
from dynident.runtime import Note, Severity, angles, percent
from dynident.runtime.arrays import Array

MAX_TILT = 0.2  # rad: a larger tilt is intended mounting
MAX_AFFINE_ERROR = 1e-10  # of the largest entry: to what the rows must be affine in gravity
MIN_GAIN = 2.0  # % of the squared cross-validated error that a tilt must remove
STRETCHES_PER_FOLD = 8  # of each motion, in a fold
EDGE_SHARE = 0.1  # share of a stretch left out at either end
START_TILT = 1e-3  # rad: at zero tilt, masses that act only through a tilt have no effect


class BaseTilt(Note):
    """The base tilt: rotations about the root link's x and y axes, in rad, with standard errors ``std``, and training
    error (%) ``before`` and ``after`` correction.

    ``gain`` is that of the best tilt in cross-validation, None where none is seen. A tilt that gains no more than one
    standard error, or 2 %, is zero; so is one above 0.2 rad, which is then in ``steep``. The rotations of a base on its
    side or over (``find_mounting``) are larger, and have no ``gain``.
    """

    severity = Severity.INFO
    x: float
    y: float
    std: tuple[float, float]
    before: float
    after: float
    gain: Gain | None = None
    steep: tuple[float, float] | None = None

    def __str__(self) -> str:
        dx, dy = np.rad2deg(self.std)
        if not (self.x or self.y):
            why = "" if self.gain is None else f": the best tilt would gain {self.gain}"
            if self.steep:
                why += f", but is {angles(*self.steep)}, more than a mounting error"
            uncertainty = f" (+- {dx:.2f} and {dy:.2f} deg about x and y)" if np.isfinite(dx + dy) else ""
            return f"the base is taken as level{uncertainty}{why}"
        change = f"correcting this lowers the training error from {percent(self.before)} to {percent(self.after)}"
        if max(abs(self.x), abs(self.y)) > MAX_TILT and self.gain is None:
            return f"the base is mounted turned by {angles(self.x, self.y, 2)} (+- {dx:.2f} and {dy:.2f}); {change}"
        return f"the base is tilted by {angles(self.x, self.y, 2)} (+- {dx:.2f} and {dy:.2f}); {change}"


class SteepBase(Note):
    """A base tilt by ``x`` and ``y`` (rad) would be more than a mounting error: the base is taken as level."""

    x: float
    y: float

    def __str__(self) -> str:
        return (
            f"the torques ask for a base that is tilted by {angles(self.x, self.y)}, more than a mounting error; it "
            "is taken as level. If the robot is mounted so, set `gravity` of the model; if not, check the zeros and "
            "axes of its joints, the signs of its torques, and what it carries"
        )


def find_base_tilt(
    model: Model, motions: Sequence[Motion], estimator: Estimator, selection: Selection = EVERYTHING
) -> BaseTilt:
    """Find the tilt of the base at which the estimator explains the torque of the motions best.

    Gauss-Newton steps on the residual, from which the estimator has eliminated all other parameters. None are
    taken where a linearisation at zero shows that no tilt can gain much. The tilt is zero unless it lowers the
    cross-validated error by more than one standard error and 2 %, and where it exceeds 0.2 rad. Raises the errors
    of ``tilt_base``, ``Regression`` and the estimator.
    """
    trial_motions = thin_motions(motions, trial_samples(model))
    mounting = find_mounting(model, trial_motions, estimator, selection)
    if mounting is not None:
        (x, y), std, error = _search_tilt(model, trial_motions, estimator, selection, mounting)
        if max(abs(x - mounting[0]), abs(y - mounting[1])) <= MAX_TILT:
            return BaseTilt(x, y, std, error(0.0, 0.0), error(x, y))
    level_folds = factors_by_fold(model, trial_motions, FOLDS, selection, spread_fold_numbers)
    linear = _TiltGain.linearise(model, trial_motions, selection, level_folds, (0.0, 0.0))
    # A linear estimate costs one fit; the search below costs many and is not worth it where nothing can be gained.
    if linear.gain.share < 0.5 * MIN_GAIN:
        dx, dy = linear.find_std().tolist()
        return BaseTilt(0.0, 0.0, (dx, dy), linear.error, linear.error, linear.gain)
    # The search has a step of a tenth of where it begins, so that it does not begin nearer to zero than this.
    start = np.copysign(np.clip(np.abs(linear.tilt), START_TILT, MAX_TILT), linear.tilt)
    (x, y), std, error = _search_tilt(model, trial_motions, estimator, selection, start=start)
    # The level base is the result wherever the tilt is refused below, with the errors that are known by then.
    before = error(0.0, 0.0)
    level = BaseTilt(0.0, 0.0, std, before, before)
    if not (x or y):  # a tilt that the motion does not excite
        return level
    gain = _TiltGain.linearise(model, trial_motions, selection, level_folds, (x, y)).gain
    if not (gain.sure and gain.share > MIN_GAIN):
        return replace(level, gain=gain)
    if max(abs(x), abs(y)) > MAX_TILT:
        return replace(level, gain=gain, steep=(x, y))
    return BaseTilt(x, y, std, before, error(x, y), gain)


def _search_tilt(
    model: Model,
    thin: tuple[Motion, ...],
    estimator: Estimator,
    selection: Selection,
    mounting: tuple[float, float] = (0.0, 0.0),
    start: ArrayLike = (START_TILT, START_TILT),
) -> tuple[tuple[float, float], tuple[float, float], Callable[[float, float], float]]:
    """Return the best tilt (rad), its standard errors, and a function giving the training error (%) at a tilt.

    The search begins ``start`` away from ``mounting``, with the weights of the joints that the estimator has there; a
    component within two standard errors of ``mounting`` is set to it.
    """
    from scipy.optimize import least_squares

    quick_estimator = estimator.quick()
    entries_at = _affine_entries(tilt_base(model, START_TILT, START_TILT), thin, selection)

    def fit(tilt: Array) -> tuple[list[EntryBlock], Estimate]:
        """Return the rows with the base tilted this much, and the fit to them."""
        tilted_model = tilt_base(model, *tilt)
        regression = Regression(tilted_model, thin, selection.unfiltered)
        # few rows, needed twice: for the factors and for the residual
        blocks = list(regression.entries() if entries_at is None else entries_at(_term_gravity(tilted_model)))
        regression = regression.with_factors(factorise(blocks, blocks[0].structure))
        return blocks, quick_estimator(Problem(tilted_model, thin, regression))

    def residual(tilt: Array) -> Array:
        """Return the torque residual (n, N) of the fit."""
        blocks, estimate = fit(tilt)
        return np.concatenate([(block.tau - block.torque(estimate.value)) * block.used for block in blocks], axis=1)

    torque = float(np.sqrt(sum(float(np.sum(motion.tau[motion.mask] ** 2)) for motion in thin)))
    # The start is off zero and the steps are coarse: the residual is that of a full fit and not smooth to rounding.
    settings = {"diff_step": 0.1, "x_scale": 0.01, "xtol": 1e-3, "ftol": 1e-4, "max_nfev": 20}
    n, (_, estimate) = len(model.joints), fit(np.add(start, mounting))
    weights = np.ones(n) if estimate.residual.weights is None else estimate.residual.weights
    solution = least_squares(lambda tilt: (weights[:, None] * residual(tilt + mounting)).ravel(), start, **settings)
    # rows of both are by joint; the samples of a motion follow each other
    lines, e = solution.jac.reshape(n, -1, 2), solution.fun.reshape(n, -1)
    ends = np.cumsum([len(motion) for motion in thin])[:-1]
    regression = Regression(tilt_base(model, *(solution.x + mounting)), thin, selection.unfiltered)
    std = calibration_std(np.split(lines, ends, axis=1), np.split(e, ends, axis=1), regression, weights)
    x, y = (float(v) for v in mounting + solution.x * (np.abs(solution.x) > 2.0 * std))

    def error(x: float, y: float) -> float:
        return 100.0 * float(np.linalg.norm(residual(np.array([x, y])))) / torque if torque > 0 else 0.0

    return (x, y), (float(std[0]), float(std[1])), error


@dataclass(frozen=True, eq=False)
class _TiltGain:
    """The cross-validated gain of a tilt over a level base, by linearisation of the torque at a nearby tilt.

    ``tilt`` (2) is the best one in rad, whose standard errors (2) ``find_std`` returns, and ``error`` the training
    error (%) of the level base.
    """

    gain: Gain
    tilt: Array
    error: float
    find_std: Callable[[], Array]

    @classmethod
    def linearise(
        cls, model: Model, motions: tuple[Motion, ...], selection: Selection, level_folds: Sequence[TriangularFactors],
        tilt: tuple[float, float],
    ) -> _TiltGain:  # fmt: skip
        """Linearise at a tilt, with the least-squares parameters there; ``level_folds`` are those of the level base.

        Each fold finds its own tilt. Parameters are restricted to the directions that a level base determines: others
        would be fitted to noise as long as the tilt is small.
        """
        tilted_model = tilt_base(model, *tilt)
        directions = rank_of(merge_factors(level_folds).stack(), model.parameters).determined_directions
        regression = Regression(tilted_model, motions, selection.unfiltered)
        projected = _project_factors(regression.triangular_factors, directions)
        value = directions @ solve_least_squares(projected.stack()).value
        # The tilt adds two columns, so that all folds are judged from triangular factors without another fit.
        slopes = [tilt_slopes(model, motion, value, tilt) for motion in motions]
        columns = [np.moveaxis(slope, 0, 2) for slope in slopes]
        tilted_folds = factors_by_fold(tilted_model, motions, FOLDS, selection, spread_fold_numbers, columns)
        level, tilted = (
            [_project_factors(fold_factors, directions) for fold_factors in folds]
            for folds in (level_folds, tilted_folds)
        )
        gain = gain_from_errors(prediction_errors(level, level), prediction_errors(tilted, tilted))
        merged_tilted, merged_level = merge_factors(tilted), merge_factors(level)
        weights = joint_weights(merged_tilted, "per_joint", WEIGHT_ITERATIONS)
        factor = merged_tilted.stack(weights)
        best = solve_least_squares(factor).value[directions.shape[1] :] + tilt
        error = training_error(merged_level, solve_least_squares(merged_level.stack()).value)
        find_std = partial(_linear_std, regression, slopes, directions, factor, selection, weights)
        return cls(gain, best, error, find_std)


def _linear_std(
    regression: Regression, slopes: Sequence[Array], directions: Array, factor: Array, selection: Selection,
    weights: Array,
) -> Array:  # fmt: skip
    """Return the standard errors (2) of a tilt whose ``slopes`` are columns of the ``factor`` beside the directions.

    ``weights`` (n) are those of the joints in the factor.
    """
    model = regression.model
    r = directions.shape[1]
    fit = solve_least_squares(factor)
    # what the directions explain of each slope does not tell anything of the tilt
    shared = directions @ np.linalg.lstsq(factor[:r, :r], factor[:r, r : r + 2], rcond=None)[0]
    lines, residuals = [], []
    for motion, slope in zip(regression.motions, slopes, strict=True):
        states, used = motion.states(), fitted_mask(motion, selection.min_speed).T * weights[:, None]
        lines.append(
            np.stack([(slope[k] - model.torque(**states, theta=shared[:, k])).T * used for k in range(2)], axis=2)
        )
        torque = model.torque(**states, theta=directions @ fit.value[:r]) + np.tensordot(fit.value[r:], slope, 1)
        residuals.append((motion.tau - torque).T * used)
    return calibration_std(lines, residuals, regression, weights)


def _project_factors(triangular: TriangularFactors, directions: Array) -> TriangularFactors:
    """Return the factors in coordinates along directions (p, r) of the first p parameters; other columns stay."""
    p, r = directions.shape
    n_other = triangular.factors.shape[2] - p
    projection = np.zeros((p + n_other, r + n_other))
    projection[:p, :r], projection[p:, r:] = directions, np.eye(n_other)
    return TriangularFactors(np.asarray(np.linalg.qr(triangular.factors @ projection, mode="r")), triangular.rows)


def spread_fold_numbers(motion: Motion, folds: int) -> NDArray[np.intp]:
    """Return the fold of each sample (N), -1 for none.

    A fold has several stretches, spread evenly, so that the remaining ones excite the same parameters. There are gaps
    between them.
    """
    numbers = np.full(len(motion), -1)
    # Whole stretches with cut ends: samples next to a border share smoothing errors with the neighbouring fold.
    for k, rows in enumerate(np.array_split(np.flatnonzero(motion.mask), folds * STRETCHES_PER_FOLD)):
        edge = int(EDGE_SHARE * len(rows))
        numbers[rows[edge : len(rows) - edge]] = k % folds
    return numbers


def tilt_slopes(model: Model, motion: Motion, value: Array, tilt: tuple[float, float] = (0.0, 0.0)) -> Array:
    """Return the derivative of the torque by the tilt, (2, N, n) in N m/rad."""
    # Central differences of the torque; the torque is nearly linear in a tilt of this size.
    ends = [
        [tilt_base(model, *(tilt + side * step)).torque(**motion.states(), theta=value) for side in (1, -1)]
        for step in START_TILT * np.eye(2)
    ]
    return np.array([(forward - backward) / (2 * START_TILT) for forward, backward in ends])


def _term_gravity(model: Model) -> Array:
    """Return the gravity (k, 3) of the terms that have one."""
    return np.array([term.gravity for term in model.terms if term.gravity is not None])


def _affine_entries(
    model: Model, motions: tuple[Motion, ...], selection: Selection
) -> Callable[[Array], Iterator[EntryBlock]] | None:
    """Return a function from gravity (k, 3) to the blocks of rows, or None where it cannot be had.

    Rows are affine in gravity, so that four gravities determine those for any other. None where the terms differ
    in their gravity, or where the function does not reproduce the rows of ``model``.
    """
    model_gravity = _term_gravity(model)
    if not (model_gravity == model_gravity[0]).all() or not model_gravity.any():
        return None
    magnitude = float(np.linalg.norm(model_gravity[0]))
    # Gravity zero and one unit along each axis: enough to determine a function that is affine in three variables.
    trial_models = [
        model.with_gravity(partial(np.add, trial))
        for trial in np.concatenate([np.zeros((1, 3)), magnitude * np.eye(3)]) - model_gravity[0]
    ]
    structure = common_structure(trial_models)
    without_gravity, *along_axes = (
        list(Regression(trial, motions, selection.unfiltered).entries(structure)) for trial in trial_models
    )
    slopes = [
        np.stack([trial.entries - reference.entries for trial in trials])
        for reference, *trials in zip(without_gravity, *along_axes, strict=True)
    ]

    affected_rows = [slope.any(axis=(0, 2)) for slope in slopes]  # gravity acts on masses and their centres alone
    slopes = [slope[:, rows] for slope, rows in zip(slopes, affected_rows, strict=True)]

    def entries_at(gravity: Array) -> Iterator[EntryBlock]:
        share = gravity[0] / magnitude
        for block, slope, rows in zip(without_gravity, slopes, affected_rows, strict=True):
            entries = block.entries.copy()
            entries[rows] += np.tensordot(share, slope, 1)
            yield replace(block, entries=entries)

    # Terms of the user may depend on gravity in another way: accept the function only where it is exact here.
    exact = Regression(model, motions, selection.unfiltered).entries(structure)
    pairs = zip(entries_at(model_gravity), exact, strict=True)
    return (
        entries_at
        if all(np.abs(a.entries - b.entries).max() <= MAX_AFFINE_ERROR * np.abs(b.entries).max() for a, b in pairs)
        else None
    )
