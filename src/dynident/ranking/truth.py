"""The true parameters, where they are known, and how far an estimate is from them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynident.bounds import accuracy_bound
from dynident.errors import ConfigError, ModelError, brief, choices
from dynident.identification import Identification, StandardErrors
from dynident.identification.result import Identifiability
from dynident.io.excitation_known import nominal
from dynident.io.opener import real
from dynident.io.opener import text as text_of
from dynident.io.robot import SUFFIXES, load_robot
from dynident.io.saved import result_values
from dynident.io.settings import RobotSettings
from dynident.io.yaml_text import load_yaml
from dynident.log import Log
from dynident.models import Model, RigidBodies
from dynident.regression import base_parameters

__all__ = ["Truth", "digest_text", "read_truth", "truth_of"]

Array = NDArray[np.float64]
NEGLIGIBLE = 1e-6  # share of a base parameter, in scaled columns, that an unknown parameter may have


@dataclass(frozen=True, eq=False)
class Truth:
    """True base parameters ``value`` (r), nan where not known, with their ``names`` and ``units``, as the map
    ``combination`` (r, p) makes them of the parameters of the model; ``bound`` (r) are the least standard deviations
    that any unbiased method can reach with these logs."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    combination: Array
    value: Array
    bound: Array

    __repr__ = brief

    def base(self, value: Array) -> Array:
        """Return the base parameters (r) of parameters (p)."""
        return self.combination @ value

    def std(self, errors: StandardErrors, base: Identifiability) -> Array:
        """Return the standard errors (r) of an estimate for these base parameters, nan for those it has not."""
        own = base.on_data
        if own is None and len(errors.best) == len(self.names):
            return errors.best
        found = errors.best_base
        known = {} if own is None or found is None else dict(zip(own.groupings, found.tolist(), strict=True))
        return np.array([known.get(name, np.nan) for name in self.names])


def read_truth(given: str | Path | Mapping[str, float], folder: Path, spec: str | RobotSettings) -> dict[str, float]:
    """Return true values by the names of parameters: a mapping, or a file in the ``folder``.

    The file is YAML of values by name, the ``parameters.yaml`` or ``result.json`` of an identification, or a robot file
    with the true values, read with the settings of the model. Raises ConfigError and InputError for any other.
    """
    if isinstance(given, Mapping):
        return {str(name): float(value) for name, value in given.items()}
    path = real(folder / given)
    if path.suffix.lower() in SUFFIXES:
        return _of_robot(path, spec)
    if path.suffix.lower() == ".json":
        return _rows(result_values(path).get("parameters"), path)
    data = load_yaml(text_of(path, ConfigError, (".yaml", ".yml")), str(path))
    if isinstance(data, dict) and isinstance(data.get("parameters"), list):
        return _rows(data["parameters"], path)
    if not isinstance(data, dict) or not all(_is_number(value) for value in data.values()):
        raise ConfigError(f"{path}: is no list of true values; write lines such as `Fv_elbow: 6.0`.")
    return {str(name): float(value) for name, value in data.items()}


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and bool(np.isfinite(value))


def _rows(rows: Any, path: Path) -> dict[str, float]:
    if not isinstance(rows, list) or not all(isinstance(one, dict) and _is_number(one.get("value")) for one in rows):
        raise ConfigError(f"{path}: its `parameters` are no list of names with values.")
    return {str(one.get("name")): float(one["value"]) for one in rows}


def _of_robot(path: Path, spec: str | RobotSettings) -> dict[str, float]:
    if not isinstance(spec, RobotSettings):
        raise ConfigError(f"truth: {path} is a robot file, and the model is none; give values by name.")
    model = load_robot(spec.model_copy(update={"file": {str(path): path}}))
    known = nominal(model)
    return dict(zip(model.names, known.theta.tolist(), strict=True)) | _of_joints(model)


def _of_joints(model: Model) -> dict[str, float]:
    """Return friction and rotor inertia that the robot file gives, by the names that terms of them have."""
    found: dict[str, float] = {}
    for term in model.terms:
        if isinstance(term, RigidBodies):
            for prefix, values in (("Fv", term.damping), ("Fc", term.friction), ("Ia", term.armature)):
                found |= {f"{prefix}_{joint}": float(value) for joint, value in values.items()}
    return found


def truth_of(values: Mapping[str, float], found: Identification, logs: Mapping[str, Log]) -> Truth:
    """Return what is true of the base parameters of an identification, and the bound at its parameters.

    Raises ConfigError where no value is of a parameter of the model, and the errors of ``accuracy_bound``.
    """
    names = found.estimate.names
    if not set(values) & set(names):
        first = next(iter(values), "")
        raise ConfigError(f"truth: none of its values is of a parameter of the model; {choices(first, names)}")
    directions = found.estimate.determined.directions
    if directions is None:
        raise ModelError("truth: the first fit does not say what the data determine.")
    basis = base_parameters(directions, found.estimate.parameters)
    known = np.array([name in values for name in names])
    share = np.abs(basis.combination) * basis.scale[list(basis.independent), None] / basis.scale
    lost = (share > NEGLIGIBLE)[:, ~known].any(axis=1)
    value = basis.to_base(np.array([values.get(name, 0.0) for name in names]))
    bound = accuracy_bound(found.model, logs, replace(found.recipe, restart=None))
    least = dict(zip(bound.names, bound.std["now"].tolist(), strict=True))
    return Truth(
        basis.groupings,
        tuple(found.estimate.units[k] for k in basis.independent),
        basis.combination,
        np.where(lost, np.nan, value),
        np.array([least.get(name, np.nan) for name in basis.groupings]),
    )


def digest_text(truth: Truth | None) -> str:
    """Return what tells a truth from others, as text."""
    if truth is None:
        return ""
    return json.dumps([truth.names, np.round(truth.value, 12).tolist(), truth.combination.tolist()])
