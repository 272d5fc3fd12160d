"""``dynident identify`` for arms of position servos: fitted in MuJoCo, written as its model."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dynident.cli.failures import command
from dynident.cli.terminal import console, print_files, print_path, status
from dynident.runtime import number

if TYPE_CHECKING:
    from dynident.apps.servo import ServoIdentification
    from dynident.apps.servo.predict import ServoPrediction

OPTION_NAMES = {"parameters": "parameter", "file_rate": "file-rate"}  # of keys that are called otherwise
CHIRP_OPTIONS = ("duration", "rate", "floor", "packages", "grippers", "seed")  # that chirps have
STYLES = {"good for simulation": "green", "simulate with care": "yellow", "do not use": "red"}


def print_servos(result: ServoIdentification, config: Path, out: Path | None) -> None:
    """Print verdict, values and files of an arm of position servos."""
    from dynident.apps.servo import MODEL, NUMBERS, PAGE, parameter_table, rollout_table, suspect_lines, verdict_words

    screen = console()
    for table in (parameter_table(result), rollout_table(result)):
        screen.show(table, detail=True)
    for line in (*suspect_lines(result), *result.warnings):
        screen.remark(f"Warning: {line}", "yellow")
    if out is None:
        hint = command("identify", config, "--out", f"{config.stem}-out")
        screen.remark(f"To keep this, as a model of MuJoCo with a report: {hint}", no_wrap=True)
    else:
        print_files(screen, [out / name for name in (MODEL, NUMBERS, PAGE)])
        hint = command("export", out / NUMBERS, "--format", "isaac", "--out", out / f"{result.name}_isaac.py")
        screen.remark(f"For other simulators: {hint}", no_wrap=True)
    screen.say(verdict_words(result), f"bold {STYLES.get(str(result.use), 'yellow')}")


def print_prediction(prediction: ServoPrediction, out: Path | None) -> None:
    """Print the errors of rollouts, and write them into a file."""
    from dynident.apps.servo import rollout_frame, rollout_table
    from dynident.files.results import write_table

    screen = console()
    for line in prediction.warnings:
        screen.remark(f"Warning: {line}", "yellow")
    screen.show(rollout_table(prediction))
    if out:
        print_path(screen, "Positions", write_table(out, rollout_frame(prediction)))


def write_chirps(
    robot: Path, out: Path, settings: Path | None, changes: Mapping[str, Any], *, allow_code: bool
) -> None:
    """Write commands that show the values of servos, and the configuration that reads their recordings.

    Raises ConfigError where ``robot`` is no robot file, or a file that was changed by hand would be replaced, and the
    errors of reading and of ``design_chirps``.
    """
    from dynident.apps.excitation import DEFAULT_RATE, DEFAULT_SPEED, command_csv, design_chirps
    from dynident.apps.excitation.robot import read_excitation
    from dynident.apps.init.servo_config import servo_config
    from dynident.files.folder import result_folder
    from dynident.files.opener import refuse_inputs
    from dynident.files.xml_text import SUFFIXES
    from dynident.project.project import parse_project
    from dynident.runtime import ConfigError

    if robot.suffix.lower() not in SUFFIXES:
        raise ConfigError(f"{robot}: --for servo takes a robot file (URDF, MJCF); settings go into --settings FILE.")
    if others := [f"--{OPTION_NAMES.get(key, key)}" for key in changes if key not in CHIRP_OPTIONS]:
        raise ConfigError(f"{', '.join(others)}: of no use with --for servo, whose motions are chirps; leave it out.")
    with result_folder(out) as folder, status():
        refuse_inputs(*(folder.path / name for name in ("motion.csv", "validation.csv", "identify.yaml")))
        if (folder.path / "identify.yaml").exists():
            raise ConfigError(f"{out / 'identify.yaml'}: exists already, perhaps edited; choose another folder.")
        project = read_excitation(
            robot, settings, {**changes, "grippers": True}, allow_code=allow_code, defaults={"rate": DEFAULT_RATE},
            speed=DEFAULT_SPEED,
        )  # fmt: skip
        motion, validation = design_chirps(project)
        text, blanks = servo_config(str(robot), project.prior.model.joints, folder.path)
        parse_project(text, folder.path / "identify.yaml")  # what is written can be read
        files = {"motion.csv": command_csv(motion), "validation.csv": command_csv(validation), "identify.yaml": text}
        written = folder.replace(files)
    screen = console()
    print_files(screen, written)
    screen.remark(
        f"{motion.t[-1]:.3g} s at {number(1 / (motion.t[1] - motion.t[0]), 3)} Hz, from the pose of the first row, "
        "where the arm has to be; its torques are not checked. Record what was commanded and reached, under the names "
        "in identify.yaml."
    )
    for line in blanks:
        screen.remark(f"Fill in: {line}")
    screen.remark(f"Next, when both are recorded: {command('check', out / 'identify.yaml')}", no_wrap=True)
