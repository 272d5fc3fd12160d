"""A designed motion with all of its files: what ``dynident.excite`` and the command write."""

from __future__ import annotations

import json
from collections.abc import Mapping
from concurrent.futures import Executor
from dataclasses import asdict
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from dynident.apps.excitation.design import Design
from dynident.apps.excitation.expected_report import excitation_findings
from dynident.apps.excitation.files import recording_config, trajectory_files
from dynident.apps.excitation.limits import LIMITS_FILE, Feasibility, JointLimits, usual_arm
from dynident.apps.excitation.players import FRANKA, ROS, players
from dynident.apps.excitation.report import MOTIONS, SLOWER, TRIAL, excitation_page, motions_of
from dynident.apps.excitation.robot import ExcitationProject, read_excitation
from dynident.apps.excitation.trajectory import Trajectory, slow_down
from dynident.apps.excitation.verify import QUANTITIES, LimitError, verify
from dynident.files.folder import REPORT, ResultFolder, is_unchanged, refuse_other_report, result_folder
from dynident.files.opener import content, refuse_inputs, watch_inputs
from dynident.files.results import as_path, json_text
from dynident.identification import versions
from dynident.project.arms import KnownArm
from dynident.project.explicit_config import settings_text
from dynident.project.project import parse_project
from dynident.runtime import ConfigError, InputError

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
    "script": "a URScript that plays it on an arm of Universal Robots; its head says how",
}
_MOTIONS = tuple(f"{stem}.{ending}" for stem in _STEMS for ending in _USES)
_EDITABLE = (CONFIG, LIMITS_FILE, ROS, FRANKA)  # which somebody may have changed by hand


def excite(
    robot: str | Path,
    out: str | Path | None = None,
    settings: str | Path | None = None,
    *,
    allow_code: bool = False,
    executor: Executor | None = None,
    **changes: Any,
) -> Design:
    """Design a motion that shows the parameters of a robot as accurately as its limits allow, and another one for
    validation.

    ``robot`` is a robot file, a configuration, or a result, to whose information the motion then adds. What motion, in
    which surroundings, say the keys of the configuration's section ``excitation``, a file of such ``settings``, or
    keywords, such as ``duration=20``. In the folder ``out`` are written ``motion``, ``validation`` and a slow ``trial``
    as .csv, .npz and .trajectory.yaml (ROS 2), programs that play them, ``identify.yaml``, which will read the
    recordings, ``excite.json`` and ``report.html``.
    The search is spread over ``executor``.

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
    robot = as_path(robot)
    with watch_inputs(robot):
        if out is None:
            project = read_excitation(robot, settings, changes, allow_code=allow_code)
            return project.design(executor)
        with result_folder(out) as folder:
            project = read_excitation(
                robot, settings, changes, ready=partial(refuse_targets, folder.path), allow_code=allow_code
            )
            design = project.design(executor)
            write_design(folder, project, design)
            return design


def refuse_targets(folder: Path) -> None:
    """Raise ConfigError, before long work, where a file that a design writes is one that was read, the report
    there is that of another command, or configuration, limits or players were written or changed by hand."""
    refuse_inputs(*(folder / name for name in (*_MOTIONS, *_EDITABLE, NUMBERS, REPORT)))
    refuse_other_report(folder, NUMBERS)
    digests = _earlier_digests(folder)
    for path in (folder / name for name in _EDITABLE):
        # what has the digest of an earlier run is unchanged and may be replaced
        if path.exists() and not is_unchanged(path, digests.get(path.name)):
            raise ConfigError(
                f"{path}: was written or changed by hand, and would be replaced; move it, or choose another folder."
            )


def _earlier_digests(folder: Path) -> Mapping[str, Any]:
    """Return the digests of the files that an earlier run wrote here, by name."""
    try:
        files = json.loads(content(folder / NUMBERS, remember=False))["files"]
    except (InputError, ValueError, RecursionError, KeyError, TypeError):
        return {}
    return files if isinstance(files, Mapping) else {}


def write_design(folder: ResultFolder, project: ExcitationProject, design: Design) -> tuple[Path, ...]:
    """Write all files of a design and return their paths.

    Raises InputError where one cannot be written, ConfigError where one was read.
    """
    rate = design.request.file_rate
    files: dict[str, str | bytes] = {}
    for stem, trajectory in motions_of(design).items():
        files |= trajectory_files(trajectory, stem, rate, design.limits)
    if trial := _trial_motion(design):
        files |= trajectory_files(trial, TRIAL, rate, design.limits, round(SLOWER))
    uses = [(name, f"{_STEMS[stem]}: {_USES[ending]}") for name in files for stem, _, ending in [name.partition(".")]]
    for name, (program, use) in players(design.limits.joints).items():
        files[name] = program
        uses.append((name, use))
    if arm := usual_arm(design.model, design.limits):
        files[LIMITS_FILE] = _limits_text(project, arm)
        uses.append((LIMITS_FILE, f"the settings, with usual limits of a {arm.name}"))
    if text := recording_config(project, folder.path):
        parse_project(text, folder.path / CONFIG)  # what is written can be read
        files[CONFIG] = text
        uses.append((CONFIG, "the configuration that reads the recordings"))
    digests = {
        name: sha256(contents if isinstance(contents, bytes) else contents.encode()).hexdigest()
        for name, contents in files.items()
    }
    uses.append((NUMBERS, "all numbers of this page"))
    files[NUMBERS] = json_text(_design_dict(project, design, digests))
    files[REPORT] = excitation_page(project, design, uses)
    return folder.replace(files, removed={*_EDITABLE, *_MOTIONS})


def _limits_text(project: ExcitationProject, arm: KnownArm) -> str:
    """Return the settings of a motion with the limits of an arm, for ``--settings``; what the user gives stays."""
    settings = project.settings.model_dump(mode="json", exclude_unset=True)
    given = {name: limits.model_dump(exclude_none=True) for name, limits in project.settings.limits.items()}
    limits = {name: {**usual, **given.get(name, {})} for name, usual in arm.limits.items()}
    head = (f"Settings of a motion, for --settings, with limits of acceleration and jerk of a {arm.name}:", arm.source)
    return settings_text({**settings, "limits": limits}, {"": head})


def _trial_motion(design: Design) -> Trajectory | None:
    """Return the motion for a first run: the same path, once and slowly.

    None where momentum carries the arm along it, so that slow motion takes more torque than is allowed.
    """
    trial = slow_down(design.trajectory.without_repeats, SLOWER)
    try:
        verify(trial, Feasibility(design.model, design.theta, design.limits))
    except LimitError:
        return None
    return trial


def _design_dict(project: ExcitationProject, design: Design, digests: Mapping[str, str]) -> dict[str, Any]:
    """Return the design as plain values: SI units, limits less the margin."""
    limits, accuracy = design.limits, design.expected
    return {
        "format": FORMAT,
        "version": VERSION,
        "robot": str(project.path),
        "settings": project.settings.model_dump(mode="json"),
        "duration": {name: trajectory.duration for name, trajectory in motions_of(design).items()},
        "noise": {"from": project.origin.value, "sigma": _values_by_joint(design, design.request.sigma)},
        "limits": {name: _values_by_joint(design, getattr(limits, name)) for name in JointLimits.model_fields},
        "limits_by_rule": {joint: list(rules) for joint, rules in limits.by_rule.items()},
        "expected": {
            "log_det": accuracy.log_det,
            "condition": accuracy.condition,
            "parameters": [
                {"name": name, "value": value, "std": std}
                for name, value, std in zip(
                    accuracy.basis.groupings, accuracy.value.tolist(), accuracy.std.tolist(), strict=True
                )
            ],
        },
        "checked": {name: _check_dict(design, k) for k, name in enumerate(MOTIONS)},
        "findings": excitation_findings(project, design),
        "files": dict(digests),
        "versions": versions(),
    }


def _values_by_joint(design: Design, values: np.ndarray[Any, Any]) -> dict[str, float]:
    return dict(zip(design.limits.joints, values.tolist(), strict=True))


def _check_dict(design: Design, k: int) -> dict[str, Any]:
    check = design.checks[k]
    reached = {name: _values_by_joint(design, row) for name, row in zip(QUANTITIES, check.reached, strict=True)}
    nearest = {
        name: value and asdict(value) for name, value in (("links", check.nearest), ("shapes", check.nearest_shapes))
    }
    return {"samples": check.samples, "share_of_limits": reached, "torque_by": list(check.routes), "nearest": nearest}
