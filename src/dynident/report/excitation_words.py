"""What a design assumed, in sentences: surroundings, the noise of the torques, limits by rule; and its notes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from dynident.checks import Topic, check_robot
from dynident.errors import install_command, listed
from dynident.excitation import CapsuleSpace, Floor, Interrupted, LeftOut, Made
from dynident.excitation.spaces.obstacles import obstacle_name
from dynident.io.excitation_known import NoiseOrigin
from dynident.models import RigidBodies
from dynident.report.page import number
from dynident.report.wording import words

if TYPE_CHECKING:
    from dynident.excitation import Design
    from dynident.io.excitation import ExcitationProject

__all__ = ["body_words", "floor_words", "limit_words", "noise_words", "shape_words"]

SHOWN, FEW = 8, 3  # joints, and files, in a sentence
DOUBTED = (Topic.IMPOSSIBLE, Topic.MASSLESS, Topic.FAR)
PACKAGED = "package://"
RATE, MOST = 50.0, 5000  # Hz and samples of the lowest point
_ORIGINS = {
    NoiseOrigin.GIVEN: "as far as given; of other joints as known, or 1 % of the torque limit",
    NoiseOrigin.RESULT: "the residual of the result, each sample counted as often as it is independent",
    NoiseOrigin.LOGS: "the residual of a fit to the logs, each sample counted as often as it is independent",
    NoiseOrigin.RULE: "by rule: 1 % of the torque limit, or 1 N m. Give `noise`, or a result, for errors to rely on",
}


def floor_words(project: ExcitationProject, found: Design) -> Iterator[str]:
    """Yield how low the arm reaches, where no floor is given."""
    space = found.space
    if not isinstance(space, CapsuleSpace) or any(isinstance(one, Floor) for one in project.obstacles):
        return
    t = found.trajectory.times(min(RATE, MOST / found.trajectory.duration))
    placed = space.bodies.placements(found.trajectory.states(t)[0])
    moving = [one for one in space.capsules if one.body >= 0]
    if not moving:
        return
    body, radii = [one.body for one in moving], np.array([one.radius for one in moving])
    ends = (placed.points(body, np.array([getattr(one, end) for one in moving])) for end in ("start", "end"))
    low = float(min((points[..., 2] - radii).min() for points in ends))
    where = f"{-low:.2f} m below" if low < 0 else f"{low:.2f} m above"
    yield (
        f"No floor is given: the arm reaches down to {where} the origin of its root link. Where it stands on "
        "something, give `floor: 0` (its height in m), and `boxes` and `cylinders` for what else is near."
    )


def body_words(project: ExcitationProject) -> Iterator[str]:
    """Yield where the torque is that of a robot file whose masses and inertias cannot be right."""
    if project.known.found is not None:
        return
    for bodies in (one for one in project.known.model.terms if isinstance(one, RigidBodies)):
        found = check_robot(bodies.file, [joint.name for joint in bodies.joints])
        if links := dict.fromkeys(one.link for one in found if one.topic in DOUBTED and one.link):
            yield (
                f"Torques are by the robot file, where mass or inertia of {listed(links, SHOWN)} cannot be right: see "
                "`dynident check` of it. Do not rely on the torque limits until it is corrected."
            )


def shape_words(project: ExcitationProject) -> Iterator[str]:
    """Yield which shapes of links are not known, and where no real shapes were looked at."""
    geometry = project.geometry
    if geometry is None:
        yield "The model is not made of a robot file: nothing keeps the arm clear of itself."
        return
    if unknown := [geometry.link(body) for body, made in geometry.made.items() if made is Made.JOINTS]:
        lost = (f"{file}: {reason.rstrip('.')}" for file, reason in geometry.missing.items())
        files = f" ({listed(lost, FEW)})" if geometry.missing else ""
        packaged = any(file.startswith(PACKAGED) for file in geometry.missing)
        hint = ", or name the folder of their package (`packages`, `--package`)" if packaged else ""
        yield (
            f"The shapes of {listed(unknown, SHOWN)} are not known{files}: distances are from the lines between their "
            f"joints, with a thickness by rule. Look whether they are as thick{hint}."
        )
    standing = {obstacle_name(one) for one in project.obstacles}
    left = project.space.left_out if isinstance(project.space, CapsuleSpace) else ()
    for one, other in left:
        if other in standing:
            yield f"{one} is at {other} in every pose, as what is mounted there: this pair is not watched."
    if links := [f"{one} and {other}" for one, other in left if other not in standing]:
        yield f"Not watched, because they are close to each other in nearly every pose: {listed(links, SHOWN)}."
    if project.space.pairs and project.shapes is None:
        yield (
            "Distances are those of capsules around the links; the last check also looks at their real shapes where "
            f"Pinocchio is installed: {install_command('pin')}."
        )


def noise_words(project: ExcitationProject) -> Iterator[str]:
    """Yield which noise of the torques was assumed, and why recordings do not count that could."""
    sigma = project.request.sigma
    sizes = (f"{name} {number(float(x), 2)}" for name, x in zip(project.limits.joints, sigma, strict=True))
    rate, origin = project.request.rate, _ORIGINS[project.origin]
    yield f"Noise of the torques at {rate:g} Hz (N m or N): {listed(sizes, SHOWN)}; {origin}."
    if project.known.lost:
        yield f"What was recorded before does not count: {project.known.lost}."


def limit_words(found: Design) -> Iterator[str]:
    """Yield which limits neither the robot file nor the user gives, and which exceed those of the file."""
    by_quantity: dict[str, list[str]] = {}
    for joint, names in found.limits.by_rule.items():
        for name in names:
            by_quantity.setdefault(name, []).append(joint)
    for name, joints in by_quantity.items():
        every = len(joints) == len(found.limits.joints)
        whose = "all joints" if every else listed(joints, SHOWN)
        if name == "torque":
            yield f"The torque of {whose} has no limit: it was not looked at."
            continue
        k = found.limits.joints.index(joints[0])
        size = "" if name == "position" else f" (at {joints[0]} {number(float(getattr(found.limits, name)[k]), 3)})"
        yield f"Limits of {name} of {whose} are by rule{size}: give your robot's own, if they are known."
    for joint, names in found.limits.beyond.items():
        yield f"The limits that are given for {joint} exceed those of the robot file: {', '.join(names)}."


@words.register
def _(note: Interrupted) -> str:  # noqa: ARG001
    return "The search was stopped before its end: the motion is the best until then, and keeps to all limits."


@words.register
def _(note: LeftOut) -> str:
    return (
        f"Terms that remember the motion ({', '.join(note.terms)}) are left out of the design: what it tells of them "
        "is not known."
    )
