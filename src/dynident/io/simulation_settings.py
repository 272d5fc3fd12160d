"""The settings of free simulations: the controllers that drove the joints, or the measured torque."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Literal, Self

from pydantic import Field, PrivateAttr, ValidationInfo, WrapValidator, model_validator

from dynident.errors import ConfigError, choices
from dynident.io.channels import POSITIONS, VELOCITIES, Angle, Channel, same_names
from dynident.io.fields import Amount, Gain, Name, Number, Positive, Section, by_kind, unit_factor
from dynident.io.python_file import CODE, FileFunction, from_file, located
from dynident.models import Joint

__all__ = [
    "CascadeJoint",
    "CascadeSettings",
    "FunctionJoint",
    "FunctionSettings",
    "LoopJoint",
    "LoopSettings",
    "PDJoint",
    "PDSettings",
    "PIDJoint",
    "PIDSettings",
    "Simulation",
    "TorqueInputSettings",
    "check_loop",
]


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
    def _loaded(self, info: ValidationInfo) -> Self:
        place, _, name = self.kind.rpartition(":")
        if (folder := (info.context or {}).get("code")) is None:
            raise ValueError(f"{self.kind!r} {CODE}")
        try:
            path = located(folder, place, "kind", ConfigError)
            from_file(path, name, "function", "kind", ConfigError)
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


KINDS: Mapping[str, type[Section]] = {
    "cascade": CascadeSettings,
    "pd": PDSettings,
    "pid": PIDSettings,
    "measured_torque": TorqueInputSettings,
}
Simulation = Annotated[
    CascadeSettings | PDSettings | PIDSettings | FunctionSettings | TorqueInputSettings,
    WrapValidator(by_kind(KINDS, of_file=FunctionSettings)),
]


def check_loop(loop: LoopSettings, joints: Sequence[Joint], labels: Sequence[str], *, geared: bool) -> None:
    """Check a controller against the model's joints and the names of the recordings; raises ConfigError."""
    same_names("simulation.joints", loop.joints, joints)
    if geared:
        raise ConfigError(
            "simulation: a controller of motors behind a transmission cannot be simulated; use `kind: measured_torque`."
        )
    for joint in joints:
        one, where = loop.joints[joint.name], f"simulation.joints.{joint.name}"
        unit_factor(one.reference.unit, POSITIONS[joint.kind], f"{where}.reference.unit")
        if isinstance(one, PDJoint) and one.velocity_reference is not None:
            unit_factor(one.velocity_reference.unit, VELOCITIES[joint.kind], f"{where}.velocity_reference.unit")
        for name in one.feedforward if isinstance(one.feedforward, Mapping) else ():
            if name not in labels:
                raise ConfigError(f"{where}.feedforward: there is no recording {name!r}; {choices(name, labels)}")
