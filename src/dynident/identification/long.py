"""Identification from recordings too long for the memory: choices on excerpts, then a fit to all samples.

Least squares needs of any number of samples only their triangular factors. Pieces of the recordings, each
smoothed with some samples around it so that the motion is that of the whole (``overlap``), are reduced one by
one, by any process; their factors merge to those of the whole, and give standard errors that allow for any
correlation within a piece.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial

import numpy as np

from dynident.estimators import Estimate, Pieces, Problem
from dynident.estimators.notes import LimitedByMotion, MotionCorrected
from dynident.identification.calibration import Setup, choose_setup
from dynident.identification.dataset import Dataset
from dynident.identification.identify import ParameterFit, conclude, correct_bias
from dynident.identification.motion_errors import MAX_COVARIANCE_SAMPLES, MotionErrors, sampled_bias
from dynident.identification.pieces import (
    DEFAULT_DIVISION,
    DivisionSettings,
    LongRecording,
    PieceFactors,
    Reducer,
    Span,
    plan_spans,
    read_excerpts,
)
from dynident.identification.recipe import Recipe
from dynident.identification.repetition import credible_share, pieces_of
from dynident.identification.result import Identification
from dynident.identification.uncertainty import RobustStd, covariance_of_calibration
from dynident.models import Model
from dynident.motion.log import Log, Motion
from dynident.motion.smoothers import Smoother, overlap
from dynident.regression import (
    Regression,
    TriangularFactors,
    base_parameters,
    merge_factors,
    one_thread,
    unpack_factors,
)
from dynident.runtime import (
    ConfigError,
    InputError,
    ModelError,
    Note,
    Noun,
    Severity,
    call_part,
    percent,
    report_progress,
)
from dynident.runtime.arrays import Array
from dynident.validation import clustered_std

MEMORY_DURATION = 10.0  # s before a piece from which terms that remember are followed


class InPieces(Note):
    """The fit was in ``pieces`` of recordings of ``seconds`` with ``samples`` in all.

    All choices, and the errors and figures of the training, are those of ``excerpts``. ``joint`` has the largest
    ``error`` (%) over all pieces.
    """

    severity = Severity.INFO
    samples: int
    seconds: float
    pieces: int
    excerpts: int
    joint: str
    error: float

    def __str__(self) -> str:
        length = f"{self.seconds / 3600:.3g} h" if self.seconds >= 3600 else f"{self.seconds:.3g} s"
        return (
            f"all {self.samples:,} samples ({length}) are fitted, in {self.pieces} pieces; what was chosen before the "
            f"fit, and errors and figures of the training, are of {self.excerpts} excerpts. Over all samples the "
            f"largest error is that of {self.joint}, {percent(self.error)}"
        )


class PiecePlan(Noun):
    """The work on all pieces: ``reducer(span)`` for each of ``spans``.

    ``setup`` was chosen on the excerpts, ``logs``; ``lost_samples`` are in stretches too short to be smoothed.
    """

    setup: Setup
    logs: Mapping[str, Log]
    reducer: Reducer
    spans: tuple[Span, ...]
    lost_samples: int


def plan_pieces(
    model: Model, recordings: Sequence[LongRecording], recipe: Recipe, division: DivisionSettings = DEFAULT_DIVISION
) -> PiecePlan:
    """Choose all that the recipe leaves to the data on excerpts of the recordings, and plan the pieces.

    Raises the errors of ``identify``, and ConfigError for an estimator that needs all samples at once or a smoother to
    which samples matter that are far away.
    """
    if recipe.estimator.needs_samples:
        raise _all_at_once(recipe)
    logs = {log.source: log for log in read_excerpts(recordings, division)}
    with one_thread():
        data = Dataset.of(logs, (), recipe, tuple(joint.name for joint in model.joints))
        setup = choose_setup(model, data, recipe)
        estimate = call_part(setup.recipe.estimator, setup.problem(data), Estimate)
    if estimate.needs_samples:
        raise _all_at_once(recipe)
    # Every piece must be smoothed alike, else their factors would not merge to those of the whole.
    smoother, log, motion = _fix_smoother(setup, logs)
    step = float(np.median(np.diff(log.t)))
    # Samples around a piece, so that its smoothed motion, friction states and filter are those of the whole.
    margin = overlap(smoother, log, motion)
    if motion.memory is not None:
        margin += round(MEMORY_DURATION / step)
    if (parallel_filter := setup.recipe.filter) is not None:
        margin += parallel_filter.pad_samples(parallel_filter.sections(motion))
    used_recipe = replace(setup.recipe, smoother=smoother)
    # The excerpts decided whether rests within are left out; pieces follow that decision.
    inner_rests = [rest for rest in setup.motions.rests if rest.within]
    leave_out_rests = recipe.rests == "trim" and (not inner_rests or any(rest.left_out for rest in inner_rests))
    spans, lost_samples = plan_spans(recordings, division, margin)
    if not spans:
        raise InputError(f"{recordings[0].label}: no stretch without a gap is long enough to be smoothed.")
    reducer = Reducer(
        setup.model,
        used_recipe,
        tuple(recordings),
        leave_out_rests,
        estimate.value,
        _credible_noise_share(setup, estimate.value, logs),
    )
    return PiecePlan(setup, logs, reducer, spans, lost_samples)


def _all_at_once(recipe: Recipe) -> ConfigError:
    return ConfigError(
        f"estimator: {type(recipe.estimator).__name__} needs all samples at once, which are too many for the memory; "
        "take least_squares, ridge, or consistent without such a `fit`, or a shorter part."
    )


def identify_from_pieces(
    plan: PiecePlan, pieces: Sequence[PieceFactors], validation: Mapping[str, Log] | Sequence[Log] = ()
) -> Identification:
    """Return the identification from all pieces, in the order of the spans, validated on excerpts and held-out logs.

    Raises the errors of ``identify``.
    """
    model, recipe = plan.reducer.model, plan.reducer.recipe
    (smoother,) = recipe.smoothers

    def parts() -> Iterator[TriangularFactors]:
        return (unpack_factors(piece.factors, piece.rows, model.structure) for piece in pieces)

    with one_thread():
        data = Dataset.of(plan.logs, validation, recipe, tuple(joint.name for joint in model.joints))
        motions = data.motions(model, smoother, recipe)
        train_motions = motions.remember(model).train
        sample = Regression(model, train_motions, recipe.selection(model.joints))
        report_progress("estimating")
        # The factors replace the pass over all samples; the excerpts stand for what needs samples.
        regression = sample.with_factors(merge_factors(parts()))
        problem = Problem(model, train_motions, regression, data.fitted_logs(motions), train_motions[0].time_offset)
        clustered = partial(clustered_std, parts)
        fit = _estimate_from_pieces(problem, sample, plan, pieces, clustered)
        residuals = _piece_residuals(plan, pieces, parts(), fit.regression, fit.estimate)
        estimate = replace(fit.estimate, residual=replace(fit.estimate.residual, pieces=residuals))
        notes = (*plan.setup.notes, _pieces_note(plan, residuals, model))
        calibration = plan.setup.calibration
        return conclude(replace(fit, estimate=estimate), data, motions, recipe, calibration, notes, clustered)


def _estimate_from_pieces(
    problem: Problem, sample: Regression, plan: PiecePlan, pieces: Sequence[PieceFactors], clustered: RobustStd
) -> ParameterFit:
    """Fit the parameters to all pieces; correct a significant bias by the motion, as repetitions of pieces show it."""
    model, recipe, regression = problem.model, plan.reducer.recipe, problem.regression
    estimate = call_part(recipe.estimator, problem, Estimate)
    calibration = plan.setup.calibration
    covariance = covariance_of_calibration(model, sample, estimate, calibration.time_offset, calibration.base_tilt)
    fit = ParameterFit(problem, estimate, regression, covariance)
    report_progress("repeating the smoothing")
    weights = estimate.residual.weights
    repetitions = (piece.repetitions(model.structure) for piece in pieces)
    # Repetitions of some samples of each piece predict the bias that smoothing makes.
    sampled = sampled_bias(repetitions, model, np.ones(len(model.joints)) if weights is None else weights)
    if sampled is None:
        return fit
    factor = regression.triangular_factors.stack(weights)
    basis = base_parameters(factor, model.parameters)
    remaining_covariance = sampled.covariance + np.outer(sampled.remainder, sampled.remainder)
    bias, std = np.abs(basis.to_base(sampled.bias)), np.full(basis.rank, np.inf)
    with suppress(ModelError):  # nearly dependent columns: the bias is not corrected
        std = clustered(regression, estimate.value, weights, basis.independent)
    size = np.divide(bias, std, out=np.zeros_like(std), where=std > 0)
    worst = int(size.argmax()) if len(size) else 0
    p = len(sampled.bias)
    torque, torque_bias = (float(np.linalg.norm(factor[:, :p] @ theta)) for theta in (estimate.value, sampled.bias))
    worst_bias = (basis.groupings[worst], float(size[worst])) if len(size) else ("", 0.0)
    share = torque_bias / max(torque, 1e-300)
    errors = MotionErrors(sampled.bias, remaining_covariance, *worst_bias, share)
    corrected = correct_bias(fit, errors, recipe.estimator)
    if not any(isinstance(note, MotionCorrected) for note in corrected.notes):
        return corrected
    remaining_std = np.sqrt(np.einsum("ij,jk,ik->i", basis.combination, remaining_covariance, basis.combination))
    limited = int((remaining_std > std).sum())
    if not limited:  # standard errors are not mostly the remaining bias by errors of the motion
        return corrected
    ratio = np.divide(remaining_std, std, out=np.zeros_like(std), where=std > 0)
    note = LimitedByMotion(basis.groupings[int(np.argmax(ratio))], limited, basis.rank)
    return replace(corrected, notes=(*corrected.notes, note))


def _piece_residuals(
    plan: PiecePlan,
    pieces: Sequence[PieceFactors],
    parts: Iterator[TriangularFactors],
    regression: Regression,
    estimate: Estimate,
) -> Pieces:
    """Return the torque and its residual in each piece."""
    value = estimate.value + (0.0 if regression.bias is None else regression.bias)
    sums = [(np.square(piece.factors[:, :, -1]).sum(axis=1), piece.residual(value)) for piece in parts]
    rows = np.array([piece.rows for piece in pieces])
    torque, residual = (np.sqrt(np.array([piece[k] for piece in sums]) / np.maximum(rows, 1)) for k in (0, 1))
    labels = tuple(plan.reducer.recordings[piece.recording].label for piece in plan.spans)
    begins, ends = (np.array([getattr(piece, name) for piece in pieces]) for name in ("begins", "ends"))
    return Pieces(labels, begins, ends, rows, torque, residual)


def _pieces_note(plan: PiecePlan, pieces: Pieces, model: Model) -> InPieces:
    samples = sum(span.stop - span.start for span in plan.spans)
    seconds = float((pieces.ends - pieces.begins).sum())
    error = np.nan_to_num(pieces.relative_error)
    worst = int(error.argmax())
    return InPieces(samples, seconds, len(plan.spans), len(plan.logs), model.joints[worst].name, float(error[worst]))


def _credible_noise_share(setup: Setup, theta: Array, logs: Mapping[str, Log]) -> float:
    """Return the share of the position noise that the residual of the excerpts allows."""
    model, recipe, (smoother,) = setup.model, setup.recipe, setup.recipe.smoothers
    share = min(1.0, MAX_COVARIANCE_SAMPLES / sum(map(len, logs.values())))
    parts = [
        piece
        for name, motion in setup.motions.by_role["train"].items()
        for piece in pieces_of(
            model, recipe.repair(recipe.trim(logs[name]), torque=True), motion, smoother, theta, share
        )
    ]
    return credible_share(model, parts, theta, np.random.default_rng(0))


def _fix_smoother(setup: Setup, logs: Mapping[str, Log]) -> tuple[Smoother, Log, Motion]:
    """Return a smoother with fixed bandwidth for all pieces, and the excerpt that it is taken from."""
    (smoother,), motions = setup.recipe.smoothers, setup.motions.by_role["train"]
    widths = {name: float(np.mean(motion.smoothing.get("bandwidth", 0.0))) for name, motion in motions.items()}
    # The median bandwidth, so that an excerpt with unusual motion does not decide.
    middle = sorted(widths, key=lambda name: widths[name])[len(widths) // 2]
    return smoother.as_used(motions[middle]), logs[middle], motions[middle]
