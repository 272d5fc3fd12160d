"""The controller that drove the joints of a recording, with its gains and references, in SI units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ConfigError, InputError
from dynident.io.channels import POSITIONS, VELOCITIES, Channel
from dynident.io.settings import LogSpec
from dynident.io.signals import RecordedSignals, bad_values, channel_values
from dynident.io.simulation_settings import (
    CascadeSettings,
    FunctionSettings,
    LoopJoint,
    LoopSettings,
    PDJoint,
    PIDSettings,
)
from dynident.io.tables import DataTable
from dynident.log import Controller
from dynident.models import Joint
from dynident.simulation import PD, PID, CascadePD, Differenced, Function, HasTimes

__all__ = ["controller"]

Array = NDArray[np.float64]
WHERE = "simulation.joints"


def controller(signals: RecordedSignals, settings: object, spec: LogSpec, joints: Sequence[Joint]) -> Controller | None:
    """Return the controller of a recording, None where the configuration has none.

    Raises InputError where a reference or a gain is missing, ConfigError for gains with which a joint does not follow.
    """
    if not isinstance(settings, LoopSettings):
        return None
    found = _logged(signals, settings, spec, joints)
    try:
        found = found if settings.period is None else found.every(settings.period)
    except InputError as error:
        raise ConfigError(f"simulation.period: {signals.table.source}: {error}") from error
    return found if settings.velocity_steps == 1 else Differenced(found, settings.velocity_steps)


def _logged(signals: RecordedSignals, settings: LoopSettings, spec: LogSpec, joints: Sequence[Joint]) -> HasTimes:
    """Return the controller, with its references as they were logged."""
    loop = _Loop(signals, [settings.joints[joint.name] for joint in joints], joints)
    shared: dict[str, Any] = {"joints": tuple(joint.name for joint in joints), "t": signals.t}
    shared |= {"reference": loop.signal("reference", POSITIONS), "feedforward": loop.feedforward(spec)}
    shared |= {name: loop.gains(name) for name in ("gain", "saturation")}
    if not (shared["saturation"] > 0).all():
        k = int(np.argmin(shared["saturation"] > 0))
        value = shared["saturation"][k]
        raise ConfigError(f"{WHERE}.{joints[k].name}.saturation: saturation is {value:g}; give a positive number.")
    if isinstance(settings, FunctionSettings):
        return Function(law=settings.law, **shared)
    if isinstance(settings, CascadeSettings):
        kp, kv = loop.gains("kp"), loop.gains("kv")
        loop.follow(kp * kv)
        return CascadePD(kp=kp, kv=kv, **shared)
    kp, ki = loop.gains("kp"), loop.gains("ki") if isinstance(settings, PIDSettings) else None
    loop.follow(kp if ki is None else np.hypot(kp, ki))
    pd = PD(kp=kp, kd=loop.gains("kd"), velocity_reference=loop.rates(), **shared)
    return pd if ki is None else PID(pd, ki)


class _Loop:
    """The settings of the drives of the joints beside a recording."""

    def __init__(self, signals: RecordedSignals, drives: Sequence[LoopJoint], joints: Sequence[Joint]) -> None:
        self.table, self.rows, self.drives, self.joints = signals.table, len(signals.t), drives, joints

    def signal(self, name: str, units: Mapping[str, str]) -> Array:
        """Return a channel of the drives (N, n)."""
        found = [self._column(getattr(one, name), joint, name, units) for one, joint in self._each()]
        return np.column_stack(found)

    def rates(self) -> Array | None:
        """Return the references of the velocities (N, n), zero at joints without one; None where no joint has one."""
        given = [one.velocity_reference if isinstance(one, PDJoint) else None for one in self.drives]
        if all(one is None for one in given):
            return None
        name = "velocity_reference"
        return np.column_stack(
            [
                np.zeros(self.rows) if one is None else self._column(one, joint, name, VELOCITIES)
                for one, joint in zip(given, self.joints, strict=True)
            ]
        )

    def feedforward(self, spec: LogSpec) -> Array:
        """Return the feedforward of the drives (N, n) in a recording, zero where there is none."""
        found = []
        for one, joint in self._each():
            column = one.column(spec.label)
            where = f"{WHERE}.{joint.name}.feedforward"
            found.append(np.zeros(self.rows) if column is None else self.table.column(column, where))
            _require_valid(self.table, "feedforward", found[-1], self.rows)
        return np.column_stack(found)

    def gains(self, name: str) -> Array:
        """Return a number of each drive (n), infinite where it is not given."""
        values = [(getattr(one, name), f"{WHERE}.{joint.name}.{name}") for one, joint in self._each()]
        return np.array([np.inf if value is None else self.table.constant(value, where) for value, where in values])

    def follow(self, stiffness: Array) -> None:
        """Raise ConfigError for a joint whose position does not matter to its controller."""
        for joint, value in zip(self.joints, stiffness, strict=True):
            if not value:
                raise ConfigError(
                    f"{WHERE}.{joint.name}: with these gains, of which one is 0, the joint does not follow its "
                    "reference; give its gains, or simulate from the torque (`kind: measured_torque`)."
                )

    def _each(self) -> list[tuple[LoopJoint, Joint]]:
        return list(zip(self.drives, self.joints, strict=True))

    def _column(self, channel: Channel, joint: Joint, name: str, units: Mapping[str, str]) -> Array:
        values = channel_values(self.table, {joint.name: channel}, [joint], WHERE, units)[:, 0]
        _require_valid(self.table, name.replace("_", " "), values, self.rows)
        return values


def _require_valid(table: DataTable, name: str, values: Array, size: int) -> None:
    if len(values) != size or len(bad_values(values)):
        raise InputError(f"{table.source}: the {name} of the controller is not one valid number per time stamp.")
