"""Distances of points to obstacles, against searches over their surfaces."""

import numpy as np
import pytest

from dynident.apps.excitation.clearance import obstacle_name, signed_distance
from dynident.models import Box, Cylinder, Floor


def test_distances_to_a_box_are_those_to_its_faces() -> None:
    box = Box("table", (0.2, 0.1, 0.3), (0.4, 0.6, 0.2))
    grid = np.linspace(-0.5, 0.5, 41)
    faces = np.array([np.insert([a, b], k, side) for k in range(3) for side in (-0.5, 0.5) for a in grid for b in grid])
    surface = np.array(box.centre) + faces * box.size
    points = np.random.default_rng(0).uniform(-0.6, 0.8, (80, 3))
    distance, _ = signed_distance(box)(points)
    inside = (np.abs(points - box.centre) < np.array(box.size) / 2).all(axis=1)
    near = np.linalg.norm(points[:, None] - surface, axis=2).min(axis=1)
    assert inside.any()
    assert ((distance < 0) == inside).all()
    assert (np.abs(distance) < near + 1e-12).all()
    assert near**2 == pytest.approx(distance**2, abs=1.1e-4)  # the grid is 15 mm wide


@pytest.mark.parametrize(
    ("point", "distance", "away"),
    [
        ((1.0, 0.0, 0.5), 0.7, (1, 0, 0)),
        ((0.0, 0.1, 1.2), 0.2, (0, 0, 1)),
        ((0.0, 0.0, -0.5), 0.5, (0, 0, -1)),
        ((0.0, 0.7, 1.3), 0.5, (0, 0.8, 0.6)),
        ((0.0, 0.25, 0.5), -0.05, (0, 1, 0)),
    ],
)
def test_distances_to_a_cylinder(point, distance, away) -> None:
    found, normal = signed_distance(Cylinder("post", (0.0, 0.0), 0.3, 0.0, 1.0))(np.array([point]))
    assert found[0] == pytest.approx(distance)
    assert normal[0] == pytest.approx(away)


def test_a_cylinder_without_ends_has_no_top() -> None:
    found, normal = signed_distance(Cylinder("post", (1.0, 0.0), 0.3))(np.array([[1.0, 0.0, 9.0], [0.0, 0.0, -9.0]]))
    assert found == pytest.approx([-0.3, 0.7])
    assert normal[1] == pytest.approx([-1, 0, 0])


def test_the_floor_is_a_height() -> None:
    found, normal = signed_distance(Floor(0.2))(np.array([[3.0, 1.0, 0.5]]))
    assert found == pytest.approx([0.3])
    assert normal.tolist() == [[0, 0, 1]]


def test_what_is_no_obstacle_has_no_distance() -> None:
    with pytest.raises(TypeError, match="str is no obstacle"):
        signed_distance("wall")


def test_obstacles_have_names() -> None:
    assert [obstacle_name(one) for one in (Floor(), Cylinder("post", (0, 0), 1))] == ["floor", "post"]
