"""Figures of parameters: their intervals, and the singular values that tell how many of them the data show."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dynident.report.figures.canvas import BLUE, GRID, INK, RED, Array, Drawing, Trace, panels, plain, trace
from dynident.splines import NORMAL_95

if TYPE_CHECKING:
    from dynident.models import Model
    from dynident.regression import BaseParameters

__all__ = ["interval_figure", "only_nominal", "relative_std", "singular_figure"]

WIDEST = 100.0  # % of a parameter's value at which the axis ends
LEAST = 1e-20  # relative singular values below it are zero but for rounding
LONGEST = 30  # letters of a name at the axis; the rest shows when pointed at


def interval_figure(
    names: Sequence[str], units: Sequence[str], value: Array, std: Array, known: Sequence[float | None] = ()
) -> Drawing:
    """Draw the 95 % interval (1.96 standard errors) of each parameter (k) in % of its value, one row per parameter.

    The axis ends at 100 %: a bar that leaves it means that not even the sign is known. Parameters that the data do not
    determine (infinite standard error, or a value of zero) are hollow and have no bar; a blue cross is the distance
    of the true value ``known``, where there is one, in % of the estimate.
    """
    rows = list(range(len(names)))
    value, std = np.asarray(value, dtype=float), np.asarray(std, dtype=float)
    relative = relative_std(value, std)
    sure = np.isfinite(relative)
    half = np.where(sure, np.minimum(NORMAL_95 * relative, 1e6), 0.0)
    signs = zip(names, value, std, units, strict=True)
    words = [f"{plain(name)}: {v:.4g} ± {NORMAL_95 * s:.2g} {plain(unit)}" for name, v, s, unit in signs]
    figure = panels([""], 105 + 20 * len(names), shared=False)
    figure.add(_intervals(words, half, sure))
    marked = [k for k, true in enumerate(known) if true is not None and sure[k]]
    if marked:
        true = np.array([known[k] for k in marked], dtype=float)
        away = 100 * (true - value[marked]) / np.abs(value[marked])
        figure.add(_crosses([plain(names[k]) for k in marked], true, away, marked))
    reach = float(np.clip(1.2 * half.max(initial=0.0), 0.01, WIDEST))
    shown = [plain(name if len(name) <= LONGEST else f"{name[:LONGEST]}…") for name in names]
    figure.axes("y", tickvals=rows, ticktext=shown, range=[len(names) - 0.5, -0.5])
    figure.axes("x", range=[-reach, reach], title="95 % interval, % of the value", zeroline=True, zerolinecolor=GRID)
    figure.layout.update(hovermode="closest", showlegend=True)
    return figure


def _intervals(words: Sequence[str], half: Array, sure: NDArray[np.bool_]) -> Trace:
    """Return a mark per parameter (k) with its interval to both sides (%), hollow where it is not ``sure``."""
    return trace(
        "scatter",
        x=np.zeros(len(words)),
        y=list(range(len(words))),
        error_x={"array": half, "color": RED, "thickness": 1.6, "width": 4},
        mode="markers",
        name="estimate with its 95 % interval" + ("" if sure.all() else " (hollow: not determined, or zero)"),
        marker={"color": RED, "size": 8, "symbol": ["circle" if ok else "circle-open" for ok in sure]},
        text=words,
        hovertemplate="%{text} (95 % interval)<extra></extra>",
    )


def _crosses(names: Sequence[str], true: Array, away: Array, rows: Sequence[int]) -> Trace:
    """Return a cross per known parameter, ``away`` (%) from its estimate."""
    return trace(
        "scatter",
        x=away,
        y=rows,
        mode="markers",
        name="true value",
        marker={"color": BLUE, "size": 11, "symbol": "x-thin", "line": {"color": BLUE, "width": 2}},
        customdata=true,
        text=names,
        hovertemplate="%{text}: true value %{customdata:.4g}<extra></extra>",
    )


def relative_std(value: Array, std: Array) -> Array:
    """Return the standard errors (p) in % of the values; infinite where the value is zero."""
    value, std = np.asarray(value), np.asarray(std)
    relative: Array = np.full(len(value), np.inf)
    with np.errstate(over="ignore"):
        np.divide(100 * std, np.abs(value), out=relative, where=value != 0)
    return relative


def only_nominal(model: Model) -> bool:
    """Tell whether the parameters' known values are only nominal, as those of a robot file, which knows bodies."""
    return any(parameter.body for parameter in model.parameters)


def singular_figure(basis: BaseParameters) -> Drawing:
    """Draw the singular values of the column-scaled regressor, largest first; those beyond the rank are hollow."""
    values = np.asarray(basis.singular_values, dtype=float)
    figure = panels(["singular value, relative"], 300, shared=False)
    order, relative = np.arange(1, len(values) + 1), values / (values[:1] if values[0] > 0 else 1.0)
    for name, rows, colour, symbol in (
        ("seen by the data", order <= basis.rank, BLUE, "circle"),
        ("not seen", order > basis.rank, INK, "circle-open"),
    ):
        rows = rows & (relative > LEAST)
        if rows.any():
            marker = {"color": colour, "size": 6, "symbol": symbol}
            figure.add(
                trace(
                    "scatter",
                    x=order[rows],
                    y=relative[rows],
                    mode="markers",
                    name=name,
                    marker=marker,
                    meta="ink" if colour == INK else None,
                    hovertemplate="number %{x}: %{y:.2g}<extra></extra>",
                )
            )
    figure.axes("y", type="log", exponentformat="power", nticks=8, tickfont={"size": 11})
    figure.axes("x", title="number of the singular value")
    figure.layout.update(hovermode="closest")
    return figure
