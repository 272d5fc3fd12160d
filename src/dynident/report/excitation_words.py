"""What a design assumed, in sentences: the noise of the torques, and limits that a rule has made."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from dynident.errors import listed
from dynident.io.excitation_known import NoiseOrigin
from dynident.report.page import number

if TYPE_CHECKING:
    from dynident.excitation import Design
    from dynident.io.excitation import ExcitationProject

__all__ = ["limit_words", "noise_words"]

SHOWN = 8  # joints in a sentence
_ORIGINS = {
    NoiseOrigin.GIVEN: "as given",
    NoiseOrigin.RESULT: "the residual of the result, each sample counted as often as it is independent",
    NoiseOrigin.LOGS: "the residual of a fit to the logs, each sample counted as often as it is independent",
    NoiseOrigin.RULE: "by rule: 1 % of the torque limit, or 1 N m. Give `noise`, or a result, for errors to rely on",
}


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
