"""The time offset between torque and motion, found before a fit.

The parameters of the model are eliminated at every trial value (variable projection; Golub and Pereyra 1973), so that
the search has one unknown.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import count
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dynident.estimators.least_squares import joint_weights
from dynident.identification.calibration_std import calibration_std
from dynident.identification.cross_validation import Gain, motion_gain
from dynident.identification.repetition import repeat_recordings
from dynident.identification.smoother_choice import SmootherChoice, choose_by_joint, choose_smoother, cut_excerpts
from dynident.models import Model
from dynident.models.friction import Dahl
from dynident.motion.log import Log, Motion, subsample
from dynident.motion.smoothers import Smoother, TimeShifted, smooth_log, strip_time_offset
from dynident.regression import EVERYTHING, Regression, Selection, TriangularFactors, fitted_mask, fitted_rows, rank_of
from dynident.regression.whitening import long_run
from dynident.runtime import Note, Severity, Step, percent, report_progress, short
from dynident.runtime.arrays import Array

MAX_ENTRIES = 200_000  # samples of all logs together times parameters: one or two unknowns need no more
MIN_SAMPLES = 200  # least number of samples to estimate a time offset
# s, of either sign; the search refines the best up to the last but one
TRIAL_OFFSETS = (0.0, 0.001, 0.003, 0.01, 0.032, 0.05)
WIDE_OFFSETS = (*TRIAL_OFFSETS, 0.1, 0.15)  # s: those of a search beyond the usual range
MAX_USUAL_OFFSET = TRIAL_OFFSETS[-2]  # s: what is later has another cause than filters and buses
MIN_FILTER_LAG = 0.01  # s: shorter ones are of buses
SEARCH_STEP, SLOPE_STEP = 2e-5, 2e-3  # s: of the search, and of the slope at its end
MAX_NEWTON_STEPS, NEWTON_TOLERANCE = 5, 0.1  # steps that refine the search, and in standard errors the last one
EXPECTED_FITS = 50  # fits that the search takes where it finds an offset
NEAREST_TRIALS = 3  # trials that come first where no offset is expected
WEIGHT_ITERATIONS = 5  # of the weights of the joints
PRESLIDING_SHARES = (3e-3, 3e-2)  # of the range of a joint, over which friction builds up
MIN_ERROR_REDUCTION = 0.005  # share of the error that a time offset must remove to be accepted
MIN_WIDE_REDUCTION = 0.1  # where it is unusual, as friction that a model lacks looks like one, too
MIN_SIGNIFICANCE = 3.0  # standard errors that it must differ from zero by


class TimeOffset(Note):
    """Positions are stamped ``seconds`` later than the torque; training errors (%) without and with correction.

    ``std`` (s) is the standard error, that of the best offset where none is significant; None where it is not known.
    ``gain`` is that of the best offset in cross-validation, None where another reason refused it.
    """

    topic = "time offset"
    severity = Severity.INFO
    seconds: float
    before: float
    after: float
    std: float | None = None
    gain: Gain | None = None

    def __str__(self) -> str:
        error = np.inf if self.std is None else 1e3 * self.std
        has_error = bool(np.isfinite(error))
        if not self.seconds:
            if self.gain is not None:
                return f"no time offset, as the best one does not predict left-out stretches better: {self.gain}"
            uncertainty = f" significantly; its standard error would be {short(error, 2)} ms" if has_error else ""
            return f"no time offset, as none lowers the training error ({percent(self.before)}){uncertainty}"
        lagging, leading = ("positions", "torques") if self.seconds > 0 else ("torques", "positions")
        size = f"{short(1e3 * abs(self.seconds), 2)}" + (f" +- {short(error, 1)}" if has_error else "")
        is_usual = abs(self.seconds) <= MAX_USUAL_OFFSET
        large = ", which is more than filters and buses take: look for two clocks or a buffer"
        cause = self._filter if is_usual else large
        return (
            f"{lagging} are stamped {size} ms later than {leading}{cause}; correcting this lowers the "
            f"training error from {percent(self.before)} to {percent(self.after)}"
        )

    @property
    def _filter(self) -> str:
        """What else delays by so much: in slow motion a filter of first order cannot be told from late stamps."""
        if abs(self.seconds) < MIN_FILTER_LAG:
            return ""
        commanded = " (or the positions are commanded ones)" if self.seconds < 0 else ""
        return f", or low-passed at about {short(1.0 / (2 * np.pi * abs(self.seconds)), 2)} Hz{commanded}"


@dataclass(frozen=True)
class Alignment:
    """The smoother that aligns torque and motion, with its ``choice`` and ``time_offset`` where they were estimated."""

    smoother: Smoother
    choice: SmootherChoice | None = None
    time_offset: TimeOffset | None = None


def align_motion(
    model: Model,
    logs: Sequence[Log],
    smoothers: Sequence[Smoother],
    time_offset: float | Literal["estimate"],
    selection: Selection = EVERYTHING,
    *,
    executor: Executor | None = None,
    cache: dict[int, tuple[Motion, ...]] | None = None,
    by_joint: bool = False,
    presliding: bool = True,
) -> Alignment:
    """Return the smoother, chosen among ``smoothers`` and shifted in time, that aligns torque and motion.

    Of several smoothers ``choose_smoother`` takes one, on the ``executor``, before the time offset is known and
    again with it, with ``by_joint`` then for each joint. One with a time offset of its own keeps it where no other
    predicts better. Torques that seem to be stamped late are aligned beside ``presliding`` friction, where the model
    lacks it. ``cache`` keeps the motions by each smoother, for another call.
    """
    choice: SmootherChoice | None = None
    motion_cache: dict[int, tuple[Motion, ...]] = {} if cache is None else cache

    def choose(candidates: Sequence[Smoother]) -> Smoother:
        if len(candidates) == 1:
            return candidates[0]
        nonlocal choice
        choice = choose_smoother(model, logs, candidates, motion_cache=motion_cache, executor=executor)
        return choice.smoother

    def shift_smoothers(time_offset: float) -> list[Smoother]:
        return [TimeShifted(strip_time_offset(smoother), time_offset) for smoother in smoothers]

    def smooth_by_joint(best: Smoother) -> Smoother:
        nonlocal choice
        if choice is None or not by_joint:
            return best
        choice = choose_by_joint(model, logs, choice, motion_cache)
        return choice.smoother

    if time_offset != "estimate":
        best = smooth_by_joint(choose(shift_smoothers(time_offset) if time_offset else smoothers))
        return Alignment(best, choice)
    # Without an offset first: the smoother must be known before torque and motion can be aligned.
    best = choose(smoothers)
    earlier_offset = best.time_offset if isinstance(best, TimeShifted) else 0.0
    report_progress(Step("estimating the time offset"))
    excerpt_logs = cut_excerpts(logs)
    smoothed = list(motion_cache.get(id(best)) or [smooth_log(best, log) for log in excerpt_logs])
    usable = [k for k, motion in enumerate(smoothed) if fitted_mask(motion).any()]  # not a log that is excluded wholly
    excerpt_logs, smoothed = [excerpt_logs[k] for k in usable], [smoothed[k] for k in usable]

    def estimate_offset(model: Model) -> TimeOffset:
        motions = [model.remembering(motion) for motion in smoothed]
        repeat = partial(repeat_recordings, model, excerpt_logs, motions, best)
        return find_time_offset(model, motions, selection, repeat)

    estimate = estimate_offset(model)
    # friction that builds up after a reversal looks like torques that are stamped late
    if estimate.seconds < 0 and presliding:
        estimate = estimate_offset(add_presliding(model, smoothed))
    if estimate.seconds:
        best = choose(shift_smoothers(earlier_offset + estimate.seconds))
    best = smooth_by_joint(best)  # once, with the offset
    return Alignment(best, choice, replace(estimate, seconds=earlier_offset + estimate.seconds))


def add_presliding(model: Model, motions: Sequence[Motion]) -> Model:
    """Return the model with Dahl friction of two lengths, which looks like late torques, itself where it has some."""
    reach = np.max([np.ptp(motion.q, axis=0) for motion in motions], axis=0, initial=0.0)
    lengths = {joint.name: float(r) for joint, r in zip(model.joints, reach, strict=True) if r > 0}
    if not lengths or any(isinstance(term, Dahl) for term in model.terms):
        return model
    for share in PRESLIDING_SHARES:
        length, names = {name: share * r for name, r in lengths.items()}, tuple(f"{share} {name}" for name in lengths)
        model = model.with_terms(Dahl(model.joints, on=tuple(lengths), names=names, length=length))
    return model


def find_time_offset(
    model: Model,
    motions: Sequence[Motion],
    selection: Selection = EVERYTHING,
    repeat: Callable[[Array], Iterable[Sequence[Motion]]] = lambda _: (),
) -> TimeOffset:
    """Find the time offset at which weighted least squares explains the unfiltered torque of the motions best.

    It is sought within 32 ms, then within 100 ms (``WIDE_OFFSETS``). It is zero where it removes less than 0.5 % of
    the error, is below three standard errors, or gains no more than one standard error in cross-validation, as it
    does where it imitates a torque that the model lacks; and where the best value is beyond the range, which
    indicates another fault.

    Noise in the motion, which is less between samples, and accelerations that a smoother attenuates can look like
    an offset. ``repeat`` (p to sets of motions) returns motions without an offset and their torque for the
    estimated parameters; the offset that is found in these is subtracted. Where it or the remainder is beyond the
    range, the offset is zero. Raises the errors of ``Regression``.
    """
    estimate = _find_within(TRIAL_OFFSETS, model, motions, selection, repeat)
    if np.isnan(estimate.seconds):  # a buffer, or two clocks, delay it more than filters do
        wide_estimate = _find_within(WIDE_OFFSETS, model, motions, selection, repeat)
        is_clear = wide_estimate.after < (1.0 - MIN_WIDE_REDUCTION) * wide_estimate.before
        estimate = wide_estimate if abs(wide_estimate.seconds) > 0 and is_clear else replace(estimate, seconds=0.0)
    return estimate


def _find_within(
    trials: tuple[float, ...],
    model: Model,
    motions: Sequence[Motion],
    selection: Selection,
    repeat: Callable[[Array], Iterable[Sequence[Motion]]],
) -> TimeOffset:
    """Return the time offset within the last but one of the ``trials``, nan where the best is beyond."""
    rows = subsample(motions, trial_samples(model), trials[-1])
    if sum(map(len, rows)) < MIN_SAMPLES:
        return TimeOffset(0.0, np.nan, np.nan)
    fits = count(1)
    # Which samples are slow is decided once: an error over other samples could not be compared.
    motions = _keep_fast(motions, selection)
    aligned = Regression(model, _shift(motions, rows, 0.0)).triangular_factors
    directions = rank_of(aligned.stack(), model.parameters).determined_directions
    fit = _OffsetFit(model, rows, directions, joint_weights(aligned, "per_joint", WEIGHT_ITERATIONS, model.parameters))

    def error_of(motions: Sequence[Motion]) -> Callable[[float], float]:
        """Return the weighted training error as a function of the offset."""

        @cache
        def error(time_offset: float) -> float:
            fit_number = next(fits)
            report_progress(Step("estimating the time offset", fit_number, max(fit_number, EXPECTED_FITS)))
            return training_error(*fit.solve(fit.shift(motions, time_offset)), fit.weights)

        return error

    error = error_of(motions)
    aligned_error = training_error(*fit.solve(fit.shift(motions, 0.0)))  # as it is told: without weights
    before, (best, after) = error(0.0), _minimise_error(error, trials, trials)
    if np.isnan(best):
        return TimeOffset(np.nan, aligned_error, aligned_error)
    refined, std = fit.refine(motions, best)
    # signs of velocities and noise of the motion make waves, of which the search takes the deepest: the value that the
    # slope gives is better, unless it fits clearly worse
    takes_slope = error(refined) < (1.0 + MIN_ERROR_REDUCTION) * after
    if takes_slope:
        best, after = refined, error(refined)
    std = max(std, fit.std(motions, best))
    no_offset = TimeOffset(0.0, aligned_error, aligned_error, std)
    if not after < (1.0 - MIN_ERROR_REDUCTION) * before or abs(best) < MIN_SIGNIFICANCE * std:
        return no_offset
    # The same search in repetitions with a known offset of zero shows what smoothing alone makes.
    _, theta = fit.solve(fit.shift(motions, best))
    spurious_offsets = []
    for repeated_motions in repeat(theta):
        fast = _keep_fast(repeated_motions, selection)
        offset, _ = _minimise_error(error_of(fast), trials[:NEAREST_TRIALS], trials)
        if takes_slope and np.isfinite(offset):
            offset, _ = fit.refine(fast, offset)
        spurious_offsets.append(offset)
    if not np.isfinite(spurious_offsets).all():  # smoothing alone shows one beyond the range
        return no_offset
    if count_repeated := len(spurious_offsets):  # what they share is of the smoother; how they differ is chance
        best -= float(np.mean(spurious_offsets))
        std = float(np.hypot(std, np.std(spurious_offsets) / np.sqrt(count_repeated)))
    if not (error(best) < (1.0 - MIN_ERROR_REDUCTION) * before and MIN_SIGNIFICANCE * std <= abs(best) <= trials[-2]):
        return replace(no_offset, std=std)
    shifted = fit.shift(motions, best)
    gain = motion_gain(model, fit.shift(motions, 0.0), shifted)
    estimate = TimeOffset(best, aligned_error, training_error(*fit.solve(shifted)), std, gain)
    return estimate if gain.sure else replace(no_offset, std=std, gain=gain)


def _keep_fast(motions: Sequence[Motion], selection: Selection) -> list[Motion]:
    """Return the motions of which the fit leaves out samples slower than ``min_speed`` (n)."""
    if selection.min_speed is None:
        return list(motions)
    return [replace(motion, keep=fitted_rows(motion, selection.min_speed)) for motion in motions]


def _minimise_error(
    error: Callable[[float], float],
    trials: Sequence[float] = TRIAL_OFFSETS,
    all_trials: Sequence[float] = TRIAL_OFFSETS,
) -> tuple[float, float]:
    """Return the offset of least error, nan beyond the range, and its error.

    It lies next to the best of the trials; where that is the last, ``all_trials`` are tried.
    """
    from scipy.optimize import minimize_scalar

    errors = {side * trial: error(side * trial) for trial in trials for side in ((-1.0, 1.0) if trial else (1.0,))}
    # Start from the best trial; Brent's method then needs a bracket around it.
    best = min(errors, key=lambda trial: errors[trial])
    if abs(best) == trials[-1]:
        return (np.nan, errors[best]) if trials is all_trials else _minimise_error(error, all_trials, all_trials)

    def squared_error(x: float) -> float:  # nearly a parabola, of which a few values are enough
        trial = start.get(x, float(x) - 1.0)
        errors[trial] = error(trial)
        return errors[trial] ** 2

    ordered = sorted(errors)
    low, high = (ordered[ordered.index(best) + side] for side in (-1, 1))
    if errors[low] > errors[best] < errors[high]:
        start = {1.0 + trial: trial for trial in (low, best, high)}  # the precision is relative to the unknown
        minimize_scalar(squared_error, tuple(start), method="brent", options={"xtol": SEARCH_STEP})
        best = float(min(errors, key=lambda trial: errors[trial]))
    return best if abs(best) <= all_trials[-2] else np.nan, errors[best]


def _shift(motions: Sequence[Motion], rows: Sequence[NDArray[np.intp]], time_offset: float) -> tuple[Motion, ...]:
    return tuple(motion.shift(time_offset, keep) for motion, keep in zip(motions, rows, strict=True) if len(keep) > 1)


@dataclass(frozen=True, eq=False)
class _OffsetFit:
    """Least squares of a ``model`` to the ``rows`` of shifted motions, along the ``directions`` (p, r) alone.

    Directions that the data do not determine would be fitted to noise, and a rank takes longer than this fit. Joints
    count by their ``weights`` (n): what the model lacks at one of them must not move the offset.
    """

    model: Model
    rows: Sequence[NDArray[np.intp]]
    directions: Array
    weights: Array

    def shift(self, motions: Sequence[Motion], time_offset: float) -> tuple[Motion, ...]:
        """Return the rows of the motions at an offset."""
        return _shift(motions, self.rows, time_offset)

    def solve(self, shifted: tuple[Motion, ...]) -> tuple[TriangularFactors, Array]:
        """Return the factors of shifted motions, and the parameters (p)."""
        from scipy.linalg import lstsq

        triangular = Regression(self.model, shifted).triangular_factors
        factor = triangular.stack(self.weights)
        solution = lstsq(factor[:, :-1] @ self.directions, factor[:, -1], lapack_driver="gelsy")[0]
        return triangular, np.asarray(self.directions @ solution)

    def residuals(self, shifted: tuple[Motion, ...]) -> list[Array]:
        """Return the weighted residual (n, N) that is fitted, of each motion."""
        _, value = self.solve(shifted)
        pairs = ((motion, motion.tau - self.model.torque(**motion.states(), theta=value)) for motion in shifted)
        return [(residual * fitted_mask(motion) * self.weights).T for motion, residual in pairs]

    def refine(self, motions: Sequence[Motion], best: float) -> tuple[float, float]:
        """Return the offset (s) next to the best at which f' is zero, and its standard error; inf where there is none.

        With f half the sum of squares e'e that the fit leaves, a step of Newton's method is -f' / f'', and the
        standard error is sqrt(S) / f'', with S the long-run covariance of the samples' shares in f'. Derivatives are
        differences over a few ms, over which noise in the motion counts for nothing.
        """
        h, offset, std = _slope_step(motions), best, np.inf
        for _ in range(MAX_NEWTON_STEPS):
            forward, central, backward = (
                [np.square(e).sum(axis=0) for e in self.residuals(self.shift(motions, offset + side * h))]
                for side in (1.0, 0.0, -1.0)
            )
            # Second difference for the curvature, central differences of the samples for the scores.
            later, here, earlier = (sum(map(np.sum, squares)) for squares in (forward, central, backward))
            curvature = float(later + earlier - 2 * here) / (2 * h**2)
            if not curvature > 0:
                return best, np.inf
            scores = [(a - b)[:, None] / (4 * h) for a, b in zip(forward, backward, strict=True)]
            std = float(np.sqrt(long_run(scores)[0, 0]) / curvature)
            step = -float(later - earlier) / (4 * h) / curvature
            if abs(offset + step - best) > h:  # no parabola: the search knows better
                return best, std
            offset += step
            if abs(step) < NEWTON_TOLERANCE * std:
                break
        return offset, std

    def std(self, motions: Sequence[Motion], offset: float) -> float:
        """Return the standard error (s) of an offset, with the slow noise that the fit took up."""
        h = _slope_step(motions)
        later, here, earlier = (self.shift(motions, offset + side * h) for side in (1.0, 0.0, -1.0))
        pairs = zip(self.residuals(later), self.residuals(earlier), strict=True)
        lines = [(forward - backward)[..., None] / (2 * h) for forward, backward in pairs]
        return float(calibration_std(lines, self.residuals(here), Regression(self.model, here), self.weights)[0])


def _slope_step(motions: Sequence[Motion]) -> float:
    """Return the step (s) of derivatives: whole samples, as between two interpolation makes the noise less."""
    interval = max(float(np.median(np.diff(motion.t))) for motion in motions)
    return interval * float(np.ceil(SLOPE_STEP / interval))


def training_error(triangular: TriangularFactors, value: Array, weights: Array | float = 1.0) -> float:
    """Return the relative error (%) of parameters (p) on triangular factors, with ``weights`` (n) of the joints."""
    errors, torques = (triangular.residual(theta) for theta in (value, np.zeros(len(value))))
    w, torque = np.square(weights), float((np.square(weights) * torques).sum())
    return 100.0 * float(np.sqrt((w * errors).sum() / torque)) if torque > 0 else 0.0


def trial_samples(model: Model) -> int:
    """Return the number of samples of all motions to use in a trial."""
    return MAX_ENTRIES // max(len(model.parameters), 10)
