"""``dynident smooth``: smooth and differentiate columns of a file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import click

from dynident.cli.terminal import DIRECTORY, LOG, console, tell

__all__ = ["smooth"]


@click.command(short_help="Smooth and differentiate columns of a file.")
@click.argument("log", type=LOG)
@click.option("--time", "time_column", required=True, help="Column of the time stamps (s).")
@click.option("--column", "columns", multiple=True, help="Column to smooth; repeat it. Default: all but the time.")
@click.option(
    "--rule", type=click.Choice(["constraint", "gcv", "reml", "interpolate"]), default="constraint", show_default=True,
    help="How much to smooth: S = n with the noise, cross-validation, restricted likelihood, or not at all.",
)  # fmt: skip
@click.option("--sigma", type=float, help="Standard deviation of the noise; estimated where it is not given.")
@click.option("--lam", type=float, help="A fixed smoothing parameter instead of a rule.")
@click.option("--out", type=DIRECTORY, default="smooth-out", show_default=True, help="Folder for the results.")
def smooth(
    log: Path, time_column: str, columns: tuple[str, ...], rule: str, sigma: float | None, lam: float | None, out: Path
) -> None:
    """Smooth columns of LOG; write values and derivatives (smoothed.csv) and a plot (report.html)."""
    from dynident.errors import ConfigError
    from dynident.io.columns import read_name
    from dynident.io.fields import UNITS
    from dynident.io.opener import keep, refuse_inputs
    from dynident.io.results import write_table, write_text
    from dynident.io.tables import read_columns
    from dynident.report.page import terminal
    from dynident.report.smoothing import smoothed_columns, smoothing_page, smoothing_table
    from dynident.splines import Fixed, rule_named

    if lam is not None and rule != "constraint":
        raise ConfigError(f"--lam and --rule {rule} contradict each other; give one of them.")
    keep(log)
    refuse_inputs(out / "smoothed.csv", out / "report.html")
    chosen = rule_named(rule) if lam is None else Fixed(lam=lam)
    table = read_columns(log)
    found = smoothed_columns(table, time_column, columns, chosen, sigma)
    page = smoothing_page(log.name, found.names, found.measured, found.fit)
    screen = console()
    if (unit := read_name(time_column, ()).unit) in UNITS["time"] and unit != "s":
        note = (
            f"{time_column!r} is read as seconds, but its name says {unit}: derivatives and bandwidths are per {unit}."
        )
        table = replace(table, notes=(*table.notes, note))
    for note in table.notes:
        screen.print(f"Warning: {note}", style="yellow", soft_wrap=True, highlight=False, markup=False)
    screen.print(terminal(smoothing_table(found.names, found.fit)))
    tell(screen, "Table", write_table(out / "smoothed.csv", found.frame()))
    tell(screen, "Report", write_text(out / "report.html", page))
