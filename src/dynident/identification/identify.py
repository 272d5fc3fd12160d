"""The whole method in one place: logs -> motions -> linear problem -> estimate -> validation."""

from __future__ import annotations

import platform
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib.metadata import PackageNotFoundError, version
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dynident import __version__
from dynident.errors import ConfigError, ModelError, Note, choices
from dynident.estimators import Estimate, Estimator, LeastSquares, Problem
from dynident.estimators.notes import Undetermined
from dynident.identification.calibration import BaseTilt, Pairing, find_base_tilt, mounted, pair
from dynident.log import Log, Motion
from dynident.models import MassMatrixCheck, Model
from dynident.regression import (
    BaseParameters,
    ParallelFilter,
    Regression,
    UnexcitedParameters,
    base_parameters,
    base_std,
    compare,
    informed_std,
    one_thread,
    structural_base_parameters,
)
from dynident.smoothers import Smoother, Spline, unshifted
from dynident.validation import SEED, FreeRun, LogValidation, check_mass, free_run, robust_covariance, validate

__all__ = ["Identification", "Recipe", "identify", "versions"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Recipe:
    """How to identify: the interchangeable parts, with the article's method as the default.

    Of several smoothers, ``choose_smoother`` takes one by the cross-validated torque error on the training logs.
    ``min_speed``, a speed (rad/s, m/s) or one by joint name, leaves slower samples out of that joint's equation in the
    fit. ``time_offset`` (s) is how much later than the torque the positions show the motion; "estimate" finds it on the
    training logs. With ``base_tilt`` the tilt of the robot's base is found there too. ``restart`` (s) asks for free
    simulations from the measured torque; logs that know their controller need none.
    """

    smoother: Smoother | tuple[Smoother, ...] = field(default_factory=Spline)
    estimator: Estimator = field(default_factory=LeastSquares)
    filter: ParallelFilter | None = None
    min_speed: Mapping[str, float] | float | None = None
    time_offset: float | Literal["estimate"] = 0.0
    base_tilt: bool = False
    restart: float | None = None

    def min_speeds(self, joints: Sequence[str]) -> tuple[float, ...] | None:
        """Return ``min_speed`` for each joint; ConfigError where it names another."""
        if self.min_speed is None or not isinstance(self.min_speed, Mapping):
            return None if self.min_speed is None else (float(self.min_speed),) * len(joints)
        for name in self.min_speed:
            if name not in joints:
                raise ConfigError(f"min_speed: there is no joint {name!r}. {choices(name, joints)}")
        return tuple(float(self.min_speed.get(name, 0.0)) for name in joints)


@dataclass(frozen=True, eq=False)
class Identification:
    """Everything that one run found: what reports and exports read.

    ``base_parameters`` are the base parameters that the training data show, ``base_std`` (r) their standard errors for
    independent residuals, ``structural`` those that any motion could show, and ``unexcited`` the motion that would show
    the rest; all are given where the data do not determine every parameter.

    ``std_hac`` (p) and ``base_std_hac`` (r) are standard errors that allow for correlated residuals, infinite for what
    the data do not determine, None where they cannot be had. ``mass`` is the mass matrix over all logs and random
    poses; ``runs`` are the free simulations. ``recorded`` are the recordings before smoothing, one for each log; their
    positions show the motion ``time_offset`` (s) later than their torques. ``pairing`` and ``base_tilt`` say how
    smoother, time offset and the tilt of the base were found, where they were sought.
    """

    model: Model
    estimate: Estimate
    logs: tuple[LogValidation, ...]
    warnings: tuple[Note, ...] = ()
    settings: Mapping[str, str] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
    base_parameters: BaseParameters | None = None
    base_std: Array | None = None
    structural: BaseParameters | None = None
    unexcited: tuple[UnexcitedParameters, ...] = ()
    std_hac: Array | None = None
    base_std_hac: Array | None = None
    mass: MassMatrixCheck | None = None
    runs: tuple[FreeRun, ...] = ()
    recorded: tuple[Log, ...] = ()
    time_offset: float = 0.0
    pairing: Pairing | None = None
    base_tilt: BaseTilt | None = None


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
    trained, min_speed = tuple(roles["train"].values()), recipe.min_speeds(joints)
    candidates = recipe.smoother if isinstance(recipe.smoother, tuple) else (recipe.smoother,)
    pairing = pair(model, trained, candidates, recipe.time_offset, recipe.estimator, min_speed, progress=progress)
    smoother = pairing.smoother
    motions = _smoothed(roles, smoother, progress)
    fitted = tuple(motions["train"].values())
    late = fitted[0].time_offset
    model, tilt = _mounted(model, fitted, recipe, min_speed, progress)
    progress("reducing the regression to triangular factors")
    regression = Regression(model, fitted, recipe.filter, min_speed)
    _ = regression.triangular_factors
    progress("estimating")
    estimate = recipe.estimator(Problem(model, fitted, regression, trained, late))
    if estimate.sample_weights:
        regression = replace(regression, weights=estimate.sample_weights)
    progress("validating")
    judged = tuple(
        validate(
            model, estimate.value, motion, name=name, role=role, parallel_filter=recipe.filter, min_speed=min_speed
        )
        for role in ("train", "validation")
        for name, motion in motions[role].items()
    )
    found = Identification(
        model,
        estimate,
        judged,
        estimate.notes,
        {**_settings(recipe), **_used(smoother, late), **_tilt(tilt)},
        versions(),
        mass=check_mass(model, estimate.value, [log.motion for log in judged]),
        recorded=tuple(roles[log.role][log.name] for log in judged),
        time_offset=late,
        pairing=pairing,
        base_tilt=tilt,
    )
    found = replace(found, runs=_runs(found, recipe, smoother, progress))
    return _with_errors(found, regression, fitted, progress)


def _roles(
    train: Mapping[str, Log] | Sequence[Log], validation: Mapping[str, Log] | Sequence[Log], joints: tuple[str, ...]
) -> dict[str, dict[str, Log]]:
    """Return the logs by role and name, of these joints in this order; ConfigError where none is to be fitted."""
    roles = {"train": _named(train), "validation": _named(validation)}
    if not roles["train"]:
        raise ConfigError("no training log is given; name at least one.")
    return {role: {name: log.select(joints) for name, log in logs.items()} for role, logs in roles.items()}


def _smoothed(
    roles: Mapping[str, Mapping[str, Log]], smoother: Smoother, progress: Callable[[str], None]
) -> dict[str, dict[str, Motion]]:
    motions: dict[str, dict[str, Motion]] = {role: {} for role in roles}
    for role, logs in roles.items():
        for name, log in logs.items():
            progress(f"smoothing {name}")
            motions[role][name] = smoother(log)
    return motions


def _mounted(
    model: Model,
    motions: tuple[Motion, ...],
    recipe: Recipe,
    min_speed: tuple[float, ...] | None,
    progress: Callable[[str], None],
) -> tuple[Model, BaseTilt | None]:
    """Return the model on its base as it is tilted, and how it does, where the recipe asks for it."""
    if not recipe.base_tilt:
        return model, None
    progress("finding how the base is tilted")
    tilt = find_base_tilt(model, motions, recipe.estimator, min_speed)
    return mounted(model, tilt.x, tilt.y), tilt


def _tilt(tilt: BaseTilt | None) -> dict[str, str]:
    """Return what a saved result must say of the base to be used again."""
    return {} if tilt is None else {"lean used": repr((tilt.x, tilt.y))}


def _with_errors(
    found: Identification, regression: Regression, fitted: tuple[Motion, ...], progress: Callable[[str], None]
) -> Identification:
    """Return the identification with honest standard errors, and base parameters where not all are determined."""
    model, estimate = found.model, found.estimate
    if estimate.rank == len(model.parameters):
        return replace(found, std_hac=_robust_std(regression, estimate, estimate.std))
    progress("finding base parameters")
    shown = estimate.directions  # where the estimator says them, so that both have one rank
    on_data = base_parameters(
        regression.triangular_factors.stacked(estimate.weights) if shown is None else shown, model.parameters
    )
    structural = structural_base_parameters(model)
    missing = compare(structural, on_data, model, fitted)
    if any(parameter.body for parameter in model.parameters):  # no motion tells all inertial parameters apart
        found = replace(found, warnings=(*_surprising(estimate.notes), *missing))
    own = _base_std(on_data, regression, estimate)
    robust = _robust_std(regression, estimate, own, on_data)
    return replace(
        found,
        base_parameters=on_data,
        base_std=own,
        structural=structural,
        unexcited=missing,
        std_hac=None if robust is None else _of_determined(on_data, robust),
        base_std_hac=robust,
    )


def _surprising(notes: Sequence[Note]) -> tuple[Note, ...]:
    return tuple(note for note in notes if not isinstance(note, Undetermined))


def _runs(
    found: Identification, recipe: Recipe, smoother: Smoother, progress: Callable[[str], None]
) -> tuple[FreeRun, ...]:
    """Return the free simulations of the recordings that know their controller, or of all where the recipe asks."""
    runs = []
    for one, log in zip(found.logs, found.recorded, strict=True):
        if log.controller is not None or recipe.restart is not None:
            progress(f"simulating {one.name}")
            # a controller sees the positions when they were stamped
            stamped = log.controller is not None and one.motion.time_offset
            motion = unshifted(smoother)(log) if stamped else one.motion
            made = free_run(found.model, found.estimate.value, motion, log.controller, recipe.restart, name=one.name)
            runs.append(made)
    return tuple(runs)


def _base_std(basis: BaseParameters, regression: Regression, estimate: Estimate) -> Array:
    if estimate.information is None:
        std = base_std(basis, regression.triangular_factors, estimate.sigma, estimate.weights)
        return np.hypot(std, _moved(estimate, basis))
    return informed_std(basis, estimate.information)


def _robust_std(
    regression: Regression, estimate: Estimate, own: Array, basis: BaseParameters | None = None
) -> Array | None:
    """Return standard errors that allow for correlated residuals, at least ``own`` where these count the motion's."""
    columns = None if basis is None else basis.independent
    try:
        covariance = robust_covariance(regression, estimate.value, estimate.weights, columns, estimate.slopes)
        robust = np.hypot(np.sqrt(np.diag(covariance)), _moved(estimate, basis))
    except ModelError:  # nearly dependent columns: then there is no such figure
        return None
    return robust if estimate.information is None else np.maximum(robust, own)


def _moved(estimate: Estimate, basis: BaseParameters | None) -> Array:
    """Return what constraints moved the parameters by, or the base parameters; it may be an error of theirs."""
    moved = np.zeros_like(estimate.value) if estimate.unconstrained is None else estimate.value - estimate.unconstrained
    return moved if basis is None else basis.to_base(moved)


def _of_determined(basis: BaseParameters, std: Array) -> Array:
    """Return standard errors (p) of the standard parameters that are base parameters by themselves, else infinite."""
    found = np.full(len(basis.names), np.inf)
    for k, row, value in zip(basis.independent, basis.combination, std, strict=True):
        if np.count_nonzero(row) == 1:
            found[k] = value
    return found


def _settings(recipe: Recipe) -> dict[str, str]:
    """Return what a saved result says of the recipe."""
    found = {"recipe": repr(recipe), "estimator": repr(recipe.estimator), "low-pass": repr(recipe.filter)}
    return {**found, "seed of the random poses": str(SEED)}


def _used(smoother: Smoother, time_offset: float) -> dict[str, str]:
    """Return what a saved result must say of the smoother to be used again."""
    used = {"smoother used": repr(unshifted(smoother))}
    return used | {"delay used": repr(time_offset)} if time_offset else used


def versions() -> dict[str, str]:
    """Return the versions of what computes the numbers, and the platform."""
    found = {"dynident": __version__, "python": platform.python_version()}
    for name in ("numpy", "scipy", "pin", "clarabel", "polars"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:  # pin, where there is no wheel for it, may come from elsewhere
            found[name] = "not installed as a package"
    return {**found, "platform": platform.platform()}


def _named(logs: Mapping[str, Log] | Sequence[Log]) -> dict[str, Log]:
    if isinstance(logs, Mapping):
        return dict(logs)
    named = {log.source: log for log in logs}
    if len(named) != len(logs):
        raise ConfigError(f"two logs have the same source among {[log.source for log in logs]}; give them by name.")
    return named
