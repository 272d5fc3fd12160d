"""The settings of what drives the joints: controllers, position servos, or the measured torque."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal, Self

from pydantic import Field, PrivateAttr, ValidationInfo, WrapValidator, model_validator
from pydantic_core import PydanticCustomError

from dynident.models import Joint
from dynident.project.fields import (
    POSITIONS,
    TORQUES,
    VELOCITIES,
    Amount,
    Angle,
    Channel,
    DelayValue,
    Gain,
    Name,
    NonNegative,
    Number,
    Positive,
    Section,
    check_same_names,
    unit_factor,
    unit_size,
)
from dynident.project.python_file import CODE, FileFunction, load_from_file, resolve_file
from dynident.runtime import ConfigError, choices


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


class ServoJoint(Section):
    """The servo of a joint: torque = kp (command - q) - kd dq within +-limit (N m, N); kp may be sought.

    Without ``kp`` the command is the torque. What ``kd`` damps acts as the joint's own damping does, so that it is
    given, not sought.
    """

    command: Angle
    kp: Positive | Literal["estimate"] | None = None
    kd: NonNegative = 0.0
    limit: Positive | None = None

    @model_validator(mode="before")
    @classmethod
    def _refuse_integral(cls, data: Any) -> Any:
        if isinstance(data, Mapping) and "ki" in data:
            words = (
                "`ki`: MuJoCo, which simulates the servos, has no actuator with an integral of the error; leave it out "
                "where it hardly acts, or log the torque that is commanded and give that as `command`, without `kp`"
            )
            raise PydanticCustomError("words", "{words}", {"words": words})
        return data

    @model_validator(mode="after")
    def _check_gain(self) -> Self:
        is_torque = any(unit_size(self.command.unit, dimension) for dimension in TORQUES.values())
        if self.kp is None and not is_torque:
            raise ValueError(f"needs `kp` for a command in {self.command.unit}, a number or `estimate`")
        if self.kp is not None and is_torque:
            raise ValueError(f"`kp` is that of a commanded position; leave it out for a command in {self.command.unit}")
        return self

    @property
    def dimensions(self) -> Mapping[str, str]:
        """What the command is, by the kind of the joint."""
        return TORQUES if self.kp is None else POSITIONS


class ServoSettings(Section):
    """Servos, whose commands of positions or torques stand for the torques: these are not in the logs.

    Commands are ``held`` until the next one, or interpolated, or as the logs say; ``delay`` (s) lies between a command
    and the position that answers it.
    """

    kind: Literal["servo"]
    commands: Literal["held", "interpolated", "estimate"] = "estimate"
    delay: DelayValue | Literal["estimate"] = "estimate"
    joints: Mapping[Name, ServoJoint] = Field(min_length=1)


SIMULATION_KINDS: Mapping[str, type[Section]] = {
    "cascade": CascadeSettings,
    "pd": PDSettings,
    "pid": PIDSettings,
    "measured_torque": TorqueInputSettings,
    "servo": ServoSettings,
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
    CascadeSettings | PDSettings | PIDSettings | FunctionSettings | TorqueInputSettings | ServoSettings,
    WrapValidator(_read_simulation),
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
