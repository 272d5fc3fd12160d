"""An identification from the plain values of ``result.json``, and the model that it is of."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from dynident.estimators import Estimate
from dynident.identification import Identifiability, Identification, StandardErrors, tilt_base
from dynident.models import Model
from dynident.project.config import has_changed, is_xacro, load_model, parse_config
from dynident.project.parts import build
from dynident.project.result_format import ResultFile, ResultTables, read_result
from dynident.project.settings import robot_settings
from dynident.runtime import ConfigError, InputError, ModelError
from dynident.runtime.families import PartFamily


def identification_of(
    data: dict[str, Any], source: str, model: Model | None = None, *, allow_code: bool = False
) -> Identification:
    """Return the identification in the plain values of a file; ``model`` is needed where it was made from Python.
    Python files that the values name are run only where ``allow_code``.

    Raises InputError, led by ``source``, where the values do not fit, ModelError where the model is another than it
    was, and ConfigError where a part cannot be built.
    """
    tables = read_result(ResultTables, data, source)
    if model is None:
        model = _load_model(tables, source, allow_code=allow_code)
    configuration, joints = tables.provenance.configuration, model.joints
    # where the relative names of Python files start
    code_folder = Path(source if configuration is None else configuration.path).parent if allow_code else None

    def build_part(family: PartFamily, settings: Any) -> Any:
        return build(family, settings, family.name, code_folder, **({"joints": joints} if family.caller_fields else {}))

    try:
        file = read_result(ResultFile, data, source, build=build_part)
        model = _model_as_used(model, file)
    except (ConfigError, ModelError) as error:
        raise type(error)(f"{source}: {error}") from error
    base = file.base_parameters
    identification = Identification(
        model,
        file.recipe,
        _complete_estimate(file, model, source),
        _complete_errors(file),
        Identifiability(
            None if base.on_data is None else base.on_data.build(model.names, source),
            None if base.structural is None else base.structural.build(model.names, source),
            base.unexcited,
        ),
        file.validations,
        file.mass_matrix,
        file.calibration,
        file.provenance,
        (*file.warnings, *file.findings),
    )
    identification.fact("verdict", lambda: file.verdict)
    return identification


def _model_as_used(model: Model, file: ResultFile) -> Model:
    """Return the model with the terms that were chosen, on its tilted base; its parameters are those of the file."""
    choice, tilt = file.calibration.terms, file.recipe.base_tilt
    # nothing in a model as used is left to choose
    model = replace(model.with_terms(*(() if choice is None else choice.terms)), chooses_terms=False, proposed=())
    model = tilt_base(model, *tilt) if isinstance(tilt, tuple) else model
    names = tuple(row.name for row in file.parameters)
    if names != model.names:
        odd = next(iter(set(names) ^ set(model.names)), "")
        raise ModelError(f"its parameters are not those of the model ({odd!r}); identify again.")
    return model if file.model.load is None else replace(model, load=file.model.load)


def _load_model(tables: ResultTables, source: str, *, allow_code: bool) -> Model:
    """Return the model of a configuration, or of a robot file alone, which must be as it was.

    Where a robot file is gone, its text in the result is used. Raises InputError where there is neither, ModelError
    where the model's file is gone or has changed.
    """
    configuration, robot = tables.provenance.configuration, tables.provenance.model
    is_gone = robot is not None and bool(robot.text) and not os.path.exists(robot.path)
    if robot is not None and not is_gone and has_changed(robot):
        raise ModelError(
            f"{robot.path}: has changed since {source} was identified with it, so that its parameters may mean "
            "something else. Put the old file back, or identify again."
        )
    # the stored text of a xacro file is already expanded: reading the file would run a program
    text = robot.text if robot is not None and (is_gone or is_xacro(Path(robot.path))) else None
    if configuration is not None:
        folder = Path(configuration.path).parent
        config = parse_config(configuration.text, folder, f"{source}, its configuration", allow_code=allow_code)
        return load_model(config.model, folder, text, allow_code=allow_code)
    if robot is not None:
        # a call of Python names joints that are used or locked, which the file does not know
        used = {"joints": tuple(joint.name for joint in tables.model.joints), "lock": tables.model.lock}
        settings = robot_settings(robot.path)
        spec = robot.path if settings is None else settings.model_copy(update=used)
        return load_model(spec, text=text, allow_code=allow_code)
    raise InputError(f"{source}: was made from Python, without a configuration; give its model: load(path, model).")


def _complete_estimate(file: ResultFile, model: Model, source: str) -> Estimate:
    """Return the estimate with what stands in the rows of the parameters."""
    value = np.array([row.value for row in file.parameters])
    if not np.isfinite(value).all():
        raise InputError(f"{source}: a parameter has no value; identify again.")
    rows = tuple(row.provenance for row in file.parameters if row.provenance is not None)
    provenance = rows if len(rows) == len(value) else ()
    return replace(file.estimate, parameters=model.parameters, value=value, provenance=provenance)


def _complete_errors(file: ResultFile) -> StandardErrors:
    """Return the standard errors with what stands in the rows of the parameters and base parameters."""
    base = file.base_parameters.on_data
    names = ("std", "std_independent")
    columns = {name: np.array([getattr(row, name) for row in file.parameters]) for name in names}
    if base is not None:
        columns |= {
            f"base_{name}": np.array(column, dtype=float)
            for name in names
            if None not in (column := [getattr(row, name) for row in base.parameters])
        }
    return replace(file.errors, **columns)
