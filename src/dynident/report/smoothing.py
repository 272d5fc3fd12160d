"""The report of ``dynident smooth``: columns of a file, smoothed and differentiated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from dynident.errors import ConfigError, InputError
from dynident.report import figures
from dynident.report.page import Column, Figure, PageSection, PageTable, number, render
from dynident.splines import Rule, SmoothingSpline, smooth

if TYPE_CHECKING:
    import polars as pl

    from dynident.io.tables import DataTable as Columns

__all__ = ["Smoothed", "smoothed_columns", "smoothing_page", "smoothing_table"]

_PREFIXES = ("", "d_", "dd_")  # of the names of values, first and second derivatives
_HEADS = {"sigma": "sigma", "noise": "noise left", "S": "S", "lam": "lam", "edf": "edf", "bandwidth": "bandwidth, s"}


@dataclass(frozen=True, eq=False)
class Smoothed:
    """Columns of a file with their spline: ``names`` (k) of ``measured`` (N, k), over the column ``time``.

    ``stamps`` (N) are the values of that column, in its own unit.
    """

    time: str
    stamps: figures.Array
    names: tuple[str, ...]
    measured: figures.Array
    fit: SmoothingSpline

    def frame(self) -> pl.DataFrame:
        """Return a table of the time, the smoothed columns, and their first (d_) and second (dd_) derivatives."""
        import polars as pl

        found = {self.time: self.stamps}
        for order, prefix in enumerate(_PREFIXES):
            values = self.fit.derivative(order)
            found |= {f"{prefix}{name}": values[:, k] for k, name in enumerate(self.names)}
        return pl.DataFrame(found)


def smoothed_columns(
    table: Columns, time: str, columns: Sequence[str], rule: Rule, sigma: float | None = None, unit: float = 1.0
) -> Smoothed:
    """Smooth ``columns`` of a table, by default all but the ``time``; ``sigma`` in their unit, None: estimated.

    ``unit`` is that of the time, in s; derivatives are per s.

    Raises InputError for columns that are missing, differ in length or cannot be smoothed, ConfigError where a column
    has the name of another one's derivative.
    """
    stamps = table.column(time)
    names = tuple(columns) or tuple(name for name in table.columns if name != time)
    if not names:
        raise InputError(f"{table.source}: holds no column besides {time!r} to smooth.")
    _check_names(table.source, (*names, time), [f"{prefix}{name}" for prefix in _PREFIXES[1:] for name in names])
    wrong = [name for name in names if len(table.column(name)) != len(stamps)]
    if wrong:
        raise InputError(f"{table.source}: column {wrong[0]!r} and {time!r} differ in length.")
    measured = np.column_stack([table.column(name) for name in names])
    return Smoothed(time, stamps, names, measured, smooth(unit * stamps, measured, rule, sigma=sigma))


def _check_names(source: str, columns: Sequence[str], derivatives: Sequence[str]) -> None:
    clash = [name for name in derivatives if name in columns]
    if clash:
        raise ConfigError(f"{source}: {clash[0]!r} would name both a column and a derivative; choose with --column.")


def smoothing_table(names: Sequence[str], fit: SmoothingSpline) -> PageTable:
    """Return what was chosen for each column: noise, S, lam, effective degrees of freedom, bandwidth."""
    values = [np.atleast_1d(getattr(fit, key)) for key in _HEADS]
    rows = tuple((name, *(number(float(value[k])) for value in values)) for k, name in enumerate(names))
    return PageTable((Column("column", numeric=False), *map(Column, _HEADS.values())), rows, "Smoothing per column")


def smoothing_page(source: str, names: Sequence[str], measured: np.ndarray, fit: SmoothingSpline) -> str:
    """Return the page: the table, and per column the measured and smoothed values with both derivatives."""
    parts = [fit.derivative(order) for order in range(3)]
    sections = [PageSection("Smoothing", (smoothing_table(names, fit),))]
    for k, name in enumerate(names):
        figure = figures.smoothing_figure(fit.t, measured[:, k], [part[:, k] for part in parts])
        sections.append(PageSection(name, (Figure(figure, name),)))
    return render(f"Smoothed {source}", "Natural cubic smoothing splines and their derivatives.", sections)
