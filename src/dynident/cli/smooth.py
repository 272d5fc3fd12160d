"""``dynident smooth``: smooth and differentiate columns of a file."""

from __future__ import annotations

from pathlib import Path

import click

from dynident.cli.options import DIRECTORY, LOG
from dynident.cli.terminal import console, tell

__all__ = ["smooth"]


@click.command(short_help="Smooth and differentiate columns of a file.")
@click.argument("log", type=LOG)
@click.option("--time", "time_column", required=True, help="Column of the time stamps.")
@click.option("--time-unit", "unit", help="Unit of the time stamps; default: the one in the column's name, else s.")
@click.option("--column", "columns", multiple=True, help="Column to smooth; repeat it. Default: all but the time.")
@click.option(
    "--rule", type=click.Choice(["constraint", "gcv", "reml", "interpolate"]), default="constraint", show_default=True,
    help="How much to smooth: S = n with the noise, cross-validation, restricted likelihood, or not at all.",
)  # fmt: skip
@click.option("--sigma", type=float, help="Standard deviation of the noise; estimated where it is not given.")
@click.option("--lam", type=float, help="A fixed smoothing parameter instead of a rule.")
@click.option("--out", type=DIRECTORY, default="smooth-out", show_default=True, help="Folder for the results.")
def smooth(
    log: Path,
    time_column: str,
    unit: str | None,
    columns: tuple[str, ...],
    rule: str,
    sigma: float | None,
    lam: float | None,
    out: Path,
) -> None:
    """Smooth columns of LOG; write values and derivatives (smoothed.csv) and a plot (report.html).

    Derivatives and bandwidths are per s and in s, whatever the unit of the time stamps.
    """
    from dynident.errors import ConfigError
    from dynident.io.columns import read_name
    from dynident.io.fields import unit_factor
    from dynident.io.folder import result_folder
    from dynident.io.opener import keep, refuse_inputs
    from dynident.io.tables import read_columns
    from dynident.report.smoothing import smoothed_columns, smoothing_page, smoothing_table
    from dynident.splines import Fixed, rule_named

    if lam is not None and rule != "constraint":
        raise ConfigError(f"--lam and --rule {rule} contradict each other; give one of them.")
    if unit is not None:
        unit_factor(unit, "time", "--time-unit")
    keep(log)
    refuse_inputs(out / "smoothed.csv", out / "report.html")
    chosen = rule_named(rule) if lam is None else Fixed(lam=lam)
    with result_folder(out) as folder:
        table = read_columns(log)
        fixed = table.units.get(time_column)
        if fixed is not None and unit not in (None, fixed):
            raise ConfigError(
                f"--time-unit: {time_column!r} holds dates, times or durations, read in {fixed}: not {unit!r}."
            )
        named = read_name(time_column, ())
        used = unit or fixed or (named.unit if named.role == "time" else None) or "s"
        found = smoothed_columns(table, time_column, columns, chosen, sigma, unit_factor(used, "time", "--time-unit"))
        page = smoothing_page(log.name, found.names, found.measured, found.fit)
        written = folder.replace({"smoothed.csv": found.frame().write_csv(), "report.html": page})
    screen = console()
    if unit is None and used != "s":
        note = f"{time_column!r} is read in {used}, as its name says; else give --time-unit."
        screen.remark(note)
    for note in table.notes:
        screen.remark(f"Warning: {note}", "yellow")
    screen.show(smoothing_table(found.names, found.fit))
    for what, path in zip(("Table", "Report"), written, strict=True):
        tell(screen, what, path)
