"""Points whose hull contains a solid, and surfaces for drawings."""

import numpy as np
import pytest

import dynident as dy
from dynident.models import Mesh, outlines
from dynident.models.capsules import cut_halves, simplify_mesh
from dynident.models.geometry import Solid, build_geometry
from dynident.models.robot_files import ShapeKind, placement, rotation
from tests.apps.excitation.meshes import BENT, volume
from tests.models.test_capsules import at, shaped
from tests.robots import joint, urdf

FRAME = placement(rotation(np.array([0.6, 0.0, 0.8]), 0.7), np.array([0.1, 0.2, -0.3]))


def solid(kind, *size, mesh=None):
    return Solid("link", 0, kind, size, FRAME, mesh)


def test_both_sides_of_a_cut_contain_the_triangles_there() -> None:
    shape = solid(ShapeKind.MESH, 1, 1, 1, mesh=BENT)
    weights = np.random.default_rng(2).dirichlet(np.ones(3), 40)
    points = np.einsum("wc,fci->fwi", weights, BENT.vertices[BENT.triangles]).reshape(-1, 3)
    points = points @ FRAME[:3, :3].T + FRAME[:3, 3]
    directions = np.random.default_rng(3).normal(size=(400, 3))
    sides = list(cut_halves(shape))
    assert len(sides) == 9
    for pair in sides:
        within = [((points @ directions.T) < (x.centres @ directions.T).max(axis=0) + 1e-9).all(axis=1) for x in pair]
        assert np.logical_or(*within).all()


SHAPES = {
    '<box size="0.2 0.4 0.6"/>': 0.048,
    '<sphere radius="0.3"/>': 4 / 3 * np.pi * 0.027,
    '<cylinder radius="0.1" length="0.4"/>': np.pi * 0.004,
    '<capsule radius="0.1" length="0.4"/>': np.pi * 0.004 + 4 / 3 * np.pi * 0.001,
}


@pytest.mark.parametrize(("shape", "true"), SHAPES.items())
def test_an_outline_encloses_the_shape_and_points_outwards(shape, true) -> None:
    placed = at("0.3 -0.2 1.0", shape).replace("<origin", '<origin rpy="0.3 0.2 0.1"')
    bodies = dy.RigidBodies(urdf(shaped("base"), shaped("arm", placed), joint("one", "revolute", "base", "arm")))
    geometry = build_geometry(bodies)
    (result,) = outlines(geometry, ())
    assert (result.link, result.body) == ("arm", 0)
    assert 0.8 * true < volume(result.mesh) < 1.0001 * true
    assert result.mesh.vertices.mean(axis=0) == pytest.approx([0.3, -0.2, 1.0], abs=1e-9)


def test_a_mesh_of_many_triangles_becomes_one_of_few() -> None:
    turn, up = np.meshgrid(np.linspace(0, 2 * np.pi, 81)[:-1], np.linspace(-1.5, 1.5, 60), indexing="ij")
    points = np.stack((np.cos(turn) * np.cos(up), np.sin(turn) * np.cos(up), np.sin(up)), axis=-1).reshape(-1, 3)
    here = np.arange(len(points)).reshape(80, 60)
    right = np.roll(here, -1, axis=0)
    squares = [(here[:, :-1], right[:, :-1], right[:, 1:]), (here[:, :-1], right[:, 1:], here[:, 1:])]
    mesh = Mesh(points, np.concatenate([np.stack(square, axis=-1).reshape(-1, 3) for square in squares]))
    result = simplify_mesh(mesh, 500)
    assert 100 < len(result.triangles) <= 500
    assert volume(result) == pytest.approx(volume(mesh), rel=0.15)
    assert simplify_mesh(result, 500) is result
