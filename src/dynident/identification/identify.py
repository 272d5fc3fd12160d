"""The whole method in one place: logs -> motions -> linear problem -> estimate -> validation."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ConfigError, InputError, ModelError, Note, called
from dynident.estimators import Estimate, Problem
from dynident.estimators.notes import Undetermined
from dynident.identification.calibration import BaseTilt, find_base_tilt, mounted, pair
from dynident.identification.outliers import held_out_outliers, torque_outliers, without
from dynident.identification.recipe import Recipe
from dynident.identification.result import (
    Calibration,
    Identifiability,
    Identification,
    Sources,
    StandardErrors,
    versions,
)
from dynident.log import Log, Motion
from dynident.models import Model
from dynident.regression import (
    BaseParameters,
    Regression,
    base_parameters,
    base_std,
    compare,
    informed_std,
    one_thread,
    structural_base_parameters,
)
from dynident.smoothers import Smoother, motion_of, unshifted
from dynident.validation import FreeRun, LogValidation, Signals, check_mass, free_run, robust_covariance, validate

__all__ = ["identify"]

Array = NDArray[np.float64]
ROLES: tuple[Literal["train", "validation"], ...] = ("train", "validation")


def identify(
    model: Model,
    train: Mapping[str, Log] | Sequence[Log],
    validation: Mapping[str, Log] | Sequence[Log] = (),
    recipe: Recipe | None = None,
    *,
    progress: Callable[[str], None] = lambda _: None,
) -> Identification:
    """Identify the parameters of ``model`` from the training logs and judge them on all logs.

    Logs are given by name, or in a sequence (then named by their source); their joints are matched to the model's by
    name. ``progress`` is called with a few words before each step. Raises the errors of the stages: InputError,
    ConfigError, ModelError. BLAS works in one thread meanwhile: the matrices are small and many.
    """
    with one_thread():
        return _identify(model, train, validation, recipe or Recipe(), progress)


def _identify(
    model: Model,
    train: Mapping[str, Log] | Sequence[Log],
    validation: Mapping[str, Log] | Sequence[Log],
    recipe: Recipe,
    progress: Callable[[str], None],
) -> Identification:
    joints = tuple(joint.name for joint in model.joints)
    roles = _roles(train, validation, joints)
    logs = {role: {name: recipe.repaired(log, torque=role == "train") for name, log in named.items()}
            for role, named in roles.items()}  # fmt: skip
    trained, min_speed = tuple(logs["train"].values()), recipe.min_speeds(joints)
    pairing = pair(model, trained, recipe.smoothers, recipe.time_offset, recipe.estimator, min_speed, progress=progress)
    smoother = pairing.smoother
    motions = _smoothed(logs, smoother, progress)
    if recipe.outliers == "mask":
        motions["train"] = _masked(model, motions["train"], roles["train"], min_speed)
        trained = tuple(
            replace(log, tau=motion.tau) for log, motion in zip(trained, motions["train"].values(), strict=True)
        )
    fitted = tuple(motions["train"].values())
    late = fitted[0].time_offset
    model, tilt, angles = _mounted(model, fitted, recipe, min_speed, progress)
    used = replace(recipe, smoother=smoother, time_offset=late, base_tilt=angles)
    progress("reducing the regression to triangular factors")
    regression = Regression(model, fitted, recipe.filter, min_speed)
    _ = regression.triangular_factors
    progress("estimating")
    estimate = called(recipe.estimator, Problem(model, fitted, regression, trained, late), Estimate)
    if estimate.residual.sample_weights:
        regression = replace(regression, weights=estimate.residual.sample_weights)
    progress("validating")
    judged = _judged(model, estimate, roles, motions, used, progress)
    errors, base = _identifiability(model, regression, estimate, progress)
    return Identification(
        model,
        used,
        estimate,
        errors,
        base,
        judged,
        check_mass(model, estimate.value, [log.motion for log in judged]),
        Calibration(pairing.choice, pairing.time_offset, tilt),
        Sources(versions=versions()),
        (*_warnings(model, estimate, base), *(held_out_outliers(judged) if recipe.outliers == "mask" else ())),
    )


def _roles(
    train: Mapping[str, Log] | Sequence[Log], validation: Mapping[str, Log] | Sequence[Log], joints: tuple[str, ...]
) -> dict[str, dict[str, Log]]:
    """Return the logs by role and name, of these joints in this order.

    ConfigError where none is to be fitted, InputError where no torque is.
    """
    roles = {"train": _named(train), "validation": _named(validation)}
    if not roles["train"]:
        raise ConfigError("no training log is given; name at least one.")
    if not any(log.tau.any() for log in roles["train"].values()):
        raise InputError("all torques of the training are zero; check that the right columns are named and recorded.")
    return {role: {name: log.select(joints) for name, log in logs.items()} for role, logs in roles.items()}


def _smoothed(
    roles: Mapping[str, Mapping[str, Log]], smoother: Smoother, progress: Callable[[str], None]
) -> dict[str, dict[str, Motion]]:
    motions: dict[str, dict[str, Motion]] = {role: {} for role in roles}
    for role, logs in roles.items():
        for name, log in logs.items():
            progress(f"smoothing {name}")
            motions[role][name] = motion_of(smoother, log)
    return motions


def _masked(
    model: Model, motions: Mapping[str, Motion], logs: Mapping[str, Log], min_speed: tuple[float, ...] | None
) -> dict[str, Motion]:
    """Return the motions of the training with what is wrong of their torques left out of the fit."""
    found = torque_outliers(model, tuple(motions.values()), tuple(logs.values()), min_speed)
    return {name: without(motion, one, logs[name]) for (name, motion), one in zip(motions.items(), found, strict=True)}


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
    progress("estimating the base tilt")
    tilt = find_base_tilt(model, motions, recipe.estimator, min_speed)
    return mounted(model, tilt.x, tilt.y), tilt, (tilt.x, tilt.y)


def _judged(
    model: Model,
    estimate: Estimate,
    roles: Mapping[str, Mapping[str, Log]],
    motions: Mapping[str, Mapping[str, Motion]],
    recipe: Recipe,
    progress: Callable[[str], None],
) -> tuple[LogValidation, ...]:
    """Return how the model does on all logs, those of the training first."""
    min_speed, found = recipe.min_speeds([joint.name for joint in model.joints]), []
    for role in ROLES:
        for name, motion in motions[role].items():
            one = validate(
                model, estimate.value, motion, name=name, role=role, parallel_filter=recipe.filter, min_speed=min_speed
            )
            log = roles[role][name]
            signals = Signals(motion, one.predicted, log)
            run = _run(model, estimate, name, recipe.repaired(log), motion, recipe, progress)
            found.append(replace(one, signals=signals, free_run=run))
    return tuple(found)


def _identifiability(
    model: Model, regression: Regression, estimate: Estimate, progress: Callable[[str], None]
) -> tuple[StandardErrors, Identifiability]:
    """Return the standard errors, and base parameters where not all parameters are determined."""
    if estimate.determined.rank == len(model.parameters):
        return StandardErrors(estimate.std, _robust_std(regression, estimate, estimate.std)), Identifiability()
    progress("finding base parameters")
    shown = estimate.determined.directions  # where the estimator says them, so that both have one rank
    on_data = base_parameters(
        regression.triangular_factors.stacked(estimate.residual.weights) if shown is None else shown, model.parameters
    )
    structural = structural_base_parameters(model)
    missing = compare(structural, on_data, model, regression.motions)
    own = _base_std(on_data, regression, estimate)
    robust = _robust_std(regression, estimate, own, on_data)
    std_hac = None if robust is None else _of_determined(on_data, robust)
    return StandardErrors(estimate.std, std_hac, own, robust), Identifiability(on_data, structural, missing)


def _warnings(model: Model, estimate: Estimate, base: Identifiability) -> tuple[Note, ...]:
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
    progress: Callable[[str], None],
) -> FreeRun | None:
    """Return the free simulation of a recording that knows its controller, or of any where the recipe asks."""
    if log.controller is None and recipe.restart is None:
        return None
    progress(f"simulating {name}")
    if log.controller is not None and motion.time_offset:  # a controller sees the positions when they were stamped
        motion = unshifted(recipe.smoothers[0])(log)
    return free_run(model, estimate.value, motion, log.controller, recipe.restart, name=name)


def _base_std(basis: BaseParameters, regression: Regression, estimate: Estimate) -> Array:
    if estimate.information is None:
        std = base_std(basis, regression.triangular_factors, estimate.residual.sigma, estimate.residual.weights)
        return np.hypot(std, _moved(estimate, basis))
    return informed_std(basis, estimate.information)


def _robust_std(
    regression: Regression, estimate: Estimate, own: Array, basis: BaseParameters | None = None
) -> Array | None:
    """Return standard errors that allow for correlated residuals, at least ``own`` where these count the motion's."""
    columns = None if basis is None else basis.independent
    try:
        covariance = robust_covariance(
            regression, estimate.value, estimate.residual.weights, columns, estimate.residual.slopes
        )
        robust = np.hypot(np.sqrt(np.diag(covariance)), _moved(estimate, basis))
    except ModelError:  # nearly dependent columns: then there is no such figure
        return None
    return robust if estimate.information is None else np.maximum(robust, own)


def _moved(estimate: Estimate, basis: BaseParameters | None) -> Array:
    """Return what constraints moved the parameters by, or the base parameters; it may be an error of theirs."""
    free = estimate.consistency.unconstrained if estimate.consistency else None
    moved = np.zeros_like(estimate.value) if free is None else estimate.value - free
    return moved if basis is None else basis.to_base(moved)


def _of_determined(basis: BaseParameters, std: Array) -> Array:
    """Return standard errors (p) of the standard parameters that are base parameters by themselves, else infinite."""
    found = np.full(len(basis.names), np.inf)
    for k, row, value in zip(basis.independent, basis.combination, std, strict=True):
        if np.count_nonzero(row) == 1:
            found[k] = value
    return found


def _named(logs: Mapping[str, Log] | Sequence[Log]) -> dict[str, Log]:
    if isinstance(logs, Mapping):
        return dict(logs)
    named = {log.source: log for log in logs}
    if len(named) != len(logs):
        raise ConfigError(f"two logs have the same source among {[log.source for log in logs]}; give them by name.")
    return named
