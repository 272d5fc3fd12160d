"""The figure of a fit in pieces: what is left of the torque from piece to piece."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from dynident.report.figures.canvas import AMBER, BLUE, GREEN, INK, PALE, RED, Drawing, panels, plain, trace

if TYPE_CHECKING:
    from collections.abc import Sequence

    from dynident.estimators import Pieces

__all__ = ["pieces_figure"]

COLOURS = (BLUE, RED, GREEN, AMBER, INK, PALE)
HOUR, LONG = 3600.0, 7200.0  # s


def pieces_figure(pieces: Pieces, joints: Sequence[str]) -> Drawing:
    """Draw the residual of each joint, relative to its torque over all pieces (%), over the time of the pieces.

    A piece without rows of a joint is a gap. Recordings follow each other; each begins at its own time.
    """
    middle = (pieces.begins + pieces.ends) / 2
    long = float(np.ptp(middle)) > LONG
    t = (middle - pieces.begins.min()) / (HOUR if long else 1.0)
    whole = np.sqrt((pieces.rows * pieces.torque**2).sum(axis=0) / np.maximum(pieces.rows.sum(axis=0), 1))
    figure = panels(["residual of the torque, %"], 360)
    for j, joint in enumerate(joints):
        if whole[j] == 0:
            continue
        share = np.where(pieces.rows[:, j] > 0, 100.0 * pieces.residual[:, j] / whole[j], np.nan)
        for k, name in enumerate(dict.fromkeys(pieces.recording)):
            own = np.flatnonzero(np.array(pieces.recording) == name)
            several = len(set(pieces.recording)) > 1
            line = {"color": COLOURS[j % len(COLOURS)], "width": 1.3}
            drawn = trace("scatter", x=t[own], y=share[own], mode="lines", line=line, legendgroup=plain(joint))
            words = f"{plain(joint)}, {plain(name)}" if several else plain(joint)
            figure.add(drawn | {"name": words, "showlegend": k == 0 or several})
    figure.axes("x", title="time, h" if long else "time, s")
    figure.axes("y", rangemode="tozero")
    return figure
