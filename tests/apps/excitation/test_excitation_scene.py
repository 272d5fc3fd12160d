"""The arm along a designed motion: what is drawn, and what is said of its distances."""

from __future__ import annotations

from base64 import b64decode
from dataclasses import replace

import numpy as np

from dynident.apps.excitation.report import obstacle_mesh, scene_section
from dynident.models import Box, Cylinder, EmptySpace, Floor, ShapeSource
from dynident.report.page import Figure, PageTable
from tests.report.designs import designed


def test_bodies_move_as_the_robot_does() -> None:
    project, found = designed()
    figure = next(one.figure for one in scene_section(project, found).blocks if isinstance(one, Figure))
    assert figure.motion is not None
    assert [one["name"] for one in figure.data[: len(figure.motion["moving"])]] == ["upper", "lower"]
    (replay,) = figure.motion["replays"]
    assert replay["stop"] == found.trajectory.duration
    q = np.frombuffer(b64decode(replay["q"]), "<f4").reshape(-1, 2)
    t = np.linspace(0.0, replay["stop"], len(q))
    np.testing.assert_allclose(q, found.trajectory.states(t)[0], atol=1e-6)


def test_the_closest_pairs_come_first() -> None:
    project, found = designed()
    (table,) = [one for one in scene_section(project, found).blocks if isinstance(one, PageTable)]
    sizes = [float(row[2]) for row in table.rows]
    assert sizes == sorted(sizes)
    t = found.trajectory.times(100.0)
    least = 1e3 * found.space.distances(found.trajectory.states(t)[0]).min()
    assert sizes[0] == np.round(least, 1) or abs(sizes[0] / least - 1) < 0.01


def test_what_is_known_of_the_shapes_is_said() -> None:
    project, found = designed()
    (lines,) = [one for one in scene_section(project, found).blocks if isinstance(one, tuple)]
    assert lines[0].startswith("Distances of")
    assert "the lines between their joints" in lines[0]
    geometry = replace(
        project.geometry,
        missing={"a.dae": "there is no such file."},
        sources={0: ShapeSource.VISUAL, 1: ShapeSource.COLLISION},
    )
    project.__dict__["geometry"], kept = geometry, project.geometry
    (lines,) = [one for one in scene_section(project, found).blocks if isinstance(one, tuple)]
    project.__dict__["geometry"] = kept
    assert lines[0] == "Distances of lower: by capsules around their collision shapes."
    assert lines[2] == "Meshes that could not be read: a.dae (there is no such file)."


def test_a_model_without_bodies_has_no_view() -> None:
    project, found = designed()
    project.__dict__["geometry"], kept = None, project.geometry
    section = scene_section(project, replace(found, space=EmptySpace(2)))
    project.__dict__["geometry"] = kept
    assert len(section.blocks) == 2
    assert not any(isinstance(one, Figure) for one in section.blocks)


def test_obstacles_are_drawn_where_they_are() -> None:
    floor = obstacle_mesh(Floor(-0.5), 2.0)
    np.testing.assert_array_equal(floor.vertices[:, 2], -0.5)
    turned = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])
    box = obstacle_mesh(Box("b", (1, 2, 3), (0.2, 0.4, 0.6), tuple(map(tuple, turned))), 2.0)
    np.testing.assert_allclose(np.ptp(box.vertices, axis=0), [0.4, 0.2, 0.6])
    np.testing.assert_allclose(box.vertices.mean(axis=0), [1, 2, 3])
    post = obstacle_mesh(Cylinder("c", (1, 2), 0.3, -np.inf, 1.0), 2.0)
    np.testing.assert_allclose(np.ptp(post.vertices, axis=0), [0.6, 0.6, 3.0])
