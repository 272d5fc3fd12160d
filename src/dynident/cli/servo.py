"""``dynident identify`` for arms of position servos: fitted in MuJoCo, written as its model."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from dynident.cli.failures import command
from dynident.cli.terminal import console, print_path

if TYPE_CHECKING:
    from dynident.apps.servo import ServoIdentification
    from dynident.files.folder import ResultFolder
    from dynident.project.project import Project

STYLES = {"good for simulation": "green", "simulate with care": "yellow", "do not use": "red"}


def identify_servos(project: Project, folder: ResultFolder | None) -> tuple[ServoIdentification, tuple[Path, ...]]:
    """Identify an arm of position servos, and write its files into a folder; return both.

    Raises the errors of ``dynident.apps.servo.identify_servo``, and ConfigError before the fit where the folder holds
    the report of another command.
    """
    from dynident.apps.servo import MODEL, NUMBERS, PAGE, identify_servo, servo_dict, servo_page
    from dynident.files.folder import refuse_other_report
    from dynident.files.opener import refuse_inputs
    from dynident.files.results import json_text

    if folder is not None:
        refuse_other_report(folder.path, NUMBERS)
        refuse_inputs(*(folder.path / name for name in (MODEL, NUMBERS, PAGE)))
    result = identify_servo(project)
    if folder is None:
        return result, ()
    files = {MODEL: result.mjcf, NUMBERS: json_text(servo_dict(result)), PAGE: servo_page(result)}
    return result, folder.replace(files)


def print_servos(written: tuple[ServoIdentification, tuple[Path, ...]], config: Path, out: Path | None) -> None:
    """Print verdict, values and files of an arm of position servos."""
    from dynident.apps.servo import parameter_table, rollout_table, suspect_lines, verdict_words

    result, paths = written
    screen = console()
    screen.show(parameter_table(result))
    screen.show(rollout_table(result))
    for line in (*suspect_lines(result), *result.warnings):
        screen.remark(f"Warning: {line}", "yellow")
    for label, path in zip(("Model", "Numbers", "Report"), paths, strict=False):
        print_path(screen, label, path)
    if out is None:
        hint = command("identify", config, "--out", f"{config.stem}-out")
        screen.remark(f"To keep this, as a model of MuJoCo with a report: {hint}", no_wrap=True)
    screen.say(verdict_words(result), f"bold {STYLES.get(str(result.use), 'yellow')}")
