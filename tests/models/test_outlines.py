"""Surfaces for drawings."""

import numpy as np
import pytest

import dynident as dy
from dynident.models import Mesh, outlines
from dynident.models.capsules import body_capsules, joint_rod, simplify_mesh
from dynident.models.geometry import build_geometry
from tests.apps.excitation.meshes import volume
from tests.models.test_capsules import at, shaped
from tests.robots import ARM, joint, urdf

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
    (found,) = outlines(geometry, ())
    assert (found.link, found.body) == ("arm", 0)
    assert 0.8 * true < volume(found.mesh) < 1.0001 * true
    assert found.mesh.vertices.mean(axis=0) == pytest.approx([0.3, -0.2, 1.0], abs=1e-9)


def test_links_of_unknown_shape_are_drawn_as_capsules() -> None:
    geometry = build_geometry(dy.RigidBodies(ARM))
    capsules = body_capsules(geometry)
    found = outlines(geometry, capsules)
    assert [one.body for one in found] == [0, 1, 2]
    for one, capsule in zip(found, capsules, strict=True):
        true = np.pi * capsule.radius**2 * (np.linalg.norm(capsule.end - capsule.start) + 4 / 3 * capsule.radius)
        assert 0.8 * true < volume(one.mesh) < true


def test_without_capsules_they_are_rods_the_last_one_to_its_centre_of_mass() -> None:
    bodies = dy.RigidBodies(ARM)
    first, *_, last = outlines(build_geometry(bodies))
    theta = bodies.arm.bodies[-1].theta
    reach = joint_rod(build_geometry(bodies), 2)
    np.testing.assert_allclose(reach.end, theta[1:4] / theta[0])
    assert np.linalg.norm(last.mesh.vertices - reach.end, axis=1).min() <= reach.radius
    along = bodies.arm.bodies[1].placement[:3, 3]
    assert (first.mesh.vertices @ along).max() > along @ along


def test_a_mesh_of_many_triangles_becomes_one_of_few() -> None:
    turn, up = np.meshgrid(np.linspace(0, 2 * np.pi, 81)[:-1], np.linspace(-1.5, 1.5, 60), indexing="ij")
    points = np.stack((np.cos(turn) * np.cos(up), np.sin(turn) * np.cos(up), np.sin(up)), axis=-1).reshape(-1, 3)
    here = np.arange(len(points)).reshape(80, 60)
    right = np.roll(here, -1, axis=0)
    squares = [(here[:, :-1], right[:, :-1], right[:, 1:]), (here[:, :-1], right[:, 1:], here[:, 1:])]
    mesh = Mesh(points, np.concatenate([np.stack(one, axis=-1).reshape(-1, 3) for one in squares]))
    found = simplify_mesh(mesh, 500)
    assert 100 < len(found.triangles) <= 500
    assert volume(found) == pytest.approx(volume(mesh), rel=0.15)
    assert simplify_mesh(found, 500) is found
