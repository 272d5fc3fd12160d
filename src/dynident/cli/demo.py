"""``dynident demo``: the whole way with the arm that comes with dynident, and how far from the truth it ends."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

import click

from dynident.cli.identify import write_result
from dynident.cli.init import drafted
from dynident.cli.launcher import command
from dynident.cli.options import DIRECTORY
from dynident.cli.terminal import console, status

if TYPE_CHECKING:
    from dynident.cli.screen import Screen
    from dynident.demo import Comparison
    from dynident.identification import Identification

__all__ = ["demo"]

LOGS = ("monday.parquet", "tuesday.parquet")


@click.command(short_help="Identify the arm that comes with dynident, to see how it goes.")
@click.option("--out", type=DIRECTORY, default="arm-out", show_default=True, help="Folder for the arm's files.")
@click.option("--files", is_flag=True, help="Only write the arm's files, to go the way of the tutorial.")
def demo(out: Path, files: bool) -> None:
    """Identify a simulated arm whose truth is known, from its robot file and two recordings, which come with dynident.

    The commands that do this are printed, and the folder is left to try others.
    """
    from dynident.demo import compare_with_truth, demo_files
    from dynident.io.opener import keep

    screen = console()
    demo_files(out)
    for name in ("arm.urdf", *LOGS):
        keep(out / name)
    screen.say(f"In {out.resolve()}: a robot file, arm.urdf, and two recordings of that arm, which are simulated.")
    if files:
        return
    _check(screen, out, _init(screen, out))
    found = _identify(screen, out)
    _compare(screen, compare_with_truth(found))
    _command(screen, "Next")
    for what, how in _next(out):
        screen.remark(f"{what}:")
        screen.remark(f"  {how}", whole=True)


def _next(out: Path) -> tuple[tuple[str, str], ...]:
    """Return what can be done with the folder, and how."""
    config, result, free = out / "robot.yaml", out / "result", out / "free"
    more = f"Add the lines of {out / 'controller.yaml'} to {config} for a free simulation in the loop of its controller"
    return (
        ("Look at the report, in a browser", str((result / "report.html").resolve())),
        ("The torque of a recording", command("predict", result / "result.json", out / LOGS[1])),
        ("How accurate any method could be", command("bound", config)),
        (more, command("identify", config, "--out", free)),
        ("Your own robot", command("init", "YOUR.urdf", "MONDAY.csv", "TUESDAY.csv")),
    )


def _command(screen: Screen, text: str) -> None:
    screen.say("")
    screen.say(text, "bold")


def _init(screen: Screen, out: Path) -> str:
    """Draft robot.yaml and return its text; InputError where another one, perhaps edited, is there."""
    from dynident.errors import InputError
    from dynident.io.opener import content
    from dynident.io.results import write_text

    config = out / "robot.yaml"
    files = [out / name for name in ("arm.urdf", *LOGS)]
    _command(screen, f"$ {command('init', *files, '-o', config)}")
    with status() as say:
        text = drafted(str(out / "arm.urdf"), [str(out / name) for name in LOGS], out, say)[0].text
    if os.path.lexists(config) and content(config, remember=False) != text.encode():
        raise InputError(f"{config}: exists already, and is not the one that is drafted; give another folder by --out.")
    write_text(config, text)
    screen.say("robot.yaml names the column and unit of each joint's position and torque.")
    return text


def _check(screen: Screen, out: Path, text: str) -> None:
    """Check the draft."""
    from dynident.errors import Severity
    from dynident.io.project import parse_project
    from dynident.report.check import check_summary
    from dynident.report.finding_words import finding_words

    config = out / "robot.yaml"
    _command(screen, f"$ {command('check', config)}")
    with status() as say:
        checked = parse_project(text, config).examine(say)
    screen.say(check_summary(checked))
    for finding in checked.findings:
        if finding.severity is not Severity.INFO:
            screen.say(finding_words(finding))


def _identify(screen: Screen, out: Path) -> Identification:
    from dynident.export import exports
    from dynident.io.folder import result_folder
    from dynident.io.model_files import moved_to
    from dynident.io.project import read_project
    from dynident.report.verdict import verdict_text

    _command(screen, f"$ {command('identify', out / 'robot.yaml', '--out', out / 'result')}")
    with result_folder(out / "result") as folder:
        with status() as say:
            found = read_project(out / "robot.yaml", say).identify(say)
            say("writing and verifying the model")
            written = write_result(folder, found, moved_to(folder.path, exports(found), found.provenance))
        screen.say(verdict_text(found)[0])
        for what, path in written:
            screen.say(f"  {what}: result/{path.name}")
    return found


def _compare(screen: Screen, found: Comparison) -> None:
    from dynident.report.page import Column, PageTable, number

    _command(screen, "How far that is from the truth, which only a simulation knows")
    screen.say(
        f"On a motion that was never recorded, the model's torque is {number(found.torque_error, 2)} % from the true "
        f"one; with the inertias of arm.urdf it would be {number(found.file_error, 2)} %, the friction being known."
    )
    screen.say(
        f"Of the {found.base} base parameters, {found.within} are within 1.96 of their standard errors, where 95 % "
        "should be."
    )
    rows = [(one.name, number(one.found, 4), number(one.true, 4), number(one.std, 2), one.unit) for one in found.values]
    titles = (Column("", numeric=False), Column("found"), Column("true"), Column("std. error"))
    screen.show(PageTable((*titles, Column("unit", numeric=False)), tuple(rows)))
