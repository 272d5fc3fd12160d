"""Blocked cross-validation: the torque of stretches of time, predicted from the others."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynident.models import Model, Parameter
from dynident.motion.log import Log, Motion, spread_pieces, thin_motions
from dynident.motion.smoothers import Smoother, TimeShifted, smooth_log, strip_time_offset
from dynident.regression import (
    EVERYTHING,
    Reduction,
    Regression,
    Selection,
    TriangularFactors,
    fitted_mask,
    one_thread,
    precision,
    rank_of,
)
from dynident.runtime import ConfigError, InputError, Step, brief, part_text, percent, report_progress, short
from dynident.runtime.arrays import Array
from dynident.runtime.jobs import run_jobs

FOLDS = 10


@dataclass(frozen=True)
class Gain:
    """The ``share`` (%) of the squared cross-validated torque error that a change removes, and its standard error.

    Each joint counts by its own error, and the standard error is that of the sum over stretches of time.
    """

    share: float
    std: float

    @property
    def sure(self) -> bool:
        """Whether the error falls by more than one standard error."""
        return self.share > self.std

    def __str__(self) -> str:
        return f"{short(self.share, 2)} +- {short(self.std, 2)} % of the squared cross-validated error"


def motion_gain(model: Model, before: Sequence[Motion], after: Sequence[Motion], folds: int = FOLDS) -> Gain:
    """Return the gain in the cross-validated error from fitting the motions ``after`` instead of ``before``.

    Both have the same samples and are compared on those that both fit, so that neither wins by leaving samples
    out.
    """
    common = [fitted_mask(old) & fitted_mask(new) for old, new in zip(before, after, strict=True)]
    old, new = (
        left_out_errors(
            model, motions, [replace(motion, keep=keep) for motion, keep in zip(motions, common, strict=True)], folds
        )
        for motions in (before, after)
    )
    return gain_from_errors(old, new)


def gains_by_stretch(old: Array, new: Array) -> Array:
    """Return what each stretch (folds) adds to the gain (%) where squared errors (folds, n) fall from old to new."""
    size = np.where(old.sum(axis=0) > 0, old.sum(axis=0), np.inf)
    # Each joint relative to its own error.
    return np.asarray(100.0 * ((old - new) / size).mean(axis=1))


def gain_from_errors(old: Array, new: Array) -> Gain:
    """Return the gain where the squared errors (folds, n) of left-out stretches fall from ``old`` to ``new``."""
    stretches = gains_by_stretch(old, new)
    # The spread over the stretches gives the standard error of the sum.
    return Gain(float(stretches.sum()), float(np.sqrt(len(stretches)) * np.std(stretches, ddof=1)))


def left_out_errors(
    model: Model, motions: Sequence[Motion], test_motions: Sequence[Motion] | None = None, folds: int = FOLDS
) -> Array:
    """Return the squared torque error (folds, n) of each joint in stretches of time predicted from the others.

    Each motion is cut into ``folds`` stretches with equal numbers of usable samples. Joints are fitted relative
    to their torque. ``test_motions`` are the motions to predict, by default those that are fitted.
    """
    parts = factors_by_fold(model, motions, folds)
    return prediction_errors(
        parts, parts if test_motions is None else factors_by_fold(model, test_motions, folds), model.parameters
    )


def prediction_errors(
    train_folds: Sequence[TriangularFactors],
    test_folds: Sequence[TriangularFactors],
    parameters: Sequence[Parameter] = (),
    *,
    relative: bool = True,
) -> Array:
    """Return the squared errors (folds, n) of each of ``test_folds``, predicted from all other ``train_folds``.

    Joints are weighted by the inverse of their torque where ``relative``, else all alike.
    """
    size = np.sqrt(sum(np.square(fold.factors[:, :, -1]).sum(axis=1) for fold in train_folds))
    weights = np.divide(1.0, size, out=np.zeros_like(size), where=size > 0) if relative else None
    # Factors of the other folds merge by stacking, so that leaving a fold out needs no pass over the samples.
    stacked = np.stack([fold.stack(weights) for fold in train_folds])
    # What no fold determines is left out at once, so that there are fewer columns in what follows.
    total = np.asarray(np.linalg.qr(np.concatenate(stacked), mode="r"))
    directions = rank_of(total, parameters).determined_directions
    r = directions.shape[1]
    along = np.concatenate([stacked[:, :, :-1] @ directions, stacked[:, :, -1:]], axis=2)
    reduced = np.asarray(np.linalg.qr(along, mode="r"))
    others = np.stack([np.concatenate(np.delete(reduced, k, axis=0)) for k in range(len(reduced))])
    factors = np.asarray(np.linalg.qr(others, mode="r"))
    # least squares of least norm, without what the other folds do not determine
    U, s, Vt = np.linalg.svd(factors[:, :r, :r])
    inverse = np.divide(1.0, s, out=np.zeros_like(s), where=s > precision(parameters) * s[:, :1])
    values = directions @ np.einsum("kji,kj,klj,kl->ik", Vt, inverse, U, factors[:, :r, r], optimize=True)
    return np.stack([fold.residual(value) for fold, value in zip(test_folds, values.T, strict=True)])


def fold_numbers(motion: Motion, folds: int) -> NDArray[np.intp]:
    """Return the fold of each sample (N): equal shares of the usable ones, in order of time; -1 for all others."""
    numbers = np.full(len(motion), -1)
    for k, rows in enumerate(np.array_split(np.flatnonzero(motion.mask), folds)):
        numbers[rows] = k
    return numbers


def keep_fold(motion: Motion, k: int, folds: int) -> Motion:
    """Return the motion with only the k-th of ``folds`` equal shares of its usable samples in the mask."""
    return replace(motion, mask=fold_numbers(motion, folds) == k)


def factors_by_fold(
    model: Model,
    motions: Sequence[Motion],
    folds: int = FOLDS,
    selection: Selection = EVERYTHING,
    number_samples: Callable[[Motion, int], NDArray[np.intp]] = fold_numbers,
    extra_torques: Sequence[Array] = (),
) -> list[TriangularFactors]:
    """Return the triangular factors of the torque equations in each of ``folds`` parts of the motions.

    ``number_samples`` returns the fold of each sample, as ``fold_numbers`` does. ``extra_torques`` holds other torques
    (N, n, k) of each motion, which become columns after all others.
    """
    numbers = [number_samples(motion, folds) for motion in motions]
    structure = model.structure.append_columns(extra_torques[0].shape[2]) if extra_torques else model.structure
    parts = [Reduction(structure) for _ in range(folds)]
    regression = Regression(model, tuple(motions), selection.unfiltered)
    with one_thread():
        # The entries of all folds are computed together: a fold of many short stretches takes long by itself.
        for k, rows, block in regression.placed_blocks(model.structure, extra_torques=extra_torques):
            for fold in np.unique(numbers[k][rows]):
                if fold >= 0:
                    parts[fold].add(block.take(numbers[k][rows] == fold))
        return [part.factors() for part in parts]


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
    smoother = replace(candidates[0], factor=factor)
    shifted = choice.smoother
    return replace(
        choice, smoother=TimeShifted(smoother, shifted.time_offset) if isinstance(shifted, TimeShifted) else smoother
    )


def _differ_by_factor(candidates: Sequence[Any], factors: Sequence[object]) -> bool:
    """Return whether smoothers have factors, and are the same but for these."""
    if not all(isinstance(factor, int | float) for factor in factors) or len(candidates) < 2:
        return False
    return all(replace(candidate, factor=factors[0]) == candidates[0] for candidate in candidates)


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


def cross_validated_error(model: Model, motions: Sequence[Motion], folds: int = 5) -> float:
    """Return the relative torque error (%) of stretches of time predicted from the others, from triangular factors."""
    parts = factors_by_fold(model, motions, folds)
    total = sum(float(np.square(part.factors[:, :, -1]).sum()) for part in parts)
    squared_error = prediction_errors(parts, parts, model.parameters, relative=False).sum()
    return 100.0 * float(np.sqrt(squared_error / total)) if total > 0 else float("nan")
