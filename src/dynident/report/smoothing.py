"""The report of ``dynident smooth``: columns of a file, smoothed and differentiated."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dynident import plot
from dynident.report.page import Column, Figure, Section, Table, number, render
from dynident.splines import SmoothingSpline

__all__ = ["smoothing_page", "smoothing_table"]

_HEADS = {"sigma": "sigma", "noise": "noise left", "S": "S", "lam": "lam", "edf": "edf", "bandwidth": "bandwidth, s"}


def smoothing_table(names: Sequence[str], fit: SmoothingSpline) -> Table:
    """Return what was chosen for each column: noise, S, lam, effective degrees of freedom, bandwidth."""
    values = [np.atleast_1d(getattr(fit, key)) for key in _HEADS]
    rows = tuple((name, *(number(float(value[k])) for value in values)) for k, name in enumerate(names))
    return Table((Column("column", numeric=False), *map(Column, _HEADS.values())), rows, "Smoothing per column")


def smoothing_page(source: str, names: Sequence[str], measured: np.ndarray, fit: SmoothingSpline) -> str:
    """Return the page: the table, and per column the measured and smoothed values with both derivatives."""
    parts = [fit.derivative(order) for order in range(3)]
    sections = [Section("Smoothing", (smoothing_table(names, fit),))]
    for k, name in enumerate(names):
        figure = plot.smoothing_figure(fit.t, measured[:, k], [part[:, k] for part in parts])
        sections.append(Section(name, (Figure(figure, name),)))
    return render(f"Smoothed {source}", "Natural cubic smoothing splines and their derivatives.", sections)
