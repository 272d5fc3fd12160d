"""Real shapes, by Pinocchio and Coal, against capsules and against what can be reckoned by hand."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

import dynident as dy
from dynident.apps.demo import demo_files
from dynident.apps.excitation import build_space, exact_space
from dynident.files.meshes import read_geometry
from dynident.models import Box, Cylinder, Floor, Mesh
from dynident.models.geometry import build_geometry
from tests.apps.excitation.meshes import BENT
from tests.apps.excitation.test_clearance import BRANCHED
from tests.models.test_capsules import at, shaped
from tests.robots import ARM, joint, urdf

pytest.importorskip("pinocchio", reason="Pinocchio is not installed: there are no real shapes to compare with")
AROUND = (Floor(-0.2), Box("table", (0.6, 0.0, 0.2), (0.4, 0.4, 0.4)), Cylinder("post", (-0.4, 0.3), 0.1))


JOINTS = ("one", "revolute", "base", "arm"), ("two", "revolute", "arm", "hand", (0.3, 0.0, 0.0))


def least(space, q):
    """The distance of each pair of names."""
    found = {}
    for pair, distance in zip(space.pairs, space.distances(q).T, strict=True):
        found[frozenset(pair)] = np.minimum(found.get(frozenset(pair), np.inf), distance)
    return found


def both(bodies, geometry):
    space = build_space(geometry, AROUND)
    exact = exact_space(geometry, space)
    assert exact is not None
    q = np.random.default_rng(0).uniform(-1.5, 1.5, (60, len(bodies.joints)))
    return least(space, q), least(exact, q)


def test_capsules_are_never_farther_apart_than_the_real_shapes(tmp_path) -> None:
    robot = demo_files(tmp_path) / "arm.urdf"
    bodies = dy.RigidBodies(robot.read_text())
    capsules, exact = both(bodies, read_geometry(bodies, robot))
    assert capsules.keys() == exact.keys()
    for pair, distance in exact.items():
        apart = distance > 0.05
        assert (capsules[pair][apart] < distance[apart] + 1e-6).all()
        assert (capsules[pair][apart] > distance[apart] - 0.02).all()  # its meshes are capsules of few facets


@pytest.mark.parametrize("xml", [ARM, BRANCHED], ids=["slide", "branched and mimic"])
def test_links_of_unknown_shape_are_the_capsules(xml) -> None:
    bodies = dy.RigidBodies(xml)
    capsules, exact = both(bodies, build_geometry(bodies))
    assert capsules.keys() == exact.keys()
    for pair, distance in exact.items():
        apart = distance > 0
        assert capsules[pair][apart] == pytest.approx(distance[apart], abs=1.5e-3)
        assert ((capsules[pair] < 1e-3) | apart).all()


def bent_arm():
    mesh, ball = at("0 0 0", '<mesh filename="bent.stl"/>'), at("0.5 0.5 0", '<sphere radius="0.1"/>')
    xml = urdf(
        shaped("base"), shaped("arm", mesh), shaped("empty", mass=None), shaped("hand", ball),
        joint("one", "revolute", "base", "arm"),
        joint("two", "prismatic", "arm", "empty"),
        joint("three", "revolute", "empty", "hand", (0.0, 0.0, 0.05)),
    )  # fmt: skip
    return build_geometry(dy.RigidBodies(xml), {"bent.stl": BENT}.get)


def test_a_mesh_near_by_is_its_triangles_and_not_its_hull(monkeypatch) -> None:
    geometry = bent_arm()
    monkeypatch.setattr("dynident.apps.excitation.clearance.neighbours", lambda *_: set())
    exact = exact_space(geometry, build_space(geometry))
    assert exact is not None
    assert exact.pairs == (("arm", "hand"),)
    # the middle of the ball is 0.4 m from the sides of both beams, which are 0.1 m wide, and half its radius high
    assert exact.distances(np.zeros((1, 3)))[0, 0] == pytest.approx(0.3, abs=1e-6)


def test_what_capsules_do_not_keep_apart_is_not_asked_of_the_shapes(monkeypatch) -> None:
    geometry = bent_arm()
    monkeypatch.setattr("dynident.apps.excitation.clearance.neighbours", lambda *_: set())
    watched = build_space(geometry)
    assert watched.meetings.tolist() == [[0, 2], [1, 2]]
    swing, still = np.array([3.0, 0.0, 3.0]), np.zeros(3)
    unwatched = replace(watched, meetings=watched.meetings[1:], unwatched=(watched.meetings[:1], watched.encounters))
    assert unwatched.left_out == (("arm", "hand"),)
    never = exact_space(geometry, unwatched, still, still)
    assert never is not None
    assert never.pairs == (("arm", "hand"),)  # which are apart in the one pose that there is
    often = exact_space(geometry, unwatched, -swing, swing)  # the ball meets the beams in some of the poses
    assert often is not None
    assert (often.pairs, often.left_out) == ((), (("arm", "hand"),))
    kept = exact_space(geometry, watched, -swing, swing)
    assert kept is not None
    assert kept.pairs == (("arm", "hand"),)


def test_a_flat_mesh_is_its_triangles() -> None:
    flat = Mesh(np.array([[0.0, 0, 0], [0.2, 0, 0], [0, 0.2, 0], [0.2, 0.2, 0]]), np.array([[0, 1, 2], [1, 3, 2]]))
    mesh, ball = at("0 0 1", '<mesh filename="flat.stl"/>'), at("0.1 0.1 0.4", '<sphere radius="0.1"/>')
    joints = (
        joint("one", "revolute", "base", "arm"),
        joint("two", "revolute", "arm", "next", axis=(1.0, 0.0, 0.0)),
        joint("three", "revolute", "next", "hand"),
    )
    xml = urdf(shaped("base"), shaped("arm", mesh), shaped("next", ball), shaped("hand", ball), *joints)
    geometry = build_geometry(dy.RigidBodies(xml), {"flat.stl": flat}.get)
    exact = exact_space(geometry, build_space(geometry))
    assert exact is not None
    assert exact.pairs == (("arm", "hand"),)
    assert exact.distances(np.zeros((1, 3)))[0, 0] == pytest.approx(0.5, abs=1e-6)


def test_it_goes_to_another_process(tmp_path) -> None:
    bodies = dy.RigidBodies(ARM)
    geometry = build_geometry(bodies)
    exact = exact_space(geometry, build_space(geometry, AROUND))
    q = np.zeros((2, 3))
    found = exact.distances(q)
    assert pickle.loads(pickle.dumps(exact)).distances(q).tolist() == found.tolist()
    assert exact.distances(q[:0]).shape == (0, len(exact.pairs))


def test_an_arm_of_two_links_has_no_pairs() -> None:
    two = urdf(shaped("base"), shaped("arm"), shaped("hand"), *(joint(*one) for one in JOINTS))
    geometry = build_geometry(dy.RigidBodies(two))
    space = build_space(geometry)
    exact = exact_space(geometry, space)
    assert exact is not None
    assert (space.pairs, exact.pairs) == ((), ())
    assert exact.distances(np.zeros((3, 2))).shape == space.distances(np.zeros((3, 2))).shape == (3, 0)


def test_without_pinocchio_there_is_none(monkeypatch) -> None:
    geometry = build_geometry(dy.RigidBodies(ARM))
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    assert exact_space(geometry, build_space(geometry)) is None
