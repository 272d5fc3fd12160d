"""Checks of a robot file: impossible inertias and limits, wrong units, placeholders."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynident.checks import file_notes
from dynident.checks.torque import nominal_torque, nuisance_columns, project_out, thin_samples, torque_or_zero
from dynident.models import Model, consistency_violations, from_physical, to_physical
from dynident.models.robot_files import RobotFile, RobotJoint, RobotJointLimits
from dynident.motion.log import Motion
from dynident.runtime import Finding, Severity
from dynident.runtime.arrays import Array

MAX_CENTRE_DISTANCE = 1.0  # m: a centre of mass beyond it, and beyond the link's joints, is rather in millimetres
MAX_GYRATION_RATIO = 0.6  # radius of gyration over the size of the link; a rod has 0.29, two masses at its ends 0.5
MIN_LINK_SIZE = 0.15  # m: size of a link without a known length, motors and all
MIN_STEINER_SHARE = 0.6  # share of m c^2 in the largest moment from which on the tensor may be about the frame's origin
MIN_ARM_MASS, MAX_ARM_MASS = 0.05, 5000.0  # kg: masses of whole arms


@dataclass(frozen=True, eq=False)
class LinkFacts:
    """A link with a mass (kg), its centre (3) in its frame (m), and principal moments (3) about it (kg m^2)."""

    link: str
    mass: float
    centre: Array
    moments: Array


@dataclass(frozen=True)
class RobotJointFacts:
    """A joint of a robot file: its kind, its ``limits``, and the ``mass`` (kg) of the body that it carries.

    ``follows`` (joint, multiplier, offset) is set for a mimic joint; ``held`` says why the joint is fixed, empty
    where it moves. The mass is that of its link and those fixed to it, nan where the file leaves it to shapes.
    """

    joint: str
    kind: str
    limits: RobotJointLimits
    follows: tuple[str, float, float] | None
    held: str
    mass: float


def joint_facts(file: RobotFile) -> tuple[RobotJointFacts, ...]:
    """Return the joints that can move, or could if they had one coordinate, in the order of the file."""
    facts = []
    for joint in file.joints:
        if joint.kind == "fixed" and not joint.refusal:
            continue
        thetas = [file.links[name] for name in _rigid_links(file, joint.child)]
        mass = float(sum(np.nan if theta is None else theta[0] for theta in thetas))
        facts.append(RobotJointFacts(joint.name, joint.kind, joint.limits, joint.follows, joint.refusal, mass))
    return tuple(facts)


def link_facts(file: RobotFile) -> tuple[LinkFacts, ...]:
    """Return mass, centre and moments of all links that have a mass, in the order of the file."""
    facts = []
    for name, theta in file.links.items():
        if theta is not None and theta[0] != 0:
            mass, centre, tensor = to_physical(theta)
            facts.append(LinkFacts(name, float(mass), centre, np.asarray(np.linalg.eigvalsh(tensor), float)))
    return tuple(facts)


def check_robot(
    file: RobotFile, joints: Sequence[str] | None = None, inconsistent: Severity = Severity.ERROR
) -> tuple[Finding, ...]:
    """Return the findings on a robot file: on its links, on the ``joints`` that move (None: all), and on the whole.

    ``inconsistent`` is the severity of inertias that no body can have: an error where the file is to be simulated, a
    warning where its values are only nominal.
    """
    facts = link_facts(file)
    moving = [joint for joint in file.joints if joint.kind != "fixed" and (joints is None or joint.name in joints)]
    findings = [
        *_inertia_findings(file, moving, inconsistent),
        *_size_findings(file, facts),
        *_origin_findings(file, facts),
        *_copy_findings(file, facts),
        *_robot_findings(file, moving, facts),
        *_limit_findings(file, moving),
        *(Finding(file_notes.Unread(f"{note}.")) for note in file.notes),
    ]
    return tuple(replace(finding, source=file.source) for finding in findings)


def _inertia_findings(file: RobotFile, moving: Sequence[RobotJoint], severity: Severity) -> Iterator[Finding]:
    """Yield impossible inertias, moving bodies without mass, inertias that come from shapes, and point masses."""
    for name, theta in file.links.items():
        for violation in () if theta is None else consistency_violations(theta):
            yield Finding(file_notes.ImpossibleInertia(violation), link=name, severity=severity)
    for joint in moving:
        carried = _rigid_links(file, joint.child)
        thetas = [file.links[name] for name in carried]
        if all(theta is not None and not theta.any() for theta in thetas):
            yield Finding(file_notes.NoMass(tuple(carried)), joint.name, link=joint.child)
    for name, theta in file.links.items():
        if theta is None:
            yield Finding(file_notes.OnlyShapes(), link=name)
        elif theta[0] > 0 and not np.abs(to_physical(theta)[2]).max() > 0:
            yield Finding(file_notes.PointMass(float(theta[0])), link=name)


def _robot_findings(file: RobotFile, moving: Sequence[RobotJoint], facts: Sequence[LinkFacts]) -> Iterator[Finding]:
    """Yield an odd total mass, joints that let the base float, and a base that is perhaps a walking robot's trunk."""
    total = sum(fact.mass for fact in facts)
    if facts and not MIN_ARM_MASS <= total <= MAX_ARM_MASS:
        yield Finding(file_notes.OddTotalMass(total))
    for name in file.floating:
        yield Finding(file_notes.FloatingBase(), name)
    if (limbs := file.limbs({joint.name for joint in moving})) is not None:
        yield Finding(file_notes.SeveralLimbs(*limbs))


def _rigid_links(file: RobotFile, link: str) -> list[str]:
    """Return the link and those fixed to it further out."""
    links = [link]
    # the list grows while it is read: a breadth-first search over fixed joints
    for name in links:
        links += [joint.child for joint in file.joints if joint.parent == name and joint.kind == "fixed"]
    return links


def _size_findings(file: RobotFile, facts: Sequence[LinkFacts]) -> Iterator[Finding]:
    """Yield the links whose centre of mass is far, and moving ones whose radius of gyration is beyond their length."""
    base_links = _rigid_links(file, file.root)
    for fact in facts:
        distance = float(np.linalg.norm(fact.centre))
        joints = [joint for joint in file.joints if fact.link in (joint.parent, joint.child)]
        reach = max((float(np.linalg.norm(joint.placement[:3, 3])) for joint in joints), default=0.0)
        if distance > max(MAX_CENTRE_DISTANCE, reach):
            yield Finding(file_notes.FarCentre(distance), link=fact.link)
        if fact.link in base_links:
            continue
        gyration = float(np.sqrt(max(fact.moments[-1], 0.0) / abs(fact.mass)))
        # the length of a link: the distance to its joints, their travel, or twice that to its centre of mass
        limits = [joint.limits for joint in joints if joint.kind == "prismatic"]
        size = max([MIN_LINK_SIZE, 2 * distance, reach, *((x.upper or 0.0) - (x.lower or 0.0) for x in limits)])
        if gyration > MAX_GYRATION_RATIO * size:
            yield Finding(file_notes.LargeGyration(float(fact.moments[-1]), gyration, fact.mass, size), link=fact.link)


def _origin_findings(file: RobotFile, facts: Sequence[LinkFacts]) -> Iterator[Finding]:
    """Yield a question where most tensors would be physically consistent also if they were about the frame's origin."""
    candidates, consistent_links = [], []
    for fact in facts:
        # only where the centre is far from the origin do the two conventions differ enough to be told apart
        lever = fact.mass * float(fact.centre @ fact.centre)
        theta = file.links[fact.link]
        if theta is None or fact.mass <= 0 or lever < MIN_STEINER_SHARE * fact.moments[-1] or not fact.moments[-1] > 0:
            continue
        candidates.append(fact.link)
        # the tensor about the frame's origin of a point mass at the centre
        point_inertia = fact.mass * (fact.centre @ fact.centre * np.eye(3) - np.outer(fact.centre, fact.centre))
        shifted = to_physical(theta)[2] - point_inertia
        if not consistency_violations(from_physical(fact.mass, fact.centre, shifted)):
            consistent_links.append(fact.link)
    if len(consistent_links) >= 2 and 2 * len(consistent_links) > len(candidates):
        yield Finding(file_notes.InertiaAboutOrigin(tuple(consistent_links)))


def _copy_findings(file: RobotFile, facts: Sequence[LinkFacts]) -> Iterator[Finding]:
    """Yield links of the same mass and moments, except on one parent, as the fingers of a gripper are."""
    alike: dict[tuple[float, ...], list[LinkFacts]] = {}
    for fact in facts:
        alike.setdefault((fact.mass, *np.round(fact.moments, 9).tolist()), []).append(fact)
    parents = {joint.child: joint.parent for joint in file.joints}
    for group in alike.values():
        names = tuple(fact.link for fact in group)
        if len({parents.get(name) for name in names}) < 2:
            continue
        alone = len(group) == len(facts) > 2
        severity = Severity.WARNING if alone else Severity.INFO
        yield Finding(file_notes.EqualLinks(names, group[0].mass, alone), severity=severity)


def _limit_findings(file: RobotFile, moving: Sequence[RobotJoint]) -> Iterator[Finding]:
    for joint in moving:
        limits = joint.limits
        if limits.lower is not None and limits.upper is not None and limits.lower >= limits.upper:
            yield Finding(file_notes.EmptyRange(limits.lower, limits.upper), joint.name)
        for name, value in (("effort", limits.effort), ("velocity", limits.velocity)):
            if value is not None and value <= 0:
                yield Finding(file_notes.LimitNotPositive(name, value), joint.name)
    for name in ("effort", "velocity") if file.format != "mjcf" else ("effort",):  # MJCF has no velocity limit
        unlimited = [joint.name for joint in moving if getattr(joint.limits, name) is None]
        if unlimited:
            yield Finding(file_notes.NoLimit(name, tuple(unlimited)))


MIN_ANGLE = 40.0  # deg from which another direction is asked about; smaller angles are a tilt, or wrong inertias
# share of the torque's variance, beside friction and rotor, that the found direction must explain
MIN_EXPLAINED_VARIANCE = 0.7
# times the unexplained variance of the assumed direction: above, both explain it about as well
MAX_VARIANCE_RATIO = 0.5
MIN_SINGULAR_SHARE = 0.02  # share of the largest singular value below which the motion does not show a direction
STANDARD_GRAVITY = 9.81  # m/s^2, the size where no gravity was assumed
MAX_SIZE_FACTOR = 3.0  # times the assumed size, or a third: then inertias or units are wrong, not the direction


def gravity_findings(model: Model, motions: Sequence[Motion]) -> Iterator[Finding]:
    """Yield a question where the robot file's inertias fit the torques under another direction of gravity.

    One factor of the inertial torque and the three components of gravity are fitted over all joints, each scaled
    by its torque, together with friction, rotor inertia and offset of each joint. Nothing is yielded where the
    motion does not determine them.
    """
    terms = [term for term in model.terms if term.gravity is not None]
    if len(terms) != 1:
        return
    assumed = np.array(terms[0].gravity)
    size = float(np.linalg.norm(assumed)) or STANDARD_GRAVITY
    X, y = _scaled_rows(model, motions, size)
    down = _gravity_direction(X, y, assumed / size) if len(y) else None
    if down is not None:
        gravity = np.round(size * down, 1) + 0.0
        yield Finding(file_notes.OtherGravity(tuple(gravity.tolist()), tuple(assumed.tolist())))


def _scaled_rows(model: Model, motions: Sequence[Motion], size: float) -> tuple[Array, Array]:
    """Return the nominal torques (M, 4) of ``_gravity_columns`` and the measured ones (M), for all joints.

    The rows of a joint are divided by the norm of its torque, and friction, rotor inertia and offset are
    projected out. Both are empty where a nominal inertia is missing.
    """
    q, dq, ddq, tau = thin_samples(motions)
    if nominal_torque(model, q, dq, ddq) is None:
        return np.empty((0, 4)), np.empty(0)
    columns = _gravity_columns(model, q, dq, ddq, size)
    # without the parts that friction, rotor and offset explain, only bodies are left to compare
    projected = [
        project_out(np.column_stack([columns[:, :, j].T, tau[:, j]]), nuisance_columns(q, dq, ddq, j))
        for j in range(q.shape[1])
    ]
    # scale each joint by its torque, so that all count the same; joints without any are left out
    scaled_joints = [x / weight for x in projected if (weight := float(np.linalg.norm(x[:, -1]))) > 0]
    rows = np.concatenate([np.empty((0, 5)), *scaled_joints])
    return rows[:, :-1], rows[:, -1]


def _gravity_direction(X: Array, y: Array, assumed: Array) -> Array | None:
    """Return the direction (3) of gravity that fits y (M) by X (M, 4), None unless it differs from the assumed one."""
    # fit gravity only along the directions that the motion shows
    _, singular_values, axes = np.linalg.svd(X[:, 1:], full_matrices=False)
    # of a planar arm not the axis of its joints
    observable = axes[singular_values > MIN_SINGULAR_SHARE * singular_values[0]]
    A = np.column_stack([X[:, 0], X[:, 1:] @ observable.T])
    singular = np.linalg.svd(A, compute_uv=False)
    if singular[-1] <= MIN_SINGULAR_SHARE * singular[0]:
        return None
    share, *components = np.linalg.lstsq(A, y)[0]
    # the alternative: gravity in the assumed direction, with factors that cannot be negative
    along = np.column_stack([X[:, 0], X[:, 1:] @ assumed])
    assumed_fit = np.maximum(np.linalg.lstsq(along, y)[0], 0.0)
    errors = y - A @ [share, *components], y - along @ assumed_fit
    residual, assumed_residual = (float(np.square(error).sum()) for error in errors)
    # what the motion does not show of the direction is completed by the assumed gravity
    gravity = _complete_gravity(components @ observable, observable, assumed)
    length = float(np.linalg.norm(gravity))
    likely = share > 0 and 1 / MAX_SIZE_FACTOR < length < MAX_SIZE_FACTOR
    explains = residual < min((1 - MIN_EXPLAINED_VARIANCE) * float(y @ y), MAX_VARIANCE_RATIO * assumed_residual)
    if likely and explains and float(gravity @ assumed) / length < np.cos(np.deg2rad(MIN_ANGLE)):
        return np.asarray(gravity / length)
    return None


def _complete_gravity(fitted: Array, observable: Array, assumed: Array) -> Array:
    """Return the ``fitted`` gravity (3), observable along r directions, extended to at least the assumed size.

    ``observable`` (r, 3) are these directions.
    """
    hidden = assumed - assumed @ observable.T @ observable
    size = float(np.linalg.norm(hidden))
    hidden_size = np.sqrt(max(float(assumed @ assumed) - float(fitted @ fitted), 0.0))
    return fitted + hidden / size * hidden_size if size > MIN_SINGULAR_SHARE else fitted


def _gravity_columns(model: Model, q: Array, dq: Array, ddq: Array, size: float) -> Array:
    """Return the nominal torques (4, M, n) of inertia, and of gravity along x, y and z of the root link."""
    zeros = np.zeros_like(q)

    def set_gravity(gravity: Array) -> Model:
        return model.with_gravity(lambda _: gravity)

    gravity_torques = [torque_or_zero(set_gravity(size * axis), q, zeros, zeros) for axis in np.eye(3)]
    return np.array([torque_or_zero(set_gravity(np.zeros(3)), q, dq, ddq), *gravity_torques])
