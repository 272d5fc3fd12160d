"""The whole method in one place: logs -> motions -> linear problem -> estimate -> validation."""

from __future__ import annotations

import platform
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib.metadata import version

import numpy as np
from numpy.typing import NDArray

from dynident import __version__
from dynident.basis import Basis, Missing, base_std, basis_of, compare, structural_basis
from dynident.errors import ConfigError, choices
from dynident.estimators import Estimate, Estimator, LeastSquares, Problem
from dynident.log import Log, Motion
from dynident.model import Model
from dynident.regression import Parallel, Regression
from dynident.selection import choose_smoother
from dynident.smoothers import Smoother, Spline
from dynident.validation import LogValidation, validate

__all__ = ["Identification", "Recipe", "identify", "versions"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Recipe:
    """How to identify: the interchangeable parts, with the article's method as the default.

    Of several smoothers, ``choose_smoother`` takes one by the cross-validated torque error on the training logs.
    ``slow``, a speed (rad/s, m/s) or one by joint name, leaves slower samples out of that joint's equation in the fit.
    """

    smoother: Smoother | tuple[Smoother, ...] = field(default_factory=Spline)
    estimator: Estimator = field(default_factory=LeastSquares)
    parallel: Parallel | None = None
    slow: Mapping[str, float] | float | None = None

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

    ``basis`` are the base parameters that the training data show, ``base_std`` (r) their standard errors in a fit
    without constraints, ``structural`` those that any motion could show, and ``missing`` the motion that would show
    the rest; all are given where the data do not determine every parameter.
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
    ConfigError, ModelError.
    """
    recipe = recipe or Recipe()
    joints = tuple(joint.name for joint in model.joints)
    roles = {"train": _named(train), "validation": _named(validation)}
    if not roles["train"]:
        raise ConfigError("no training log is given; name at least one.")
    roles = {role: {name: log.select(joints) for name, log in logs.items()} for role, logs in roles.items()}
    settings = {"recipe": repr(recipe)}
    smoother = recipe.smoother
    if isinstance(smoother, tuple):
        trained = tuple(roles["train"].values())
        choice = choose_smoother(model, trained, smoother, progress=progress)
        smoother, settings["smoother"] = choice.smoother, choice.words
    motions: dict[str, dict[str, Motion]] = {role: {} for role in roles}
    for role, logs in roles.items():
        for name, log in logs.items():
            progress(f"smoothing {name}")
            motions[role][name] = smoother(log)
    progress("estimating")
    fitted = tuple(motions["train"].values())
    slow = recipe.slowest(joints)
    regression = Regression(model, fitted, recipe.parallel, slow)
    estimate = recipe.estimator(Problem(model, fitted, regression, tuple(roles["train"].values())))
    progress("validating")
    judged = tuple(
        validate(model, estimate.value, motion, name=name, role=role, parallel=recipe.parallel, slow=slow)
        for role in ("train", "validation")
        for name, motion in motions[role].items()
    )
    warnings: tuple[str, ...] = () if estimate.status == "ok" else (estimate.status,)
    found = Identification(model, estimate, judged, warnings, settings, versions())
    if estimate.rank == len(model.parameters):
        return found
    progress("finding base parameters")
    on_data = basis_of(regression.compressed.stacked(), model.parameters)
    structural = structural_basis(model)
    missing = compare(structural, on_data, model, fitted)
    if any(parameter.body for parameter in model.parameters):  # no motion tells all inertial parameters apart
        warnings = tuple(one.words for one in missing)
    even = getattr(recipe.estimator, "weights", "equal") == "equal"
    std = base_std(on_data, regression.compressed, estimate.sigma, None if even else 1.0 / estimate.sigma)
    return replace(found, basis=on_data, base_std=std, structural=structural, missing=missing, warnings=warnings)


def versions() -> dict[str, str]:
    """Return the versions of what computes the numbers."""
    packages = {name: version(name) for name in ("numpy", "scipy")}
    return {"dynident": __version__, "python": platform.python_version(), **packages}


def _named(logs: Mapping[str, Log] | Sequence[Log]) -> dict[str, Log]:
    if isinstance(logs, Mapping):
        return dict(logs)
    named = {log.source: log for log in logs}
    if len(named) != len(logs):
        raise ConfigError(f"two logs have the same source among {[log.source for log in logs]}; give them by name.")
    return named
