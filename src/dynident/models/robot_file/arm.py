"""The moving part of a robot file: which joints move, which are fixed, and which links are one body."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ModelError, brief
from dynident.models.inertia import moved
from dynident.models.robot_file.xml import HUGE, Coupled, RobotFile, RobotJoint, Tied, known, motion

__all__ = ["Arm", "ArmBody", "assemble", "displaced"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ArmBody:
    """A moving body: its ``joint``, the index of its parent body (None: the base), the placement (4, 4) of its
    joint's frame in that body's, its nominal inertia (10) about that frame, nan where not known, its ``links``, and
    the ``frames`` (4, 4) of these in the body's, the first of which is the identity.
    """

    joint: RobotJoint
    parent: int | None
    placement: Array
    theta: Array
    links: tuple[str, ...]
    frames: tuple[Array, ...]

    __repr__ = brief


@dataclass(frozen=True, eq=False)
class Arm:
    """The moving ``bodies``, depth first, each after its parent; ``order[k]`` is the place of body k among the joints
    as they were chosen. ``still`` are the links that do not move; ``standing`` (rad or m) are the positions of the
    joints that are held fixed.
    """

    bodies: tuple[ArmBody, ...]
    order: NDArray[np.intp]
    still: tuple[str, ...]
    standing: Mapping[str, float]

    __repr__ = brief

    @property
    def chosen(self) -> list[ArmBody]:
        """The bodies in the order in which their joints were chosen."""
        return [self.bodies[k] for k in np.argsort(self.order)]


def assemble(file: RobotFile, used: Sequence[str] | None, locked: Mapping[str, float]) -> Arm:
    """Return the arm whose joints ``used`` move (None: all but the locked); the others are at ``locked``, else at 0.

    Raises ModelError where a name is unknown, a joint cannot be a moving one, or a constraint closes a loop.
    """
    names = _used(file, used, locked)
    arm = _walk(file, set(names), locked)
    if used is not None:
        order = np.array([names.index(body.joint.name) for body in arm.bodies])
        arm = replace(arm, order=order)
    _check_ties(file, arm)
    return arm


def displaced(arm: Arm, displacements: Mapping[str, Sequence[float]]) -> Arm:
    """Return the arm with some joints displaced: by name (9) x, y, z (m) of the origin along the axes of the parent
    link's frame, a rotation vector (rad) of the joint's frame with all that it carries, and one of its axis alone, both
    in the joint's own frame.
    """
    bodies = [
        _displaced(body, np.asarray(displacements[body.joint.name], dtype=float))
        if body.joint.name in displacements
        else body
        for body in arm.bodies
    ]
    return replace(arm, bodies=tuple(bodies))


def _displaced(body: ArmBody, by: Array) -> ArmBody:
    from scipy.spatial.transform import Rotation

    placement = body.placement.copy()
    link = placement[:3, :3] @ body.joint.placement[:3, :3].T  # axes of the parent link's frame in its body's
    placement[:3, 3] += link @ by[:3]
    placement[:3, :3] = placement[:3, :3] @ Rotation.from_rotvec(by[3:6]).as_matrix()
    axis = Rotation.from_rotvec(by[6:]).apply(body.joint.axis)
    return replace(body, placement=placement, joint=replace(body.joint, axis=axis))


def _used(file: RobotFile, used: Sequence[str] | None, locked: Mapping[str, float]) -> list[str]:
    """Return the names of the moving joints: known, with one coordinate, not constrained to another."""
    movable = {joint.name: joint for joint in file.joints if joint.kind != "fixed" or joint.refusal}
    names = [name for name in movable if name not in locked] if used is None else list(used)
    _check_named(file, movable, names, locked)
    for name in names:
        _check_movable(file, movable[name])
    _check_mimics(file, names, locked)
    return names


def _check_named(
    file: RobotFile, movable: Mapping[str, RobotJoint], names: Sequence[str], locked: Mapping[str, float]
) -> None:
    """Check that the names used and locked are joints that can move, each named once."""
    for name in (*names, *locked):
        known(name, movable, file.source, "joint that can move")
        if [*names, *locked].count(name) > 1:
            raise ModelError(f"{file.source}: joint {name!r} is listed twice among the joints used and locked.")
    if not names:
        raise ModelError(f"{file.source}: no joint is left to move; the file has {', '.join(movable) or 'none'}.")
    for name, value in locked.items():
        if not abs(value) < HUGE or (movable[name].kind == "fixed" and value):
            raise ModelError(f"{file.source}: joint {name!r} cannot be locked at {value}; lock it at 0.")


def _check_mimics(file: RobotFile, names: Sequence[str], locked: Mapping[str, float]) -> None:
    for joint in file.joints:
        if joint.follows and joint.name not in locked and joint.follows[0] in names:
            raise ModelError(
                f"{file.source}: joint {joint.name!r} mimics {joint.follows[0]!r}, which moves; lock that one, or "
                f"state a value for {joint.name!r} in 'locked' if it does stand still."
            )


def _check_movable(file: RobotFile, joint: RobotJoint) -> None:
    reason = f"it mimics {joint.follows[0]!r}" if joint.follows else joint.refusal
    for constraint in file.constraints:
        if isinstance(constraint, Coupled) and joint.name in constraint.joints:
            reason = f"{constraint.what} binds it to {', '.join(map(repr, constraint.joints))}"
    if reason:
        raise ModelError(
            f"{file.source}: joint {joint.name!r} cannot be one of the moving joints: {reason}. Name the joints of the "
            "arm in 'joints_used'; the others stand still."
        )


@dataclass(eq=False)
class _Body:
    """A body whose links are being gathered, with the frame of each in that of the body."""

    joint: RobotJoint
    parent: int | None
    placement: Array
    links: dict[str, Array] = field(default_factory=dict)
    frames: list[Array] = field(default_factory=list)

    def add(self, link: str, inertia: Array | None, frame: Array) -> None:
        self.links[link] = np.full(10, np.nan) if inertia is None else moved(inertia, frame)
        self.frames.append(frame)

    def finished(self) -> ArmBody:
        theta = sum(self.links.values(), np.zeros(10))
        return ArmBody(self.joint, self.parent, self.placement, theta, tuple(self.links), tuple(self.frames))


def _walk(file: RobotFile, moving: set[str], locked: Mapping[str, float]) -> Arm:
    """Group the links into bodies, from the root to the tips, in the order of the file."""
    below: dict[str, list[RobotJoint]] = {}
    for branch in file.joints:
        below.setdefault(branch.parent, []).append(branch)
    bodies: list[_Body] = []
    still: list[str] = []
    standing: dict[str, float] = {}
    todo: list[tuple[str, RobotJoint | None, int | None, Array]] = [(file.root, None, None, np.eye(4))]
    while todo:
        link, joint, host, frame = todo.pop()
        if joint is not None and joint.name in moving:
            bodies.append(_Body(joint, host, frame))
            host, frame = len(bodies) - 1, np.eye(4)
        elif joint is not None:
            position = _position(file, joint, locked)
            frame = frame @ motion(joint, position)
            standing |= {joint.name: position} if joint.kind != "fixed" else {}
        if host is None:
            still.append(link)
        else:
            bodies[host].add(link, file.links[link], frame)
        todo += [(x.child, x, host, frame @ x.placement) for x in reversed(below.get(link, []))]
    return Arm(tuple(body.finished() for body in bodies), np.arange(len(bodies)), tuple(still), standing)


def _position(file: RobotFile, joint: RobotJoint, locked: Mapping[str, float]) -> float:
    """Return the position of a fixed joint: as given in ``locked``, else that of the joint it mimics, else zero."""
    named = {x.name: x for x in file.joints}
    factor, offset, seen = 1.0, 0.0, [joint.name]
    while seen[-1] not in locked and (follows := named[seen[-1]].follows):
        master, multiplier, shift = follows
        factor, offset = factor * multiplier, offset + factor * shift
        if master in seen:
            raise ModelError(f"{file.source}: the joints {' -> '.join([*seen, master])} mimic each other in a circle.")
        seen.append(master)
    return factor * locked.get(seen[-1], 0.0) + offset


def _check_ties(file: RobotFile, arm: Arm) -> None:
    """Raise ModelError for a closed loop; a constraint between links of one body is none."""
    host = {link: body.joint.child for body in arm.bodies for link in body.links} | dict.fromkeys(arm.still, file.root)
    for tie in file.constraints:
        if isinstance(tie, Tied):
            one, other = (host.get(link or "") for link in tie.links)
            if one is None or one != other:
                raise ModelError(
                    f"{file.source}: {tie.what} closes a loop through moving bodies; only trees can be identified. "
                    "Delete it, or leave the joints it acts on out of 'joints_used'."
                )
