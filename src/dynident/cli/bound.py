"""``dynident bound``: the accuracy that any method can reach with this robot, motion and sensors."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, cast

import click

from dynident.cli.options import CONFIG, DIRECTORY, FILE, noise_given
from dynident.cli.terminal import console, say_line, status, tell

if TYPE_CHECKING:
    from dynident.bounds import TorqueNoise

__all__ = ["bound"]


@click.command(short_help="Show the best accuracy that any method can reach.")
@click.argument("config", type=CONFIG)
@click.option("--sigma-q", multiple=True, help="Position noise (rad, m): a number, or joint=number; repeat it.")
@click.option("--sigma-tau", multiple=True, help="Torque noise (N m, N): a number, or joint=number; repeat it.")
@click.option(
    "--torque", type=click.Choice(["residual", "sensor"]), default="residual", show_default=True,
    help="Torque noise: the residual of the fit, or the scatter between neighbouring samples.",
)  # fmt: skip
@click.option("--out", type=DIRECTORY, help="Folder for report.html and bound.json.")
@click.option("--json", "json_file", type=FILE, help="File for all numbers.")
def bound(
    config: Path, sigma_q: tuple[str, ...], sigma_tau: tuple[str, ...], torque: str, out: Path | None,
    json_file: Path | None,
) -> None:  # fmt: skip
    """Show how accurately any unbiased method can determine each parameter from the training logs of CONFIG (YAML),
    what limits it, and what one more encoder bit, a ten times better torque sensor or a longer record would gain.
    """
    from dynident.io.folder import result_folder
    from dynident.io.opener import refuse_inputs
    from dynident.io.project import read_project
    from dynident.io.results import check_json, json_text, probe_folder, write_text
    from dynident.report.bound import bound_dict, bound_findings, bound_page, bound_table, noise_table
    from dynident.report.wording import Line, note_lines

    if json_file:
        check_json(json_file)
    targets = [json_file] if json_file else []
    targets += [out / "bound.json", out / "report.html"] if out else []
    if json_file:
        probe_folder(json_file.parent)
    with result_folder(out) if out else nullcontext() as folder:
        given = noise_given("--sigma-q", sigma_q), noise_given("--sigma-tau", sigma_tau)
        with status() as say:
            project = read_project(config, say)
            refuse_inputs(*targets)
            found = project.bound(*given, cast("TorqueNoise", torque), say)
        numbers = json_text(bound_dict(found))
        written = folder.replace({"bound.json": numbers, "report.html": bound_page(found)}) if folder else ()
    screen = console()
    for table in (noise_table(found), bound_table(found, short=True)):
        screen.show(table)
    for line in (*map(Line, bound_findings(found)), *note_lines(found.identification.notes)):
        say_line(screen, line)
    if json_file:
        tell(screen, "Numbers", write_text(json_file, numbers))
    for what, path in zip(("Numbers", "Report"), written, strict=False):
        tell(screen, what, path)
