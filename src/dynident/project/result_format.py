"""The format of ``result.json``, version 1: what validates a file that is read, and gives its JSON schema.

Dataclasses whose fields are plain values are used as they are; the others have a section here. Numbers that
are not finite are the texts ``Infinity``, ``-Infinity`` and ``NaN``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict
from pydantic.json_schema import GenerateJsonSchema
from pydantic_core import core_schema

from dynident.estimators import Provenance
from dynident.identification import BaseTilt, PriorStrength, Sources, TimeOffset
from dynident.identification.terms import TrialOutcome
from dynident.models import Joint
from dynident.project.fields import Section
from dynident.project.settings import Config
from dynident.runtime import Severity
from dynident.validation import Driver, NoiseFloor, ResidualTest, TorqueErrors

FORMAT, VERSION = "dynident result", 1
DRAFT = "https://json-schema.org/draft/2020-12/schema"
LIMITS = {"gt": "exclusiveMinimum", "ge": "minimum", "lt": "exclusiveMaximum", "le": "maximum"}
NOT_FINITE = ["Infinity", "-Infinity", "NaN"]


class ResultPart(BaseModel):
    """Part of a result; keys that are not known are left alone."""

    model_config = ConfigDict(frozen=True, extra="ignore")


class TaggedPart(BaseModel):
    """A value of one of several classes, such as a note or the settings of a part, tagged by its ``kind``."""

    model_config = ConfigDict(frozen=True, extra="allow")
    kind: str


class ModelPart(ResultPart):
    """The model as it was used, which is built from ``provenance``: its name and joints, and the parameters of its
    bodies by a first fit, where friction depends on their load."""

    name: str
    joints: tuple[Joint, ...]
    load: list[float] | None = None


class FilterPart(ResultPart):
    """The parallel filter of the fit: decimation, and the cut-off (Hz) and order of the low-pass."""

    decimate: int
    cutoff: float | None
    order: int


class RecipePart(ResultPart):
    """The recipe as used: ``time_offset`` and ``restart`` in s, ``base_tilt`` in rad, speeds in rad/s or m/s."""

    smoother: TaggedPart
    estimator: TaggedPart
    filter: FilterPart | None
    min_speed: dict[str, float] | float | None
    time_offset: float
    base_tilt: tuple[float, float] | None
    restart: float | None
    outliers: Literal["mask", "keep"] = "keep"
    rests: Literal["trim", "keep"] = "keep"


class ParameterPart(ResultPart):
    """A parameter: its value, standard errors (see ``StandardErrors``), unit, and what it was determined by."""

    name: str
    value: float
    std: float
    std_independent: float
    unit: str
    provenance: Provenance | None


class PiecesPart(ResultPart):
    """What a fit in pieces leaves of the torque, one row for each piece and one column for each joint; see
    ``Pieces``."""

    recording: list[str]
    begins: list[float]
    ends: list[float]
    rows: list[list[int]]
    torque: list[list[float]]
    residual: list[list[float]]


class WhiteningPart(ResultPart):
    """The noise by which rows were whitened: coefficients of the autoregression of each joint, and the covariance of
    the innovations."""

    coefficients: list[list[float]]
    covariance: list[list[float]]


class ResidualPart(ResultPart):
    """The torque that the fit leaves: standard deviation and weight of each joint, number of samples."""

    sigma: list[float]
    samples: int
    weights: list[float] | None
    pieces: PiecesPart | None = None
    whitening: WhiteningPart | None = None
    correlated: bool = False


class ConsistencyPart(ResultPart):
    """How the estimate relates to physics; see ``Consistency``. ``unconstrained`` in the order of ``parameters``."""

    eigenvalues: dict[str, float]
    costs: dict[str, float]
    unconstrained: list[float] | None = None


class EstimatePart(ResultPart):
    """What is known of all parameters together; rows and columns of matrices in the order of ``parameters``."""

    rank: int
    condition: float
    residual: ResidualPart
    consistency: ConsistencyPart | None
    notes: list[TaggedPart]
    covariance: list[list[float]]
    interval: list[tuple[float, float]] | None
    information: list[list[float]] | None


class BaseRow(ResultPart):
    """A base parameter: the standard parameter that leads it, the coefficients of all in it, and what was found."""

    name: str
    lead: str
    combination: dict[str, float]
    value: float | None = None
    std: float | None = None
    std_independent: float | None = None
    unit: str


class BasePart(ResultPart):
    """Base parameters; singular values, and the scales of the columns, in the order of ``parameters``."""

    parameters: list[BaseRow]
    singular_values: list[float]
    scale: list[float]


class IdentifiabilityPart(ResultPart):
    """Base parameters that the data show, those that any motion could show, and what the data leave out.

    ``covariance``, ``by_joint``, ``shares`` and ``by_load``: of those on the data, or of all parameters where these are
    null; see ``StandardErrors``.
    """

    on_data: BasePart | None
    structural: BasePart | None
    unexcited: list[TaggedPart]
    covariance: list[list[float]] | None = None
    by_joint: list[list[float]] | None = None
    shares: list[float] | None = None
    by_load: list[list[float]] | None = None


class RunPart(ResultPart):
    """Errors of a free simulation; see ``FreeRun``."""

    driver: Driver
    restart: float | None
    joints: tuple[str, ...]
    relative_error: dict[str, float]
    motion_error: dict[str, float]
    rms: dict[str, float]
    torque_error: dict[str, float]
    failure: TaggedPart | None


class ValidationPart(ResultPart):
    """How well the model does on one log."""

    name: str
    role: Literal["train", "validation"]
    errors: TorqueErrors
    residuals: dict[str, ResidualTest]
    free_run: RunPart | None
    floors: dict[str, NoiseFloor] = {}


class CandidatePart(ResultPart):
    """A smoother that was tried, and its cross-validated torque error (%)."""

    smoother: TaggedPart
    error: float


class ChoicePart(ResultPart):
    """The smoothers that were tried, and the place of the one that was chosen, from 0."""

    chosen: int
    candidates: list[CandidatePart]


class TrialPart(ResultPart):
    """A kind of term that was tried on a joint, and what became of it; see ``TermTrial``."""

    joint: str
    kind: str
    settings: dict[str, Any]
    gain: float
    std: float
    outcome: TrialOutcome
    faster: float | None = None
    faster_std: float | None = None


class TermsPart(ResultPart):
    """The terms that were chosen, in the order in which the model has them, and all that was tried; see
    ``TermChoice``."""

    joints: tuple[str, ...]
    chosen: list[TaggedPart]
    trials: list[TrialPart]
    before: tuple[float, ...]
    after: tuple[float, ...]
    min_speed: tuple[float, ...]
    load: tuple[float, ...] | None = None


class CalibrationPart(ResultPart):
    """How smoother, time offset, tilt of the base, terms, strength of the prior were found; null where not sought."""

    smoother: ChoicePart | None
    time_offset: TimeOffset | None
    base_tilt: BaseTilt | None
    prior_strength: PriorStrength | None = None
    terms: TermsPart | None = None


class MassPart(ResultPart):
    """The smallest eigenvalue of the mass matrix, and the pose of it."""

    smallest: float
    q: list[float]
    positive: bool


class FindingPart(ResultPart):
    """An error or a warning of the checks that were run beside the fit; see ``Finding``."""

    severity: Severity
    joint: str | None
    message: TaggedPart
    source: str
    link: str


class ResultFile(ResultPart):
    """A result of ``dynident identify``, or of ``Identification.save``.

    ``report`` holds, where the command wrote it, the verdict, notes and warnings in words, and the files of the model;
    it is not read again.
    """

    model_config = ConfigDict(frozen=True, extra="ignore", title="dynident result, version 1")

    format: Literal["dynident result"]
    version: Literal[1]
    parameters: list[ParameterPart]
    report: dict[str, Any] | None = None
    validations: list[ValidationPart]
    recipe: RecipePart
    calibration: CalibrationPart
    base_parameters: IdentifiabilityPart
    estimate: EstimatePart
    mass_matrix: MassPart | None
    warnings: list[TaggedPart]
    findings: list[FindingPart] = []
    model: ModelPart
    provenance: Sources


class _ResultSchema(GenerateJsonSchema):
    """The schema of a result, whose numbers need not be finite."""

    def float_schema(self, schema: core_schema.FloatSchema) -> dict[str, Any]:
        return {"anyOf": [super().float_schema(schema), {"enum": NOT_FINITE}]}


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
