"""The time offset between torque and motion, found before a fit.

The parameters of the model are eliminated at every trial value (variable projection; Golub and Pereyra 1973), so that
the search has one unknown.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import cache
from itertools import count
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from dynident.errors import Note, Severity, Step, called
from dynident.estimators import Estimate, Estimator, LeastSquares, Problem, quick
from dynident.identification.cross_validation import Gain, fitted, gain_of
from dynident.identification.repetition import repeated
from dynident.identification.smoother_choice import Choice, choose_smoother, excerpts
from dynident.log import Log, Motion, subsample
from dynident.models import Model
from dynident.regression import Regression, fitted_rows
from dynident.regression.long_run import long_run
from dynident.smoothers import Smoother, TimeShifted, motion_of, unshifted

__all__ = ["Pairing", "TimeOffset", "find_time_offset", "pair", "trial_samples"]

Array = NDArray[np.float64]
ENTRIES = 200_000  # samples of all logs together times parameters: one or two unknowns need no more
FEWEST = 200  # least number of samples to estimate a time offset
TRIALS = (0.0, 0.001, 0.003, 0.01, 0.032, 0.05)  # s, of either sign; the search refines the best, but for the last
MOST = 0.032  # s: what is later has another cause than filters and buses
SAFE = 0.999  # share of the least error that rounding and the rank leave of it
FINE, WIDE = 2e-5, 2e-3  # s: of the search, and of the slope at its end
USUAL = 50  # fits that the search takes where it finds an offset
NEAR = 3  # trials that come first where no offset is expected
GAIN = 0.005  # share of the error that a time offset must remove to be accepted
SURE = 3.0  # standard errors that it must differ from zero by


@dataclass(frozen=True)
class TimeOffset(Note):
    """Positions are stamped ``seconds`` later than the torque; training errors (%) without and with correction.

    ``std`` (s) is the standard error, that of the best offset where none is significant; None where it is not known.
    ``gain`` is that of the best offset in cross-validation, None where another reason refused it.
    """

    severity: ClassVar[Severity] = Severity.INFO
    seconds: float
    before: float
    after: float
    std: float | None = None
    gain: Gain | None = None


@dataclass(frozen=True)
class Pairing:
    """The smoother that pairs torque and motion, with its ``choice`` and ``time_offset`` where they were estimated."""

    smoother: Smoother
    choice: Choice | None = None
    time_offset: TimeOffset | None = None


def pair(
    model: Model,
    logs: Sequence[Log],
    smoothers: Sequence[Smoother],
    time_offset: float | Literal["estimate"],
    estimator: Estimator,
    min_speed: tuple[float, ...] | None = None,
    *,
    executor: Executor | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> Pairing:
    """Return the smoother, chosen among ``smoothers`` and shifted in time, that pairs torque and motion.

    Of several smoothers ``choose_smoother`` takes one, on the ``executor``, before the time offset is known and again
    with it. One that shifts already keeps its shift where no other predicts better.
    """
    choice: Choice | None = None
    known: dict[int, tuple[Motion, ...]] = {}

    def chosen(candidates: Sequence[Smoother]) -> Smoother:
        if len(candidates) == 1:
            return candidates[0]
        nonlocal choice
        choice = choose_smoother(model, logs, candidates, progress=progress, known=known, executor=executor)
        return choice.smoother

    if time_offset != "estimate":
        late = [TimeShifted(unshifted(one), time_offset) for one in smoothers] if time_offset else smoothers
        return Pairing(chosen(late), choice)
    best = chosen(smoothers)
    earlier = best.time_offset if isinstance(best, TimeShifted) else 0.0
    progress(Step("estimating the time offset"))
    some = excerpts(logs)
    motions = [model.remembering(one) for one in known.get(id(best)) or [motion_of(best, log) for log in some]]
    usable = [k for k, one in enumerate(motions) if fitted(one).any()]  # not a log that is excluded wholly
    some, motions = [some[k] for k in usable], [motions[k] for k in usable]

    def again(theta: Array) -> Sequence[Sequence[Motion]]:
        return repeated(model, some, motions, best, theta)

    found = find_time_offset(model, motions, estimator, min_speed, repeat=again, progress=progress)
    if found.seconds:
        best = chosen([TimeShifted(unshifted(one), earlier + found.seconds) for one in smoothers])
    return Pairing(best, choice, replace(found, seconds=earlier + found.seconds))


def find_time_offset(
    model: Model,
    motions: Sequence[Motion],
    estimator: Estimator,
    min_speed: tuple[float, ...] | None = None,
    repeat: Callable[[Array], Sequence[Sequence[Motion]]] = lambda _: (),
    progress: Callable[[str], None] = lambda _: None,
) -> TimeOffset:
    """Return the time offset, within 32 ms, at which the estimator explains the unfiltered torque of the motions best.

    It is zero where it removes less than 0.5 % of the error, is below three standard errors, or gains no more than one
    standard error in cross-validation, as what imitates a torque that the model lacks; and where the best value is
    beyond the range, which indicates another fault. Noise in the motion, which is less between samples, and
    accelerations that a smoother attenuates can look like an offset: ``repeat`` (p to sets of motions) gives motions
    without an offset and their torque for the parameters found, and what is found in these is subtracted; where that or
    what is left is beyond the range, the offset is zero. ``min_speed`` (n) is that of the fit, and of the speed without
    offset, so that all trials have the same samples; ``progress`` is called with each trial. Raises the errors of
    ``Regression`` and the estimator.
    """
    rows = subsample(motions, trial_samples(model), TRIALS[-1])
    if sum(map(len, rows)) < FEWEST:
        return TimeOffset(0.0, np.nan, np.nan)
    fast, trials = quick(estimator), count(1)
    motions = _fast_enough(motions, min_speed)

    def errors_of(motions: Sequence[Motion]) -> tuple[Callable[[float], float], Callable[[float], float]]:
        """Return the error at an offset, and less than any parameters leave there."""
        at = cache(lambda time_offset: Regression(model, _shifted(motions, rows, time_offset)))

        def error(time_offset: float) -> float:
            done = next(trials)
            progress(Step("estimating the time offset", done, max(done, USUAL)))
            return _error(at(time_offset), fast)

        return error, lambda time_offset: SAFE * _error(at(time_offset), LeastSquares())

    error, floor = errors_of(motions)
    best, after, before = _least(error, TRIALS, floor)
    if np.isnan(best):
        return TimeOffset(0.0, before, before)
    std = _offset_std(model, motions, rows, best, fast)
    none = TimeOffset(0.0, before, before, std)
    if not after < (1.0 - GAIN) * before or abs(best) < SURE * std:
        return none
    at = _shifted(motions, rows, best)
    theta = called(fast, Problem(model, at, Regression(model, at)), Estimate).value
    invented = [_least(found, TRIALS[:NEAR], least)[0]
                for found, least in (errors_of(_fast_enough(one, min_speed)) for one in repeat(theta))]  # fmt: skip
    if not np.isfinite(invented).all():  # smoothing alone shows one beyond the range: nothing is known of this one
        return none
    if invented:  # either sign is as likely where it is noise that is less between samples
        best, std = best - float(np.mean(invented)), float(np.hypot(std, np.std(invented)))
    after = error(best)
    if not (after < (1.0 - GAIN) * before and SURE * std <= abs(best) <= MOST):
        return replace(none, std=std)
    gain = gain_of(model, _shifted(motions, rows, 0.0), _shifted(motions, rows, best))
    return TimeOffset(best, before, after, std, gain) if gain.sure else replace(none, std=std, gain=gain)


def _fast_enough(motions: Sequence[Motion], min_speed: tuple[float, ...] | None) -> list[Motion]:
    """Return the motions that keep for the fit what is as fast as ``min_speed`` (n)."""
    return [one if min_speed is None else replace(one, keep=fitted_rows(one, min_speed)) for one in motions]


def _least(
    error: Callable[[float], float],
    trials: Sequence[float] = TRIALS,
    floor: Callable[[float], float] = lambda _: 0.0,
) -> tuple[float, float, float]:
    """Return the offset with the least error, nan beyond the range, its error, and that without offset.

    It lies beside the best of the trials; where that is the last, all are tried. ``floor`` is quick, and never above
    the error.
    """
    from scipy.optimize import minimize_scalar

    known = _tried(error, floor, [sign * trial for trial in trials for sign in ((-1.0, 1.0) if trial else (1.0,))])
    best, before = min(known, key=lambda trial: known[trial]), known[0.0]
    if abs(best) == trials[-1]:
        return (np.nan, before, before) if trials is TRIALS else _least(error, TRIALS, floor)

    def squared(x: float) -> float:  # nearly a parabola, of which a few values are enough
        trial = start.get(x, float(x) - 1.0)
        known[trial] = known[trial] if trial in known else error(trial)
        return known[trial] ** 2

    ordered = sorted(known)
    low, high = (ordered[ordered.index(best) + side] for side in (-1, 1))
    if known[low] > known[best] < known[high]:
        start = {1.0 + trial: trial for trial in (low, best, high)}  # the precision is relative to the unknown
        minimize_scalar(squared, tuple(start), method="brent", options={"xtol": FINE})
        best = float(min(known, key=lambda trial: known[trial]))
    return (best, known[best], before) if abs(best) <= MOST else (np.nan, before, before)


def _tried(
    error: Callable[[float], float], floor: Callable[[float], float], trials: Sequence[float]
) -> dict[float, float]:
    """Return the errors of the best of the trials, of those beside it, and of none; of others the floor, where that is
    above the best."""
    found = {trial: floor(trial) for trial in trials}
    ordered, exact = sorted(found), set[float]()
    while True:
        best = min(found, key=lambda trial: found[trial])
        k = ordered.index(best)
        if not (due := [one for one in (best, 0.0, *ordered[max(k - 1, 0) : k + 2]) if one not in exact]):
            return found
        found[due[0]] = error(due[0])
        exact.add(due[0])


def _shifted(motions: Sequence[Motion], rows: Sequence[NDArray[np.intp]], time_offset: float) -> tuple[Motion, ...]:
    return tuple(one.shifted(time_offset, keep) for one, keep in zip(motions, rows, strict=True) if len(keep) > 1)


def _offset_std(
    model: Model,
    motions: Sequence[Motion],
    rows: Sequence[NDArray[np.intp]],
    best: float,
    estimator: Estimator,
) -> float:
    """Return the standard error (s) of a time offset, for correlated residuals; inf where the torque does not show it.

    It is that of the zero of f', for f half the sum of squares e'e that the estimator leaves: sqrt(S) / f'', with S the
    long-run covariance of the samples' shares in f'. Derivatives are differences over a few ms, over which noise in the
    motion counts for nothing in f''.
    """
    step = max(float(np.median(np.diff(one.t))) for one in motions)
    wide = step * float(np.ceil(WIDE / step))  # whole samples: between two, interpolation makes noise less
    late, at, early = (
        _squares(model, _shifted(motions, rows, best + side * wide), estimator) for side in (1.0, 0.0, -1.0)
    )
    curvature = (sum(map(np.sum, late)) + sum(map(np.sum, early)) - 2 * sum(map(np.sum, at))) / (2 * wide**2)
    shares = [(a - b)[:, None] / (4 * wide) for a, b in zip(late, early, strict=True)]
    return float(np.sqrt(long_run(shares)[0, 0]) / curvature) if curvature > 0 else np.inf


def _squares(model: Model, motions: tuple[Motion, ...], estimator: Estimator) -> list[Array]:
    """Return what the estimator leaves of the torque, squared and summed over the joints, for each motion (N)."""
    value = called(estimator, Problem(model, motions, Regression(model, motions)), Estimate).value
    left = [one.tau - model.torque(**one.states(), theta=value) for one in motions]
    return [np.square(e * fitted(one)).sum(axis=1) for e, one in zip(left, motions, strict=True)]


def _error(regression: Regression, estimator: Estimator) -> float:
    """Return the relative error (%) of the fit to the regression's own rows."""
    triangular = regression.triangular_factors
    value = called(estimator, Problem(regression.model, regression.motions, regression), Estimate).value
    torque = float(np.square(triangular.factors[:, :, -1]).sum())
    return 100.0 * float(np.sqrt(triangular.residual(value).sum() / torque)) if torque > 0 else 0.0


def trial_samples(model: Model) -> int:
    """Return the number of samples of all motions to use in a trial."""
    return ENTRIES // max(len(model.parameters), 10)
