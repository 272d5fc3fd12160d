"""Points whose hull contains a solid."""

import numpy as np
import pytest

from dynident.models.capsules import bounding_balls, cut_halves
from dynident.models.geometry import Solid
from dynident.models.robot_files import ShapeKind, placement, rotation
from tests.apps.excitation.meshes import BENT

FRAME = placement(rotation(np.array([0.6, 0.0, 0.8]), 0.7), np.array([0.1, 0.2, -0.3]))


def solid(kind, *size, mesh=None):
    return Solid("link", 0, kind, size, FRAME, mesh)


def surface(kind, size):
    """Random points of the surface of a shape, in its own frame."""
    away = np.random.default_rng(0).normal(size=(2000, 3))
    ball = away / np.linalg.norm(away, axis=1, keepdims=True)
    disk = ball / np.hypot(ball[:, 0], ball[:, 1])[:, None]
    ends = np.where(ball[:, 2:] > 0, 1.0, -1.0) * [0, 0, 1]
    return {
        ShapeKind.SPHERE: lambda: size[0] * ball,
        ShapeKind.BOX: lambda: ball / np.abs(ball).max(axis=1, keepdims=True) * size,
        ShapeKind.CYLINDER: lambda: size[0] * disk * [1, 1, 0] + size[1] * ends,
        ShapeKind.CAPSULE: lambda: size[0] * ball + size[1] * ends,
        ShapeKind.ELLIPSOID: lambda: ball * size,
    }[kind]()


@pytest.mark.parametrize(
    ("kind", "size"),
    [
        (ShapeKind.SPHERE, (0.3,)),
        (ShapeKind.BOX, (0.1, 0.2, 0.3)),
        (ShapeKind.CYLINDER, (0.1, 0.4)),
        (ShapeKind.CAPSULE, (0.1, 0.4)),
        (ShapeKind.ELLIPSOID, (0.1, 0.2, 0.3)),
    ],
)
def test_the_hull_contains_the_shape_and_little_more(kind, size) -> None:
    balls = bounding_balls(solid(kind, *size))
    inside = surface(kind, size) @ FRAME[:3, :3].T + FRAME[:3, 3]
    directions = np.random.default_rng(1).normal(size=(300, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    reach = (balls.centres @ directions.T + balls.radii[:, None]).max(axis=0)
    needed = (inside @ directions.T).max(axis=0)
    assert (reach - needed).min() > -1e-9
    assert (reach - needed).max() < 0.1 * max(size)


def test_a_mesh_is_all_its_corners() -> None:
    balls = bounding_balls(solid(ShapeKind.MESH, 1.0, 1.0, 1.0, mesh=BENT))
    assert (balls.centres - FRAME[:3, 3]) @ FRAME[:3, :3] == pytest.approx(BENT.vertices)


def test_both_sides_of_a_cut_contain_the_triangles_there() -> None:
    shape = solid(ShapeKind.MESH, 1, 1, 1, mesh=BENT)
    weights = np.random.default_rng(2).dirichlet(np.ones(3), 40)
    points = np.einsum("wc,fci->fwi", weights, BENT.vertices[BENT.triangles]).reshape(-1, 3)
    points = points @ FRAME[:3, :3].T + FRAME[:3, 3]
    directions = np.random.default_rng(3).normal(size=(400, 3))
    sides = list(cut_halves(shape))
    assert len(sides) == 9
    for pair in sides:
        within = [
            ((points @ directions.T) < (one.centres @ directions.T).max(axis=0) + 1e-9).all(axis=1) for one in pair
        ]
        assert np.logical_or(*within).all()


def test_simple_shapes_are_not_cut() -> None:
    assert list(cut_halves(solid(ShapeKind.BOX, 1, 1, 1))) == []
