"""A figure of the choice of terms: what each that was tried on a joint gains."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from dynident.identification import Outcome, Trial
from dynident.report.figures.canvas import AMBER, BLUE, GREEN, GRID, INK, RED, Drawing, Trace, panels, plain, trace

__all__ = ["trial_figure"]

COLOURS = {Outcome.ENTERED: GREEN, Outcome.TOO_SMALL: INK, Outcome.WITHIN_ERROR: AMBER, Outcome.NOT_EXCITED: INK}
LEAST, MOST, LOWER = 5.0, 105.0, 0.6  # %, between which the axis ends; and its lower end, relative to the upper one


def trial_figure(trials: Sequence[Trial], words: Mapping[Outcome, str]) -> Drawing:
    """Draw the gain of each trial with its standard error, one row each, coloured by its outcome in ``words``.

    A diamond is the gain on faster motion. The axis shows the gains; what is far below zero leaves it.
    """
    rows = {one.kind: k for k, one in enumerate(trials)}
    figure = panels([""], 110 + 24 * len(trials), shared=False)
    for outcome in dict.fromkeys(one.outcome for one in trials):
        some = [one for one in trials if one.outcome is outcome]
        figure.add(_gains(some, [rows[one.kind] for one in some], outcome, words[outcome]))
    fast = [one for one in trials if one.faster is not None]
    if fast:
        figure.add(_faster(fast, [rows[one.kind] for one in fast]))
    ends = [(one.gain, one.std) for one in trials] + [(one.faster or 0.0, one.faster_std or 0.0) for one in fast]
    known = [end for end in ends if np.isfinite(end).all()]
    upper = min(max(1.08 * max((gain + std for gain, std in known), default=0.0), LEAST), MOST)
    lower = min((gain - std for gain, std in known), default=0.0)
    figure.axes("x", title="gain, % of the squared cross-validated error", zeroline=True, zerolinecolor=GRID)
    figure.axes("x", range=[max(1.08 * min(lower, 0.0), -LOWER * upper) - 0.02 * upper, upper])
    figure.axes("y", tickvals=list(rows.values()), ticktext=[plain(kind) for kind in rows])
    figure.axes("y", range=[len(trials) - 0.5, -0.5])
    figure.layout.update(hovermode="closest", showlegend=True)
    return figure


def _gains(trials: Sequence[Trial], rows: Sequence[int], outcome: Outcome, words: str) -> Trace:
    entered, colour = outcome is Outcome.ENTERED, COLOURS.get(outcome, RED)
    return trace(
        "scatter",
        x=np.array([one.gain for one in trials]),
        y=list(rows),
        error_x={"array": np.array([one.std for one in trials]), "color": colour, "thickness": 1.6, "width": 4},
        mode="markers",
        name=words,
        marker={"color": colour, "size": 9, "symbol": "circle" if entered else "circle-open"},
        text=[f"{plain(one.kind)}: {one.gain:.3g} ± {one.std:.2g} %, {words}" for one in trials],
        hovertemplate="%{text}<extra></extra>",
        meta="ink" if colour == INK else None,
    )


def _faster(trials: Sequence[Trial], rows: Sequence[int]) -> Trace:
    std = [one.faster_std or 0.0 for one in trials]
    words = [f"{one.faster:.3g} ± {error:.2g} %" for one, error in zip(trials, std, strict=True)]
    return trace(
        "scatter",
        x=np.array([one.faster for one in trials], dtype=float),
        y=np.array(rows) + 0.28,
        error_x={"array": np.array(std), "color": BLUE, "thickness": 1, "width": 3},
        mode="markers",
        name="on faster motion",
        marker={"color": BLUE, "size": 6, "symbol": "diamond-open"},
        text=[f"{plain(one.kind)} on faster motion: {said}" for one, said in zip(trials, words, strict=True)],
        hovertemplate="%{text}<extra></extra>",
    )
