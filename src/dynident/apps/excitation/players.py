"""The programs that play a motion on a robot: sources beside this file, filled in where they hold the motion.

``player.py`` sends a JointTrajectory to a controller of ROS 2, ``player.cpp`` commands an arm of Franka by libfranka
and records it, ``player.script`` is a URScript for an arm of Universal Robots.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from dynident.project.arms import is_universal_robot
from dynident.runtime.arrays import Array

ROS, FRANKA = "play_trajectory.py", "play_franka.cpp"
_FRANKA_JOINT = re.compile(r"(.*_)?(panda|fer|fr3|franka)\w*")
DIGITS = 6  # after the point, of rad, rad/s and rad/s^2


def players(joints: Sequence[str]) -> Mapping[str, tuple[str, str]]:
    """Return the programs for an arm with these joints: their texts and uses, by file name."""
    programs = {ROS: (_source("player.py"), "the program that sends a trajectory.yaml to a controller of ROS 2")}
    if len(joints) == 7 and all(map(_FRANKA_JOINT.fullmatch, joints)):
        programs[FRANKA] = (_source("player.cpp"), "the program (C++, libfranka) that plays a .csv, and records it")
    return programs


def ur_script(joints: Sequence[str], t: Array, states: Array, stem: str) -> str | None:
    """Return the URScript that plays points at times t (N) s with states (N, 3, 6) of q, dq and ddq, rad and s.

    None where the joints are not those of Universal Robots, in their order.
    """
    if not is_universal_robot(joints):
        return None
    points = np.round(states, DIGITS) + 0.0  # no negative zero
    rows = zip(t[1:].tolist(), points[1:].tolist(), strict=True)
    lines = [f"  to({time:.9g}, {', '.join(map(str, row))})" for time, row in rows]
    return (
        _source("player.script")
        .replace("@STEM@", stem)
        .replace("@NAME@", "dynident_" + re.sub(r"\W", "_", stem))
        .replace("@START@", str(points[0, 0].tolist()))
        .replace("  @POINTS@", "\n".join(lines))
    )


def _source(name: str) -> str:
    return Path(__file__).with_name(name).read_text(encoding="utf-8")
