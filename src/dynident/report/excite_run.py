"""A designed motion with all of its files: what ``dynident.excite`` and the command write."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from dataclasses import asdict
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dynident.errors import ConfigError, InputError
from dynident.excitation import LimitError, Trajectory, slowed, verify
from dynident.identification import versions
from dynident.io.excitation import ExcitationProject, read_excitation
from dynident.io.folder import REPORT, ResultFolder, refuse_other_report, result_folder
from dynident.io.opener import content, refuse_inputs, watched
from dynident.io.project import parse_project
from dynident.io.recording_draft import recording_config
from dynident.io.results import json_text
from dynident.io.trajectory_files import ROS_RATE, trajectory_files
from dynident.report.excitation import MOTIONS, SLOWER, TRIAL, excitation_findings, excitation_page, motions_of

if TYPE_CHECKING:
    from dynident.excitation import Design

__all__ = ["CONFIG", "NUMBERS", "excite", "refuse_targets", "write_design"]

CONFIG, NUMBERS = "identify.yaml", "excite.json"
FORMAT, VERSION = "dynident-excite", 1
_STEMS = {
    TRIAL: f"the motion {SLOWER:g} times slower, one period of it, for the first run",
    MOTIONS[0]: "the motion",
    MOTIONS[1]: "another one, to judge the fit",
}
_USES = {
    "csv": "t, and of each joint q, dq, ddq, in s, rad or m",
    "npz": "the same as NumPy arrays",
    "trajectory.yaml": "trajectory_msgs/JointTrajectory of ROS 2",
}
_MOTIONS = tuple(f"{stem}.{ending}" for stem in _STEMS for ending in _USES)


def excite(
    robot: str | Path,
    out: str | Path | None = None,
    settings: str | Path | None = None,
    *,
    allow_code: bool = False,
    executor: Executor | None = None,
    progress: Callable[[str], None] | None = None,
    **changes: Any,
) -> Design:
    """Design a motion that shows the parameters of a robot as accurately as its limits allow, and another one for
    validation.

    ``robot`` is a robot file, a configuration, or a result, to whose information the motion then adds. What motion, in
    which surroundings, say the keys of the configuration's section ``excitation``, a file of such ``settings``, or
    keywords, such as ``duration=20``. In the folder ``out`` are written ``motion``, ``validation`` and a slow ``trial``
    as .csv, .npz and .trajectory.yaml (ROS 2), ``identify.yaml``, which will read the recordings, ``excite.json`` and
    ``report.html``.
    The search is spread over ``executor``; ``progress`` is called with a few words before each step.

    Raises ConfigError for wrong settings and limits, ModelError for the model, InputError where nothing can be read or
    written, or no motion is found.

    >>> import dynident as dy
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> text = '''<robot name="door"><link name="wall"/><link name="leaf"><inertial><origin xyz="0.4 0 0"/>
    ... <mass value="20"/><inertia ixx="3" iyy="1" izz="4" ixy="0" ixz="0" iyz="0"/></inertial></link>
    ... <joint name="hinge" type="revolute"><parent link="wall"/><child link="leaf"/><axis xyz="0 1 0"/>
    ... <limit lower="-1" upper="1" velocity="2" effort="200"/></joint></robot>'''
    >>> with TemporaryDirectory() as folder:
    ...     file = Path(folder, "door.urdf")
    ...     _ = file.write_text(text)
    ...     found = dy.excite(file, duration=15, period=5, starts=1)
    >>> bool(found.trajectory.duration <= 15)
    True
    """
    with watched(robot):
        if out is None:
            project = read_excitation(robot, settings, changes, allow_code=allow_code, progress=progress or _silent)
            return project.design(executor, progress)
        with result_folder(out) as folder:
            project = read_excitation(
                robot,
                settings,
                changes,
                ready=partial(refuse_targets, folder.path),
                allow_code=allow_code,
                progress=progress or _silent,
            )
            found = project.design(executor, progress)
            write_design(folder, project, found)
            return found


def _silent(_: str) -> None:
    """Show no progress."""


def refuse_targets(folder: Path) -> None:
    """Raise ConfigError, before long work, where a file that a design writes is one that was read, the report
    there is that of another command, or the configuration was written or changed by hand."""
    refuse_inputs(*(folder / name for name in (*_MOTIONS, CONFIG, NUMBERS, REPORT)))
    refuse_other_report(folder, NUMBERS)
    path = folder / CONFIG
    if path.exists() and sha256(content(path, remember=False)).hexdigest() != _written(folder).get(CONFIG):
        raise ConfigError(
            f"{path}: was written or changed by hand, and would be replaced; move it, or choose another folder."
        )


def _written(folder: Path) -> Mapping[str, Any]:
    """Return the digests of the files that an earlier run wrote here, by name."""
    try:
        files = json.loads(content(folder / NUMBERS, remember=False))["files"]
    except (InputError, ValueError, RecursionError, KeyError, TypeError):
        return {}
    return files if isinstance(files, Mapping) else {}


def write_design(folder: ResultFolder, project: ExcitationProject, found: Design) -> tuple[Path, ...]:
    """Write all files of a design, each read again before, and return their paths.

    Raises InputError where one cannot be written, ConfigError where one was read.
    """
    rate = project.settings.file_rate or found.request.rate
    files: dict[str, str | bytes] = {}
    for stem, trajectory in motions_of(found).items():
        files |= trajectory_files(trajectory, stem, rate)
    if trial := _trial(found):
        files |= trajectory_files(trial, TRIAL, rate, ROS_RATE / SLOWER)
    uses = [(name, f"{_STEMS[stem]}: {_USES[ending]}") for name in files for stem, _, ending in [name.partition(".")]]
    if text := recording_config(project, folder.path):
        parse_project(text, folder.path / CONFIG)  # what is written can be read
        files[CONFIG] = text
        uses.append((CONFIG, "the configuration that reads the recordings"))
    digests = {name: sha256(one if isinstance(one, bytes) else one.encode()).hexdigest() for name, one in files.items()}
    uses.append((NUMBERS, "all numbers of this page"))
    files[NUMBERS] = json_text(_numbers(project, found, digests))
    files[REPORT] = excitation_page(project, found, uses)
    return folder.replace(files, gone={CONFIG, *_MOTIONS})


def _trial(found: Design) -> Trajectory | None:
    """Return the motion for a first run: the same path, once and slowly; None where momentum carries the arm on it, so
    that slow motion takes more torque than is allowed."""
    trial = slowed(found.trajectory.once, SLOWER)
    try:
        verify(trial, found.model, found.theta, found.limits)
    except LimitError:
        return None
    return trial


def _numbers(project: ExcitationProject, found: Design, digests: Mapping[str, str]) -> dict[str, Any]:
    """Return everything as plain values: SI units, limits less the margin."""
    limits, one = found.limits, found.expected
    names = ("lower", "upper", "velocity", "acceleration", "jerk", "torque")
    return {
        "format": FORMAT,
        "version": VERSION,
        "robot": str(project.path),
        "settings": project.settings.model_dump(mode="json"),
        "duration": {name: one.duration for name, one in motions_of(found).items()},
        "noise": {"from": project.origin.value, "sigma": _by_joint(found, found.request.sigma)},
        "limits": {name: _by_joint(found, getattr(limits, name)) for name in names},
        "limits_by_rule": {joint: list(made) for joint, made in limits.by_rule.items()},
        "expected": {
            "log_det": one.log_det,
            "condition": one.condition,
            "parameters": [
                {"name": name, "value": value, "std": std}
                for name, value, std in zip(one.basis.groupings, one.value.tolist(), one.std.tolist(), strict=True)
            ],
        },
        "checked": {name: _checked(found, k) for k, name in enumerate(MOTIONS)},
        "findings": excitation_findings(project, found),
        "files": dict(digests),
        "versions": versions(),
    }


def _by_joint(found: Design, values: np.ndarray[Any, Any]) -> dict[str, float]:
    return dict(zip(found.limits.joints, values.tolist(), strict=True))


def _checked(found: Design, k: int) -> dict[str, Any]:
    one = found.checked[k]
    quantities = ("position", "velocity", "acceleration", "jerk", "torque")
    reached = {name: _by_joint(found, row) for name, row in zip(quantities, one.reached, strict=True)}
    near = {name: value and asdict(value) for name, value in (("links", one.nearest), ("shapes", one.nearest_shapes))}
    return {"samples": one.samples, "share_of_limits": reached, "torque_by": list(one.routes), "nearest": near}
