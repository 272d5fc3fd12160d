"""The settings of an identification, as frozen values; their meaning is documented at the parts that they build."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, TypeAdapter, ValidationInfo, WrapValidator, model_validator
from pydantic_core import PydanticCustomError

from dynident.estimators import LeastSquares
from dynident.files.tables import recording_name
from dynident.files.xml_text import SUFFIXES
from dynident.models import Joint
from dynident.motion.smoothers import Spline
from dynident.project.drive_settings import LoopSettings, ServoSettings, Simulation, check_loop
from dynident.project.fields import (
    POSITIONS,
    SHORT_LIST,
    TORQUES,
    UNITS,
    Channel,
    Count,
    CountOrEach,
    Files,
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
from dynident.runtime import ConfigError, choices
from dynident.runtime.families import ESTIMATORS, SMOOTHERS, TERMS

AUTO = "auto"  # among the terms: those that the training logs choose
PLAIN_TERMS = ("rotor", "viscous", "coulomb", "offset")


TermPart = Annotated[Any, PartReader(TERMS, plain=True, words=(AUTO,))]


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
        listed = [TERMS.get(part) if isinstance(part, str) else part for part in self.terms if part != AUTO]
        classes = [part for part in listed if isinstance(part, type) and hasattr(part, "proposed")]
        return tuple(classes) if self.chooses_terms else ()

    @property
    def chooses_terms(self) -> bool:
        """Whether the training logs choose terms."""
        return AUTO in self.terms


class FilterSettings(Section):
    """Low-pass (``cutoff`` Hz, ``order``) and decimation of the torque and of all columns of the regressor."""

    decimate: Count = 1
    cutoff: Positive | None = None
    order: Order = 4


def _read_model(value: object, _: Any, info: ValidationInfo) -> str | RobotSettings:
    if isinstance(value, Mapping):
        return RobotSettings.model_validate(value, context=info.context)
    if isinstance(value, RobotSettings):
        return value
    name = TypeAdapter(Name).validate_python(value)
    return robot_settings(name, info.context) or name


def robot_settings(name: str, context: Mapping[str, Any] | None = None) -> RobotSettings | None:
    """Return the settings that the name of a robot file stands for, None where it is no such name."""
    if Path(name).suffix.lower() not in SUFFIXES:
        return None
    return RobotSettings.model_validate({"file": name}, context=context)


class Config(Section):
    """All settings of one identification; channels by the names of the model's joints.

    With ``transmission`` the channels are those of the motors: it gives for each motor, named like its joint, the
    coefficients of the joints in its position (gear ratios and couplings). ``zero`` (rad, m) is added to positions.
    Logs of position servos (``simulation`` of that kind) have commands in place of torques.
    """

    model: Annotated[str | RobotSettings, WrapValidator(_read_model)]
    time: Time
    position: Mapping[Name, PositionChannel]
    torque: Mapping[Name, Channel] = {}
    transmission: Mapping[Name, Mapping[Name, Number]] = {}
    zero: Mapping[Name, Number] = {}
    train: tuple[LogSpec, ...] = Field(min_length=1)
    validation: tuple[LogSpec, ...] = ()
    gaps: Literal["error", "split"] = "error"
    close_stamps: Literal["error", "drop", "keep"] = "error"
    smoother: Annotated[Any, PartReader(SMOOTHERS)] = Field(default_factory=lambda: Spline.Settings(rule="torque"))
    estimator: Annotated[Any, PartReader(ESTIMATORS)] = Field(default_factory=LeastSquares)
    filter: FilterSettings | None = None
    min_speed: PositiveOrEach = None
    unfitted: tuple[Name, ...] = ()
    time_offset: TimeOffsetValue | Literal["estimate"] = "estimate"
    outliers: Literal["mask", "keep"] = "mask"
    rests: Literal["trim", "keep"] = "trim"
    simulation: Simulation | None = None
    excitation: Annotated[Any, AppSection("excitation")] = None
    compare: Annotated[Any, AppSection("compare")] = None

    @model_validator(mode="after")
    def _check_torque(self) -> Self:
        is_given = "torque" in self.model_fields_set
        if isinstance(self.simulation, ServoSettings) is is_given:
            raise PydanticCustomError(
                "words",
                "with position servos (`simulation: { kind: servo }`) `torque` is left out: the commands stand for it"
                if is_given
                else "`torque` is missing; a log of commands and positions alone has `simulation: { kind: servo }`",
            )
        return self


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
    sections: list[tuple[str, Mapping[str, Section]]] = [("position", config.position), ("torque", config.torque)]
    servos = config.simulation.joints if isinstance(config.simulation, ServoSettings) else {}
    if servos:
        sections[1] = ("simulation.joints", servos)
    for section, entries in sections:
        check_same_names(section, entries, joints)
    for joint in joints:
        kind, name, servo = joint.kind, joint.name, servos.get(joint.name)
        unit_factor(config.position[name].unit, POSITIONS[kind], f"position.{name}.unit")
        if servo is None:
            unit_factor(config.torque[name].unit, TORQUES[kind], f"torque.{name}.unit")
        else:
            unit_factor(servo.command.unit, servo.dimensions[kind], f"simulation.joints.{name}.command.unit")
    for joint in joints:
        if joint.kind == "prismatic" and config.position[joint.name].multi_turn:
            raise ConfigError(f"position.{joint.name}.multi_turn: joint {joint.name!r} slides; leave the key out.")
