"""The choice of the smoother, for all joints together and for each, by the cross-validated torque error."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynident.identification.cross_validation import (
    FOLDS,
    Gain,
    cross_validated_error,
    gain_from_errors,
    left_out_errors,
)
from dynident.models import Model
from dynident.motion.log import Log, Motion, spread_pieces, thin_motions
from dynident.motion.smoothers import Smoother, TimeShifted, smooth_log, strip_time_offset
from dynident.runtime import ConfigError, InputError, Step, brief, part_text, percent, report_progress
from dynident.runtime.arrays import Array
from dynident.runtime.jobs import run_jobs

MAX_SAMPLES, PIECES_PER_LOG = 40_000, 5  # of all logs together, and of each of them, that are smoothed to choose
REGRESSION_SAMPLES = 10_000  # samples of the regression on which the choice rests
MAX_TIE_DIFFERENCE = 0.005  # relative difference below which errors count as equal; the first candidate is then taken


@dataclass(frozen=True)
class SmootherChoice:
    """The first smoother with nearly the least cross-validated torque error, and the ``errors`` (%) of all candidates.

    The error of a candidate that cannot smooth these logs is infinite.
    """

    smoother: Smoother
    candidates: tuple[Smoother, ...]
    errors: tuple[float, ...]

    __repr__ = brief

    def __str__(self) -> str:
        pairs = zip(self.candidates, self.errors, strict=True)
        trials = "; ".join(
            f"{part_text(candidate)}: {percent(error) if np.isfinite(error) else 'cannot smooth these logs'}"
            for candidate, error in pairs
        )
        return f"{part_text(self.smoother)}, by the cross-validated torque error on the training logs ({trials})"


def choose_smoother(
    model: Model,
    logs: Sequence[Log],
    candidates: Sequence[Smoother],
    *,
    folds: int = 5,
    motion_cache: dict[int, tuple[Motion, ...]] | None = None,
    executor: Executor | None = None,
) -> SmootherChoice:
    """Choose the smoother whose motion lets least squares predict the torque of left-out stretches of time best.

    The position noise determines the best smoothing of the position, not of its derivatives, and only if it is
    white; the torque error measures the derivatives. Every log is divided into ``folds`` stretches; each is
    predicted from all others, over the samples that are reliable for every candidate, against the unfiltered
    torque. Of candidates within 0.5 % of the least error the first is taken: list them from the least smoothing
    to the most. ``motion_cache`` has the motions of the logs after ``cut_excerpts`` by the ``id`` of a smoother,
    and keeps new ones. The candidates smooth on the ``executor`` side by side, by default in this process, with
    the same result. Raises the first error where no candidate can smooth the logs, InputError where all torques
    are zero, ConfigError where there is no candidate.
    """
    if not candidates:
        raise ConfigError("no smoother is given to choose from.")
    excerpt_logs, cache = cut_excerpts(logs), {} if motion_cache is None else motion_cache
    if executor is not None:
        report_progress(Step("choosing the smoother"))
        _smooth_ahead(excerpt_logs, candidates, cache, executor)
    candidate_motions = _smooth_candidates(excerpt_logs, candidates, cache)
    masks = _common_masks([motions for motions in candidate_motions if not isinstance(motions, InputError)], 10 * folds)
    errors = []
    for k, motions in enumerate(candidate_motions):
        report_progress(Step("choosing the smoother", len(candidate_motions) + k, 2 * len(candidate_motions)))
        if isinstance(motions, InputError):
            errors.append(np.inf)
            continue
        # The same samples for every candidate, so that only the motion differs.
        pairs = zip(map(model.remembering, motions), masks, strict=True)
        common = thin_motions([replace(motion, mask=mask) for motion, mask in pairs], REGRESSION_SAMPLES)
        errors.append(cross_validated_error(model, common, folds))
    best_candidates = np.flatnonzero(np.array(errors) <= min(errors) * (1 + MAX_TIE_DIFFERENCE))
    if not len(best_candidates):
        raise InputError(
            f"{logs[0].source}: the torque is zero in every sample of every log, so that no smoother can be chosen by "
            "it; look whether the right torque column is named, and was recorded."
        )
    return SmootherChoice(candidates[int(best_candidates[0])], tuple(candidates), tuple(errors))


JOINT_STEPS = (1, 2, 4)  # to either side, from the candidate of all joints to one that is tried on a single joint
JOINT_SAMPLES = 4_000  # of the regressions by which the smoothing of single joints is chosen
# % of the squared error, and its standard errors, that another smoothing of one joint must gain
MIN_JOINT_GAIN, MIN_JOINT_GAIN_ERRORS = 1.0, 2.0


def choose_by_joint(
    model: Model,
    logs: Sequence[Log],
    choice: SmootherChoice,
    motion_cache: dict[int, tuple[Motion, ...]],
    folds: int = FOLDS,
) -> SmootherChoice:
    """Return the choice, with another of the ``factor`` of its candidates for joints that gain by it.

    Joint by joint the smoothing of other candidates is tried, and taken where left-out stretches of time are predicted
    better by more than two standard errors, each joint relative to its own torque. Candidates that differ in
    more than their ``factor`` leave the choice as it is. ``motion_cache`` has the motions by the candidates.
    """
    candidates: list[Any] = [strip_time_offset(candidate) for candidate in choice.candidates]
    factors = [getattr(candidate, "factor", None) for candidate in candidates]
    usable = np.isfinite(choice.errors)
    if len(model.joints) == 1 or not usable.all() or not _differ_by_factor(candidates, factors):
        return choice
    excerpt_logs = cut_excerpts(logs)
    all_motions = [_motions(candidate, excerpt_logs, motion_cache) for candidate in choice.candidates]
    masks = _common_masks(all_motions, 10 * folds)
    all_motions = [
        tuple(replace(motion, mask=mask) for motion, mask in zip(motions, masks, strict=True))
        for motions in all_motions
    ]
    if not model.memory:  # what friction remembers needs all samples, of the joints together
        all_motions = [thin_motions(motions, JOINT_SAMPLES) for motions in all_motions]

    def errors(index: Sequence[int]) -> Array:
        """Return the squared errors (folds, n) with the candidate of each joint, by its index."""
        motions = [_mix_joints(motions_of_log, index) for motions_of_log in zip(*all_motions, strict=True)]
        if model.memory:
            motions = list(thin_motions([model.remembering(motion) for motion in motions], JOINT_SAMPLES))
        return left_out_errors(model, motions, folds=folds)

    index = [choice.candidates.index(choice.smoother)] * len(model.joints)
    best = errors(index)
    for j in range(len(model.joints)):
        report_progress(Step("choosing the smoothing of the joints", j, len(model.joints)))
        trials, gains = dict[int, Array](), dict[int, Gain]()
        # of all on a side where the neighbour gains the best one is judged: neighbours differ by too little to be sure
        for step in (side * step for side in (-1, 1) for step in JOINT_STEPS):
            i, neighbour = index[j] + step, index[j] + int(np.sign(step))
            if not 0 <= i < len(candidates) or (i != neighbour and gains[neighbour].share <= 0):
                continue
            trials[i] = errors([*index[:j], i, *index[j + 1 :]])
            gains[i] = gain_from_errors(best, trials[i])
        i, gain = max(gains.items(), key=lambda entry: entry[1].share)
        if gain.share >= max(MIN_JOINT_GAIN, MIN_JOINT_GAIN_ERRORS * gain.std):
            index[j], best = i, trials[i]
    if len(set(index)) == 1:
        return replace(choice, smoother=choice.candidates[index[0]])
    factor = {joint.name: factors[i] for joint, i in zip(model.joints, index, strict=True)}
    smoother: Smoother = replace(candidates[0], factor=factor)
    if isinstance(choice.smoother, TimeShifted):
        smoother = TimeShifted(smoother, choice.smoother.time_offset)
    return replace(choice, smoother=smoother)


def _differ_by_factor(candidates: Sequence[Any], factors: Sequence[object]) -> bool:
    """Return whether smoothers have factors, and are the same but for these."""
    is_varied = len(candidates) > 1 and all(isinstance(factor, int | float) for factor in factors)
    return is_varied and all(replace(candidate, factor=factors[0]) == candidates[0] for candidate in candidates)


def _mix_joints(candidates: Sequence[Motion], index: Sequence[int]) -> Motion:
    """Return the motion of which each joint is that of its candidate."""
    q, dq, ddq = (
        np.stack([getattr(candidates[i], name)[:, j] for j, i in enumerate(index)], axis=1)
        for name in ("q", "dq", "ddq")
    )
    return replace(candidates[index[0]], q=q, dq=dq, ddq=ddq, memory=None)


@dataclass(frozen=True, eq=False)
class _Smoothing:
    """The work of a job: the motions of the logs by the smoother of a number."""

    smoothers: tuple[Smoother, ...]
    logs: tuple[Log, ...]

    def __call__(self, k: int) -> tuple[Motion, ...]:
        return tuple(smooth_log(self.smoothers[k], log) for log in self.logs)


def _smooth_ahead(
    logs: Sequence[Log], candidates: Sequence[Smoother], cache: dict[int, tuple[Motion, ...]], executor: Executor
) -> None:
    """Put the motions of the logs by each candidate into the cache, computed by workers.

    A candidate that fails is left for this process, where its error is raised.
    """
    unshifted = map(strip_time_offset, candidates)
    new_smoothers = tuple({id(smoother): smoother for smoother in unshifted if id(smoother) not in cache}.values())
    for outcome in run_jobs(_Smoothing(new_smoothers, tuple(logs)), range(len(new_smoothers)), executor):
        if outcome.value is not None:
            cache[id(new_smoothers[outcome.job])] = outcome.value


def _smooth_candidates(
    logs: Sequence[Log], candidates: Sequence[Smoother], cache: dict[int, tuple[Motion, ...]]
) -> list[tuple[Motion, ...] | InputError]:
    """Return the motions of the logs by each candidate, or its error; raises the first error where all fail."""
    candidate_motions: list[tuple[Motion, ...] | InputError] = []
    for k, smoother in enumerate(candidates):
        report_progress(Step("choosing the smoother", k, 2 * len(candidates)))  # the errors come after
        try:
            candidate_motions.append(_motions(smoother, logs, cache))
        except InputError as error:
            candidate_motions.append(error)
    failed = [error for error in candidate_motions if isinstance(error, InputError)]
    if len(failed) == len(candidate_motions):
        raise failed[0]
    return candidate_motions


def _motions(smoother: Smoother, logs: Sequence[Log], cache: dict[int, tuple[Motion, ...]]) -> tuple[Motion, ...]:
    """Return the motions of the logs; a smoother with a time offset shifts the cached ones without it."""
    unshifted = strip_time_offset(smoother)
    if id(unshifted) not in cache:
        cache[id(unshifted)] = tuple(smooth_log(unshifted, log) for log in logs)
    motions = cache[id(unshifted)]
    return tuple(map(smoother.shift, motions)) if isinstance(smoother, TimeShifted) else motions


def _common_masks(candidate_motions: Sequence[tuple[Motion, ...]], min_samples: int) -> list[NDArray[np.bool_]]:
    """Return the samples of each log that are reliable for every candidate, or for any where too few are left."""
    both, either = (
        [combine.reduce([motion.mask for motion in motions]) for motions in zip(*candidate_motions, strict=True)]
        for combine in (np.logical_and, np.logical_or)
    )
    # the widest kernels may leave too little in common
    return both if all(mask.sum() >= min_samples for mask in both) else either


def cut_excerpts(logs: Sequence[Log]) -> list[Log]:
    """Return five pieces of each log, evenly spread, where the logs are long: enough to compare the smoothers."""
    share = min(1.0, MAX_SAMPLES / max(sum(map(len, logs)), 1))
    if share == 1.0:
        return list(logs)
    excerpt_logs = []
    for log in logs:
        if int(share * len(log) / PIECES_PER_LOG) < 1000:  # too short to smooth well
            excerpt_logs.append(log)
            continue
        parts = spread_pieces(slice(0, len(log)), PIECES_PER_LOG, share)
        excerpt_logs += [log.rows(part, f"{log.source} piece {k}") for k, part in enumerate(parts, start=1)]
    return excerpt_logs
