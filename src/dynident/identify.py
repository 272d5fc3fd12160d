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
from dynident.basis import Basis, Missing, base_std, basis_of, compare, informed_std, structural_basis
from dynident.calibration import find_lean, mounted, pair
from dynident.control import FreeRun, free_run
from dynident.errors import ConfigError, ModelError, choices
from dynident.estimators import Estimate, Estimator, LeastSquares, Problem
from dynident.log import Log, Motion
from dynident.model import MassMatrixCheck, Model
from dynident.regression import Parallel, Regression, one_thread
from dynident.smoothers import Delayed, Smoother, Spline
from dynident.uncertainty import robust_covariance
from dynident.validation import SEED, LogValidation, check_mass, validate

__all__ = ["Identification", "Recipe", "identify", "versions"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Recipe:
    """How to identify: the interchangeable parts, with the article's method as the default.

    Of several smoothers, ``choose_smoother`` takes one by the cross-validated torque error on the training logs.
    ``slow``, a speed (rad/s, m/s) or one by joint name, leaves slower samples out of that joint's equation in the fit.
    ``delay`` (s) is how much later than the torque the positions show the motion; "estimate" finds it on the training
    logs. With ``lean`` the lean of the robot's base is found there too. ``restart`` (s) asks for free simulations from
    the measured torque; logs that know their controller need none.
    """

    smoother: Smoother | tuple[Smoother, ...] = field(default_factory=Spline)
    estimator: Estimator = field(default_factory=LeastSquares)
    parallel: Parallel | None = None
    slow: Mapping[str, float] | float | None = None
    delay: float | Literal["estimate"] = 0.0
    lean: bool = False
    restart: float | None = None

    def slowest(self, joints: Sequence[str]) -> tuple[float, ...] | None:
        """Return ``slow`` for each joint; ConfigError where it names another."""
        if self.slow is None or not isinstance(self.slow, Mapping):
            return None if self.slow is None else (float(self.slow),) * len(joints)
        for name in self.slow:
            if name not in joints:
                raise ConfigError(f"slow: there is no joint {name!r}. {choices(name, joints)}")
        return tuple(float(self.slow.get(name, 0.0)) for name in joints)


@dataclass(frozen=True, eq=False)
class Identification:
    """Everything that one run found: what reports and exports read.

    ``basis`` are the base parameters that the training data show, ``base_std`` (r) their standard errors for
    independent residuals, ``structural`` those that any motion could show, and ``missing`` the motion that would show
    the rest; all are given where the data do not determine every parameter.

    ``std_hac`` (p) and ``base_std_hac`` (r) are standard errors that allow for correlated residuals, infinite for what
    the data do not determine, None where they cannot be had. ``mass`` is the mass matrix over all logs and random
    poses; ``runs`` are the free simulations. ``recorded`` are the recordings before smoothing, one for each log; their
    positions show the motion ``delay`` (s) later than their torques.
    """

    model: Model
    estimate: Estimate
    logs: tuple[LogValidation, ...]
    warnings: tuple[str, ...] = ()
    settings: Mapping[str, str] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
    basis: Basis | None = None
    base_std: Array | None = None
    structural: Basis | None = None
    missing: tuple[Missing, ...] = ()
    std_hac: Array | None = None
    base_std_hac: Array | None = None
    mass: MassMatrixCheck | None = None
    runs: tuple[FreeRun, ...] = ()
    recorded: tuple[Log, ...] = ()
    delay: float = 0.0


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
    roles = {"train": _named(train), "validation": _named(validation)}
    if not roles["train"]:
        raise ConfigError("no training log is given; name at least one.")
    roles = {role: {name: log.select(joints) for name, log in logs.items()} for role, logs in roles.items()}
    settings = {"recipe": repr(recipe), "estimator": repr(recipe.estimator), "low-pass": repr(recipe.parallel)}
    settings["seed of the random poses"] = str(SEED)
    slow = recipe.slowest(joints)
    candidates = recipe.smoother if isinstance(recipe.smoother, tuple) else (recipe.smoother,)
    trained = tuple(roles["train"].values())
    smoother, told = pair(model, trained, candidates, recipe.delay, recipe.estimator, slow, progress=progress)
    settings |= told
    settings |= _used(smoother)
    motions: dict[str, dict[str, Motion]] = {role: {} for role in roles}
    for role, logs in roles.items():
        for name, log in logs.items():
            progress(f"smoothing {name}")
            motions[role][name] = smoother(log)
    fitted = tuple(motions["train"].values())
    if recipe.lean:
        progress("finding how the base leans")
        lean = find_lean(model, fitted, recipe.estimator, slow)
        model = mounted(model, lean.x, lean.y)
        settings |= {"lean": lean.words, "lean used": repr((lean.x, lean.y))}
    progress("reducing the regression to triangular factors")
    regression = Regression(model, fitted, recipe.parallel, slow)
    _ = regression.compressed
    progress("estimating")
    late = smoother.delay if isinstance(smoother, Delayed) else 0.0
    estimate = recipe.estimator(Problem(model, fitted, regression, trained, late))
    progress("validating")
    judged = tuple(
        validate(model, estimate.value, motion, name=name, role=role, parallel=recipe.parallel, slow=slow)
        for role in ("train", "validation")
        for name, motion in motions[role].items()
    )
    found = Identification(
        model,
        estimate,
        judged,
        () if estimate.status == "ok" else (estimate.status,),
        settings,
        versions(),
        mass=check_mass(model, estimate.value, [log.motion for log in judged]),
        runs=_runs(model, estimate, judged, roles, recipe, smoother, progress),
        recorded=tuple(roles[log.role][log.name] for log in judged),
        delay=smoother.delay if isinstance(smoother, Delayed) else 0.0,
    )
    return _with_errors(found, regression, fitted, progress)


def _with_errors(
    found: Identification, regression: Regression, fitted: tuple[Motion, ...], progress: Callable[[str], None]
) -> Identification:
    """Return the identification with honest standard errors, and base parameters where not all are determined."""
    model, estimate = found.model, found.estimate
    if estimate.rank == len(model.parameters):
        return replace(found, std_hac=_robust_std(regression, estimate, estimate.std))
    progress("finding base parameters")
    shown = estimate.directions  # where the estimator says them, so that both have one rank
    on_data = basis_of(regression.compressed.stacked(estimate.weights) if shown is None else shown, model.parameters)
    structural = structural_basis(model)
    missing = compare(structural, on_data, model, fitted)
    if any(parameter.body for parameter in model.parameters):  # no motion tells all inertial parameters apart
        found = replace(found, warnings=(*estimate.remarks, *(one.words for one in missing)))
    own = _base_std(on_data, regression, estimate)
    robust = _robust_std(regression, estimate, own, on_data)
    return replace(
        found,
        basis=on_data,
        base_std=own,
        structural=structural,
        missing=missing,
        std_hac=None if robust is None else _of_determined(on_data, robust),
        base_std_hac=robust,
    )


def _runs(
    model: Model,
    estimate: Estimate,
    judged: Sequence[LogValidation],
    logs: Mapping[str, Mapping[str, Log]],
    recipe: Recipe,
    smoother: Smoother,
    progress: Callable[[str], None],
) -> tuple[FreeRun, ...]:
    runs = []
    for one in judged:
        log = logs[one.role][one.name]
        if log.controller is not None or recipe.restart is not None:
            progress(f"simulating {one.name}")
            # a controller sees the positions when they were stamped
            stamped = log.controller is not None and isinstance(smoother, Delayed)
            motion = smoother.smoother(log) if stamped else one.motion  # type: ignore[attr-defined]
            runs.append(free_run(model, estimate.value, motion, log.controller, recipe.restart, name=one.name))
    return tuple(runs)


def _base_std(basis: Basis, regression: Regression, estimate: Estimate) -> Array:
    if estimate.information is None:
        return base_std(basis, regression.compressed, estimate.sigma, estimate.weights)
    return informed_std(basis, estimate.information)


def _robust_std(regression: Regression, estimate: Estimate, own: Array, basis: Basis | None = None) -> Array | None:
    """Return standard errors that allow for correlated residuals, at least ``own`` where these count the motion's."""
    columns = None if basis is None else basis.independent
    try:
        robust = np.sqrt(np.diag(robust_covariance(regression, estimate.value, estimate.weights, columns)))
    except ModelError:  # nearly dependent columns: then there is no such figure
        return None
    return robust if estimate.information is None else np.maximum(robust, own)


def _of_determined(basis: Basis, std: Array) -> Array:
    """Return standard errors (p) of the standard parameters that are base parameters by themselves, else infinite."""
    found = np.full(len(basis.names), np.inf)
    for k, row, value in zip(basis.independent, basis.combination, std, strict=True):
        if np.count_nonzero(row) == 1:
            found[k] = value
    return found


def _used(smoother: Smoother) -> dict[str, str]:
    """Return what a saved result must say of the smoother to be used again."""
    if isinstance(smoother, Delayed):
        return {"smoother used": repr(smoother.smoother), "delay used": repr(smoother.delay)}
    return {"smoother used": repr(smoother)}


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
