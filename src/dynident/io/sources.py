"""The input of a drafted configuration: the joints of a robot, and recordings with columns of unknown meaning."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from dynident.errors import InputError, ModelError
from dynident.io.column_mapping import widths
from dynident.io.config import load_model
from dynident.io.logs import read_recording
from dynident.io.match import JointFacts
from dynident.io.robot import SUFFIXES, robot_text
from dynident.io.ros import BAGS
from dynident.io.settings import LogSpec
from dynident.io.tables import DataTable, read_columns
from dynident.models.rigid_bodies import read_robot_file
from dynident.models.robot_file import Coupled, RobotFile

__all__ = ["Source", "read_joints", "read_source"]


@dataclass(frozen=True)
class Source:
    """A recording: its file, or files by short name, the widths of text files by short name, and its table."""

    files: Mapping[str, Path]
    widths: Mapping[str, int]
    table: DataTable

    @property
    def ros(self) -> bool:
        """Whether it is a bag, whose units are those of ROS."""
        return all(path.suffix.lower() in BAGS or path.is_dir() for path in self.files.values())


def read_joints(robot: str) -> list[JointFacts]:
    """Return the joints of one coordinate of a robot file, in its order, or of a model named as in a configuration.

    Raises ModelError where it cannot be read, or has no such joint.
    """
    path = Path(robot)
    if path.suffix.lower() not in SUFFIXES:
        return [JointFacts(joint.name, joint.kind) for joint in load_model(robot).joints]
    file = read_robot_file(robot_text(path), path.name)
    bound = _bound(file)
    joints = [
        JointFacts(joint.name, joint.kind, joint.limits, bound.get(joint.name, ""))
        for joint in file.joints
        if joint.kind != "fixed" and not joint.follows  # a mimic joint moves, or stands, with its master
    ]
    if all(joint.follows for joint in joints):
        raise ModelError(f"{robot}: has no revolute or prismatic joint, so there is nothing to identify.")
    return joints


def _bound(file: RobotFile) -> dict[str, str]:
    """Return the joint that each coupled joint follows, by name."""
    bound: dict[str, str] = {}
    for constraint in file.constraints:
        if isinstance(constraint, Coupled):
            bound |= {name: _other(name, constraint.joints) for name in constraint.joints if name not in bound}
    return bound


def _other(name: str, joints: Sequence[str]) -> str:
    return next((joint for joint in joints if joint != name), name)


def read_source(log: str) -> Source:
    """Read a recording: a file, the folder of a ROS 2 bag, or files joined by a plus sign (``q.csv+tau.csv``).

    Several files get short names, from the parts in which their stems differ. Raises InputError where one cannot be
    read.
    """
    parts = [log] if os.path.exists(log) else log.split("+")
    if len(parts) == 1:
        return Source({"": Path(log)}, {}, read_columns(log))
    paths = [Path(part.strip()) for part in parts]
    files = dict(zip(_short([path.stem for path in paths]), paths, strict=True))
    if len(files) < len(paths):
        raise InputError(f"{log}: two of the files have the same name; rename one, or write the configuration by hand.")
    wide = widths({key: read_columns(path) for key, path in files.items()})
    spec = LogSpec.model_validate({"file": {key: str(path) for key, path in files.items()}, "width": wide or None})
    return Source(files, wide, read_recording(spec))


def _short(stems: Sequence[str]) -> list[str]:
    """Return the stems without the words that all of them share at the start and the end."""
    words = _differing([re.split(r"[\W_]+", stem) for stem in stems])
    words = _differing([stem[::-1] for stem in words])
    short = ["_".join(stem[::-1]) for stem in words]
    return short if all(short) and len(set(short)) == len(short) else list(stems)


def _differing(words: list[list[str]]) -> list[list[str]]:
    """Return the words without the first ones that all lists share."""
    while all(words) and len({one[0] for one in words}) == 1:
        words = [one[1:] for one in words]
    return words
