"""The moving part of a robot file: which joints move, which are fixed, and which links are one body."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ModelError, brief
from dynident.models.inertia import moved
from dynident.models.robot_file.xml import HUGE, Coupled, RobotFile, RobotJoint, Tied, known, motion, rotation

__all__ = ["Arm", "ArmBody", "assemble", "displaced"]

Array = NDArray[np.float64]
MOST_JOINTS = 500  # that move: the regressor of more needs gigabytes for a block of samples


@dataclass(frozen=True, eq=False)
class ArmBody:
    """A moving body: its ``joint``, the index of its parent body (None: the base), the placement (4, 4) of its
    joint's frame in that body's, its nominal inertia (10) about that frame, nan where not known, its ``links``, and
    the ``frames`` (4, 4) of these in the body's. The first is the identity, except where a joint of a body with
    several is held fixed. ``massless``: it only connects the joints of one body, and has no parameters.
    """

    joint: RobotJoint
    parent: int | None
    placement: Array
    theta: Array
    links: tuple[str, ...]
    frames: tuple[Array, ...]
    massless: bool = False

    __repr__ = brief

    @property
    def name(self) -> str:
        """The name of its first link."""
        return self.links[0]


@dataclass(frozen=True, eq=False)
class Arm:
    """The moving ``bodies``, depth first, each after its parent; ``driven[i]`` is the index of the body that joint i,
    as they were chosen, moves. The bodies' positions are ``drive`` (B, n) @ q + ``rest`` (B): a row of ``drive`` has a
    one for its joint, or the multiplier of a mimic joint. ``still`` are the links that do not move; ``standing`` (rad
    or m) are the positions of the joints that are held fixed.
    """

    bodies: tuple[ArmBody, ...]
    driven: tuple[int, ...]
    drive: Array
    rest: Array
    still: tuple[str, ...]
    standing: Mapping[str, float]

    __repr__ = brief

    @cached_property
    def listed(self) -> list[int]:
        """The indices of the bodies that have parameters, in the order of these: joints as chosen, mimic joints."""
        own = set(self.driven)
        every = [*self.driven, *(k for k in range(len(self.bodies)) if k not in own)]
        return [k for k in every if not self.bodies[k].massless]

    def moved(self, q: Array, dq: Array, ddq: Array) -> tuple[Array, Array, Array]:
        """Return the states of the bodies (N, B), in rad or m, from those of the joints (N, n)."""
        return q @ self.drive.T + self.rest, dq @ self.drive.T, ddq @ self.drive.T

    @property
    def chosen(self) -> list[ArmBody]:
        """The bodies that have parameters, in the order of these."""
        return [self.bodies[k] for k in self.listed]


Motion = tuple[str, float, float]  # position = factor * (position of the joint of that name) + offset


def assemble(file: RobotFile, used: Sequence[str] | None, locked: Mapping[str, float]) -> Arm:
    """Return the arm whose joints ``used`` move (None: all but the locked and a floating base); the others are at
    ``locked``, else at 0. Mimic joints of moving joints move with them.

    Raises ModelError where a name is unknown, a joint cannot be a moving one, or a constraint closes a loop.
    """
    motions = _motions(file, locked)
    names = _used(file, used, locked)
    columns = {name: column for column, name in enumerate(names)}
    moving = {name: found for name, found in motions.items() if found[0] in columns and name not in locked}
    _check_moving(file, moving)
    bodies, still, standing = _walk(file, moving, motions, locked)
    places = {body.joint.name: k for k, body in enumerate(bodies)}
    if used is None:
        names = sorted(names, key=places.__getitem__)
        columns = {name: column for column, name in enumerate(names)}
    drive, rest = np.zeros((len(bodies), len(names))), np.zeros(len(bodies))
    for name, place in places.items():
        master, factor, rest[place] = moving[name]
        drive[place, columns[master]] = factor
    arm = Arm(bodies, tuple(places[name] for name in names), drive, rest, still, standing)
    _check_ties(file, arm)
    return arm


def _motions(file: RobotFile, locked: Mapping[str, float]) -> dict[str, Motion]:
    """Return what each joint that can move follows in the end: itself, or the last joint that it mimics."""
    named = {joint.name: joint for joint in file.joints if joint.kind != "fixed" or joint.refusal}
    found: dict[str, Motion] = {}
    for name in named:
        chain = {name: (name, 1.0, 0.0)}  # joints, each with what it follows directly
        last = name
        while last not in locked and last not in found and (follows := named[last].follows) and follows[0] in named:
            chain[last], last = follows, follows[0]
            if last in chain:
                circle = " -> ".join([*chain, last])
                raise ModelError(f"{file.source}: the joints {circle} mimic each other in a circle.")
            chain[last] = last, 1.0, 0.0
        for one, (master, factor, offset) in reversed(chain.items()):
            end, outer, shift = found.get(master, (master, 1.0, 0.0))
            found.setdefault(one, (end, factor * outer, factor * shift + offset))
    return found


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
    placement = body.placement.copy()
    link = placement[:3, :3] @ body.joint.placement[:3, :3].T  # axes of the parent link's frame in its body's
    placement[:3, 3] += link @ by[:3]
    placement[:3, :3] = placement[:3, :3] @ _turned(by[3:6])
    return replace(body, placement=placement, joint=replace(body.joint, axis=_turned(by[6:]) @ body.joint.axis))


def _turned(by: Array) -> Array:
    """Return the matrix (3, 3) of a rotation vector in rad."""
    angle = float(np.linalg.norm(by))
    return rotation(by / angle, angle) if angle else np.eye(3)


def _used(file: RobotFile, used: Sequence[str] | None, locked: Mapping[str, float]) -> list[str]:
    """Return the names of the moving joints: known, with one coordinate, not constrained to another."""
    movable = {joint.name: joint for joint in file.joints if joint.kind != "fixed" or joint.refusal}
    floating = set(file.floating)
    own = [name for name, joint in movable.items() if not joint.follows and name not in floating]
    names = [name for name in own if name not in locked] if used is None else list(used)
    _check_named(file, movable, names, locked)
    for name in names:
        if follows := movable[name].follows:
            raise ModelError(
                f"{file.source}: joint {name!r} mimics {follows[0]!r} and moves with it; leave it out of `joints`."
            )
    return names


def _check_named(
    file: RobotFile, movable: Mapping[str, RobotJoint], names: Sequence[str], locked: Mapping[str, float]
) -> None:
    """Check that the names used and locked are joints that can move, each named once."""
    counts = Counter([*names, *locked])
    for name in (*names, *locked):
        known(name, movable, file.source, "joint that can move")
        if counts[name] > 1:
            raise ModelError(f"{file.source}: joint {name!r} is listed twice in `joints` and `lock`; keep one of them.")
    if not names:
        raise ModelError(f"{file.source}: no joint is left to move; the file has {', '.join(movable) or 'none'}.")
    for name, value in locked.items():
        if not abs(value) < HUGE or (movable[name].kind == "fixed" and value):
            raise ModelError(f"{file.source}: joint {name!r} cannot be locked at {value}; lock it at 0.")


def _check_moving(file: RobotFile, moving: Mapping[str, Motion]) -> None:
    """Raise ModelError where a joint cannot move by one coordinate, its own or that of its master."""
    if len(moving) > MOST_JOINTS:
        raise ModelError(
            f"{file.source}: {len(moving)} joints would move, and {MOST_JOINTS} are the most; name those of the arm in "
            "`joints`, and the others stand still."
        )
    for joint in file.joints:
        if joint.name in moving:
            _check_movable(file, joint)


def _check_movable(file: RobotFile, joint: RobotJoint) -> None:
    name, reason = joint.name, joint.refusal
    for constraint in file.constraints:
        if isinstance(constraint, Coupled) and name in constraint.joints:
            reason = f"{constraint.what} binds it to {', '.join(map(repr, constraint.joints))}"
    if reason:
        raise ModelError(
            f"{file.source}: joint {name!r} cannot be one of the moving joints: {reason}. Name the joints of the arm "
            "in `joints`, or this one in `lock`: the others stand still."
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

    def finished(self, massless: Set[str]) -> ArmBody:
        theta = sum(self.links.values(), np.zeros(10))
        own = [pair for pair in zip(self.links, self.frames, strict=True) if pair[0] not in massless]
        names, frames = zip(*(own or zip(self.links, self.frames, strict=True)), strict=True)
        return ArmBody(self.joint, self.parent, self.placement, theta, names, frames, not own)


def _walk(
    file: RobotFile, moving: Mapping[str, Motion], motions: Mapping[str, Motion], locked: Mapping[str, float]
) -> tuple[tuple[ArmBody, ...], tuple[str, ...], dict[str, float]]:
    """Group the links into bodies, from the root to the tips, in the order of the file; return these, the links that
    stand still, and the positions of the joints that do.
    """
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
        elif joint is not None and joint.kind != "fixed":
            master, factor, offset = motions[joint.name]
            standing[joint.name] = factor * locked.get(master, 0.0) + offset
            frame = frame @ motion(joint, standing[joint.name])
        if host is None:
            still.append(link)
        else:
            bodies[host].add(link, file.links[link], frame)
        todo += [(x.child, x, host, frame @ x.placement) for x in reversed(below.get(link, []))]
    massless = set(file.massless)
    return tuple(body.finished(massless) for body in bodies), tuple(still), standing


def _check_ties(file: RobotFile, arm: Arm) -> None:
    """Raise ModelError for a closed loop; a constraint between links of one body is none."""
    host = {link: body.name for body in arm.bodies for link in body.links} | dict.fromkeys(arm.still, file.root)
    for tie in file.constraints:
        if isinstance(tie, Tied):
            one, other = (host.get(link or "") for link in tie.links)
            if one is None or one != other:
                raise ModelError(
                    f"{file.source}: {tie.what} closes a loop through moving bodies; only trees can be identified. "
                    "Delete it, or leave the joints it acts on out of `joints`."
                )
