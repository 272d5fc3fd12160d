"""The moving part of a robot file: which joints move, which are fixed, and which links are one body."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from dynident.models.inertia import change_frame
from dynident.models.robot_files.xml import (
    MAX_NUMBER,
    JointCoupling,
    LinkTie,
    RobotFile,
    RobotJoint,
    check_known,
    motion_matrix,
    rotation,
)
from dynident.runtime import ModelError, Noun
from dynident.runtime.arrays import Array

MAX_JOINTS = 500  # that move: the regressor of more needs gigabytes for a block of samples


class ArmBody(Noun):
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

    @property
    def name(self) -> str:
        """The name of its first link."""
        return self.links[0]


class Arm(Noun):
    """The moving ``bodies``, depth first, each after its parent.

    ``driven[i]`` is the index of the body that joint i moves, in the order in which the joints were chosen. The
    bodies' positions are ``drive`` (B, n) @ q + ``offset`` (B): a row of ``drive`` has a one for its joint, or
    the multiplier of a mimic joint. ``fixed_links`` do not move; ``fixed_positions`` (rad or m) are those of the
    joints that are held fixed.
    """

    bodies: tuple[ArmBody, ...]
    driven: tuple[int, ...]
    drive: Array
    offset: Array
    fixed_links: tuple[str, ...]
    fixed_positions: Mapping[str, float]

    @cached_property
    def parameter_bodies(self) -> list[int]:
        """Indices of the bodies with parameters: first of the chosen joints in their order, then of mimic joints."""
        driven = set(self.driven)
        indices = [*self.driven, *(k for k in range(len(self.bodies)) if k not in driven)]
        return [k for k in indices if not self.bodies[k].massless]

    def body_states(self, q: Array, dq: Array, ddq: Array) -> tuple[Array, Array, Array]:
        """Return the states of the bodies (N, B), in rad or m, from those of the joints (N, n)."""
        return q @ self.drive.T + self.offset, dq @ self.drive.T, ddq @ self.drive.T

    @property
    def bodies_with_parameters(self) -> list[ArmBody]:
        """The bodies that have parameters, in the order of the parameters."""
        return [self.bodies[k] for k in self.parameter_bodies]


MimicLaw = tuple[str, float, float]  # position = factor * (position of the joint of that name) + offset


def assemble(file: RobotFile, joint_names: Sequence[str] | None, locked: Mapping[str, float]) -> Arm:
    """Return the arm whose joints ``joint_names`` move; None: all but the locked ones and a floating base.

    The other joints are at ``locked``, else at 0. Mimic joints of moving joints move with them. Raises ModelError
    where a name is unknown, a joint cannot be a moving one, or a constraint closes a loop.
    """
    laws = _mimic_laws(file, locked)
    names = _choose_joints(file, joint_names, locked)
    columns = {name: column for column, name in enumerate(names)}
    moving = {name: law for name, law in laws.items() if law[0] in columns and name not in locked}
    _check_moving(file, moving)
    bodies, fixed_links, fixed_positions = _walk(file, moving, laws, locked)
    places = {body.joint.name: k for k, body in enumerate(bodies)}
    # by default the joints are in the order of their bodies, from base to tip
    if joint_names is None:
        names = sorted(names, key=places.__getitem__)
        columns = {name: column for column, name in enumerate(names)}
    drive, offset = np.zeros((len(bodies), len(names))), np.zeros(len(bodies))
    for name, place in places.items():
        master, factor, offset[place] = moving[name]
        drive[place, columns[master]] = factor
    arm = Arm(bodies, tuple(places[name] for name in names), drive, offset, fixed_links, fixed_positions)
    _check_loops(file, arm)
    return arm


def _mimic_laws(file: RobotFile, locked: Mapping[str, float]) -> dict[str, MimicLaw]:
    """Return the law by which each joint that can move follows in the end: itself, or the last joint that it mimics."""
    joints = {joint.name: joint for joint in file.joints if joint.kind != "fixed" or joint.refusal}
    laws: dict[str, MimicLaw] = {}
    for name in joints:
        # follow a chain of mimic joints to its end, a joint that is locked, or one whose law is known
        chain = {name: (name, 1.0, 0.0)}  # joints, each with what it follows directly
        last = name
        while last not in locked and last not in laws and (follows := joints[last].follows) and follows[0] in joints:
            chain[last], last = follows, follows[0]
            if last in chain:
                circle = " -> ".join([*chain, last])
                raise ModelError(f"{file.source}: the joints {circle} mimic each other in a circle.")
            chain[last] = last, 1.0, 0.0
        # compose the linear laws backwards from the end of the chain
        for follower, (master, factor, offset) in reversed(chain.items()):
            end, outer, shift = laws.get(master, (master, 1.0, 0.0))
            laws.setdefault(follower, (end, factor * outer, factor * shift + offset))
    return laws


def displace_joints(arm: Arm, displacements: Mapping[str, Sequence[float]]) -> Arm:
    """Return the arm with some joints displaced: by name (9) x, y, z (m) of the origin along the axes of the parent
    link's frame, a rotation vector (rad) of the joint's frame with all that it carries, and one of its axis alone, both
    in the joint's own frame.
    """
    bodies = [
        _displace_body(body, np.asarray(displacements[body.joint.name], dtype=float))
        if body.joint.name in displacements
        else body
        for body in arm.bodies
    ]
    return replace(arm, bodies=tuple(bodies))


def _displace_body(body: ArmBody, displacement: Array) -> ArmBody:
    placement = body.placement.copy()
    link = placement[:3, :3] @ body.joint.placement[:3, :3].T  # axes of the parent link's frame in its body's
    placement[:3, 3] += link @ displacement[:3]
    placement[:3, :3] = placement[:3, :3] @ _rotation_of_vector(displacement[3:6])
    return replace(
        body,
        placement=placement,
        joint=replace(body.joint, axis=_rotation_of_vector(displacement[6:]) @ body.joint.axis),
    )


def _rotation_of_vector(vector: Array) -> Array:
    """Return the matrix (3, 3) of a rotation vector in rad."""
    angle = float(np.linalg.norm(vector))
    return rotation(vector / angle, angle) if angle else np.eye(3)


def _choose_joints(file: RobotFile, joint_names: Sequence[str] | None, locked: Mapping[str, float]) -> list[str]:
    """Return the names of the moving joints: known, with one coordinate, not constrained to another."""
    movable = {joint.name: joint for joint in file.joints if joint.kind != "fixed" or joint.refusal}
    floating = set(file.floating)
    independent = [name for name, joint in movable.items() if not joint.follows and name not in floating]
    names = [name for name in independent if name not in locked] if joint_names is None else list(joint_names)
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
        check_known(name, movable, file.source, "joint that can move")
        if counts[name] > 1:
            raise ModelError(f"{file.source}: joint {name!r} is listed twice in `joints` and `lock`; keep one of them.")
    if not names:
        raise ModelError(f"{file.source}: no joint is left to move; the file has {', '.join(movable) or 'none'}.")
    for name, value in locked.items():
        if not abs(value) < MAX_NUMBER or (movable[name].kind == "fixed" and value):
            raise ModelError(f"{file.source}: joint {name!r} cannot be locked at {value}; lock it at 0.")


def _check_moving(file: RobotFile, moving: Mapping[str, MimicLaw]) -> None:
    """Raise ModelError where a joint cannot move by one coordinate, its own or that of its master."""
    if len(moving) > MAX_JOINTS:
        raise ModelError(
            f"{file.source}: {len(moving)} joints would move, and {MAX_JOINTS} are the most; name those of the arm in "
            "`joints`, and the others stand still."
        )
    for joint in file.joints:
        if joint.name in moving:
            _check_movable(file, joint)


def _check_movable(file: RobotFile, joint: RobotJoint) -> None:
    name, reason = joint.name, joint.refusal
    # a coupling takes the freedom of all joints in it
    for constraint in file.constraints:
        if isinstance(constraint, JointCoupling) and name in constraint.joints:
            reason = f"{constraint.description} binds it to {', '.join(map(repr, constraint.joints))}"
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
        self.links[link] = np.full(10, np.nan) if inertia is None else change_frame(inertia, frame)
        self.frames.append(frame)

    def finish(self, massless: Set[str]) -> ArmBody:
        theta = sum(self.links.values(), np.zeros(10))
        # massless links only connect the joints of one body, and are not links of the file
        real_links = [pair for pair in zip(self.links, self.frames, strict=True) if pair[0] not in massless]
        names, frames = zip(*(real_links or zip(self.links, self.frames, strict=True)), strict=True)
        return ArmBody(self.joint, self.parent, self.placement, theta, names, frames, not real_links)


def _walk(
    file: RobotFile, moving: Mapping[str, MimicLaw], laws: Mapping[str, MimicLaw], locked: Mapping[str, float]
) -> tuple[tuple[ArmBody, ...], tuple[str, ...], dict[str, float]]:
    """Group the links into bodies, from the root to the tips, in the order of the file.

    Return the bodies, the links that stand still, and the positions of the joints that are held fixed.
    """
    bodies: list[_Body] = []
    fixed_links: list[str] = []
    fixed_positions: dict[str, float] = {}
    # depth first: children are stacked in reverse, so that they come in the order of the file
    todo: list[tuple[str, RobotJoint | None, int | None, Array]] = [(file.root, None, None, np.eye(4))]
    while todo:
        link, joint, host, frame = todo.pop()
        # a moving joint begins a body with its own frame; any other one adds its constant motion to the frame
        if joint is not None and joint.name in moving:
            bodies.append(_Body(joint, host, frame))
            host, frame = len(bodies) - 1, np.eye(4)
        elif joint is not None and joint.kind != "fixed":
            master, factor, offset = laws[joint.name]
            fixed_positions[joint.name] = factor * locked.get(master, 0.0) + offset
            frame = frame @ motion_matrix(joint, fixed_positions[joint.name])
        if host is None:
            fixed_links.append(link)
        else:
            bodies[host].add(link, file.links[link], frame)
        todo += [(x.child, x, host, frame @ x.placement) for x in reversed(file.joints_below.get(link, ()))]
    massless = set(file.massless)
    return tuple(body.finish(massless) for body in bodies), tuple(fixed_links), fixed_positions


def _check_loops(file: RobotFile, arm: Arm) -> None:
    """Raise ModelError for a closed loop; a constraint between links of one body is none."""
    host = {link: body.name for body in arm.bodies for link in body.links} | dict.fromkeys(arm.fixed_links, file.root)
    for tie in file.constraints:
        if isinstance(tie, LinkTie):
            first_body, second_body = (host.get(link or "") for link in tie.links)
            if first_body is None or first_body != second_body:
                raise ModelError(
                    f"{file.source}: {tie.description} closes a loop through moving bodies; only trees can be "
                    "identified. "
                    "Delete it, or leave the joints it acts on out of `joints`."
                )
