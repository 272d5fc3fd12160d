"""The settings of an identification, as frozen values; their meaning is documented at the parts that they build."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, PrivateAttr, TypeAdapter, ValidationInfo, WrapValidator, model_validator
from pydantic_core import PydanticCustomError

from dynident.files.tables import recording_name
from dynident.models import Joint
from dynident.project.fields import (
    POSITIONS,
    SHORT_LIST,
    TORQUES,
    UNITS,
    VELOCITIES,
    Amount,
    Angle,
    Channel,
    Count,
    CountOrEach,
    Files,
    Gain,
    Gravity,
    Name,
    NonNegative,
    Number,
    OneWord,
    Order,
    PositionChannel,
    Positive,
    PositiveOrEach,
    Section,
    Tilt,
    TimeOffsetValue,
    Windows,
    check_known_names,
    check_same_names,
    unit_factor,
)
from dynident.project.parts import AppSection, PartReader, by_joint
from dynident.project.python_file import CODE, FileFunction, load_from_file, resolve_file
from dynident.runtime import ConfigError, choices
from dynident.runtime.families import ESTIMATORS, SMOOTHERS, TERMS

AUTO = "auto"  # among the terms: those that the training logs choose
PLAIN_TERMS = ("rotor", "viscous", "coulomb", "offset")


TermPart = Annotated[Any, PartReader(TERMS, plain=True, words=(AUTO,))]


class LoopJoint(Section):
    """What drives of one joint have in common: torque = gain * input, the input within +-saturation.

    ``feedforward`` is a column, in units of the input, or by the name of a recording the column of those that have one.
    """

    reference: Angle
    gain: Gain = 1.0
    saturation: Amount | None = None
    feedforward: Name | Mapping[Name, Name] | None = None

    def column(self, label: str) -> str | None:
        """Return the column of the feedforward in a recording."""
        return self.feedforward.get(label) if isinstance(self.feedforward, Mapping) else self.feedforward


class CascadeJoint(LoopJoint):
    """The drive of one joint: input = kv (kp (reference - q) - dq) + feedforward."""

    kp: Amount
    kv: Amount


class PDJoint(LoopJoint):
    """The drive of one joint: input = kp (reference - q) + kd (velocity_reference - dq) + feedforward."""

    kp: Amount
    kd: Amount
    velocity_reference: Channel | None = None


class PIDJoint(PDJoint):
    """The drive of one joint: that of a PD controller with ki times the integral of (reference - q)."""

    ki: Amount


class FunctionJoint(LoopJoint):
    """The drive of one joint, whose input is what the function returns, plus feedforward."""


class LoopSettings(Section):
    """Free simulation in closed loop with the controllers of the drives, by joint, which work every ``period`` s, by
    default once a sample, and see the difference of positions ``velocity_steps`` of these apart as velocity."""

    period: Positive | None = None
    velocity_steps: Annotated[int, Field(ge=1, le=100)] = 1
    joints: Mapping[Name, LoopJoint] = Field(min_length=1)


class CascadeSettings(LoopSettings):
    """With a position loop around a velocity loop."""

    kind: Literal["cascade"]
    joints: Mapping[Name, CascadeJoint] = Field(min_length=1)


class PDSettings(LoopSettings):
    """With a spring and a damper."""

    kind: Literal["pd"]
    joints: Mapping[Name, PDJoint] = Field(min_length=1)


class PIDSettings(LoopSettings):
    """With an integral beside them."""

    kind: Literal["pid"]
    joints: Mapping[Name, PIDJoint] = Field(min_length=1)


class FunctionSettings(LoopSettings):
    """With a function of a Python file, ``law(t, q, dq, reference, **settings)``, which returns the inputs (n)."""

    kind: Annotated[str, Field(pattern=r"\.py:\w+$")]
    joints: Mapping[Name, FunctionJoint] = Field(min_length=1)
    settings: Mapping[Name, Number] = {}
    _law: FileFunction = PrivateAttr()

    @model_validator(mode="after")
    def _load_law(self, info: ValidationInfo) -> Self:
        place, _, name = self.kind.rpartition(":")
        if (folder := (info.context or {}).get("code")) is None:
            raise ValueError(f"{self.kind!r} {CODE}")
        try:
            path = resolve_file(folder, place, "kind", ConfigError)
            load_from_file(path, name, "function", "kind", ConfigError)
        except ConfigError as error:
            raise ValueError(str(error)) from error
        self._law = FileFunction(path, name, self.settings)
        return self

    @property
    def law(self) -> FileFunction:
        """The function, with its settings."""
        return self._law


class TorqueInputSettings(Section):
    """Free simulation driven by the measured torque, restarted every ``restart`` s from the measured state."""

    kind: Literal["measured_torque"]
    restart: Positive = 0.5


SIMULATION_KINDS: Mapping[str, type[Section]] = {
    "cascade": CascadeSettings,
    "pd": PDSettings,
    "pid": PIDSettings,
    "measured_torque": TorqueInputSettings,
}


def _read_simulation(value: Any, _: Any, info: ValidationInfo) -> Any:
    """Read the section of its `kind`, so that errors have its place and are of no other kind."""
    if value is None or isinstance(value, Section):
        return value
    if not isinstance(value, Mapping):
        raise PydanticCustomError("mapping_type", "a mapping")
    kind = str(value.get("kind"))
    section = FunctionSettings if kind.rpartition(":")[0].endswith(".py") else SIMULATION_KINDS.get(kind)
    if section is None:
        words = f"{value['kind']!r} is not a choice; {choices(kind, SIMULATION_KINDS)}" if "kind" in value else ""
        words = words or f"needs a `kind`: {', '.join(SIMULATION_KINDS)}"
        raise PydanticCustomError("words", "{words}", {"words": words})
    return section.model_validate(value, context=info.context)


Simulation = Annotated[
    CascadeSettings | PDSettings | PIDSettings | FunctionSettings | TorqueInputSettings, WrapValidator(_read_simulation)
]


def check_loop(loop: LoopSettings, joints: Sequence[Joint], labels: Sequence[str], *, geared: bool) -> None:
    """Check a controller against the model's joints and the names of the recordings; raises ConfigError."""
    check_same_names("simulation.joints", loop.joints, joints)
    if geared:
        raise ConfigError(
            "simulation: a controller of motors behind a transmission cannot be simulated; use `kind: measured_torque`."
        )
    for joint in joints:
        drive, where = loop.joints[joint.name], f"simulation.joints.{joint.name}"
        unit_factor(drive.reference.unit, POSITIONS[joint.kind], f"{where}.reference.unit")
        if isinstance(drive, PDJoint) and drive.velocity_reference is not None:
            unit_factor(drive.velocity_reference.unit, VELOCITIES[joint.kind], f"{where}.velocity_reference.unit")
        for name in drive.feedforward if isinstance(drive.feedforward, Mapping) else ():
            if name not in labels:
                raise ConfigError(f"{where}.feedforward: there is no recording {name!r}; {choices(name, labels)}")


class Time(Section):
    """Time stamps: a column and its unit, or the sampling rate (Hz) of a file without such a column.

    ``spacing``: "even" takes the samples as equally spaced, "stamps" as stamped; "auto" decides by the noise of q.
    """

    column: Name | None = None
    unit: str = "s"
    rate: Positive | None = None
    spacing: Literal["auto", "stamps", "even"] = "auto"

    @model_validator(mode="after")
    def _check_column_or_rate(self) -> Self:
        if (self.column is None) == (self.rate is None):
            raise ValueError("needs either `column` (with its `unit`) or `rate` (Hz)")
        if self.column is not None and "unit" not in self.model_fields_set:
            raise ValueError("needs the `unit` of its column: " + ", ".join(UNITS["time"]))
        return self


class LogSpec(Section):
    """One recording: its file (or files, whose columns are then named ``key.column``) and the parts to use.

    ``width`` is the number of columns of a text file with one number per line. ``window`` holds (start, stop) in s, and
    so does ``exclude``: samples that are smoothed through, but neither fitted nor judged.
    """

    file: Files
    width: CountOrEach = None
    window: Windows = ()
    exclude: Windows = ()
    name: Name | None = None

    @model_validator(mode="after")
    def _check_widths(self) -> Self:
        for key in self.width if isinstance(self.width, Mapping) else ():
            if key not in self.file:
                raise ValueError(f"`width` names a file {key!r} that `file` lacks; {choices(key, self.file)}")
        return self

    @property
    def label(self) -> str:
        """The name of the log, by default the stem of its first file, the folder of a pattern, or its episode."""
        return self.name or recording_name(next(iter(self.file.values())))


class CouplingSettings(Section):
    """A motor whose coordinate is a sum of joint coordinates times ``joints``, with its own rotor and friction."""

    joints: Mapping[Name, Number] = Field(min_length=1)
    terms: tuple[Literal["rotor", "viscous", "coulomb"], ...] = ("rotor", "viscous", "coulomb")


class RobotSettings(Section):
    """A model built from a robot file (URDF or MJCF): its rigid bodies, and further terms per joint.

    ``joints`` chooses and orders the moving joints (null: all, in the order of the file); ``lock`` holds positions
    (rad, m) of the others; ``base_tilt`` is that of the base away from ``gravity`` (m/s^2), by rotations (rad) about x
    and y; ``terms`` "auto", alone or in the list, are those that the training logs choose; ``coulomb_width`` (rad/s,
    m/s) smooths the sign in the Coulomb friction.
    """

    file: Files
    joints: tuple[Name, ...] | None = None
    lock: Mapping[Name, Number] = {}
    gravity: tuple[Gravity, Gravity, Gravity] = (0.0, 0.0, -9.81)
    base_tilt: tuple[Tilt, Tilt] | Literal["none", "estimate"] = "estimate"
    terms: Annotated[tuple[TermPart, ...], SHORT_LIST, OneWord(AUTO)] = (AUTO,)
    coulomb_width: NonNegative = 0.0
    couplings: Mapping[Name, CouplingSettings] = {}

    @model_validator(mode="after")
    def _check_auto_once(self) -> Self:
        if self.terms.count(AUTO) > 1:
            raise ValueError(f"`terms` lists {AUTO!r} twice; leave one out")
        return self

    @property
    def proposed(self) -> tuple[type, ...]:
        """The classes listed by name alone beside "auto" that say in what sizes they are to be tried."""
        listed_parts = [TERMS.get(part) if isinstance(part, str) else part for part in self.terms if part != AUTO]
        return tuple(
            part for part in listed_parts if self.chooses_terms and isinstance(part, type) and hasattr(part, "proposed")
        )

    @property
    def chooses_terms(self) -> bool:
        """Whether the training logs choose terms."""
        return AUTO in self.terms


class FilterSettings(Section):
    """Low-pass (``cutoff`` Hz, ``order``) and decimation of the torque and of all columns of the regressor."""

    decimate: Count = 1
    cutoff: Positive | None = None
    order: Order = 4


def _default_smoother() -> Any:
    from dynident.motion.smoothers import Spline

    return Spline.Settings(rule="torque")


def _default_estimator() -> Any:
    from dynident.estimators import LeastSquares

    return LeastSquares()


def _read_model(value: object, _: Any, info: ValidationInfo) -> str | RobotSettings:
    if isinstance(value, Mapping):
        return RobotSettings.model_validate(value, context=info.context)
    if isinstance(value, RobotSettings):
        return value
    name = TypeAdapter(Name).validate_python(value)
    return robot_settings(name, info.context) or name


def robot_settings(name: str, context: Mapping[str, Any] | None = None) -> RobotSettings | None:
    """Return the settings that the name of a robot file stands for, None where it is no such name."""
    from dynident.files.xml_text import SUFFIXES

    if Path(name).suffix.lower() not in SUFFIXES:
        return None
    return RobotSettings.model_validate({"file": name}, context=context)


class Config(Section):
    """All settings of one identification; channels by the names of the model's joints.

    With ``transmission`` the channels are those of the motors: it gives for each motor, named like its joint, the
    coefficients of the joints in its position (gear ratios and couplings). ``zero`` (rad, m) is added to positions.
    """

    model: Annotated[str | RobotSettings, WrapValidator(_read_model)]
    time: Time
    position: Mapping[Name, PositionChannel]
    torque: Mapping[Name, Channel]
    transmission: Mapping[Name, Mapping[Name, Number]] = {}
    zero: Mapping[Name, Number] = {}
    train: tuple[LogSpec, ...] = Field(min_length=1)
    validation: tuple[LogSpec, ...] = ()
    gaps: Literal["error", "split"] = "error"
    close_stamps: Literal["error", "drop", "keep"] = "error"
    smoother: Annotated[Any, PartReader(SMOOTHERS)] = Field(default_factory=_default_smoother)
    estimator: Annotated[Any, PartReader(ESTIMATORS)] = Field(default_factory=_default_estimator)
    filter: FilterSettings | None = None
    min_speed: PositiveOrEach = None
    unfitted: tuple[Name, ...] = ()
    time_offset: TimeOffsetValue | Literal["estimate"] = "estimate"
    outliers: Literal["mask", "keep"] = "mask"
    rests: Literal["trim", "keep"] = "trim"
    simulation: Simulation | None = None
    excitation: Annotated[Any, AppSection("excitation")] = None
    compare: Annotated[Any, AppSection("compare")] = None


def check_joints(config: Config, joints: Sequence[Joint]) -> None:
    """Check the channels against the model's joints, by name, and their units against the joints' kinds.

    Raises ConfigError for a joint without a position or torque, an unknown joint, or a unit that does not fit.
    """
    _check_channels(config, joints)
    if config.time.column is not None:
        unit_factor(config.time.unit, "time", "time.unit")
    for name, entries in by_joint(config.smoother):
        check_same_names(f"smoother.{name}", entries, joints)
    speeds = config.min_speed if isinstance(config.min_speed, Mapping) else {}
    rows = {f"transmission.{name}": row for name, row in config.transmission.items()}
    unfitted = dict.fromkeys(config.unfitted)
    if {joint.name for joint in joints} <= unfitted.keys():
        raise ConfigError("unfitted: names every joint, so that nothing is left to fit; leave one out.")
    # rows of the transmission name joints, too; these sections may leave joints out
    keyed_settings = {"zero": config.zero, "min_speed": speeds, "unfitted": unfitted}
    keyed_settings |= {"transmission": config.transmission, **rows}
    for section, values in keyed_settings.items():
        check_known_names(section, values, joints)
    if isinstance(config.simulation, LoopSettings):
        labels = [spec.label for spec in (*config.train, *config.validation)]
        check_loop(config.simulation, joints, labels, geared=bool(config.transmission))


def _check_channels(config: Config, joints: Sequence[Joint]) -> None:
    for section, channels, units in (("position", config.position, POSITIONS), ("torque", config.torque, TORQUES)):
        check_same_names(section, channels, joints)
        for joint in joints:
            unit_factor(channels[joint.name].unit, units[joint.kind], f"{section}.{joint.name}.unit")
    for joint in joints:
        if joint.kind == "prismatic" and config.position[joint.name].multi_turn:
            raise ConfigError(f"position.{joint.name}.multi_turn: joint {joint.name!r} slides; leave the key out.")
