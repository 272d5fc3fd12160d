"""Checks of a robot file: impossible inertias and limits, wrong units, placeholders."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.checks import file_notes
from dynident.checks.finding import Finding, Topic
from dynident.errors import Note, Severity
from dynident.models import consistency_violations, from_physical, to_physical
from dynident.models.robot_file import Limits, RobotFile, RobotJoint

__all__ = ["JointFacts", "LinkFacts", "check_robot", "joint_facts", "link_facts"]

Array = NDArray[np.float64]

FAR = 1.0  # m: a centre of mass so far from its link's frame is rather in millimetres
SPREAD = 0.6  # radius of gyration over the size of the link; a rod has 0.29, two masses at its ends 0.5
SMALLEST = 0.15  # m: size of a link without a known length, motors and all
OFFSET = 0.6  # share of m c^2 in the largest moment from which on the tensor may be about the frame's origin
LIGHTEST, HEAVIEST = 0.05, 5000.0  # kg: masses of whole arms


@dataclass(frozen=True, eq=False)
class LinkFacts:
    """A link with a mass: kg; its centre (3) in m in the link's frame; principal moments (3) about it in kg m^2."""

    link: str
    mass: float
    centre: Array
    moments: Array


@dataclass(frozen=True)
class JointFacts:
    """A joint of a robot file: its kind, its ``limits``, what it ``follows`` (joint, multiplier, offset) as a mimic
    joint, why it is ``held`` fixed (empty: it moves), and the ``mass`` (kg) of the body that it carries: of its link
    and those fixed to it, nan where the file leaves that to shapes.
    """

    joint: str
    kind: str
    limits: Limits
    follows: tuple[str, float, float] | None
    held: str
    mass: float


def joint_facts(file: RobotFile) -> tuple[JointFacts, ...]:
    """Return the joints that can move, or could if they had one coordinate, in the order of the file."""
    found = []
    for one in file.joints:
        if one.kind == "fixed" and not one.refusal:
            continue
        thetas = [file.links[name] for name in _rigid(file, one.child)]
        mass = float(sum(np.nan if theta is None else theta[0] for theta in thetas))
        found.append(JointFacts(one.name, one.kind, one.limits, one.follows, one.refusal, mass))
    return tuple(found)


def link_facts(file: RobotFile) -> tuple[LinkFacts, ...]:
    """Return mass, centre and moments of all links that have a mass, in the order of the file."""
    found = []
    for name, theta in file.links.items():
        if theta is not None and theta[0] != 0:
            mass, centre, tensor = to_physical(theta)
            found.append(LinkFacts(name, float(mass), centre, np.asarray(np.linalg.eigvalsh(tensor), float)))
    return tuple(found)


def check_robot(
    file: RobotFile, joints: Sequence[str] | None = None, inconsistent: Severity = Severity.ERROR
) -> tuple[Finding, ...]:
    """Return the findings on a robot file: on its links, on the ``joints`` that move (None: all), and on the whole.

    ``inconsistent`` is the severity of inertias that no body can have: an error where the file is to be simulated, a
    warning where its values are only nominal.
    """
    facts = link_facts(file)
    moving = [joint for joint in file.joints if joint.kind != "fixed" and (joints is None or joint.name in joints)]
    found = [
        *_impossible(file, inconsistent),
        *_massless(file, moving),
        *_far(facts),
        *_spread(file, [fact for fact in facts if fact.link not in _rigid(file, file.root)]),
        *_about_origin(file, facts),
        *_copies(file, facts),
        *_total(facts),
        *_limits(file, moving),
        *_base(file, moving),
        *(Finding(Severity.INFO, None, f"{note}.", Topic.UNREAD) for note in file.notes),
    ]
    return tuple(Finding(x.severity, x.joint, x.message, x.topic, file.source, x.link) for x in found)


def _impossible(file: RobotFile, severity: Severity) -> Iterator[Finding]:
    for name, theta in file.links.items():
        for violation in () if theta is None else consistency_violations(theta):
            yield Finding(severity, None, file_notes.ImpossibleInertia(violation), Topic.IMPOSSIBLE, link=name)


def _massless(file: RobotFile, moving: Sequence[RobotJoint]) -> Iterator[Finding]:
    """Yield the moving bodies without mass, links whose inertia comes from shapes, and point masses."""
    for joint in moving:
        carried = _rigid(file, joint.child)
        given = [file.links[name] for name in carried]
        if all(theta is not None and not theta.any() for theta in given):
            note = file_notes.NoMass(tuple(carried))
            yield Finding(Severity.WARNING, joint.name, note, Topic.MASSLESS, link=joint.child)
    for name, theta in file.links.items():
        if theta is None:
            yield Finding(Severity.INFO, None, file_notes.OnlyShapes(), Topic.SHAPES, link=name)
        elif theta[0] > 0 and not np.abs(to_physical(theta)[2]).max() > 0:
            yield Finding(Severity.INFO, None, file_notes.PointMass(float(theta[0])), Topic.POINT, link=name)


def _base(file: RobotFile, moving: Sequence[RobotJoint]) -> Iterator[Finding]:
    """Yield the joints that let the base float, and a base that is perhaps the trunk of a walking robot."""
    for name in file.floating:
        yield Finding(Severity.WARNING, name, file_notes.FloatingBase(), Topic.FLOATING)
    limbs = file.limbs({joint.name for joint in moving})
    if limbs is not None:
        yield Finding(Severity.INFO, None, file_notes.SeveralLimbs(*limbs), Topic.LIMBS)


def _rigid(file: RobotFile, link: str) -> list[str]:
    """Return the link and those fixed to it further out."""
    found = [link]
    for name in found:
        found += [joint.child for joint in file.joints if joint.parent == name and joint.kind == "fixed"]
    return found


def _far(facts: Sequence[LinkFacts]) -> Iterator[Finding]:
    for fact in facts:
        distance = float(np.linalg.norm(fact.centre))
        if distance > FAR:
            yield Finding(Severity.WARNING, None, file_notes.FarCentre(distance), Topic.FAR, link=fact.link)


def _spread(file: RobotFile, facts: Sequence[LinkFacts]) -> Iterator[Finding]:
    """Yield the links whose radius of gyration is too large for their length."""
    for fact in facts:
        gyration = float(np.sqrt(max(fact.moments[-1], 0.0) / abs(fact.mass)))
        size = _size(file, fact)
        if gyration > SPREAD * size:
            note = file_notes.LargeGyration(float(fact.moments[-1]), gyration, fact.mass, size)
            yield Finding(Severity.WARNING, None, note, Topic.SPREAD, link=fact.link)


def _size(file: RobotFile, fact: LinkFacts) -> float:
    """Return the approximate length of a link: to its joints, or twice the distance to its centre of mass."""
    lengths = [float(np.linalg.norm(x.placement[:3, 3])) for x in file.joints if fact.link in (x.parent, x.child)]
    return max([SMALLEST, 2 * float(np.linalg.norm(fact.centre)), *lengths])


def _about_origin(file: RobotFile, facts: Sequence[LinkFacts]) -> Iterator[Finding]:
    """Yield a question where most tensors would be physically consistent also if taken about the frame's origin."""
    judged, fits = [], []
    for fact in facts:
        lever = fact.mass * float(fact.centre @ fact.centre)
        theta = file.links[fact.link]
        if theta is None or fact.mass <= 0 or lever < OFFSET * fact.moments[-1] or not fact.moments[-1] > 0:
            continue
        judged.append(fact.link)
        shifted = to_physical(theta)[2] - _point(fact)
        if not consistency_violations(from_physical(fact.mass, fact.centre, shifted)):
            fits.append(fact.link)
    if len(fits) >= 2 and 2 * len(fits) > len(judged):
        yield Finding(Severity.WARNING, None, file_notes.InertiaAboutOrigin(tuple(fits)), Topic.ABOUT_ORIGIN)


def _point(fact: LinkFacts) -> Array:
    """Return the tensor (3, 3) about the frame's origin of a point mass at the link's centre of mass."""
    c = fact.centre
    return np.asarray(fact.mass * (float(c @ c) * np.eye(3) - np.outer(c, c)))


def _copies(file: RobotFile, facts: Sequence[LinkFacts]) -> Iterator[Finding]:
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
        yield Finding(severity, None, file_notes.EqualLinks(names, group[0].mass, alone), Topic.COPIED)


def _total(facts: Sequence[LinkFacts]) -> Iterator[Finding]:
    total = sum(fact.mass for fact in facts)
    if facts and not LIGHTEST <= total <= HEAVIEST:
        yield Finding(Severity.WARNING, None, file_notes.OddTotalMass(total), Topic.TOTAL_MASS)


def _limits(file: RobotFile, moving: Sequence[RobotJoint]) -> Iterator[Finding]:
    for joint in moving:
        for note in _impossible_limits(joint.limits):
            yield Finding(Severity.WARNING, joint.name, note, Topic.LIMITS)
    for name in ("effort", "velocity") if file.format != "mjcf" else ("effort",):  # MJCF has no velocity limit
        bare = [joint.name for joint in moving if getattr(joint.limits, name) is None]
        if bare:
            yield Finding(Severity.INFO, None, file_notes.NoLimit(name, tuple(bare)), Topic.LIMITS)


def _impossible_limits(limits: Limits) -> Iterator[Note]:
    if limits.lower is not None and limits.upper is not None and limits.lower >= limits.upper:
        yield file_notes.EmptyRange(limits.lower, limits.upper)
    for name, value in (("effort", limits.effort), ("velocity", limits.velocity)):
        if value is not None and value <= 0:
            yield file_notes.LimitNotPositive(name, value)
