"""``dynident check``: find errors in recordings and robot files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import click

from dynident.cli.launcher import command
from dynident.cli.options import CHECKED, FILE, ROBOTS
from dynident.cli.terminal import console, status, tell

if TYPE_CHECKING:
    from dynident.checks import CheckResult

__all__ = ["check"]


@click.command(short_help="Find errors in recordings and robot files.")
@click.argument("files", metavar="FILE...", nargs=-1, required=True, type=CHECKED)
@click.option("--json", "json_file", type=FILE, help="JSON file for the findings and their figures.")
def check(files: tuple[Path, ...], json_file: Path | None) -> None:
    """Check each FILE, a configuration (YAML) with its logs and robot file, or a robot file (URDF, MJCF) alone, and
    print what is wrong and what to do about it. The exit code is 1 where an error is found.
    """
    from dynident.io.opener import keep, refuse_inputs
    from dynident.io.results import check_json, probe_folder, write_json
    from dynident.report.check import check_dict, check_summary, check_tables

    if json_file:
        for path in files:
            keep(path)
        refuse_inputs(json_file)
        check_json(json_file)
        probe_folder(json_file.parent)
    screen, found = console(), {}
    for path in files:
        with status() as say:
            found[str(path)] = one = _examined(path, json_file, say)
        screen.say(f"{path}: {check_summary(one)}", "bold")
        for table in check_tables(one):
            screen.show(table)
    if json_file:
        tell(screen, "Findings", write_json(json_file, {path: check_dict(one) for path, one in found.items()}))
    for path in files:
        screen.remark(_next(path, found[str(path)]), whole=True)
    if any(one.failed for one in found.values()):
        raise SystemExit(1)


def _next(path: Path, found: CheckResult) -> str:
    """Return what to type next."""
    if found.failed:
        return f"When the errors are corrected: {command('check', path)}"
    if path.suffix.lower() in ROBOTS:
        drafted = command("init", path, "LOG.csv", "-o", path.with_suffix(".yaml").name)
        return f"Next, with a recording: {drafted}; without one: {command('excite', path, '-o', f'{path.stem}-motion')}"
    return f"Next: {command('identify', path, '--out', f'{path.stem}-out')}"


def _examined(path: Path, json_file: Path | None, say: Callable[[str], None]) -> CheckResult:
    """Check one file; one that cannot be used is an error among the findings, so that the others are checked.

    Raises ConfigError where the findings would replace a file that is named in it.
    """
    from dynident.errors import DynidentError, InputError
    from dynident.io.opener import find, refuse_inputs
    from dynident.io.project import read_project
    from dynident.io.robot import SUFFIXES

    try:
        find(path, InputError, (".yaml", ".yml", *SUFFIXES))
        if path.suffix.lower() in SUFFIXES:
            return _robot(path)
        project = read_project(path, say)
    except DynidentError as error:
        return _unusable(error)
    refuse_inputs(*filter(None, [json_file]))
    try:
        return project.examine(say)
    except DynidentError as error:
        return _unusable(error)


def _unusable(error: Exception) -> CheckResult:
    from dynident.checks import CheckResult, Finding, Topic
    from dynident.errors import Severity

    return CheckResult((Finding(Severity.ERROR, None, str(error), Topic.UNUSABLE),))


def _robot(path: Path) -> CheckResult:
    from dynident.checks import CheckResult, check_robot, joint_facts, link_facts
    from dynident.io.robot import robot_text
    from dynident.models.rigid_bodies import read_robot_file

    file = read_robot_file(robot_text(path), path.name)
    return CheckResult(check_robot(file), links=link_facts(file), joints=joint_facts(file))
