"""The content of exports: a model with identified values, the drives of its joints, and the inertias of its links."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from dynident.models import (
    Model,
    RigidBodies,
    RotorInertia,
    Term,
    change_frame,
    consistency_violations,
    from_pseudo,
    smallest_eigenvalue,
    to_pseudo,
)
from dynident.models.friction import Coulomb, JointTerm, Offset, PerJoint, Viscous
from dynident.models.robot_files import ArmBody
from dynident.runtime import ModelError, Noun
from dynident.runtime.arrays import Array

ADVICE = "identify with `estimator: {kind: consistent}` to avoid this; parameters.yaml and model.py hold any values"
# joint attributes that hold terms, by exact type: a subclass need not have the same torque
ATTRIBUTES: Mapping[type, str] = {Viscous: "damping", Coulomb: "friction", RotorInertia: "armature"}
MAX_NOMINAL_SHARE = 0.999  # the fixed links keep their nominal inertias up to this share of the largest consistent one


@dataclass(frozen=True)
class Servo:
    """How a joint is driven: torque = kp (reference - q) - kd dq within +-``limit``, in N m or N, rad or m, and s.

    ``kp`` is None where no controller is known, ``limit`` where there is none. The reference comes ``delay`` s late;
    the motor turns ``gear`` times as fast as the joint.
    """

    kp: float | None = None
    kd: float = 0.0
    limit: float | None = None
    delay: float = 0.0
    gear: float = 1.0


class IdentifiedModel(Noun):
    """A model and the values (p) of its parameters; ``std`` (p) and ``verdict`` (p) where they are known.

    ``servos`` say how joints are driven, by their names, where that is known. ``keeps_bodies``: inertias are those of
    the robot file, to which no rotor inertia is added.
    """

    model: Model
    value: Array
    std: Array | None = None
    verdict: tuple[str, ...] = ()
    servos: Mapping[str, Servo] = field(default_factory=dict)
    keeps_bodies: bool = False

    @property
    def parts(self) -> Iterator[tuple[Term, Array]]:
        """Each term with its own values."""
        return zip(self.model.terms, (self.value[part] for part in self.model.parameter_slices), strict=True)

    @property
    def memoryless(self) -> IdentifiedModel:
        """The model without the terms that remember more than the load.

        Its torque depends on q, dq and ddq of one sample alone.
        """
        memoryless_parts = [(term, values) for term, values in self.parts if not depends_on_past(term)]
        model = replace(self.model, terms=tuple(term for term, _ in memoryless_parts))
        return IdentifiedModel(model, np.concatenate([values for _, values in memoryless_parts]))

    @property
    def robot(self) -> RigidBodies | None:
        """The bodies of a robot file; robot files can hold the bodies of this term only."""
        return next((term for term in self.model.terms if isinstance(term, RigidBodies)), None)

    @property
    def bodies(self) -> tuple[RigidBodies, Array]:
        """The rigid bodies and their parameters (n, 10); ModelError where the model does not come from a robot file."""
        if (robot := self.robot) is not None:
            return robot, next(values for term, values in self.parts if term is robot).reshape(-1, 10)
        raise ModelError(f"{self.model.name}: this model does not come from a robot file, so there is none to write.")


def depends_on_past(term: Term) -> bool:
    """Return whether the torque of a term depends on more than one sample, and is no formula of it and the load."""
    return term.memory > 0 and not (isinstance(term, JointTerm) and term.states == ("load",) and term.formula())


class Drives(Noun):
    """The joint attributes of a robot file: damping (N m s/rad), friction (N m), armature (kg m^2), a constant torque
    ``offset`` (N m), or for sliding.

    ``left_out`` describes the parameters that no attribute holds; ``notes`` the values that the file keeps.
    """

    damping: Mapping[str, float] = field(default_factory=dict)
    friction: Mapping[str, float] = field(default_factory=dict)
    armature: Mapping[str, float] = field(default_factory=dict)
    offset: Mapping[str, float] = field(default_factory=dict)
    left_out: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def torque(self, joints: tuple[str, ...], dq: Array, ddq: Array) -> Array:
        """Return damping dq + friction sign(dq) + armature ddq + offset, shape (N, n)."""
        damping, friction, armature, offset = (
            np.array([values.get(name, 0.0) for name in joints])
            for values in (self.damping, self.friction, self.armature, self.offset)
        )
        return np.asarray(damping * dq + friction * np.sign(dq) + armature * ddq + offset)


def drives(identified: IdentifiedModel, *, armature: bool, offset: bool = False) -> Drives:
    """Return the part of the other terms that a robot file can hold.

    ``armature`` says whether it can hold rotor inertia, ``offset`` whether constant torques. A value that is not
    identified is that of the file. Raises ModelError for a negative value, which simulators reject.
    """
    bodies, _ = identified.bodies
    kinds = _drive_attributes(armature) | ({Offset: "offset"} if offset else {})
    identified_values: dict[str, dict[str, float]] = {name: {} for name in kinds.values()}
    left_out: list[str] = []
    for term, values in identified.parts:
        if term is bodies:
            continue
        if not isinstance(term, PerJoint) or type(term) not in kinds:
            left_out += omission_notes(term, values)
            continue
        # several terms may drive one joint: their values add
        _add_values(identified_values[kinds[type(term)]], term, values)
        left_out += _sign_notes(term)
    nominal: dict[str, dict[str, float]] = {name: getattr(bodies, name, {}) for name in identified_values}
    # the identified value of a joint already contains that of the joints that mimic it
    followers = _mimic_joints(bodies, identified_values)
    drive_values = {
        name: {**nominal[name], **identified_values[name], **dict.fromkeys(followers[name], 0.0)}
        for name in identified_values
    }
    notes = [
        f"{name} {value:g} of joint {joint!r} is the file's own; it was not identified"
        for name, values_by_joint in nominal.items()
        for joint, value in values_by_joint.items()
        if value and joint not in identified_values[name]
    ]
    notes += [
        f"{name} of {', '.join(map(repr, joints))} is set to 0, as the joint that they follow has it"
        for name, joints in followers.items()
        if joints
    ]
    return Drives(**drive_values, left_out=tuple(left_out), notes=tuple(notes))


def holdable_mask(identified: IdentifiedModel, *, armature: bool) -> NDArray[np.bool_]:
    """Return which parameters (p) a robot file can hold; ``armature``: whether it can hold rotor inertia."""
    robot, kinds = identified.robot, _drive_attributes(armature)
    masks = [
        np.full(len(values), term is robot or (isinstance(term, PerJoint) and type(term) in kinds))
        for term, values in identified.parts
    ]
    return np.concatenate(masks)


def _drive_attributes(armature: bool) -> dict[type, str]:
    """Return the attributes of joints, without ``armature`` where a file has none."""
    return {kind: name for kind, name in ATTRIBUTES.items() if armature or kind is not RotorInertia}


def _add_values(sums: dict[str, float], term: PerJoint, values: Array) -> None:
    """Add the values of a term to those of its joints; ModelError where one is negative."""
    for parameter, joint, value in zip(term.parameters, term.acts_on, values.tolist(), strict=True):
        if value < 0 and type(term) is not Offset:
            raise ModelError(f"{parameter.name} is {value:.4g} {parameter.unit}, below zero; {ADVICE}.")
        sums[joint] = sums.get(joint, 0.0) + value


def _sign_notes(term: Term) -> Iterator[str]:
    """Yield notes on the sign in Coulomb friction, where the file cannot hold it."""
    if not isinstance(term, Coulomb):
        return
    rules = [term.rule(joint) for joint in term.acts_on]
    # each rule is named once, with its joints only where they differ
    for width, band in dict.fromkeys(rules):
        if width or band:
            rule = f"by tanh over {width:.3g}" if width else f"zero up to {band:.3g}"
            pairs = zip(term.acts_on, rules, strict=True)
            where = [repr(joint) for joint, joint_rule in pairs if joint_rule == (width, band)]
            joints_text = "" if len(where) == len(rules) else f" of {', '.join(where)}"
            yield f"how Coulomb friction{joints_text} changes its sign: {rule} rad/s or m/s; the file's friction jumps"


def _mimic_joints(bodies: RigidBodies, names: Iterable[str]) -> dict[str, list[str]]:
    """Return, by name of the attribute, the mimic joints for which the file gives one."""
    model_joints = {joint.name for joint in bodies.joints}
    follow = [body.joint for body in bodies.arm.bodies if body.joint.name not in model_joints]
    return {name: [joint.name for joint in follow if joint.nominal.get(name)] for name in names}


def omission_notes(term: Term, values: Array) -> Iterator[str]:
    """Yield a note on each parameter of a term that is left out."""
    for parameter, value in zip(term.parameters, values, strict=True):
        if value:
            yield f"{parameter.name} = {value:.6g} {parameter.unit} ({parameter.expression})"


class LinkInertias(Noun):
    """The identified bodies divided among the links of the file.

    ``links`` has by link its parameters (10) in its own frame, None for a link that loses its inertia; unchanged
    links are not listed. ``notes`` give the reasons.
    """

    links: Mapping[str, Array | None]
    notes: tuple[str, ...] = ()


def link_inertias(bodies: RigidBodies, values: Array) -> LinkInertias:
    """Divide the parameters (n, 10) of the bodies among their links; the sums are exact.

    The other links of a body keep the inertias of the file, and its first link gets the remainder. Where that
    would not be physically consistent, the others keep a share that leaves half of the body along the tightest
    direction. Raises ModelError for a body whose pseudo-inertia is not positive definite.
    """
    links: dict[str, Array | None] = {}
    notes: list[str] = []
    for body, theta in zip(bodies.arm.bodies_with_parameters, values, strict=True):
        if smallest_eigenvalue(theta) <= 0:
            why = "; ".join(consistency_violations(theta)) or "its pseudo-inertia is singular"
            raise ModelError(f"body {body.name!r} is not physically consistent: {why}; {ADVICE}.")
        # nominal parameters in the own frame, and this frame in the body's
        frames = zip(body.links[1:], body.frames[1:], strict=True)
        other_links = {link: (bodies.file.links[link], frame) for link, frame in frames}
        share = _nominal_share(theta, other_links)
        # what the other links keep is subtracted from the body
        remainder = theta.copy()
        for link, (nominal, frame) in other_links.items():
            if nominal is None:
                links[link] = None
                continue
            # links are expressed in the frame of the body, where parameters add
            remainder -= share * change_frame(nominal, frame)
            if share < 1 and nominal.any():
                links[link] = share * nominal if share else None
        # the first link gets the remainder, in its own frame
        links[body.name] = from_pseudo(to_pseudo(change_frame(remainder, np.linalg.inv(body.frames[0]))))
        notes += _share_notes(body, share, other_links)
    return LinkInertias(links, tuple(notes))


def _nominal_share(theta: Array, other_links: Mapping[str, tuple[Array | None, Array]]) -> float:
    """Return t such that theta - t (sum of the other links) is consistent; 0 where one of these links is not."""
    from scipy.linalg import eigh

    nominals = [
        change_frame(nominal, frame) for nominal, frame in other_links.values() if nominal is not None and nominal.any()
    ]
    if not nominals:
        return 1.0
    if any(consistency_violations(nominal) for nominal in nominals):
        return 0.0
    # the largest generalised eigenvalue: theta - t nominal stays positive definite for t below its inverse
    largest = float(eigh(to_pseudo(sum(nominals, np.zeros(10))), to_pseudo(theta), eigvals_only=True)[-1])
    return 1.0 if largest <= MAX_NOMINAL_SHARE else 0.5 / largest


def _share_notes(body: ArmBody, share: float, other_links: Mapping[str, tuple[Array | None, Array]]) -> Iterator[str]:
    for link, (nominal, _) in other_links.items():
        if nominal is None:
            yield f"link {link!r}: its inertia follows from meshes; now it is part of {body.name!r}"
    weighty = [link for link, (nominal, _) in other_links.items() if nominal is not None and nominal.any()]
    if weighty and share < 1:
        kept_part = f"{100 * share:.3g} % of their inertias" if share else "no inertia"
        yield (
            f"body {body.name!r}: the inertias that the file gives {', '.join(map(repr, weighty))} do not fit "
            f"into the identified body; they keep {kept_part}, and {body.name!r} has the rest"
        )
