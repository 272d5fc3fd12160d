"""The figure of a payload: where the errors of mass, centre and inertia come from."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from dynident.payload import Component, Source
from dynident.report.figures.canvas import AMBER, BLUE, GREEN, INK, RED, VIOLET, Drawing, panels, trace

if TYPE_CHECKING:
    from collections.abc import Mapping

    from dynident.payload import Payload

__all__ = ["payload_figure"]

COLOURS = {
    Source.ARM: BLUE, Source.LOADED: GREEN, Source.UNLOADED: GREEN, Source.DRIFT: AMBER,
    Source.FRICTION: RED, Source.GAINS: VIOLET, Source.PRIOR: INK,
}  # fmt: skip
HATCHED = (Source.UNLOADED,)


def payload_figure(found: Payload, titles: Mapping[str, str]) -> Drawing:
    """Draw the shares of each source, by its name in ``titles``, in the variance of each component, in %."""
    figure = panels([""], 360, shared=False)
    for source, share in found.shares.items():
        marker = {"color": COLOURS[source], "pattern": {"shape": "/" if source in HATCHED else ""}}
        bars = trace(
            "bar", x=list(Component), y=100 * np.asarray(share), name=titles.get(source.value, source.value),
            marker=marker, hovertemplate="%{y:.3g} %",
        )  # fmt: skip
        figure.add(bars)
    figure.axes("y", title="share of the variance, %", range=[0, 100])
    figure.axes("x", type="category")
    figure.layout.update(barmode="stack")
    return figure
