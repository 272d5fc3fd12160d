"""A saved result of servos (servo.json), and its model for the exports to other simulators."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite
from pathlib import Path

import numpy as np

from dynident.apps.servo.result import entry_name, entry_unit
from dynident.apps.servo.run import ServoArm, load_servos
from dynident.apps.servo.values import Entry, Quantity, ServoValues
from dynident.models import Model, RigidBodies, RotorInertia, change_frame
from dynident.models.friction import Coulomb, Viscous
from dynident.project.export import IdentifiedModel, Servo
from dynident.project.project import Project, parse_project
from dynident.project.result_format import SERVO_FORMAT, SERVO_VERSION
from dynident.project.saved import result_values
from dynident.runtime import InputError, ModelError, number
from dynident.runtime.arrays import Array

TERMS = {Quantity.ARMATURE: RotorInertia, Quantity.DAMPING: Viscous, Quantity.FRICTIONLOSS: Coulomb}


@dataclass(frozen=True, eq=False)
class SavedServos:
    """A result that was read: its ``project`` and ``arm``, the fitted ``values``, and standard errors ``std`` by entry.

    Commands are ``held``, else interpolated; ``warnings`` say what has changed since.
    """

    project: Project
    arm: ServoArm
    values: ServoValues
    std: Mapping[Entry, float]
    held: bool
    warnings: tuple[str, ...]

    @property
    def identified(self) -> IdentifiedModel:
        """The model for exports: bodies of the robot file with the fitted masses, what joints add, and their servos."""
        model, values = self.project.model, self.values
        bodies = next(term for term in model.terms if isinstance(term, RigidBodies))
        terms = [kind(model.joints) for kind in TERMS.values()]
        model = Model((bodies, *terms), model.name)
        inertias = self._inertias(bodies)
        value = [inertias.ravel(), *(getattr(values, quantity) for quantity in TERMS)]
        std = [np.full(inertias.size, np.nan)]
        std += [np.array([self.std.get(Entry(q, k), np.nan) for k in range(len(model.joints))]) for q in TERMS]
        columns = zip(values.kp.tolist(), values.kd.tolist(), values.limit.tolist(), strict=True)
        servos = [Servo(kp or None, kd, limit if isfinite(limit) else None, values.delay) for kp, kd, limit in columns]
        servos_by_joint = dict(zip(self.arm.plant.joints, servos, strict=True))
        return IdentifiedModel(
            model, np.concatenate(value), np.concatenate(std), servos=servos_by_joint, keeps_bodies=True
        )

    @property
    def left_out(self) -> tuple[str, ...]:
        """What no other simulator's file holds: offsets of encoders and commands."""
        joints, values = self.project.model.joints, self.values
        entries = [entry for entry in self.std if entry.quantity in (Quantity.OFFSET, Quantity.COMMAND_OFFSET)]
        return tuple(
            f"{entry_name(entry, self.arm.plant.joints)} = {number(values.entry(entry), 3)} "
            f"{entry_unit(entry, joints, values)}"
            for entry in entries
        )

    def _inertias(self, bodies: RigidBodies) -> Array:
        """Return the parameters (n, 10) of the bodies, those of links that joints move times the fitted factors."""
        nominal = [parameter.value for parameter in bodies.parameters]
        if None in nominal:
            name = bodies.parameters[nominal.index(None)].body
            raise ModelError(f"{bodies.source}: {name!r} has no inertia of its own; give it an <inertial>.")
        inertias = np.array(nominal, dtype=float).reshape(-1, 10)
        factors = dict(zip(self.arm.plant.joints, self.values.mass.tolist(), strict=True))
        for k, body in enumerate(bodies.arm.bodies_with_parameters):
            link = bodies.file.links[body.links[0]]
            if link is not None:  # links that are fixed to it keep theirs
                inertias[k] += (factors.get(body.joint.name, 1.0) - 1) * change_frame(link, body.frames[0])
        return inertias


def load_servo_result(path: Path, *, allow_code: bool = False) -> SavedServos:
    """Return the result in ``path`` (servo.json), with the robot file as it is now.

    Raises InputError where the file is no such result, and the errors of reading the configuration and the robot file.
    """
    data = result_values(path)
    try:
        joints = list(map(str, data["joints"]))
        rows = {
            Entry(Quantity(row["quantity"]), joints.index(row["joint"]) if row["joint"] else 0): row
            for row in data["parameters"]
        }
        value, std = ({entry: float(row.get(name, np.nan)) for entry, row in rows.items()} for name in ("value", "std"))
        text, place = str(data["configuration"]["text"]), Path(data["configuration"]["path"])
        if not all(map(isfinite, value.values())):
            raise ValueError("a value is not finite")
        digests, held = dict(data["files"]), bool(data["commands_held"])
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path}: is no result of servos ({SERVO_FORMAT}): {error!r}.") from error
    if data.get("version") != SERVO_VERSION:
        raise InputError(f"{path}: is of version {data.get('version')}; {SERVO_VERSION} is read. Identify again.")
    project = parse_project(text, place, allow_code=allow_code)
    arm = load_servos(project)
    if joints != [joint.name for joint in project.model.joints]:
        raise InputError(f"{path}: {', '.join(joints)} are not the joints of the robot file; identify again.")
    values = arm.nominal.changed(list(value), list(value.values()))
    file = project.sources.model
    warnings: tuple[str, ...] = ()
    if file is not None and digests.get(file.path) != file.sha256:
        warnings = (f"{file.path} is not as it was when the values were found.",)
    return SavedServos(project, arm, values, std, held, warnings)
