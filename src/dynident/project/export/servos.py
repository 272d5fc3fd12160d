"""What simulators want beside the dynamics: how joints are driven, and in which range each value is."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from numbers import Real
from pathlib import Path

import numpy as np

from dynident.files.xml_text import XmlText
from dynident.identification import Identification
from dynident.models import RigidBodies, Term
from dynident.models.friction import PerJoint
from dynident.project.config import parse_config
from dynident.project.drive_settings import CascadeJoint, LoopJoint, LoopSettings, PDJoint, PIDJoint
from dynident.project.export.identified import ATTRIBUTES, Drives, IdentifiedModel, Servo
from dynident.project.export.tree_text import element
from dynident.project.settings import Config
from dynident.runtime import DynidentError
from dynident.runtime.arrays import Array

NORMAL_95 = 1.96  # standard errors to either side
COMMAND_STEP = 5e-4  # s: MuJoCo keeps enough commands for a time step as short as this


def identified_model(identification: Identification) -> IdentifiedModel:
    """Return what exports hold of an identification, with the drives of its configuration."""
    estimate, configuration = identification.estimate, identification.provenance.configuration
    servos: Mapping[str, Servo] = {}
    if configuration is not None:
        # a controller in Python, or files that are gone: the model is written without
        with suppress(DynidentError):
            folder = Path(configuration.path).parent
            servos = servos_of(parse_config(configuration.text, folder, configuration.path, allow_code=False))
    return IdentifiedModel(
        identification.model, estimate.value, identification.errors.std, tuple(estimate.provenance), servos
    )


def servos_of(config: Config) -> dict[str, Servo]:
    """Return the drives of the joints that a configuration has as numbers: controllers, limits and gears."""
    gears = _gears(config.transmission)
    loop = config.simulation.joints if isinstance(config.simulation, LoopSettings) else {}
    servos = {}
    for joint in config.position:
        drive, gear = loop.get(joint), gears.get(joint, 1.0)
        if drive is not None:
            servos[joint] = _servo(drive, gear)
        elif joint in gears:
            servos[joint] = Servo(gear=gear)
    return servos


def _gears(transmission: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
    """Return the gear ratios of joints that have a motor of their own: turns of the motor for one of the joint."""
    rows = [{joint: ratio for joint, ratio in row.items() if ratio} for row in transmission.values()]
    uses = [joint for row in rows for joint in row]
    return {
        joint: float(ratio) for row in rows if len(row) == 1 for joint, ratio in row.items() if uses.count(joint) == 1
    }


def _servo(drive: LoopJoint, gear: float) -> Servo:
    """Return a drive as a spring and a damper, without them where a gain is no number, or the law is another."""
    values = [drive.gain, *(getattr(drive, name, 0.0) for name in ("kp", "kv", "kd"))]
    limit = drive.saturation
    if not all(isinstance(value, Real) for value in values) or isinstance(limit, str):
        return Servo(gear=gear)
    gain, kp, kv, kd = (float(value) for value in values if not isinstance(value, str))
    torque_limit = None if limit is None else abs(gain) * float(limit)
    if isinstance(drive, CascadeJoint):
        kp, kd = kv * kp, kv
    elif not isinstance(drive, PDJoint) or isinstance(drive, PIDJoint):
        return Servo(limit=torque_limit, gear=gear)
    return Servo(gain * kp, gain * kd, torque_limit, gear=gear)


@dataclass(frozen=True)
class ValueRange:
    """In which range an ``attribute`` of a joint or body is, with a probability of 95 %, by its standard error."""

    attribute: str
    name: str
    low: float
    high: float

    @property
    def label(self) -> str:
        """The name of a number in an MJCF."""
        return f"range of {self.attribute} {self.name}"


def ranges(identified: IdentifiedModel, joint_drives: Drives) -> tuple[ValueRange, ...]:
    """Return the ranges of damping, friction and armature of joints as the file has them, and of masses of bodies.

    None of them is below zero; where there is no standard error, or none that is finite, there is no range.
    """
    if identified.std is None:
        return ()
    errors = replace(identified, value=identified.std).parts
    return tuple(
        ValueRange(attribute, name, max(value - NORMAL_95 * std, 0.0), value + NORMAL_95 * std)
        for (term, values), (_, term_std) in zip(identified.parts, errors, strict=True)
        for attribute, name, value, std in _uncertain_values(term, values, term_std, joint_drives)
        if np.isfinite(std) and value > 0
    )


def _uncertain_values(
    term: Term, values: Array, std: Array, joint_drives: Drives
) -> Iterator[tuple[str, str, float, float]]:
    """Yield the attributes of joints, as the file has them, and the masses of a term, each with its standard error."""
    if isinstance(term, PerJoint) and (attribute := ATTRIBUTES.get(type(term))):
        for name, error in zip(term.acts_on, std.tolist(), strict=True):
            yield attribute, name, getattr(joint_drives, attribute).get(name, 0.0), error
    elif isinstance(term, RigidBodies):
        for parameter, mass, error in zip(term.parameters, values.tolist(), std.tolist(), strict=True):
            if parameter.role == "mass":
                yield "mass", parameter.body, mass, error


def range_lines(value_ranges: Sequence[ValueRange]) -> list[str]:
    """Return the ranges as numbers of an MJCF, called ``range of armature elbow``."""
    if not value_ranges:
        return []
    lines = ["  " + element("numeric", name=x.label, data=(x.low, x.high)) for x in value_ranges]
    return ["<custom>", *lines, "</custom>"]


def actuator_lines(servos: Mapping[str, Servo], bodies: RigidBodies, offset: Mapping[str, float]) -> list[str]:
    """Return the actuators of an MJCF: of position where the gains are known, else of torque where a limit is.

    A constant torque ``offset`` (N m or N) of a joint is taken off the force of its actuator.
    """
    lines = []
    for joint in bodies.joints:
        servo, constant = servos.get(joint.name, Servo()), offset.get(joint.name, 0.0)
        limit = servo.limit or bodies.limits[joint.name].effort
        # without a constant torque this is the same as <position> or <motor>
        attributes: dict[str, object] = {"name": joint.name, "joint": joint.name, "biastype": "affine"}
        attributes |= {"gainprm": 1.0 if servo.kp is None else servo.kp}
        attributes |= {"biasprm": (-constant, -(servo.kp or 0.0), -servo.kd)}
        if limit:
            attributes |= {"forcerange": np.array([-limit, limit]) - constant}
        if servo.kp is None and limit:
            attributes |= {"ctrlrange": (-limit, limit)}
        if servo.delay:
            attributes |= {"delay": servo.delay, "nsample": str(2 + math.ceil(servo.delay / COMMAND_STEP))}
        if constant or limit or servo.kp is not None:
            lines.append("  " + element("general", **attributes))
    return ["<actuator>", *lines, "</actuator>"] if lines else []


def constant_torques(text: XmlText, joints: Sequence[str]) -> Array:
    """Return the constant torques (n) that the actuators of an MJCF take off."""
    nodes = [node for section in text.root.children if section.tag == "actuator" for node in section.children]
    biases = {node.attributes.get("joint"): node.attributes.get("biasprm", "0").split()[0] for node in nodes}
    return np.array([-float(biases.get(joint, 0.0)) for joint in joints])


def range_comment(value_ranges: Sequence[ValueRange]) -> Iterator[str]:
    """Yield the lines of an XML comment with the ranges; in it names cannot end the comment."""
    if value_ranges:
        yield "<!-- ranges with a probability of 95 %, for domain randomisation:"
        for x in value_ranges:
            yield f"  {x.attribute} {ascii(x.name).replace('--', '- -')}: {x.low!r} to {x.high!r}"
        yield "-->"
