"""Identification from recordings too long for the memory: all is chosen on excerpts, then all samples are fitted.

Least squares needs of any number of samples only their triangular factors. Pieces of the recordings, each smoothed with
some samples around it so that the motion is that of the whole (``overlap``), are reduced one by one, by any process;
their factors merge to those of the whole, and give standard errors that allow for any correlation within a piece.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ConfigError, InputError, ModelError, Note, Severity, brief, called
from dynident.estimators import Estimate, Pieces, Problem, needs_samples
from dynident.estimators.notes import MotionCorrected, MotionLimits, MotionTooNoisy
from dynident.identification.division import USUAL, Division, LongRecording, Span, excerpts_of, spans_of
from dynident.identification.identify import FAR, identify, judged, warnings_of
from dynident.identification.motion_errors import SAMPLES
from dynident.identification.outliers import held_out_outliers
from dynident.identification.recipe import Recipe
from dynident.identification.reducer import Reduced, Reducer
from dynident.identification.repetition import credible_share, pieces_of
from dynident.identification.rests import Rests
from dynident.identification.result import Identification, Sources, versions
from dynident.identification.role_logs import NotFitted, RoleLogs, not_judged, substituted
from dynident.identification.sampled_bias import sampled_bias
from dynident.identification.standard_errors import covariance_of_time_offset, identifiability_of
from dynident.log import Log, Motion
from dynident.models import Model
from dynident.regression import (
    Regression,
    TriangularFactors,
    base_parameters,
    merged,
    one_thread,
    unpacked,
)
from dynident.smoothers import Smoother, as_used, overlap
from dynident.splines import NORMAL_95
from dynident.validation import check_mass, clustered_std, smoothed_away

__all__ = ["InPieces", "Prepared", "finished", "prepared"]

Array = NDArray[np.float64]
FORGETS = 10.0  # s before a piece from which terms that remember are followed


@dataclass(frozen=True)
class InPieces(Note):
    """``samples`` of recordings of ``seconds`` were fitted in ``pieces``; all that was chosen, and the errors and
    figures of the training, are of ``excerpts``. ``joint`` has the largest ``error`` (%) over all of them."""

    severity: ClassVar[Severity] = Severity.INFO
    samples: int
    seconds: float
    pieces: int
    excerpts: int
    joint: str
    error: float


@dataclass(frozen=True, eq=False)
class Prepared:
    """What is to be done with all pieces: ``reducer(span)`` for each of ``spans``; how that was ``chosen`` on
    ``logs``, the excerpts."""

    chosen: Identification
    logs: Mapping[str, Log]
    reducer: Reducer
    spans: tuple[Span, ...]
    lost: int

    __repr__ = brief


def prepared(
    model: Model,
    recordings: Sequence[LongRecording],
    recipe: Recipe,
    division: Division = USUAL,
    progress: Callable[[str], None] = lambda _: None,
) -> Prepared:
    """Choose all that the recipe leaves to the data on excerpts of the recordings, and plan the pieces.

    Raises the errors of ``identify``, and ConfigError for an estimator that needs all samples at once or a smoother to
    which samples matter that are far away.
    """
    if needs_samples(recipe.estimator):
        raise _all_at_once(recipe)
    logs = {log.source: log for log in excerpts_of(recordings, division, progress)}
    chosen = identify(model, logs, (), recipe, progress=progress)
    if chosen.estimate.needs_samples:
        raise _all_at_once(recipe)
    smoother, log, motion = _fixed(chosen, logs)
    step = float(np.median(np.diff(log.t)))
    around = overlap(smoother, log, motion)
    if motion.memory is not None:
        around += round(FORGETS / step)
    if (low := chosen.recipe.filter) is not None:
        around += low.pad(low.sections(motion))
    used = replace(chosen.recipe, smoother=smoother)
    within = [note for note in chosen.notes if isinstance(note, Rests) and note.within]
    leave = recipe.rests == "trim" and (not within or any(note.left_out for note in within))
    spans, lost = spans_of(recordings, division, around)
    if not spans:
        raise InputError(f"{recordings[0].label}: no stretch without a gap is long enough to be smoothed.")
    reducer = Reducer(chosen.model, used, tuple(recordings), leave, chosen.estimate.value, _credible(chosen, logs))
    return Prepared(chosen, logs, reducer, spans, lost)


def _all_at_once(recipe: Recipe) -> ConfigError:
    return ConfigError(
        f"estimator: {type(recipe.estimator).__name__} needs all samples at once, which are too many for the memory; "
        "take least_squares, ridge, or consistent without such a `fit`, or a shorter part."
    )


def finished(
    found: Prepared,
    pieces: Sequence[Reduced],
    validation: Mapping[str, Log] | Sequence[Log] = (),
    progress: Callable[[str], None] = lambda _: None,
) -> Identification:
    """Return the identification from all pieces, in the order of the spans, judged on excerpts and held-out logs.

    Raises the errors of ``identify``.
    """
    with one_thread():
        return _finished(found, pieces, validation, progress)


def _finished(
    found: Prepared,
    pieces: Sequence[Reduced],
    validation: Mapping[str, Log] | Sequence[Log],
    progress: Callable[[str], None],
) -> Identification:
    model, recipe = found.reducer.model, found.reducer.recipe
    speeds, (smoother,) = recipe.min_speeds([joint.name for joint in model.joints]), recipe.smoothers
    logs = RoleLogs.of(found.logs, validation, recipe, tuple(joint.name for joint in model.joints))
    motions, resting = logs.motions(model, smoother, recipe, progress)
    fitted = tuple(map(model.remembering, motions["train"].values()))
    sample = Regression(model, fitted, recipe.filter, speeds)

    def parts() -> Iterator[TriangularFactors]:
        return (unpacked(one.factors, one.rows, model.structure) for one in pieces)

    progress("estimating")
    whole = sample.with_factors(merged(parts()))
    problem = Problem(model, fitted, whole, logs.fitted(motions), fitted[0].time_offset, progress)
    clustered = partial(clustered_std, parts)
    estimate, whole, more, noted = _unbiased(problem, sample, found, pieces, clustered, progress)
    left = _left(found, pieces, parts(), whole, estimate)
    estimate = replace(estimate, residual=replace(estimate.residual, pieces=left))
    validations = judged(model, estimate, logs.trimmed, motions, recipe, progress)
    errors, base = identifiability_of(model, whole, estimate, more, progress, clustered, recipe.unfitted)
    return Identification(
        model,
        recipe,
        estimate,
        errors,
        base,
        validations,
        check_mass(model, estimate.value, [log.motion for log in validations]),
        found.chosen.calibration,
        Sources(versions=versions()),
        (
            _said(found, left, model),
            *warnings_of(model, estimate, base),
            *noted,
            *resting,
            *((NotFitted(recipe.unfitted),) if recipe.unfitted else ()),
            *not_judged(validations),
            *substituted(validations),
            *smoothed_away(validations),
            *(held_out_outliers(validations) if recipe.outliers == "mask" else ()),
        ),
    )


def _unbiased(
    problem: Problem,
    sample: Regression,
    found: Prepared,
    pieces: Sequence[Reduced],
    clustered: Callable[..., Array],
    progress: Callable[[str], None],
) -> tuple[Estimate, Regression, Array, tuple[Note, ...]]:
    """Return the estimate from all pieces, without the bias by errors of the motion that repetitions show where that
    is significant, and the regression it is of; the covariance (p, p) by the time offset and what is left of
    the bias, and what to note."""
    model, recipe, whole = problem.model, found.reducer.recipe, problem.regression
    estimate = called(recipe.estimator, problem, Estimate)
    late = covariance_of_time_offset(model, sample, estimate, found.chosen.calibration.time_offset)
    progress("repeating the smoothing")
    weights = estimate.residual.weights
    each = (one.repetitions(model.structure) for one in pieces)
    wrong = sampled_bias(each, model, np.ones(len(model.joints)) if weights is None else weights)
    if wrong is None:
        return estimate, whole, late, ()
    factor = whole.triangular_factors.stacked(weights)
    basis = base_parameters(factor, model.parameters)
    left = wrong.covariance + np.outer(wrong.remainder, wrong.remainder)
    small = estimate, whole, late + np.outer(wrong.bias, wrong.bias) + left, ()
    try:
        std = clustered(whole, estimate.value, weights, basis.independent)
    except ModelError:  # nearly dependent columns
        return small
    bias = np.abs(basis.to_base(wrong.bias))
    size = np.divide(bias, std, out=np.zeros_like(std), where=std > 0)
    worst = int(size.argmax()) if len(size) else 0
    if not len(size) or size[worst] <= NORMAL_95:
        return small
    p = len(wrong.bias)
    if np.linalg.norm(factor[:, :p] @ wrong.bias) >= FAR * np.linalg.norm(factor[:, :p] @ estimate.value):
        return estimate, whole, late, (MotionTooNoisy(basis.groupings[worst], float(size[worst])),)
    whole = whole.unbiased(wrong.bias)
    estimate = called(recipe.estimator, replace(problem, regression=whole), Estimate)
    wide = np.sqrt(np.einsum("ij,jk,ik->i", basis.combination, left, basis.combination))
    notes: tuple[Note, ...] = (MotionCorrected(basis.groupings[worst], float(size[worst])),)
    return estimate, whole, late + left, (*notes, *_limited(basis.groupings, wide, std))


def _limited(names: Sequence[str], wide: Array, std: Array) -> tuple[Note, ...]:
    """Return the note on standard errors that are mostly what is left of the bias by errors of the motion."""
    limited = np.flatnonzero(wide > std)
    if not len(limited):
        return ()
    worst = int(np.argmax(np.divide(wide, std, out=np.zeros_like(std), where=std > 0)))
    return (MotionLimits(names[worst], len(limited), len(names)),)


def _left(
    found: Prepared,
    pieces: Sequence[Reduced],
    parts: Iterator[TriangularFactors],
    whole: Regression,
    estimate: Estimate,
) -> Pieces:
    """Return what the estimate leaves of the torque in each piece."""
    value = estimate.value + (0.0 if whole.bias is None else whole.bias)
    sums = [(np.square(one.factors[:, :, -1]).sum(axis=1), one.residual(value)) for one in parts]
    rows = np.array([one.rows for one in pieces])
    torque, residual = (np.sqrt(np.array([one[k] for one in sums]) / np.maximum(rows, 1)) for k in (0, 1))
    labels = tuple(found.reducer.recordings[one.recording].label for one in found.spans)
    begins, ends = (np.array([getattr(one, name) for one in pieces]) for name in ("begins", "ends"))
    return Pieces(labels, begins, ends, rows, torque, residual)


def _said(found: Prepared, pieces: Pieces, model: Model) -> InPieces:
    samples = sum(one.stop - one.start for one in found.spans)
    seconds = float((pieces.ends - pieces.begins).sum())
    error = np.nan_to_num(pieces.relative_error)
    worst = int(error.argmax())
    return InPieces(samples, seconds, len(found.spans), len(found.logs), model.joints[worst].name, float(error[worst]))


def _credible(chosen: Identification, logs: Mapping[str, Log]) -> float:
    """Return the share of the noise of the positions that the residual of the excerpts allows."""
    model, theta, (smoother,) = chosen.model, chosen.estimate.value, chosen.recipe.smoothers
    share = min(1.0, SAMPLES / sum(map(len, logs.values())))
    recipe = chosen.recipe
    parts = [
        piece
        for one in chosen.validations
        for log in (recipe.repaired(recipe.trimmed(logs[one.name]), torque=True),)
        for piece in pieces_of(model, log, one.motion, smoother, theta, share)
    ]
    return credible_share(model, parts, theta, np.random.default_rng(0))


def _fixed(chosen: Identification, logs: Mapping[str, Log]) -> tuple[Smoother, Log, Motion]:
    """Return the smoother that smooths all pieces alike, as much as the excerpt in the middle, which is the log."""
    (smoother,) = chosen.recipe.smoothers
    widths = [np.mean(one.motion.smoothing.get("bandwidth", 0.0)) for one in chosen.validations]
    middle = chosen.validations[int(np.argsort(widths, kind="stable")[len(widths) // 2])]
    return as_used(smoother, middle.motion), logs[middle.name], middle.motion
