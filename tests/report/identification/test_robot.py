"""The robot in its report: coloured links, along its recordings, with its inertia."""

from __future__ import annotations

import re
from base64 import b64decode
from dataclasses import replace

import numpy as np
import pytest

from dynident.estimators import PhysicallyConsistent
from dynident.identification.links import DeterminedBy
from dynident.models import Model, RigidBodies
from dynident.models.geometry import build_geometry
from dynident.report.identification.robot import COLOURS, robot_blocks, robot_view
from dynident.report.page import Figure
from tests.report.robots import TREE, identified


def view(estimator: PhysicallyConsistent | None = None) -> Figure:
    *_, figure = robot_blocks(identified(estimator))
    return figure


def test_links_have_the_colour_of_what_determined_them() -> None:
    drawn = view(PhysicallyConsistent()).figure.data
    links = [x for x in drawn if x["type"] == "mesh3d" and x.get("hovertext")]
    assert [link["name"] for link in links] == ["turret (+1)", "slide", "&lt;b&gt;hand", "finger"]
    assert links[0]["color"] == COLOURS[DeterminedBy.DATA]
    assert links[2]["color"] == COLOURS[DeterminedBy.PRIOR]
    assert links[2]["hovertext"].startswith("&lt;b&gt;hand<br>mass 0.")
    assert links[0]["hovertext"].endswith("<br>by the data 2, the prior 1")
    words = [x["name"] for x in drawn if x.get("legendrank") == 1]
    assert words == ["well determined", "by the file or prior"]


def test_it_moves_along_all_recordings_those_held_out_first() -> None:
    identification, figure = identified(), view().figure
    replays = figure.motion["replays"]
    assert [replay["name"] for replay in replays] == ["tuesday (held out)", "monday (training)"]
    motion = identification.validations[1].motion
    q = np.frombuffer(b64decode(replays[0]["q"]), "<f4").reshape(-1, 4)
    t = np.linspace(replays[0]["start"], replays[0]["stop"], len(q))
    np.testing.assert_allclose(q[:, 2], np.interp(t, motion.t, motion.q[:, 2]), atol=1e-5)
    np.testing.assert_allclose(q[:, 3], 0.2 - 0.5 * q[:, 2], atol=1e-6)  # mimics it


def test_inertia_is_hidden_until_it_is_asked_for() -> None:
    for estimator, names in (
        (None, ["inertia in the file", "centre in the file"]),
        (PhysicallyConsistent(), ["found", "inertia in the file", "centre found", "centre in the file"]),
    ):
        figure = view(estimator).figure
        (layer,) = figure.motion["layers"]
        assert [figure.data[k]["name"] for k in layer["shown"]] == names
        assert not any(figure.data[k]["visible"] for k in layer["shown"])
        assert layer["faded"] == (0, 1, 2, 3)


def test_a_small_view_follows_without_a_player() -> None:
    small = robot_view(identified())
    assert not small.player
    assert small.figure.layout["height"] == 250
    assert [x["name"] for x in small.figure.data if x.get("legendrank") == 1][1:] == ["by combination"]
    assert "by combination (the data determine only sums with other links)." in small.caption
    scene = small.figure.layout["scene"]
    assert not scene["xaxis"]["visible"]
    links = [x for x in small.figure.data if x.get("hovertext")]
    for axis in "xyz":  # it looks at the arm, where that stands in the view
        middle = (min(link[axis].min() for link in links) + max(link[axis].max() for link in links)) / 2
        low, high = scene[f"{axis}axis"]["range"]
        side = scene["aspectratio"][axis] * ((middle - low) / (high - low) - 0.5)
        assert scene["camera"]["center"][axis] == pytest.approx(side, abs=1e-6)


def test_a_robot_file_without_masses_has_no_view() -> None:
    bare = RigidBodies(re.sub("<(inertial|collision)>.*?</\\1>", "", TREE, flags=re.DOTALL), ("pan", "reach", "wrist"))
    other = replace(identified(), model=Model((bare,)))
    assert list(robot_blocks(other, build_geometry(bare))) == []
    assert robot_view(other, build_geometry(bare)) is None
