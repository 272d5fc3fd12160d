"""``dynident excite``: a motion that shows what matters, before the robot moves."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from dynident.cli.launcher import command
from dynident.cli.options import ALLOW_CODE, CONFIG, DESIGNED, DIRECTORY, Range, noise_given
from dynident.cli.terminal import console, status, tell
from dynident.cli.workers import Spread, spread

__all__ = ["excite"]

PROGRAMS = ("motion", "friction", "gravity", "all")
POSITIVE = Range(0, min_open=True)


@click.command(short_help="Design a motion that shows the parameters of a robot.")
@click.argument("robot", type=DESIGNED)
@click.option(
    "-o", "--out", type=DIRECTORY, required=True,
    help="Folder for the motions (CSV, NumPy, ROS 2), identify.yaml, excite.json and report.html.",
)  # fmt: skip
@click.option(
    "--settings", type=CONFIG, metavar="FILE",
    help="File (YAML) of the settings, limits and obstacles.  [default: section `excitation` of a configuration]",
)  # fmt: skip
@click.option(
    "--program", type=click.Choice(PROGRAMS),
    help="An optimised motion, constant speeds of each joint, poses for gravity, or all of these.",
)  # fmt: skip
@click.option("--duration", type=POSITIVE, metavar="S", help="Most seconds that it may take, with its ways.")
@click.option("--criterion", type=click.Choice(["d", "a", "condition"]), help="What is optimised.")
@click.option("--parameter", multiple=True, metavar="NAME", help="A parameter that matters (criterion a); repeat it.")
@click.option("--family", type=click.Choice(["fourier", "bspline"]), help="Periodic, or of one piece.")
@click.option("--period", type=POSITIVE, metavar="S", help="Seconds of a period.")
@click.option("--harmonics", type=click.IntRange(1), help="Harmonics of a period.")
@click.option("--rate", type=POSITIVE, metavar="HZ", help="Rate of the recording.")
@click.option("--file-rate", type=POSITIVE, metavar="HZ", help="Rate of the files.  [default: that of the recording]")
@click.option("--floor", type=float, metavar="M", help="Height of a floor, along z of the root link.")
@click.option(
    "--package", multiple=True, type=DIRECTORY,
    help="Folder of a package (package://) with the robot's meshes, or one around it; repeat it.",
)  # fmt: skip
@click.option("--noise", multiple=True, help="Torque noise (N m, N): a number, or joint=number; repeat it.")
@click.option("--starts", type=click.IntRange(1), help="How often the search begins anew.")
@click.option("--seed", type=click.IntRange(0), help="Of what is drawn: another one gives another motion.")
@ALLOW_CODE
@spread
def excite(
    robot: Path, out: Path, settings: Path | None, parameter: tuple[str, ...], package: tuple[Path, ...],
    noise: tuple[str, ...], allow_code: bool, spread: Spread, **given: Any,
) -> None:  # fmt: skip
    """Design the motion that shows the parameters of ROBOT as accurately as its limits allow, another one for
    validation, and say how accurate a result will be.

    ROBOT is a robot file (URDF, MJCF), a configuration (YAML), or the result.json of identify, to whose information the
    motion then adds. Options stand in place of the settings. Ctrl-C ends the search with the best motion so far.
    """
    from functools import partial

    from dynident.io.excitation import read_excitation
    from dynident.io.folder import result_folder
    from dynident.report.excitation import NO_TRIAL, TRIAL, excitation_findings, excitation_heading, excitation_tables
    from dynident.report.excite_run import CONFIG as DRAFT
    from dynident.report.excite_run import refuse_targets, write_design

    changes = {name: value for name, value in given.items() if value is not None}
    changes |= {"parameters": list(parameter), "criterion": "a"} if parameter else {}
    changes |= {"packages": list(package)} if package else {}
    changes |= {} if (size := noise_given("--noise", noise)) is None else {"noise": size}
    with result_folder(out) as folder, status() as say:
        ready = partial(refuse_targets, folder.path)
        project = read_excitation(robot, settings, changes, ready=ready, allow_code=allow_code, progress=say)
        with spread.executor("dynident.excitation.design") as executor:
            found = project.design(executor, say)
        say("writing the motions and reading them again")
        written = write_design(folder, project, found)
    screen = console()
    screen.say(excitation_heading(found), "bold")
    for table in excitation_tables(found):
        screen.show(table)
    for line in excitation_findings(project, found):
        screen.say(f"* {line}")
    if not any(path.name.startswith(f"{TRIAL}.") for path in written):
        screen.say(f"* {NO_TRIAL}")
    for path in written:
        what = "Configuration" if path.name == DRAFT else _KINDS.get(path.suffix)
        if what:
            tell(screen, what, path)
    screen.remark("Beside each motion (.csv) is the same as .npz, and as .trajectory.yaml for ROS 2.")
    if any(path.name == DRAFT for path in written):
        screen.remark(f"Next, when both are recorded: {command('check', out / DRAFT)}", whole=True)


_KINDS = {".csv": "Motion", ".json": "Numbers", ".html": "Report"}
