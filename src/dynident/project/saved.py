"""Results to files, and read again: ``result.json``."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from enum import Enum
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from dynident.estimators import Estimate
from dynident.files.folder import settle
from dynident.files.opener import content, real_path, refuse_inputs, remember_inputs, watch_inputs
from dynident.files.results import as_path, write_json
from dynident.files.yaml_text import is_deep
from dynident.identification import Calibration, Identification, Recipe, SmootherChoice, Sources
from dynident.identification.terms import TermChoice
from dynident.models import Model
from dynident.models.simulation import Failure
from dynident.project.config import parse_config
from dynident.project.logs import Reading, log_spec, read_logs
from dynident.project.result_format import FORMAT, VERSION, ResultFile
from dynident.project.result_read import identification_of
from dynident.regression import BaseParameters
from dynident.runtime import Finding, InputError, ModelError, Note
from dynident.runtime.families import ESTIMATORS, SMOOTHERS, TERMS
from dynident.validation import LogValidation

JSON_WEIGHT = 30  # memory of the content of JSON, per byte of its text


def result_data(identification: Identification, report: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Return a result as JSON holds it; ``report`` is what a report adds in words.

    Signals, sample weights and the directions of the rank are left out. Raises ConfigError where a part has settings
    without a plain form.
    """
    mass, notes = identification.mass, identification.notes
    data = {
        "format": FORMAT,
        "version": VERSION,
        "parameters": list(_parameter_rows(identification)),
        "report": report,
        "validations": [_validation_values(entry) for entry in identification.validations],
        "recipe": _recipe_values(identification.recipe),
        "calibration": _calibration_values(identification.calibration),
        "base_parameters": _identifiability_values(identification),
        "estimate": _estimate_values(identification.estimate),
        "mass_matrix": mass and {"smallest": mass.smallest, "q": mass.q, "positive": bool(mass.positive)},
        "warnings": [_tagged_values(note) for note in notes],
        "findings": [_finding_values(entry) for entry in identification.findings],
        "model": {
            "name": identification.model.name,
            "joints": [asdict(joint) for joint in identification.model.joints],
            "load": identification.model.load,
        },
        "provenance": asdict(identification.provenance),
    }
    plain: dict[str, Any] = _to_json_value(data)
    ResultFile.model_validate(plain)  # what is written can be read
    return plain if report is not None else {key: value for key, value in plain.items() if key != "report"}


def _parameter_rows(identification: Identification) -> Iterator[dict[str, Any]]:
    estimate, errors = identification.estimate, identification.errors
    for k, parameter in enumerate(estimate.parameters):
        yield {
            "name": parameter.name,
            "value": estimate.value[k],
            "std": errors.std[k],
            "std_independent": errors.std_independent[k],
            "unit": parameter.unit,
            "provenance": estimate.provenance[k] if estimate.provenance else None,
        }


def _estimate_values(estimate: Estimate) -> dict[str, Any]:
    residual = estimate.residual
    whitening = residual.whitening
    # parts that few estimators have are left out instead of written as null
    optional_parts: dict[str, Any] = {} if residual.pieces is None else {"pieces": vars(residual.pieces)}
    if residual.correlated:
        optional_parts["correlated"] = True
    if whitening is not None:
        optional_parts["whitening"] = {"coefficients": whitening.coefficients, "covariance": whitening.covariance}
    return {
        "rank": estimate.determined.rank,
        "condition": estimate.determined.condition,
        "residual": {
            "sigma": residual.sigma,
            "samples": residual.samples,
            "weights": residual.weights,
            **optional_parts,
        },
        "consistency": None if estimate.consistency is None else asdict(estimate.consistency),
        "notes": [_tagged_values(note) for note in estimate.notes],
        "covariance": estimate.covariance,
        "interval": estimate.interval,
        "information": estimate.information,
    }


def _recipe_values(recipe: Recipe) -> dict[str, Any]:
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


def _calibration_values(calibration: Calibration) -> dict[str, Any]:
    offset, tilt, strength = calibration.time_offset, calibration.base_tilt, calibration.prior_strength
    return {
        "smoother": None if calibration.smoother is None else _smoother_choice_values(calibration.smoother),
        "time_offset": None if offset is None else asdict(offset),
        "base_tilt": None if tilt is None else asdict(tilt),
        "prior_strength": None if strength is None else asdict(strength),
        "terms": None if calibration.terms is None else _term_choice_values(calibration.terms),
    }


def _term_choice_values(choice: TermChoice) -> dict[str, Any]:
    trials = [{**vars(entry), "settings": dict(entry.settings)} for entry in choice.trials]
    plain = {key: value for key, value in vars(choice).items() if key != "terms"}
    return plain | {"trials": trials, "chosen": [TERMS.describe(entry) for entry in choice.terms]}


def _smoother_choice_values(choice: SmootherChoice) -> dict[str, Any]:
    pairs = zip(choice.candidates, choice.errors, strict=True)
    return {
        "chosen": choice.candidates.index(choice.smoother),
        "candidates": [{"smoother": SMOOTHERS.describe(candidate), "error": error} for candidate, error in pairs],
    }


def _identifiability_values(identification: Identification) -> dict[str, Any]:
    base, units = identification.base, identification.estimate.units
    return {
        "on_data": base.on_data and _base_values(base.on_data, units, identification),
        "structural": base.structural and _base_values(base.structural, units),
        "unexcited": [_tagged_values(note) for note in base.unexcited],
        "covariance": identification.errors.base_covariance,
        "by_joint": identification.errors.base_by_joint,
        "shares": identification.errors.base_shares,
        "by_load": identification.errors.base_by_load,
    }


def _base_values(
    basis: BaseParameters, units: Sequence[str], identification: Identification | None = None
) -> dict[str, Any]:
    """Return base parameters by name, with their values and standard errors where they are known."""
    estimates = {}
    if identification is not None:
        columns = (
            basis.to_base(identification.estimate.value),
            identification.errors.base_std,
            identification.errors.base_std_independent,
        )
        estimates = {
            key: column
            for key, column in zip(("value", "std", "std_independent"), columns, strict=True)
            if column is not None
        }
    # of each combination only the coefficients that are not zero
    rows = [
        {
            "name": name,
            **{key: column[k] for key, column in estimates.items()},
            "unit": units[lead],
            "lead": basis.names[lead],
            "combination": {basis.names[j]: basis.combination[k, j] for j in np.flatnonzero(basis.combination[k])},
        }
        for k, (name, lead) in enumerate(zip(basis.groupings, basis.independent, strict=True))
    ]
    return {"parameters": rows, "singular_values": basis.singular_values, "scale": basis.scale}


def _validation_values(log: LogValidation) -> dict[str, Any]:
    run = log.free_run
    keys = ("driver", "restart", "joints", "relative_error", "motion_error", "rms", "torque_error")
    return {
        "name": log.name,
        "role": log.role,
        "errors": asdict(log.errors),
        "residuals": {joint: asdict(test) for joint, test in log.residuals.items()},
        "floors": {joint: asdict(floor) for joint, floor in log.floors.items()},
        "free_run": run
        and {key: getattr(run, key) for key in keys} | {"failure": run.failure and _tagged_values(run.failure)},
    }


def _finding_values(finding: Finding) -> dict[str, Any]:
    return {**vars(finding), "message": _tagged_values(finding.message)}


def _tagged_values(noun: Note | Failure) -> dict[str, Any]:
    """Return the fields of a note or failure, tagged with the name of its class."""
    return {"kind": type(noun).__name__, **asdict(noun)}


def _to_json_value(value: Any) -> Any:
    """Return a value in types that JSON knows; numbers that are not finite become texts."""
    if isinstance(value, Mapping):
        return {str(key): _to_json_value(item) for key, item in value.items()}
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, np.ndarray | np.generic):
        return _to_json_value(value.tolist())
    if isinstance(value, list | tuple):
        return [_to_json_value(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return "NaN" if math.isnan(value) else "Infinity" if value > 0 else "-Infinity"
    return value


def save(identification: Identification, path: str | Path, report: Mapping[str, Any] | None = None) -> Path:
    """Write a result as JSON and return the path; ``report`` is what a report adds in words.

    The file never is half written. Raises InputError where it cannot be written, ConfigError where a part has settings
    without a plain form, or where a file that was read would be replaced.
    """
    path = as_path(path)
    with watch_inputs(*source_files(identification.provenance)):
        refuse_inputs(path)
        return write_json(path, result_data(identification, report))


def load(path: str | Path, model: Model | None = None, *, allow_code: bool = False) -> Identification:
    """Read a result that was saved: all that ``save`` writes, to the last digit; signals of the logs are None.

    The model is built again from the configuration in the result and the model's file, which must not have changed. A
    result made from Python needs the ``model`` as it was given to ``identify``.

    A result that names a Python file, as the model or as a part, is refused unless ``allow_code``: reading it would run
    the file. Raises InputError where the file is no result or of a newer version, ModelError
    where the model is another than it was, ConfigError where its configuration cannot be read any more.

    >>> import numpy as np
    >>> import dynident as dy
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> from dynident.models.lagrangian import pendulum
    >>> arm = pendulum()
    >>> motion = dy.simulate(arm, arm.values, lambda s: [np.sin(5 * s)], np.arange(1001) * 0.01)
    >>> log = dy.record(motion, 1e-4, 0.01, np.random.default_rng(0)).log
    >>> found = dy.identify(arm, log)
    >>> with TemporaryDirectory() as folder:
    ...     _ = found.save(Path(folder, "result.json"))
    ...     again = dy.load(Path(folder, "result.json"), model=arm)
    >>> bool((again.estimate.value == found.estimate.value).all())
    True
    """
    if not isinstance(model, Model | None):
        raise ModelError(f"load: the model is a {type(model).__name__}; give the Model that was identified.")
    data, source = result_values(as_path(path)), str(path)
    if data.get("format") != FORMAT:
        raise InputError(f"{path}: is no result of `dynident identify`: it needs `format`: {FORMAT!r}.")
    if data.get("version") != VERSION:
        raise InputError(
            f"{path}: has version {data.get('version')!r}, and this dynident reads {VERSION}; identify again, or take "
            "another dynident."
        )
    identification = identification_of(data, source, model, allow_code=allow_code)
    for file in source_files(identification.provenance):
        remember_inputs(file)
    return identification


def read_log_like(identification: Identification, text: str, *, allow_code: bool = False) -> Reading:
    """Read the recording named on a command line, as ``log_spec`` says, with the channels of a result's configuration.

    Its torques may be missing; ``allow_code`` as in ``load``. Raises the errors of ``log_spec`` and ``read_logs``, and
    InputError for a result without configuration.
    """
    configuration = identification.provenance.configuration
    if configuration is None:
        raise InputError("the result was made from Python, without a configuration: predict a Log from Python, too.")
    config = parse_config(
        configuration.text, Path(configuration.path).parent, configuration.path, allow_code=allow_code
    )
    return read_logs(log_spec(text, config), config, identification.model.joints, torque=False)


def model_files(path: Path, sources: Sources) -> tuple[str, ...]:
    """Return the files of the model that were written with the result at ``path`` and are unchanged.

    Files that are among the ``sources`` are left out.
    """
    read = source_files(sources)
    try:
        export_entries = json.loads(content(path, weight=JSON_WEIGHT, remember=False))["report"]["exports"]
        digests = {path.with_name(entry["file"]): entry["sha256"] for entry in export_entries}
        present_files = [file for file in digests if file.is_file() and str(real_path(file)) not in read]
        return tuple(
            file.name for file in present_files if sha256(content(file, remember=False)).hexdigest() == digests[file]
        )
    except (InputError, ValueError, RecursionError, KeyError, TypeError):
        return ()  # no result, or of another version


def source_files(sources: Sources) -> list[str]:
    """Return the files that a result was made from: the configuration, the model's file and the recordings."""
    return [file.path for file in (sources.configuration, sources.model, *sources.logs) if file is not None]


def result_values(path: Path) -> dict[str, Any]:
    """Return the plain values of a saved result; InputError where the file is none."""
    settle(path.parent)
    text = content(path, InputError, (".json",), JSON_WEIGHT)
    try:
        data = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: is not a result.json of `dynident identify` ({error}).") from error
    if not isinstance(data, dict) or is_deep(data):
        raise InputError(f"{path}: is not a result.json of `dynident identify`.")
    return data
