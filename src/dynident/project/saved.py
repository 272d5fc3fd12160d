"""Results to files, and read again: ``result.json``."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import is_dataclass
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np

from dynident.files.folder import is_unchanged, settle
from dynident.files.opener import content, real_path, refuse_inputs, remember_inputs, watch_inputs
from dynident.files.results import as_path, write_json
from dynident.files.yaml_text import is_deep
from dynident.identification import Identification, Sources
from dynident.models import Model, RigidBodies
from dynident.project.config import parse_config
from dynident.project.logs import Reading, log_spec, read_logs
from dynident.project.result_format import FORMAT, SERVO_FORMAT, VERSION
from dynident.project.result_read import identification_of
from dynident.project.settings import Config
from dynident.regression import BaseParameters
from dynident.runtime import InputError, ModelError, Part, TaggedUnion, saved_fields
from dynident.runtime.families import part_family

JSON_WEIGHT = 30  # memory of the content of JSON, per byte of its text


def result_data(identification: Identification, report: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Return a result as JSON holds it; ``report`` is what a report adds in words.

    Signals, sample weights and the directions of the rank are left out. Raises ConfigError where a part has settings
    without a plain form.
    """
    base, model = identification.base, identification.model
    data = {
        "format": FORMAT,
        "version": VERSION,
        "parameters": list(_parameter_rows(identification)),
        **({} if report is None else {"report": report}),
        "validations": identification.validations,
        "recipe": identification.recipe,
        "calibration": identification.calibration,
        "base_parameters": {
            "on_data": base.on_data and _base_values(base.on_data, identification, on_data=True),
            "structural": base.structural and _base_values(base.structural, identification),
            "unexcited": base.unexcited,
        },
        "errors": identification.errors,
        "estimate": identification.estimate,
        "mass_matrix": identification.mass,
        "verdict": identification.verdict,
        "warnings": identification.notes,
        "findings": identification.findings,
        "model": {"name": model.name, "joints": model.joints, "load": model.load, "lock": _locked_positions(model)},
        "provenance": identification.provenance,
    }
    plain: dict[str, Any] = _plain_values(data)
    return plain


def _locked_positions(model: Model) -> dict[str, float]:
    bodies = [term for term in model.terms if isinstance(term, RigidBodies)]
    return {name: float(value) for term in bodies for name, value in dict(term.locked).items()}


def _parameter_rows(identification: Identification) -> Iterator[dict[str, Any]]:
    estimate, errors = identification.estimate, identification.errors
    for k, parameter in enumerate(estimate.parameters):
        provenance = estimate.provenance[k] if estimate.provenance else None
        yield {
            "name": parameter.name, "value": estimate.value[k], "std": errors.std[k],
            "std_independent": errors.std_independent[k], "unit": parameter.unit, "provenance": provenance,
        }  # fmt: skip


def _base_values(basis: BaseParameters, identification: Identification, *, on_data: bool = False) -> dict[str, Any]:
    """Return base parameters by name; those ``on_data`` with their values and standard errors where they are known."""
    estimate, errors = identification.estimate, identification.errors
    columns = {"value": basis.to_base(estimate.value), "std": errors.base_std}
    columns |= {"std_independent": errors.base_std_independent}
    # of each combination only the coefficients that are not zero
    rows = [
        {
            "name": name,
            **{key: column[k] for key, column in columns.items() if on_data and column is not None},
            "unit": estimate.units[lead],
            "lead": basis.names[lead],
            "combination": {basis.names[j]: basis.combination[k, j] for j in np.flatnonzero(basis.combination[k])},
        }
        for k, (name, lead) in enumerate(zip(basis.groupings, basis.independent, strict=True))
    ]
    return {"parameters": rows, "singular_values": basis.singular_values, "scale": basis.scale}


def _plain_values(value: Any) -> Any:
    """Return nouns and their fields in types that JSON knows; numbers that are not finite become texts."""
    if isinstance(value, Part):
        return _plain_values(part_family(type(value)).describe(value))
    if is_dataclass(value) and not isinstance(value, type):
        tag: dict[str, Any] = {"kind": type(value).__name__} if isinstance(value, TaggedUnion) else {}
        return tag | {name: _plain_values(getattr(value, name)) for name in saved_fields(type(value))}
    if isinstance(value, Mapping):
        return {str(key): _plain_values(item) for key, item in value.items()}
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, np.ndarray | np.generic):
        return _plain_values(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain_values(item) for item in value]
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
    identification = identification_of(data, source, model, allow_code=allow_code)
    for file in source_files(identification.provenance):
        remember_inputs(file)
    return identification


def read_log_like(identification: Identification, text: str, *, allow_code: bool = False) -> Reading:
    """Read the recording named on a command line, as ``log_spec`` says, with the channels of a result's configuration.

    Its torques may be missing; ``allow_code`` as in ``load``. Raises the errors of ``log_spec`` and ``read_logs``, and
    InputError for a result without configuration.
    """
    config = config_of_result(identification, "predict a Log", allow_code=allow_code)
    return read_logs(log_spec(text, config), config, identification.model.joints, torque=False)


def config_of_result(identification: Identification, task: str, *, allow_code: bool) -> Config:
    """Return the configuration of a result; InputError, which says a ``task``, for one that was made from Python."""
    configuration = identification.provenance.configuration
    if configuration is None:
        raise InputError(f"the result was made from Python, without a configuration: {task} from Python, too.")
    folder = Path(configuration.path).parent
    return parse_config(configuration.text, folder, configuration.path, allow_code=allow_code)


def model_files(path: Path, sources: Sources) -> tuple[str, ...]:
    """Return the files of the model that were written with the result at ``path`` and are unchanged.

    Files that are among the ``sources`` are left out.
    """
    read = source_files(sources)
    try:
        export_entries = json.loads(content(path, weight=JSON_WEIGHT, remember=False))["report"]["exports"]
        digests = {path.with_name(entry["file"]): entry["sha256"] for entry in export_entries}
        unread = {file: digest for file, digest in digests.items() if str(real_path(file)) not in read}
        return tuple(file.name for file, digest in unread.items() if is_unchanged(file, digest))
    except (InputError, ValueError, RecursionError, KeyError, TypeError):
        return ()  # no result, or of another version


def source_files(sources: Sources) -> list[str]:
    """Return the files that a result was made from: the configuration, the model's file and the recordings."""
    return [file.path for file in (sources.configuration, sources.model, *sources.logs) if file is not None]


def is_servo_result(path: Path) -> bool:
    """Whether a file is the servo.json of an arm of servos; InputError where it is no result at all."""
    return result_values(path).get("format") == SERVO_FORMAT


def result_values(path: Path, name: str = "result.json of `dynident identify`") -> dict[str, Any]:
    """Return the plain values of a saved result, or of what has another ``name``; InputError where the file is none."""
    settle(path.parent)
    text = content(path, InputError, (".json",), JSON_WEIGHT)
    try:
        data = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: is not a {name} ({error}).") from error
    if not isinstance(data, dict) or is_deep(data):
        raise InputError(f"{path}: is not a {name}.")
    return data
