"""The figure of two results: by how many standard errors their base parameters differ."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from dynident.report.figures.canvas import BLUE, GRID, RED, Drawing, Trace, panels, plain, trace

if TYPE_CHECKING:
    from dynident.identification import BaseDifference, ResultComparison

__all__ = ["difference_figure"]

FAR = 20.0  # standard errors beyond which a mark stands at the edge


def difference_figure(found: ResultComparison) -> Drawing:
    """Draw the difference of each base parameter in its standard errors, in the order of the parameters of the first;
    those that differ significantly are triangles. The band holds 95 % of what chance makes."""
    order = {name: k for k, name in enumerate(found.first.base_names)}
    rows = sorted(found.base, key=lambda one: order[one.name])
    figure = panels([""], 330, shared=False)
    marked = {one.name for one in found.significant}
    for name, colour, symbol, chosen in (
        ("no significant difference", BLUE, "circle", [k for k, one in enumerate(rows) if one.name not in marked]),
        ("significant", RED, "triangle-up", [k for k, one in enumerate(rows) if one.name in marked]),
    ):
        if chosen:
            figure.add(_marks(name, colour, symbol, chosen, rows))
    most = max([3.0, *(min(abs(one.z), FAR) for one in rows)])
    figure.axes("y", title="difference, standard errors", range=[-1.15 * most, 1.15 * most], zeroline=True)
    figure.axes("x", title="base parameter, in the order of the reference", range=[-1, len(rows)])
    band = {"type": "rect", "xref": "paper", "x0": 0, "x1": 1, "y0": -1.96, "y1": 1.96}
    figure.layout.update(
        hovermode="closest",
        showlegend=True,
        shapes=[{**band, "fillcolor": GRID, "line": {"width": 0}, "layer": "below"}],
    )
    return figure


def _marks(name: str, colour: str, symbol: str, chosen: list[int], rows: list[BaseDifference]) -> Trace:
    text = [
        f"{plain(one.name)}: {one.first:.4g} ± {one.first_std:.2g}, then {one.second:.4g} ± {one.second_std:.2g} "
        f"{plain(one.unit)}; {one.z:+.2g} standard errors"
        for one in (rows[k] for k in chosen)
    ]
    return trace(
        "scatter",
        x=chosen,
        y=np.clip([rows[k].z for k in chosen], -FAR, FAR),
        mode="markers",
        name=name,
        marker={"color": colour, "size": 9, "symbol": symbol},
        text=text,
        hovertemplate="%{text}<extra></extra>",
    )
