"""Runs that come with dynident: ``dynident demo``, the arm whose truth is known, and ``reproduce``, the article."""

from __future__ import annotations

import os
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, cast

import click

from dynident.cli.failures import command
from dynident.cli.identification import draft_from_files
from dynident.cli.options import DIRECTORY, JSON_FILE, WorkerOptions, add_worker_options
from dynident.cli.terminal import console, print_files, status

if TYPE_CHECKING:
    from dynident.apps.demo import Comparison
    from dynident.cli.screen import Screen

LOGS = ("monday.parquet", "tuesday.parquet")
SHORT_WATCH = ("--once", "--block", 0.5, "--baseline", 10)  # of a recording of 15 s
PRELOADED_MODULES = ("dynident.apps.article.article",)  # by all workers at once


@click.command(short_help="Identify the simulated arm that comes with dynident.")
@click.option("--out", type=DIRECTORY, default="arm-out", show_default=True, help="Folder for the arm's files.")
@click.option("--files", is_flag=True, help="Only write the arm's files, for the tutorial.")
@click.option("--servo", is_flag=True, help="An arm of position servos: commands in, a MuJoCo model out.")
def demo(out: Path, files: bool, servo: bool) -> None:
    """Identify a simulated arm whose truth is known, from its robot file and two recordings, which come with dynident.

    The commands are printed as they run. The folder stays, so that you can try others.
    """
    from dynident.apps.demo import compare_with_truth, demo_files
    from dynident.files.opener import remember_inputs
    from dynident.project.saved import load

    screen = console()
    if servo:
        _run_servos(screen, out, only_files=files)
        return
    demo_files(out)
    for name in ("arm.urdf", *LOGS):
        remember_inputs(out / name)
    screen.say(f"{out.resolve()} has a robot file, arm.urdf, and two simulated recordings of that arm.")
    if files:
        return
    _draft_config(screen, out)
    _run(screen, "check", out / "robot.yaml")
    _run(screen, "identify", out / "robot.yaml", "--out", out / "result")
    _show_comparison(screen, compare_with_truth(load(out / "result" / "result.json")))
    _print_heading(screen, "Next")
    for title, hint in _next_steps(out):
        screen.remark(f"{title}:")
        screen.remark(f"  {hint}", no_wrap=True)


def _run_servos(screen: Screen, out: Path, *, only_files: bool) -> None:
    """Write the files of the arm of servos, identify it, and compare it with the truth."""
    from dynident.apps.demo import TRUE_DELAY, TRUE_VALUES, servo_files
    from dynident.apps.servo import identify_servos
    from dynident.cli.servo import print_servos
    from dynident.files.results import write_text

    with status():
        files = servo_files(out)
    screen.say(f"In {out.resolve()}: a robot file, servos.xml, and two recordings: commands, positions, no torque.")
    if only_files:
        return
    config = out / "servos.yaml"
    _print_heading(screen, f"$ {command('init', *files, '-o', config)}")
    write_text(config, draft_from_files(str(files[0]), [str(file) for file in files[1:]], out)[0].text)
    _print_heading(screen, f"$ {command('identify', config, '--out', out / 'servos')}")
    with status():
        result = identify_servos(config, out / "servos")
    print_servos(result, config, out / "servos")
    values = result.fit.values
    errors = [abs(getattr(values, key) / true - 1).max() for key, true in TRUE_VALUES.items()]
    _print_heading(screen, "How far that is from the truth, which only a simulation knows")
    screen.say(
        f"Armature, damping and dry friction are at most {100 * max(errors):.2g} % off, where servos.xml was off by "
        f"factors of 2 to 3; the delay, {1e3 * TRUE_DELAY:g} ms, by {1e3 * abs(values.delay - TRUE_DELAY):.2g} ms."
    )


def _next_steps(out: Path) -> tuple[tuple[str, str], ...]:
    """Return what can be done with the folder: titles, and commands or paths."""
    config, result = out / "robot.yaml", out / "result"
    return (
        ("Open the report in a browser", str((result / "report.html").resolve())),
        ("Predict the torque of a recording", command("predict", result / "result.json", out / LOGS[1])),
        ("Watch that recording for changes", command("watch", result / "result.json", out / LOGS[1], *SHORT_WATCH)),
        ("See how accurate any method could be", command("bound", config)),
        ("Repeat the simulation study of the article", command("reproduce")),
        ("Start with your own robot", command("init", "YOUR.urdf", "MONDAY.csv", "TUESDAY.csv")),
    )


def _print_heading(screen: Screen, text: str) -> None:
    screen.say("")
    screen.say(text, "bold")


def _draft_config(screen: Screen, out: Path) -> None:
    """Draft robot.yaml; raises InputError where another, perhaps edited, one exists."""
    from dynident.files.opener import content
    from dynident.files.results import write_text
    from dynident.runtime import InputError

    config = out / "robot.yaml"
    files = [out / name for name in ("arm.urdf", *LOGS)]
    _print_heading(screen, f"$ {command('init', *files, '-o', config)}")
    with status():
        text = draft_from_files(str(out / "arm.urdf"), [str(out / name) for name in LOGS], out)[0].text
    if os.path.lexists(config) and content(config, remember=False) != text.encode():
        raise InputError(f"{config}: exists already, and is not the one that is drafted; give another folder by --out.")
    write_text(config, text)
    screen.say("robot.yaml names the column and unit of each joint's position and torque.")


def _run(screen: Screen, name: str, *words: object) -> None:
    """Print a command, and run it."""
    _print_heading(screen, f"$ {command(name, *words)}")
    root = click.get_current_context().find_root()
    work = cast("click.Group", root.command).commands[name]
    with work.make_context(name, list(map(str, words)), root) as context:
        work.invoke(context)


def _show_comparison(screen: Screen, comparison: Comparison) -> None:
    from dynident.report.page import UNIT, PageTable
    from dynident.runtime import number

    _print_heading(screen, "Compared with the true arm, which is known because it is simulated")
    screen.say(
        f"On another motion the model's torque differs from the true one by {number(comparison.torque_error, 2)} %. "
        f"The inertias of arm.urdf, with the true friction, differ by {number(comparison.file_error, 2)} %."
    )
    screen.say(
        f"{comparison.within} of {comparison.base} base parameters are within 1.96 standard errors of the truth; 95 % "
        "are expected."
    )
    rows = (
        (value.name, number(value.estimate, 4), number(value.true, 4), number(value.std, 2), value.unit)
        for value in comparison.values
    )
    screen.show(PageTable.of(("",), ("identified", "true", "std. error", UNIT), rows))


@click.command(short_help="Repeat the simulation study of the article.")
@click.option("--scenario", default="tabulated", show_default=True, help="tabulated, stated or weak.")
@click.option("--runs", default=30, show_default=True, help="Recordings per noise level.")
@click.option("--seed", default=0, show_default=True, help="Seed of the noise.")
@click.option(
    "--methods", default="raw,filtered,spline", show_default=True,
    help="Methods, separated by commas; also spline-early (the transient dropped before smoothing), ml (maximum "
    "likelihood), any kind of smoother, and any kind of estimator, on the article's spline.",
)  # fmt: skip
@add_worker_options
@click.option("--out", type=DIRECTORY, help="Folder for report.html and study.parquet; a study in it is resumed.")
@click.option("--rerun", is_flag=True, help="Compute all runs anew, also those of an earlier study in the folder.")
@JSON_FILE
def reproduce(
    scenario: str, runs: int, seed: int, methods: str, spread: WorkerOptions, out: Path | None, rerun: bool,
    json_file: Path | None,
) -> None:  # fmt: skip
    """Run the article's study (sec. 3) again and print its tables 2-7 beside the published numbers and the bound."""
    from dynident.apps.article import article, study_page, study_text
    from dynident.files.folder import result_folder
    from dynident.files.results import claim_json, write_json
    from dynident.runtime.kernel import kernel

    claim_json(json_file)
    names = [name.strip() for name in methods.split(",") if name.strip()]
    table = out / "study.parquet" if out else None
    with result_folder(out) if out else nullcontext() as folder:
        with status(), spread.executor(*PRELOADED_MODULES) as executor:
            reproduction = article.reproduce(
                scenario, runs, seed, names, path=table, executor=executor, limits=spread.limits, rerun=rerun
            )
        written = folder.replace({"report.html": study_page(reproduction)}) if folder else ()
    screen = console()
    screen.print_and_log(study_text(reproduction))
    screen.remark(f"Computed by {kernel()}.", detail=True)
    if json_file:
        write_json(json_file, reproduction.summary())
    print_files(screen, written)
