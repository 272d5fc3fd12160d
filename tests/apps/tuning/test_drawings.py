"""Figures keep what matters when they are thinned, and are finest where a person looks."""

from __future__ import annotations

import json

import numpy as np

from dynident.apps.tuning import Bench
from dynident.apps.tuning.drawings import (
    MAX_COARSE_POINTS,
    MAX_POINTS,
    curve_drawing,
    motion_drawing,
    residual_drawing,
    torque_drawing,
)


def test_a_zoom_is_drawn_finely(validated_arm: Bench) -> None:
    one = validated_arm.smooth(validated_arm.start, "monday", validated_arm.joints[0])
    fine, coarse = motion_drawing(one, "rad", ()), motion_drawing(one, "rad", (), fine=False)
    assert len(coarse.data[4]["x"]) <= MAX_COARSE_POINTS + 8 < len(one.t) <= MAX_POINTS + 400
    assert np.nanmax(coarse.data[4]["y"]) == np.nanmax(fine.data[4]["y"])
    zoomed = motion_drawing(one, "rad", (), (2.0, 2.5), fine=False)
    inside = [(trace["x"] >= 2.0) & (trace["x"] <= 2.5) for trace in (zoomed.data[4], coarse.data[4])]
    assert inside[0].sum() > 2 * inside[1].sum()


def test_windows_are_grey_and_all_is_json(validated_arm: Bench) -> None:
    one, fit = (
        validated_arm.smooth(validated_arm.start, "monday", validated_arm.joints[0]),
        validated_arm.fit(validated_arm.start),
    )
    figures = (
        motion_drawing(one, "rad", ((1.0, 2.0),)),
        residual_drawing(one, "rad"),
        torque_drawing(fit.logs["monday"], 0, "N m", ((1.0, 2.0), (3.0, 4.0))),
        curve_drawing(validated_arm.curve(validated_arm.start), 0.0, 0, alone=False),
    )
    assert len(figures[0].layout["shapes"]) == 1
    assert [shape["x0"] for shape in figures[2].layout["shapes"]] == [1.0, 3.0]
    assert all(json.loads(figure.json())["data"] for figure in figures)
    names = figures[3].data[1]["text"]
    assert "torque" in ", ".join(names)
