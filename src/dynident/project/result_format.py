"""The format of ``result.json``, version 1: what validates a file that is read, and gives its JSON schema.

The groups of a file are the nouns of a result, by the types of their fields. Values and standard errors of the
parameters, and the base parameters, are rows of a table instead. Numbers that are not finite are the texts
``Infinity``, ``-Infinity`` and ``NaN``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError, ValidationInfo, WrapValidator
from pydantic.json_schema import GenerateJsonSchema
from pydantic_core import core_schema

from dynident.estimators import Estimate, Provenance
from dynident.identification import Calibration, Recipe, Sources, StandardErrors, Verdict
from dynident.models import Joint, MassMatrixCheck
from dynident.project.fields import Section
from dynident.project.python_file import error_text
from dynident.project.settings import Config
from dynident.regression import BaseParameters, UnexcitedParameters
from dynident.runtime import Axes, ConfigError, Finding, InputError, Note
from dynident.runtime.arrays import Array
from dynident.validation import LogValidation

FORMAT, VERSION = "dynident result", 1
SERVO_FORMAT, SERVO_VERSION = "dynident servos", 1  # of servo.json
DRAFT = "https://json-schema.org/draft/2020-12/schema"
LIMITS = {"gt": "exclusiveMinimum", "ge": "minimum", "lt": "exclusiveMaximum", "le": "maximum"}
NOT_FINITE = ["Infinity", "-Infinity", "NaN"]


class ResultPart(BaseModel):
    """Part of a result; keys that are not known are left alone."""

    model_config = ConfigDict(frozen=True, extra="ignore", defer_build=True)  # seldom read


class ModelPart(ResultPart):
    """The model as it was used, which is built from ``provenance``: its name and joints, the parameters of its bodies
    by a first fit, where friction depends on their load, and the positions (rad, m) of joints that were locked."""

    name: str
    joints: tuple[Joint, ...]
    load: tuple[float, ...] | None = None
    lock: Mapping[str, float] = {}


class ParameterRow(ResultPart):
    """A parameter: its value, standard errors (see ``StandardErrors``), unit, and what it was determined by."""

    name: str
    value: float
    std: float
    std_independent: float
    unit: str
    provenance: Provenance | None


class BaseRow(ResultPart):
    """A base parameter: the standard parameter that leads it, the coefficients of all in it, and what was found."""

    name: str
    lead: str
    combination: dict[str, float]
    value: float | None = None
    std: float | None = None
    std_independent: float | None = None
    unit: str


class BaseTable(ResultPart):
    """Base parameters; singular values, and the scales of the columns, in the order of ``parameters``."""

    parameters: list[BaseRow]
    singular_values: Annotated[Array, Axes("s")]
    scale: Annotated[Array, Axes("p")]

    def build(self, names: tuple[str, ...], source: str) -> BaseParameters:
        """Return the base parameters of the parameters by name; InputError where one is not among them."""
        index, rows = {name: k for k, name in enumerate(names)}, self.parameters
        combination = np.zeros((len(rows), len(names)))
        for k, row in enumerate(rows):
            for name, coefficient in {row.lead: 1.0, **row.combination}.items():
                if name not in index:
                    raise InputError(f"{source}: base_parameters: there is no parameter {name!r}; identify again.")
                combination[k, index[name]] = coefficient
        leads = tuple(index[row.lead] for row in rows)
        return BaseParameters(names, len(rows), self.singular_values, leads, combination, self.scale)


class BasePart(ResultPart):
    """Base parameters that the data show, those that any motion could show, and what the data leave out."""

    on_data: BaseTable | None
    structural: BaseTable | None
    unexcited: tuple[UnexcitedParameters, ...]


class ResultTables(ResultPart):
    """What of a result can be read without its model and parts."""

    format: Literal["dynident result"]
    version: Literal[1]
    parameters: list[ParameterRow]
    report: dict[str, Any] | None = None
    base_parameters: BasePart
    errors: StandardErrors
    validations: tuple[LogValidation, ...]
    model: ModelPart
    provenance: Sources


def _name_group(value: Any, handler: Callable[[Any], Any], info: ValidationInfo) -> Any:
    """Return a group whose nouns check themselves, what they say led by its name."""
    try:
        return handler(value)
    except ConfigError as error:
        group = f"{info.field_name}: "
        raise ConfigError(f"{group}{str(error).removeprefix(group)}") from error


class ResultFile(ResultTables):
    """A result of ``dynident identify``, or of ``Identification.save``.

    ``report`` holds, where the command wrote it, the verdict, notes and warnings in words, and the files of the model;
    it is not read again.
    """

    model_config = ConfigDict(frozen=True, extra="ignore", title="dynident result, version 1")

    recipe: Annotated[Recipe, WrapValidator(_name_group)]
    calibration: Annotated[Calibration, WrapValidator(_name_group)]
    estimate: Annotated[Estimate, WrapValidator(_name_group)]
    mass_matrix: MassMatrixCheck | None
    verdict: Verdict | None = None
    warnings: tuple[Note, ...]
    findings: tuple[Finding, ...] = ()


Tables = TypeVar("Tables", bound=ResultTables)


def read_result(kind: type[Tables], data: dict[str, Any], source: str, **context: Any) -> Tables:
    """Return the plain values of a result as ``kind``, whose parts the function ``build`` of the context makes.

    Raises InputError, led by ``source``, where it is no result of this version, or its values do not fit.
    """
    if data.get("format") == SERVO_FORMAT:
        raise InputError(
            f"{source}: is of servos, which only `dynident predict` and `dynident export` read; the model is robot.xml."
        )
    if data.get("format") != FORMAT:
        raise InputError(f"{source}: is no result of `dynident identify`: it needs `format`: {FORMAT!r}.")
    if data.get("version") != VERSION:
        raise InputError(
            f"{source}: has version {data.get('version')!r}, and this dynident reads {VERSION}; identify again, or "
            "take another dynident."
        )
    try:
        return kind.model_validate(data, context={"sizes": _sizes(data), **context})
    except ValidationError as error:
        raise InputError(f"{error_text(error, data, source)}; identify again.") from None


def _sizes(data: Mapping[str, Any]) -> dict[str, int]:
    """Return how many parameters (p), joints (n) and base parameters (r) there are, nothing of damaged tables."""
    try:
        p, n, base = len(data["parameters"]), len(data["model"]["joints"]), data["base_parameters"]["on_data"]
        # without base parameters, the covariance is that of the standard ones
        return {"p": p, "n": n, "r": p if base is None else len(base["parameters"])}
    except (LookupError, TypeError):
        return {}


class _ResultSchema(GenerateJsonSchema):
    """The schema of a result, whose numbers need not be finite."""

    def float_schema(self, schema: core_schema.FloatSchema) -> dict[str, Any]:
        return {"anyOf": [super().float_schema(schema), {"enum": NOT_FINITE}]}

    def encode_default(self, dft: Any) -> Any:
        return "NaN" if isinstance(dft, float) and math.isnan(dft) else super().encode_default(dft)


def config_schema() -> dict[str, Any]:
    """Return the schema of the configuration, with the settings of all kinds of parts that are installed."""
    return section_schema(Config, "dynident configuration")


def section_schema(section: type[Section], title: str) -> dict[str, Any]:
    """Return the schema of a file with these settings."""
    schema: dict[str, Any] = _rename_limits(section.model_json_schema())
    return {"$schema": DRAFT, **schema, "title": title}


def result_schema() -> dict[str, Any]:
    """Return the schema of ``result.json``."""
    return {"$schema": DRAFT, **ResultFile.model_json_schema(schema_generator=_ResultSchema)}


def _rename_limits(schema: Any) -> Any:
    """Return a schema with the names of limits that JSON schema knows: pydantic keeps its own for numbers that a
    function reads.
    """
    if isinstance(schema, Mapping):
        number = schema.get("type") in ("number", "integer")
        return {
            LIMITS[key] if number and key in LIMITS else key: _rename_limits(value) for key, value in schema.items()
        }
    return [_rename_limits(entry) for entry in schema] if isinstance(schema, list) else schema


SCHEMAS: Mapping[str, Callable[[], dict[str, Any]]] = {"config": config_schema, "result": result_schema}
