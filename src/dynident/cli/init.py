"""``dynident init``: draft a configuration from a robot file and logs."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from dynident.cli.launcher import command
from dynident.cli.options import FILE, LOG_NAME, ROBOT
from dynident.cli.terminal import console, status, tell

if TYPE_CHECKING:
    from dynident.io.config_draft import ConfigDraft
    from dynident.io.tables import DataTable

__all__ = ["drafted", "init"]


@click.command(short_help="Draft a configuration for your robot and logs.")
@click.argument("robot", type=ROBOT)
@click.argument("logs", nargs=-1, required=True, type=LOG_NAME)
@click.option("-o", "--out", type=FILE, default="identify.yaml", show_default=True, help="The configuration to write.")
@click.option("--force", is_flag=True, help="Overwrite an existing configuration.")
def init(robot: str, logs: tuple[str, ...], out: Path, force: bool) -> None:
    """Write a configuration for `dynident identify`, with columns and units guessed from LOGS.

    ROBOT is a URDF or MJCF file, or gallery:NAME. The first log is fitted and the last one held out. Files that make
    one log together are joined by a plus sign: q.csv+tau.csv.
    """
    from dynident.errors import InputError
    from dynident.io.opener import keep, refuse_inputs
    from dynident.io.results import write_text

    if os.path.lexists(out) and not force:
        raise InputError(f"{out}: exists already; choose another name with -o, or overwrite it with --force.")
    for file in (robot, robot.rpartition(":")[0], *logs, *(file.strip() for log in logs for file in log.split("+"))):
        keep(file)
    refuse_inputs(out)
    with status() as say:
        written, tables = drafted(robot, logs, out.parent, say)
    tell(console(), "Configuration", write_text(out, written.text))
    _remarks(written, out, tables)


def drafted(
    robot: str, logs: Sequence[str], folder: Path, say: Callable[[str], None]
) -> tuple[ConfigDraft, list[DataTable]]:
    """Return the configuration drafted for a folder, and what was read."""
    from dynident.io.column_mapping import map_columns
    from dynident.io.config_draft import draft_config, same_columns
    from dynident.io.gain_draft import with_gains
    from dynident.io.robot import SUFFIXES
    from dynident.io.sources import read_joints, read_source

    joints = read_joints(robot)
    sources = []
    for log in logs:
        say(f"reading {log}")
        sources.append(read_source(log))
    first, *others = (source.table for source in sources)
    found = map_columns(first, joints, sources[0].ros, others, lockable=Path(robot).suffix.lower() in SUFFIXES)
    same_columns(found, sources)
    if any(one.gain for one in found.torque.values()):
        say("estimating the gains")
        found = with_gains(robot, joints, found, sources, folder)
    return draft_config(robot, joints, found, sources, folder), [source.table for source in sources]


def _remarks(written: ConfigDraft, out: Path, tables: Sequence[DataTable]) -> None:
    """Print what to fill in and to confirm, and the next command."""
    screen = console()
    for note in written.notes:
        screen.remark(f"Note: {note}")
    said = [note for table in tables for note in table.notes]
    notes = [note for table in tables for note in table.notes if note not in table.guesses]  # these are asked below
    for note in [*notes, *(() if written.blanks else _trial(written.text, out, said))]:
        screen.remark(f"Warning: {note}", "yellow")
    for title, items in (("Fill in:", written.blanks), ("Confirm or correct:", written.questions)):
        if items:
            screen.say(title)
        for item in items:
            screen.say(f"  {item}")
    first = "Then" if written.blanks or written.questions else "Next"
    screen.remark(f"{first}: {command('check', out)}", whole=True)


def _trial(text: str, out: Path, said: Sequence[str]) -> list[str]:
    """Read the logs as the configuration says, and return what that warns of or fails at, but for notes ``said``."""
    from dynident.errors import DynidentError
    from dynident.io.project import parse_project

    try:
        project = parse_project(text, out)
        specs = (*project.config.train, *project.config.validation)
        known = {f"{spec.label}: {note}" for spec in specs for note in said}
        return [one for one in (*project.warnings, *project.logs()[1]) if one not in known]
    except DynidentError as error:
        return [f"the configuration cannot be used yet: {error}"]
