"""An identification as the plain values of ``result.json``."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from enum import Enum
from typing import Any

import numpy as np

from dynident.errors import Finding, Note
from dynident.estimators import Estimate
from dynident.identification import Calibration, Choice, Identification, Recipe, TermChoice
from dynident.io.families import ESTIMATORS, SMOOTHERS, TERMS
from dynident.io.result_format import FORMAT, VERSION, ResultFile
from dynident.regression import BaseParameters
from dynident.simulation import Failure
from dynident.validation import LogValidation

__all__ = ["result_data"]


def result_data(found: Identification, report: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Return a result as JSON holds it; ``report`` is what a report adds in words.

    Signals, sample weights and the directions of the rank are left out. Raises ConfigError where a part has settings
    without a plain form.
    """
    mass, notes = found.mass, found.notes
    data = {
        "format": FORMAT,
        "version": VERSION,
        "parameters": list(_parameters(found)),
        "report": report,
        "validations": [_validation(one) for one in found.validations],
        "recipe": _recipe(found.recipe),
        "calibration": _calibration(found.calibration),
        "base_parameters": _identifiability(found),
        "estimate": _estimate(found.estimate),
        "mass_matrix": mass and {"smallest": mass.smallest, "q": mass.q, "positive": bool(mass.positive)},
        "warnings": [_kind(note) for note in notes],
        "findings": [_finding(one) for one in found.findings],
        "model": {
            "name": found.model.name,
            "joints": [asdict(joint) for joint in found.model.joints],
            "load": found.model.load,
        },
        "provenance": asdict(found.provenance),
    }
    plain: dict[str, Any] = _plain(data)
    ResultFile.model_validate(plain)  # what is written can be read
    return plain if report is not None else {key: value for key, value in plain.items() if key != "report"}


def _parameters(found: Identification) -> Iterator[dict[str, Any]]:
    estimate, errors = found.estimate, found.errors
    for k, parameter in enumerate(estimate.parameters):
        yield {
            "name": parameter.name,
            "value": estimate.value[k],
            "std": errors.std[k],
            "std_hac": None if errors.std_hac is None else errors.std_hac[k],
            "unit": parameter.unit,
            "provenance": estimate.provenance[k] if estimate.provenance else None,
        }


def _estimate(estimate: Estimate) -> dict[str, Any]:
    residual = estimate.residual
    noise = residual.whitening
    more: dict[str, Any] = {} if residual.pieces is None else {"pieces": vars(residual.pieces)}
    if residual.correlated:
        more["correlated"] = True
    if noise is not None:
        more["whitening"] = {"coefficients": noise.coefficients, "covariance": noise.covariance}
    return {
        "rank": estimate.determined.rank,
        "condition": estimate.determined.condition,
        "residual": {"sigma": residual.sigma, "samples": residual.samples, "weights": residual.weights, **more},
        "consistency": None if estimate.consistency is None else asdict(estimate.consistency),
        "notes": [_kind(note) for note in estimate.notes],
        "covariance": estimate.covariance,
        "interval": estimate.interval,
        "information": estimate.information,
    }


def _recipe(recipe: Recipe) -> dict[str, Any]:
    (smoother,) = recipe.smoothers
    return {
        "smoother": SMOOTHERS.describe(smoother),
        "estimator": ESTIMATORS.describe(recipe.estimator),
        "filter": None if recipe.filter is None else asdict(recipe.filter),
        "min_speed": recipe.min_speed,
        "time_offset": recipe.time_offset,
        "base_tilt": recipe.base_tilt,
        "restart": recipe.restart,
        "outliers": recipe.outliers,
        "rests": recipe.rests,
    }


def _calibration(calibration: Calibration) -> dict[str, Any]:
    offset, tilt, strength = calibration.time_offset, calibration.base_tilt, calibration.prior_strength
    return {
        "smoother": None if calibration.smoother is None else _choice(calibration.smoother),
        "time_offset": None if offset is None else asdict(offset),
        "base_tilt": None if tilt is None else asdict(tilt),
        "prior_strength": None if strength is None else asdict(strength),
        "terms": None if calibration.terms is None else _terms(calibration.terms),
    }


def _terms(choice: TermChoice) -> dict[str, Any]:
    trials = [{**vars(one), "settings": dict(one.settings)} for one in choice.trials]
    plain = {key: value for key, value in vars(choice).items() if key != "terms"}
    return plain | {"trials": trials, "chosen": [TERMS.describe(one) for one in choice.terms]}


def _choice(choice: Choice) -> dict[str, Any]:
    pairs = zip(choice.candidates, choice.errors, strict=True)
    return {
        "chosen": choice.candidates.index(choice.smoother),
        "candidates": [{"smoother": SMOOTHERS.describe(one), "error": error} for one, error in pairs],
    }


def _identifiability(found: Identification) -> dict[str, Any]:
    base, units = found.base, found.estimate.units
    return {
        "on_data": base.on_data and _base(base.on_data, units, found),
        "structural": base.structural and _base(base.structural, units),
        "unexcited": [_kind(note) for note in base.unexcited],
        "covariance": found.errors.base_covariance,
        "by_joint": found.errors.base_by_joint,
        "shares": found.errors.base_shares,
        "by_load": found.errors.base_by_load,
    }


def _base(basis: BaseParameters, units: Sequence[str], found: Identification | None = None) -> dict[str, Any]:
    """Return base parameters by name, with their values and standard errors where they are known."""
    known = {}
    if found is not None:
        columns = basis.to_base(found.estimate.value), found.errors.base_std, found.errors.base_std_hac
        known = {key: one for key, one in zip(("value", "std", "std_hac"), columns, strict=True) if one is not None}
    rows = [
        {
            "name": name,
            **{key: one[k] for key, one in known.items()},
            "unit": units[lead],
            "lead": basis.names[lead],
            "combination": {basis.names[j]: basis.combination[k, j] for j in np.flatnonzero(basis.combination[k])},
        }
        for k, (name, lead) in enumerate(zip(basis.groupings, basis.independent, strict=True))
    ]
    return {"parameters": rows, "singular_values": basis.singular_values, "scale": basis.scale}


def _validation(log: LogValidation) -> dict[str, Any]:
    run = log.free_run
    keys = ("driver", "restart", "joints", "relative_error", "motion_error", "rms", "torque_error")
    return {
        "name": log.name,
        "role": log.role,
        "errors": asdict(log.errors),
        "residuals": {joint: asdict(test) for joint, test in log.residuals.items()},
        "floors": {joint: asdict(floor) for joint, floor in log.floors.items()},
        "free_run": run and {key: getattr(run, key) for key in keys} | {"failure": run.failure and _kind(run.failure)},
    }


def _finding(finding: Finding) -> dict[str, Any]:
    message = finding.message if isinstance(finding.message, str) else _kind(finding.message)
    return {**vars(finding), "message": message}


def _kind(noun: Note | Failure) -> dict[str, Any]:
    """Return the fields of a noun of which there are several kinds, with the name of its own."""
    return {"kind": type(noun).__name__, **asdict(noun)}


def _plain(value: Any) -> Any:
    """Return a value in types that JSON knows; numbers that are not finite become texts."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return "NaN" if math.isnan(value) else "Infinity" if value > 0 else "-Infinity"
    return value
