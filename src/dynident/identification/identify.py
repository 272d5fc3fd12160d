"""The whole method in one place: logs -> motions -> linear problem -> estimate -> validation."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from dynident.estimators import Estimate, Estimator, Problem
from dynident.estimators.notes import MotionCorrected, MotionTooNoisy, Undetermined
from dynident.identification.base_tilt import BaseTilt
from dynident.identification.calibration import Calibration, choose_setup
from dynident.identification.dataset import Dataset, Logs, NotFitted, RoleMotions, exclusion_notes, substitute_notes
from dynident.identification.motion_errors import MotionErrors, motion_errors
from dynident.identification.outliers import held_out_outliers
from dynident.identification.recipe import Recipe
from dynident.identification.result import Identifiability, Identification, Sources, versions
from dynident.identification.time_offset import Alignment
from dynident.identification.uncertainty import RobustStd, covariance_of_calibration, identifiability_of
from dynident.models import Model
from dynident.motion.log import Log
from dynident.motion.smoothers import smooth_log, strip_time_offset
from dynident.regression import Regression, one_thread
from dynident.runtime import Note, Step, call_part, report_progress
from dynident.runtime.arrays import Array
from dynident.validation import (
    FreeRun,
    LogValidation,
    Signals,
    check_mass,
    correlated_std,
    free_run,
    smoothing_losses,
    validate,
    with_floors,
)

MAX_CORRECTED_BIAS = 0.1  # share of the torque above which a bias by errors of the motion is too large to be corrected
ROLES: tuple[Literal["train", "validation"], ...] = ("train", "validation")


def identify(
    model: Model,
    train: Logs,
    validation: Logs = (),
    recipe: Recipe | None = None,
    *,
    executor: Executor | None = None,
) -> Identification:
    """Identify the parameters of ``model`` from the training logs and judge them on all logs.

    Logs are given by name, or in a sequence (then named by their source); their joints are matched to the model's by
    name. Of several smoothers each is tried on the ``executor``, by default in this process, with the same result.
    Raises the errors of the stages: InputError, ConfigError, ModelError. BLAS works in one thread meanwhile: the
    matrices are small and many.
    """
    recipe = recipe or Recipe()
    with one_thread():
        data = Dataset.of(train, validation, recipe, tuple(joint.name for joint in model.joints))
        setup = choose_setup(model, data, recipe, executor)
        fit = estimate_parameters(
            setup.problem(data), setup.recipe.estimator, setup.alignment, setup.calibration.base_tilt
        )
        return conclude(fit, data, setup.motions, setup.recipe, setup.calibration, setup.notes)


@dataclass(frozen=True, eq=False)
class ParameterFit:
    """An ``estimate`` of a problem and the weighted ``regression`` that it is of.

    ``motion_covariance`` (p, p) is that by errors of the motion, the time offset and the base tilt; ``notes`` say what
    of these was corrected.
    """

    problem: Problem
    estimate: Estimate
    regression: Regression
    motion_covariance: Array
    notes: tuple[Note, ...] = ()


def estimate_parameters(
    problem: Problem,
    estimator: Estimator,
    alignment: Alignment,
    tilt: BaseTilt | None = None,
    *,
    needs_noise: bool = True,
) -> ParameterFit:
    """Fit the parameters, and correct the bias by the smoothed motion where that is significant.

    Unless ``needs_noise``, the covariance by noise of the motion is left out where it decides nothing.
    """
    report_progress("estimating")
    estimate = call_part(estimator, problem, Estimate)
    regression = estimate.residual.weight_rows(problem.regression)
    fit = ParameterFit(
        problem, estimate, regression,
        covariance_of_calibration(problem.model, regression, estimate, alignment.time_offset, tilt),
    )  # fmt: skip
    if estimate.information is not None:  # the estimator has its own motion, with its errors
        return fit
    report_progress("repeating the smoothing")
    errors = motion_errors(problem.logs, regression, alignment.smoother, estimate, needs_noise=needs_noise)
    return fit if errors is None else correct_bias(fit, errors, estimator)


def correct_bias(fit: ParameterFit, errors: MotionErrors, estimator: Estimator) -> ParameterFit:
    """Return a fit with the bias by errors of the motion corrected, or counted in its errors."""
    covariance = fit.motion_covariance + errors.covariance
    # A bias within the standard errors is not corrected, but counts as an error.
    if not errors.significant:
        return replace(fit, motion_covariance=covariance + np.outer(errors.bias, errors.bias))
    # The prediction of the bias is of first order: a large one is reported, not corrected.
    if errors.share >= MAX_CORRECTED_BIAS:
        return replace(fit, motion_covariance=covariance, notes=(MotionTooNoisy(errors.parameter, errors.size),))
    unbiased = fit.problem.regression.subtract_bias(errors.bias)
    estimate = call_part(estimator, replace(fit.problem, regression=unbiased), Estimate)
    notes = (MotionCorrected(errors.parameter, errors.size),)
    return ParameterFit(fit.problem, estimate, estimate.residual.weight_rows(unbiased), covariance, notes)


def conclude(
    fit: ParameterFit,
    data: Dataset,
    motions: RoleMotions,
    recipe: Recipe,
    calibration: Calibration,
    notes: Sequence[Note] = (),
    robust: RobustStd = correlated_std,
) -> Identification:
    """Validate a fit on all logs, and gather what is known of it.

    ``robust`` gives the standard errors that allow for correlated residuals.
    """
    model, estimate = fit.problem.model, fit.estimate
    validations = validate_logs(model, estimate, data, motions, recipe)
    errors, base = identifiability_of(fit.regression, estimate, fit.motion_covariance, robust, recipe.unfitted)
    return Identification(
        model=model,
        recipe=recipe,
        estimate=estimate,
        errors=errors,
        base=base,
        validations=validations,
        mass=check_mass(model, estimate.value, [log.motion for log in validations]),
        calibration=calibration,
        provenance=Sources(versions=versions()),
        warnings=(
            *estimate_notes(model, estimate, base),
            *fit.notes,
            *motions.rests,
            *((NotFitted(recipe.unfitted),) if recipe.unfitted else ()),
            *exclusion_notes(validations),
            *substitute_notes(validations),
            *notes,
            *smoothing_losses(validations),
            *(held_out_outliers(validations) if recipe.outliers == "mask" else ()),
        ),
    )


def validate_logs(
    model: Model, estimate: Estimate, data: Dataset, motions: RoleMotions, recipe: Recipe
) -> tuple[LogValidation, ...]:
    """Return the validation of the model on all logs, those of the training first."""
    selection = recipe.selection(model.joints)
    validations: list[LogValidation] = []
    total = sum(len(motions.by_role[role]) for role in ROLES)
    for role in ROLES:
        for name, motion in motions.by_role[role].items():
            report_progress(Step("validating", len(validations), total))
            validation = validate(model, estimate.value, motion, name=name, role=role, selection=selection)
            log = data.trimmed[role][name]
            signals = Signals(validation.motion, validation.predicted_torque, log)
            run = _simulate_recording(model, estimate, validation, recipe.repair(log), recipe)
            validations.append(replace(validation, signals=signals, free_run=run))
    return with_floors(validations)


def estimate_notes(model: Model, estimate: Estimate, base: Identifiability) -> tuple[Note, ...]:
    """Return the notes of the estimate, except those on what no motion of any robot can show."""
    if base.on_data is None or not any(parameter.body for parameter in model.parameters):
        return estimate.notes
    return (*(note for note in estimate.notes if not isinstance(note, Undetermined)), *base.unexcited)


def _simulate_recording(
    model: Model, estimate: Estimate, validation: LogValidation, log: Log, recipe: Recipe
) -> FreeRun | None:
    """Return the free simulation of a recording that knows its controller, or of any where the recipe asks."""
    if log.controller is None and recipe.restart is None:
        return None
    motion = validation.motion
    if log.controller is not None and motion.time_offset:  # a controller sees the positions when they were stamped
        motion = smooth_log(strip_time_offset(recipe.smoothers[0]), log, judge_only=True)
    return free_run(model, estimate.value, motion, log.controller, recipe.restart, name=validation.name)
