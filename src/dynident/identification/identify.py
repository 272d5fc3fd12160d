"""The whole method in one place: logs -> motions -> linear problem -> estimate -> validation."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dynident.errors import Note, Step, called
from dynident.estimators import Estimate, Estimator, Problem
from dynident.estimators.notes import MotionCorrected, MotionTooNoisy, Undetermined
from dynident.identification.base_tilt import BaseTilt, SteepBase, find_base_tilt, has_gravity, mounted
from dynident.identification.load import with_load
from dynident.identification.motion_errors import MotionErrors, motion_errors
from dynident.identification.outliers import held_out_outliers
from dynident.identification.prior_strength import find_prior_strength, with_strength
from dynident.identification.recipe import Recipe
from dynident.identification.result import (
    Calibration,
    Identifiability,
    Identification,
    Sources,
    versions,
)
from dynident.identification.role_logs import NotFitted, RoleLogs, not_judged, substituted
from dynident.identification.standard_errors import covariance_of_time_offset, identifiability_of
from dynident.identification.terms import PlainTerms
from dynident.identification.terms.added import chosen, first, with_choice
from dynident.identification.time_offset import Pairing, pair
from dynident.log import Log, Motion
from dynident.models import Model
from dynident.regression import (
    Regression,
    one_thread,
)
from dynident.smoothers import motion_of, unshifted
from dynident.validation import (
    FreeRun,
    LogValidation,
    Signals,
    check_mass,
    free_run,
    smoothed_away,
    validate,
    with_floors,
)

__all__ = ["FAR", "estimated", "identify", "judged", "warnings_of"]

Array = NDArray[np.float64]
FAR = 0.1  # share of the torque above which a bias by the errors of the motion is too large to be corrected
ROLES: tuple[Literal["train", "validation"], ...] = ("train", "validation")


def identify(
    model: Model,
    train: Mapping[str, Log] | Sequence[Log],
    validation: Mapping[str, Log] | Sequence[Log] = (),
    recipe: Recipe | None = None,
    *,
    executor: Executor | None = None,
    progress: Callable[[str], None] | None = None,
) -> Identification:
    """Identify the parameters of ``model`` from the training logs and judge them on all logs.

    Logs are given by name, or in a sequence (then named by their source); their joints are matched to the model's by
    name. Of several smoothers each is tried on the ``executor``, by default in this process, with the same result.
    ``progress`` is called with a few words before each step. Raises the errors of the stages: InputError,
    ConfigError, ModelError. BLAS works in one thread meanwhile: the matrices are small and many.
    """
    with one_thread():
        return _identify(model, train, validation, recipe or Recipe(), progress or (lambda _: None), executor)


def _identify(
    model: Model,
    train: Mapping[str, Log] | Sequence[Log],
    validation: Mapping[str, Log] | Sequence[Log],
    recipe: Recipe,
    progress: Callable[[str], None],
    executor: Executor | None = None,
) -> Identification:
    joints = tuple(joint.name for joint in model.joints)
    logs = RoleLogs.of(train, validation, recipe, joints)
    trained, min_speed = tuple(logs.repaired["train"].values()), recipe.min_speeds(joints)
    whole, (model, early) = model, first(model, recipe)
    sought = recipe.smoothers, recipe.time_offset, early.estimator, min_speed
    pairing = pair(model, trained, *sought, executor=executor, progress=progress)
    smoother = pairing.smoother
    motions, resting = logs.motions(model, smoother, recipe, progress)
    fitted = tuple(motions["train"].values())
    trained = logs.fitted(motions)
    late = fitted[0].time_offset
    model, tilt, angles = _mounted(model, fitted, early, min_speed, progress)
    if recipe.terms is not None:
        choice = chosen(whole, angles, fitted, min_speed, recipe.proposed, progress)
        level = recipe.base_tilt if angles == (0.0, 0.0) else angles  # one that was refused is tried again
        whole, named, absent = with_choice(whole, recipe, choice)
        named = replace(named, smoother=smoother, base_tilt=level, proposed=())
        found = _identify(whole, train, validation, named, progress)
        found = replace(found, warnings=(*found.warnings, *absent))
        return _chosen(found, Calibration(pairing.choice, pairing.time_offset, tilt, terms=choice), late)
    model = with_load(whole, model, fitted, early.estimator, recipe.filter, min_speed, progress)
    fitted = tuple(map(model.remembering, fitted))
    strength = find_prior_strength(model, fitted, recipe.estimator, min_speed, progress=progress)
    estimator = with_strength(recipe.estimator, strength)
    used = replace(recipe, smoother=smoother, estimator=estimator, time_offset=late, base_tilt=angles)
    progress("reducing the regression to triangular factors")
    regression = Regression(model, fitted, recipe.filter, min_speed)
    _ = regression.triangular_factors
    problem = Problem(model, fitted, regression, trained, late, progress)
    estimate, regression, more, noted = estimated(problem, estimator, pairing, progress)
    validations = judged(model, estimate, logs.trimmed, motions, used, progress)
    errors, base = identifiability_of(model, regression, estimate, more, progress, unfitted=recipe.unfitted)
    return Identification(
        model,
        used,
        estimate,
        errors,
        base,
        validations,
        check_mass(model, estimate.value, [log.motion for log in validations]),
        Calibration(pairing.choice, pairing.time_offset, tilt, strength),
        Sources(versions=versions()),
        (
            *warnings_of(model, estimate, base),
            *noted,
            *resting,
            *((NotFitted(recipe.unfitted),) if recipe.unfitted else ()),
            *not_judged(validations),
            *substituted(validations),
            *_steep(tilt),
            *smoothed_away(validations),
            *(held_out_outliers(validations) if recipe.outliers == "mask" else ()),
        ),
    )


def estimated(
    problem: Problem, estimator: Estimator, pairing: Pairing, progress: Callable[[str], None]
) -> tuple[Estimate, Regression, Array, tuple[Note, ...]]:
    """Return the estimate, without the bias by the smoothed motion where that matters, and the regression it is of; the
    covariance (p, p) by errors of motion and time offset, and what to note of them.
    """
    progress("estimating")
    model, plain, logs = problem.model, problem.regression, problem.logs
    estimate = called(estimator, problem, Estimate)
    regression = estimate.residual.weighted(plain)
    late = covariance_of_time_offset(model, regression, estimate, pairing.time_offset)
    if estimate.information is not None:
        return estimate, regression, late, ()
    progress("repeating the smoothing")
    found = motion_errors(model, logs, regression, pairing.smoother, estimate)
    if found is None:
        return estimate, regression, late, ()
    if not found.significant:
        return estimate, regression, late + found.covariance + np.outer(found.bias, found.bias), ()
    if found.share < FAR:
        plain = plain.unbiased(found.bias)
        estimate = called(estimator, replace(problem, regression=plain), Estimate)
        regression = estimate.residual.weighted(plain)
    return estimate, regression, late + found.covariance, _noted(found)


def _mounted(
    model: Model,
    motions: tuple[Motion, ...],
    recipe: Recipe,
    min_speed: tuple[float, ...] | None,
    progress: Callable[[str], None],
) -> tuple[Model, BaseTilt | None, tuple[float, float] | None]:
    """Return the model on its base as it is tilted, how that was found, and the tilt, as the recipe asks for it."""
    if recipe.base_tilt is None:
        return model, None, None
    if recipe.base_tilt != "estimate":
        return mounted(model, *recipe.base_tilt), None, recipe.base_tilt
    if not has_gravity(model):
        return model, None, None
    progress("estimating the base tilt")
    tilt = find_base_tilt(model, motions, recipe.estimator, min_speed)
    return mounted(model, tilt.x, tilt.y), tilt, (tilt.x, tilt.y)


def _chosen(found: Identification, first: Calibration, late: float) -> Identification:
    """Return an identification with terms that were chosen by what ``first`` holds, with a time offset ``late`` (s)."""
    again = found.calibration
    offset = first.time_offset if again.time_offset is None or again.time_offset.seconds == late else again.time_offset
    tilt = first.base_tilt if again.base_tilt is None else again.base_tilt
    steep = _steep(first.base_tilt) if again.base_tilt is None else ()
    few = (PlainTerms(),) if first.terms and not first.terms.trials else ()
    known = replace(again, smoother=first.smoother, time_offset=offset, base_tilt=tilt, terms=first.terms)
    return replace(found, calibration=known, warnings=(*found.warnings, *steep, *few))


def _steep(tilt: BaseTilt | None) -> tuple[Note, ...]:
    """Return the note on a tilt that is more than a mounting error."""
    return (SteepBase(*tilt.steep),) if tilt and tilt.steep else ()


def _noted(found: MotionErrors) -> tuple[Note, ...]:
    """Return the note on errors of the motion that are significant."""
    return ((MotionCorrected if found.share < FAR else MotionTooNoisy)(found.parameter, found.size),)


def judged(
    model: Model,
    estimate: Estimate,
    roles: Mapping[str, Mapping[str, Log]],
    motions: Mapping[str, Mapping[str, Motion]],
    recipe: Recipe,
    progress: Callable[[str], None],
) -> tuple[LogValidation, ...]:
    """Return how the model does on all logs, those of the training first."""
    low, slow = recipe.filter, recipe.min_speeds([joint.name for joint in model.joints])
    found: list[LogValidation] = []
    total = sum(len(motions[role]) for role in ROLES)
    for role in ROLES:
        for name, motion in motions[role].items():
            progress(Step("validating", len(found), total))
            one = validate(model, estimate.value, motion, name=name, role=role, parallel_filter=low, min_speed=slow)
            log = roles[role][name]
            signals = Signals(one.motion, one.predicted, log)
            run = _run(model, estimate, name, recipe.repaired(log), motion, recipe)
            found.append(replace(one, signals=signals, free_run=run))
    return with_floors(found)


def warnings_of(model: Model, estimate: Estimate, base: Identifiability) -> tuple[Note, ...]:
    """Return the warnings: the notes of the estimate, except those on what no motion of any robot can show."""
    if base.on_data is None or not any(parameter.body for parameter in model.parameters):
        return estimate.notes
    return (*(note for note in estimate.notes if not isinstance(note, Undetermined)), *base.unexcited)


def _run(
    model: Model,
    estimate: Estimate,
    name: str,
    log: Log,
    motion: Motion,
    recipe: Recipe,
) -> FreeRun | None:
    """Return the free simulation of a recording that knows its controller, or of any where the recipe asks."""
    if log.controller is None and recipe.restart is None:
        return None
    if log.controller is not None and motion.time_offset:  # a controller sees the positions when they were stamped
        motion = motion_of(unshifted(recipe.smoothers[0]), log, judged=True)
    return free_run(model, estimate.value, motion, log.controller, recipe.restart, name=name)
