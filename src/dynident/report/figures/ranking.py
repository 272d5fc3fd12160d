"""The figures of a comparison: errors of all combinations with their differences to the best, and what they cost."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import groupby
from typing import TYPE_CHECKING

from dynident.report.figures.canvas import AMBER, BLUE, GREEN, INK, RED, VIOLET, Drawing, Trace, panels, plain, trace

if TYPE_CHECKING:
    from dynident.ranking import Ranked, Ranking

__all__ = ["cost_figure", "ranking_figure"]

COLOURS = (BLUE, RED, GREEN, AMBER, VIOLET, INK)
SYMBOLS = ("circle", "square", "diamond", "triangle-up", "cross", "x", "star")
FAR = 30.0  # times the least error, beyond which a mark stands at the edge
LINE = 15  # px of a combination
WIDE = 4.0  # ratio of the ends of an axis from which on it is logarithmic


def ranking_figure(found: Ranking) -> Drawing:
    """Draw the error of each combination, grouped by estimator, one mark a smoother; the line through a mark is the
    95 % interval of its difference to the best, whose error is the dashed line. Open marks are worse by more than
    chance."""
    places, names, centres = _places(found)
    figure = panels([""], 110 + LINE * (int(max(places.values(), default=0)) + 1), shared=False)
    least = found.ranked[0].error
    edge = FAR * least
    for k, name in enumerate(_smoothers(found)):
        rows = [one for one in found.ranked if one.combination.smoother == name]
        figure.add(_marks(name, k, rows, places, least, edge))
    reach = [-1.0, max(places.values()) + 1.0]
    figure.add(_best(least, reach))
    figure.axes("y", tickvals=centres, ticktext=[plain(name) for name in names], range=reach[::-1], showgrid=False)
    low, high = _reached(found.ranked, edge)
    _scale(figure, "x", low, high, "torque error, % (geometric mean over joints)")
    figure.layout.update(hovermode="closest", showlegend=True, shapes=_bands(centres, places))
    return figure


def cost_figure(found: Ranking) -> Drawing:
    """Draw the error of each combination over the seconds that smoothing and estimate took; open marks are worse than
    the best by more than chance, and the ring is the one to take."""
    figure = panels([""], 430, shared=False)
    least = found.ranked[0].error
    edge = FAR * least
    if found.choice is not None:
        ring = {"color": "rgba(0, 0, 0, 0)", "size": 20, "line": {"width": 1.6, "color": INK}}
        at = {"x": [found.choice.seconds], "y": [found.choice.error]}
        figure.add(trace("scatter", **at, mode="markers", name="to take", marker=ring, hoverinfo="skip"))
    for k, name in enumerate(_smoothers(found)):
        rows = [one for one in found.ranked if one.combination.smoother == name]
        at = {"x": [one.seconds for one in rows], "y": [min(one.error, edge) for one in rows]}
        figure.add(trace("scatter", **at, **_look(name, k, rows)))
    times = [one.seconds for one in found.ranked]
    _scale(figure, "x", min(times) / 1.3, max(times) * 1.3, "smoothing and estimate, s")
    most = min(max(one.error for one in found.ranked), edge)
    _scale(figure, "y", least * 0.93, most * 1.1, "torque error, %")
    figure.layout.update(hovermode="closest", showlegend=True)
    return figure


def _smoothers(found: Ranking) -> list[str]:
    """Return the smoothers that have an error, in the order in which they are compared."""
    seen = {one.combination.smoother for one in found.ranked}
    return [one.name for one in found.smoothers if one.name in seen]


def _places(found: Ranking) -> tuple[dict[str, float], list[str], list[float]]:
    """Return the height of each combination by its name, and names and centres of the estimators, the best first."""
    order = list(dict.fromkeys(one.combination.estimator for one in found.ranked))
    smoothers = _smoothers(found)
    rows = sorted(
        found.ranked,
        key=lambda one: (order.index(one.combination.estimator), smoothers.index(one.combination.smoother)),
    )
    places: dict[str, float] = {}
    names, centres, at = list[str](), list[float](), 0.0
    for name, run in groupby(rows, key=lambda one: one.combination.estimator):
        group = list(run)
        for k, one in enumerate(group):
            places[one.combination.name] = at + k
        names.append(name)
        centres.append(at + (len(group) - 1) / 2)
        at += len(group) + 1
    return places, names, centres


def _best(least: float, reach: Sequence[float]) -> Trace:
    """Return the dashed line of the least error."""
    line = {"color": INK, "width": 1.2, "dash": "dash"}
    at = {"x": [least, least], "y": reach, "mode": "lines", "name": "best", "line": line}
    return trace("scatter", **at, hoverinfo="skip", meta="ink", showlegend=False)


def _reached(ranked: Sequence[Ranked], edge: float) -> tuple[float, float]:
    """Return the ends of the axis that holds all marks and intervals, up to an ``edge``."""
    least = ranked[0].error
    ends = [one.error for one in ranked] + [least + one.interval[1] for one in ranked]
    starts = [least] + [least + one.interval[0] for one in ranked]
    low, most = min(filter(math.isfinite, starts)), min(max(filter(math.isfinite, ends)), edge)
    return max(low, 0.5 * least) * 0.96, most * 1.06


def _bands(centres: Sequence[float], places: dict[str, float]) -> list[dict[str, object]]:
    """Return a pale band behind every other estimator."""
    edges = sorted(places.values())
    groups: list[list[float]] = []
    for y in edges:
        if groups and y - groups[-1][-1] < 1.5:
            groups[-1].append(y)
        else:
            groups.append([y])
    band = {"type": "rect", "xref": "paper", "x0": 0, "x1": 1, "line": {"width": 0}, "layer": "below"}
    return [
        {**band, "y0": one[0] - 0.8, "y1": one[-1] + 0.8, "fillcolor": "rgba(128, 128, 128, 0.10)"}
        for one in groups[: len(centres)][::2]
    ]


def _marks(name: str, k: int, rows: list[Ranked], places: dict[str, float], least: float, edge: float) -> Trace:
    ends = [(one.interval[1] - (one.error - least), (one.error - least) - one.interval[0]) for one in rows]
    known = all(math.isfinite(x) for pair in ends for x in pair)
    bars = {
        "type": "data", "symmetric": False, "array": [max(a, 0.0) for a, _ in ends],
        "arrayminus": [max(b, 0.0) for _, b in ends], "thickness": 1.2, "width": 0,
    }  # fmt: skip
    at = {"x": [min(one.error, edge) for one in rows], "y": [places[one.combination.name] for one in rows]}
    return trace("scatter", **at, error_x=bars if known else None, **_look(name, k, rows))


def _look(name: str, k: int, rows: list[Ranked]) -> Trace:
    """Return how the marks of the k-th smoother look, and what they say."""
    return {
        "mode": "markers", "name": plain(name), "marker": _marker(k, rows), "text": [_words(one) for one in rows],
        "hovertemplate": "%{text}<extra></extra>", "meta": "ink" if COLOURS[k % len(COLOURS)] == INK else None,
    }  # fmt: skip


def _marker(k: int, rows: list[Ranked]) -> Trace:
    symbol = SYMBOLS[k % len(SYMBOLS)]
    symbols = [f"{symbol}-open" if one.worse else symbol for one in rows]
    widths = [1.6 if one.worse else 0.0 for one in rows]
    return {"color": COLOURS[k % len(COLOURS)], "size": 9, "symbol": symbols, "line": {"width": widths}}


def _words(one: Ranked) -> str:
    own = " (of the configuration)" if one.combination.own else ""
    low, high = one.interval
    against = "" if math.isnan(low) else f"<br>to the best: {low:+.2g} to {high:+.2g} percentage points"
    return (
        f"{plain(one.combination.smoother)} with {plain(one.combination.estimator)}{own}<br>{one.error:.4g} %, "
        f"{one.seconds:.2g} s{against}"
    )


def _scale(figure: Drawing, letter: str, low: float, high: float, title: str) -> None:
    """Set the range of an axis, which is logarithmic where its ends differ by more than a factor of four."""
    if high <= WIDE * low:
        figure.axes(letter, title=title, range=[low, high])  # type: ignore[arg-type]
        return
    decades = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    steps = (1, 2, 5) if high < 300 * low else (1,)
    ticks = [step * 10.0**k for k in decades for step in steps]
    figure.axes(
        letter,  # type: ignore[arg-type]
        title=title,
        type="log",
        range=[math.log10(low), math.log10(high)],
        tickvals=ticks,
        ticktext=[f"{tick:g}" for tick in ticks],
    )
