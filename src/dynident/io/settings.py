"""The settings of an identification, as frozen values; their meaning is documented at the parts that they build."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from glob import has_magic
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, TypeAdapter, ValidationInfo, WrapValidator, model_validator

from dynident.errors import ConfigError, choices
from dynident.io.channels import POSITIONS, TORQUES, Channel, PositionChannel, known_names, same_names
from dynident.io.compare_settings import CompareSettings
from dynident.io.excitation_settings import ExcitationSettings
from dynident.io.families import ESTIMATORS, SMOOTHERS, TERMS
from dynident.io.fields import (
    FEW,
    UNITS,
    Count,
    CountOrEach,
    Delay,
    Files,
    Gravity,
    Name,
    NonNegative,
    Number,
    OneWord,
    Order,
    Positive,
    PositiveOrEach,
    Section,
    Tilt,
    Windows,
    unit_factor,
)
from dynident.io.parts import PartReader, by_joint
from dynident.io.simulation_settings import LoopSettings, Simulation, check_loop
from dynident.models import Joint

__all__ = [
    "AUTO",
    "PLAIN",
    "Config",
    "CouplingSettings",
    "FilterSettings",
    "LogSpec",
    "RobotSettings",
    "Time",
    "check_joints",
    "robot_settings",
]

AUTO = "auto"  # among the terms: those that the training logs choose
PLAIN = ("rotor", "viscous", "coulomb", "offset")


class Time(Section):
    """Time stamps: a column and its unit, or the sampling rate (Hz) of a file without such a column.

    ``spacing``: "even" takes the samples as equally spaced, "stamps" as stamped; "auto" decides by the noise of q.
    """

    column: Name | None = None
    unit: str = "s"
    rate: Positive | None = None
    spacing: Literal["auto", "stamps", "even"] = "auto"

    @model_validator(mode="after")
    def _one(self) -> Self:
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
    def _widths(self) -> Self:
        for key in self.width if isinstance(self.width, Mapping) else ():
            if key not in self.file:
                raise ValueError(f"`width` names a file {key!r} that `file` lacks; {choices(key, self.file)}")
        return self

    @property
    def label(self) -> str:
        """The name of the log, by default the stem of its first file, or the folder of a pattern."""
        first = next(iter(self.file.values()))
        return self.name or (first.parent.name if has_magic(first.name) and first.parent.name else first.stem)


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

    _former: ClassVar[Mapping[str, str]] = {"lean": "base_tilt"}

    file: Files
    joints: tuple[Name, ...] | None = None
    lock: Mapping[Name, Number] = {}
    gravity: tuple[Gravity, Gravity, Gravity] = (0.0, 0.0, -9.81)
    base_tilt: tuple[Tilt, Tilt] | Literal["none", "estimate"] = "estimate"
    terms: Annotated[tuple[Annotated[Any, PartReader(TERMS, plain=True, words=(AUTO,))], ...], FEW, OneWord(AUTO)] = (
        AUTO,
    )  # fmt: skip
    coulomb_width: NonNegative = 0.0
    couplings: Mapping[Name, CouplingSettings] = {}

    @model_validator(mode="after")
    def _once(self) -> Self:
        if self.terms.count(AUTO) > 1:
            raise ValueError(f"`terms` lists {AUTO!r} twice; leave one out")
        return self

    @property
    def proposed(self) -> tuple[type, ...]:
        """The classes listed by name alone beside "auto" that say in what sizes they are to be tried."""
        named = [TERMS.get(one) if isinstance(one, str) else one for one in self.terms if one != AUTO]
        return tuple(one for one in named if self.chooses_terms and isinstance(one, type) and hasattr(one, "proposed"))

    @property
    def chooses_terms(self) -> bool:
        """Whether the training logs choose terms."""
        return AUTO in self.terms


class FilterSettings(Section):
    """Low-pass (``cutoff`` Hz, ``order``) and decimation of the torque and of all columns of the regressor."""

    decimate: Count = 1
    cutoff: Positive | None = None
    order: Order = 4


def _spline() -> Any:
    from dynident.smoothers import Spline

    return Spline.Settings(rule="torque")


def _least_squares() -> Any:
    from dynident.estimators import LeastSquares

    return LeastSquares()


def _model(value: object, _: Any, info: ValidationInfo) -> str | RobotSettings:
    if isinstance(value, Mapping):
        return RobotSettings.model_validate(value, context=info.context)
    if isinstance(value, RobotSettings):
        return value
    name = TypeAdapter(Name).validate_python(value)
    return robot_settings(name, info.context) or name


def robot_settings(name: str, context: Mapping[str, Any] | None = None) -> RobotSettings | None:
    """Return the settings that the name of a robot file stands for, None where it is no such name."""
    from dynident.io.robot import SUFFIXES

    if Path(name).suffix.lower() not in SUFFIXES:
        return None
    return RobotSettings.model_validate({"file": name}, context=context)


class Config(Section):
    """All settings of one identification; channels by the names of the model's joints.

    With ``transmission`` the channels are those of the motors: it gives for each motor, named like its joint, the
    coefficients of the joints in its position (gear ratios and couplings). ``zero`` (rad, m) is added to positions.
    """

    _former: ClassVar[Mapping[str, str]] = {"parallel": "filter", "slow": "min_speed"}

    model: Annotated[str | RobotSettings, WrapValidator(_model)]
    time: Time
    position: Mapping[Name, PositionChannel]
    torque: Mapping[Name, Channel]
    transmission: Mapping[Name, Mapping[Name, Number]] = {}
    zero: Mapping[Name, Number] = {}
    train: tuple[LogSpec, ...] = Field(min_length=1)
    validation: tuple[LogSpec, ...] = ()
    gaps: Literal["error", "split"] = "error"
    close_stamps: Literal["error", "drop", "keep"] = "error"
    smoother: Annotated[Any, PartReader(SMOOTHERS)] = Field(default_factory=_spline)
    estimator: Annotated[Any, PartReader(ESTIMATORS)] = Field(default_factory=_least_squares)
    filter: FilterSettings | None = None
    min_speed: PositiveOrEach = None
    unfitted: tuple[Name, ...] = ()
    delay: Delay | Literal["estimate"] = "estimate"
    outliers: Literal["mask", "keep"] = "mask"
    rests: Literal["trim", "keep"] = "trim"
    simulation: Simulation | None = None
    excitation: ExcitationSettings | None = None
    compare: CompareSettings | None = None


def check_joints(config: Config, joints: Sequence[Joint]) -> None:
    """Check the channels against the model's joints, by name, and their units against the joints' kinds.

    Raises ConfigError for a joint without a position or torque, an unknown joint, or a unit that does not fit.
    """
    _check_channels(config, joints)
    if config.time.column is not None:
        unit_factor(config.time.unit, "time", "time.unit")
    for name, given in by_joint(config.smoother):
        same_names(f"smoother.{name}", given, joints)
    speeds = config.min_speed if isinstance(config.min_speed, Mapping) else {}
    rows = {f"transmission.{name}": row for name, row in config.transmission.items()}
    unfitted = dict.fromkeys(config.unfitted)
    if {joint.name for joint in joints} <= unfitted.keys():
        raise ConfigError("unfitted: names every joint, so that nothing is left to fit; leave one out.")
    named = {"zero": config.zero, "min_speed": speeds, "unfitted": unfitted}
    named |= {"transmission": config.transmission, **rows}
    for section, values in named.items():
        known_names(section, values, joints)
    if isinstance(config.simulation, LoopSettings):
        labels = [spec.label for spec in (*config.train, *config.validation)]
        check_loop(config.simulation, joints, labels, geared=bool(config.transmission))


def _check_channels(config: Config, joints: Sequence[Joint]) -> None:
    for section, channels, units in (("position", config.position, POSITIONS), ("torque", config.torque, TORQUES)):
        same_names(section, channels, joints)
        for joint in joints:
            unit_factor(channels[joint.name].unit, units[joint.kind], f"{section}.{joint.name}.unit")
    for joint in joints:
        if joint.kind == "prismatic" and config.position[joint.name].multi_turn:
            raise ConfigError(f"position.{joint.name}.multi_turn: joint {joint.name!r} slides; leave the key out.")
