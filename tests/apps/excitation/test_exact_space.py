"""Real shapes by Pinocchio and Coal, against capsules and by hand, and which pairs are watched."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

import dynident as dy
from dynident.apps.demo import demo_files
from dynident.apps.excitation import build_space, exact_space
from dynident.apps.excitation.clearance import neighbours, refuse_contact
from dynident.apps.excitation.exact_space import _coal_shape, build_capsule_space, sample_poses, sample_robot_poses
from dynident.files.meshes import read_geometry
from dynident.models import Box, Capsule, Cylinder, Floor, Mesh, Solid
from dynident.models.geometry import build_geometry
from dynident.models.robot_files import ShapeKind
from dynident.runtime import ConfigError, InputError
from tests.apps.excitation.meshes import BENT
from tests.apps.excitation.test_clearance import BRANCHED
from tests.models.test_capsules import at, shaped
from tests.robots import ARM, joint, link, urdf

pytest.importorskip("pinocchio", reason="Pinocchio is not installed: there are no real shapes to compare with")


AROUND = (Floor(-0.2), Box("table", (0.6, 0.0, 0.2), (0.4, 0.4, 0.4)), Cylinder("post", (-0.4, 0.3), 0.1))
JOINTS = ("one", "revolute", "base", "arm"), ("two", "revolute", "arm", "hand", (0.3, 0.0, 0.0))


def least(space, q):
    """The distance of each pair of names."""
    result = {}
    for pair, distance in zip(space.pairs, space.distances(q).T, strict=True):
        result[frozenset(pair)] = np.minimum(result.get(frozenset(pair), np.inf), distance)
    return result


def both(bodies, geometry):
    space = build_space(geometry, AROUND)
    exact = exact_space(geometry, space)
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
    assert exact.pairs == (("arm", "hand"),)
    # the middle of the ball is 0.4 m from the sides of both beams, which are 0.1 m wide, and half its radius high
    assert exact.distances(np.zeros((1, 3)))[0, 0] == pytest.approx(0.3, abs=1e-6)


def test_what_capsules_do_not_keep_apart_is_not_asked_of_the_shapes(monkeypatch) -> None:
    geometry = bent_arm()
    monkeypatch.setattr("dynident.apps.excitation.clearance.neighbours", lambda *_: set())
    watched = build_space(geometry)
    assert watched.watched.tolist() == [[0, 2], [1, 2]]
    swing = sample_poses(np.array([-3.0, 0.0, -3.0]), np.array([3.0, 0.0, 3.0]))
    unwatched = replace(watched, watched=watched.watched[1:], unwatched=watched.watched[:1])
    assert unwatched.left_out == (("arm", "hand"),)
    never = exact_space(geometry, unwatched, np.zeros((1, 3)))
    assert never.pairs == (("arm", "hand"),)  # which are apart in the one pose that there is
    often = exact_space(geometry, unwatched, swing)  # the ball meets the beams in some of the poses
    assert (often.pairs, often.left_out) == ((), (("arm", "hand"),))
    always = exact_space(geometry, watched, swing)
    assert always.pairs == (("arm", "hand"),)


def test_a_cylinder_has_its_radius_and_height() -> None:
    shape = _coal_shape(Solid("post", 0, ShapeKind.CYLINDER, (0.1, 0.4), np.eye(4)))
    assert (shape.radius, shape.halfLength) == (0.1, 0.4)


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
    assert exact.pairs == (("arm", "hand"),)
    assert exact.distances(np.zeros((1, 3)))[0, 0] == pytest.approx(0.5, abs=1e-6)


def test_an_arm_of_two_links_has_no_pairs_also_in_another_process() -> None:
    two = urdf(shaped("base"), shaped("arm"), shaped("hand"), *(joint(*facts) for facts in JOINTS))
    geometry = build_geometry(dy.RigidBodies(two))
    space = build_space(geometry)
    exact = pickle.loads(pickle.dumps(exact_space(geometry, space)))
    assert (space.pairs, exact.pairs) == ((), ())
    assert exact.distances(np.zeros((3, 2))).shape == space.distances(np.zeros((3, 2))).shape == (3, 0)


def test_without_pinocchio_there_is_none(monkeypatch) -> None:
    geometry = build_geometry(dy.RigidBodies(ARM))
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    assert exact_space(geometry, build_space(geometry)) is None


LIMIT = '<limit effort="10" velocity="2" lower="-2.8" upper="2.8"/>'
CHAIN = dy.RigidBodies(
    urdf(
        *(link(name, 1.0) for name in ("base", "a", "b", "c", "d")),
        *(
            joint(f"j{k}", "revolute", parent, child, (0.0, 0.0, 0.4 if k else 0.1), axis=(0.0, 1.0, 0.0), inside=LIMIT)
            for k, (parent, child) in enumerate(("base a", "a b", "b c", "c d")[j].split() for j in range(4))
        ),
    )
)


def along(body, length=0.3, radius=0.04):
    name = CHAIN.file.root if body < 0 else CHAIN.arm.bodies[body].name
    return Capsule(name, body, np.zeros(3), np.array([0.0, 0.0, length]), radius)


def test_all_pairs_are_watched_but_a_body_and_the_next_with_capsules() -> None:
    space = build_capsule_space(CHAIN, [along(k) for k in range(-1, 4)], [Floor(-2.0)])
    assert set(space.pairs[:6]) == {("base", "b"), ("base", "c"), ("base", "d"), ("a", "c"), ("a", "d"), ("b", "d")}
    assert space.pairs[6:] == tuple((name, "floor") for name in "abcd")
    assert space.left_out == ()
    assert neighbours(CHAIN, {-1, 0, 2, 3}) == {frozenset((0, -1)), frozenset((2, 0)), frozenset((3, 2))}


def test_links_that_are_always_near_are_left_out_before_they_touch() -> None:
    beside = [along(0, 0.4), along(1), along(2, 0.1, 0.345)]  # up to 15 mm apart
    poses = sample_poses(np.array([-3.0, 0.0, -3.0, -3.0]), np.array([3.0, 0.0, 3.0, 3.0]))
    assert build_capsule_space(CHAIN, beside, poses=poses).left_out == (("a", "c"),)
    assert build_capsule_space(CHAIN, beside, poses=poses, clearance=0.0).left_out == ()
    assert build_capsule_space(CHAIN, [along(0, 0.0)], [Floor(0.04)]).left_out == ()  # 20 mm above it
    assert build_capsule_space(CHAIN, [along(0, 0.0)], [Floor(0.04)], clearance=0.03).left_out == (("a", "floor"),)


def test_boxes_of_its_own_do_not_meet_the_first_body() -> None:
    own = Box("base", (0.0, 0.0, -0.2), (1.0, 1.0, 0.4))
    space = build_capsule_space(CHAIN, [along(k) for k in range(4)], [Floor(-2.0)], own_boxes=[own])
    assert [pair for pair in space.pairs if pair[1] == "base"] == [("b", "base"), ("c", "base"), ("d", "base")]
    assert [pair for pair in space.pairs if pair[1] == "floor"] == [(name, "floor") for name in "abcd"]


def test_poses_are_the_same_each_time_and_fill_the_range() -> None:
    low, high = np.array([-1.0, 0.0, 2.0]), np.array([1.0, 4.0, 2.5])
    result = sample_poses(low, high, 500)
    assert result.tolist() == sample_poses(low, high, 500).tolist()
    share = (result - low) / (high - low)
    assert (share >= 0).all()
    assert (share < 1).all()
    octants = np.unique((share < 0.5) @ [1, 2, 4], return_counts=True)[1]
    assert octants.min() > 50
    endless = sample_robot_poses(dy.RigidBodies(BRANCHED))[:, 1]
    assert endless.min() < -3 < 3 < endless.max()


def test_a_start_in_contact_is_refused_with_the_pair() -> None:
    table = Box("table", (0.0, 0.0, 1.5), (1.0, 1.0, 0.2))
    space = build_capsule_space(CHAIN, [along(k) for k in range(-1, 4)], [table])
    with pytest.raises(InputError, match=r"start: '[a-z]*' and '[a-z]*' overlap by \d+ mm, and 10 mm are to be kept"):
        refuse_contact(space, np.zeros(4), 0.01, "the start")
    refuse_contact(space, np.array([0.0, 0.5, 0.5, 0.5]), 0.01, "the start")
    with pytest.raises(InputError, match=r"are \d+ mm apart, and 500 mm"):
        refuse_contact(space, np.array([0.0, 0.5, 0.5, 0.5]), 0.5, "the start")


TALL = Capsule("c", 2, np.array([0.0, 0.0, -3.0]), np.array([0.0, 0.0, 3.0]), 3.0)
END = Capsule("d", 3, np.zeros(3), np.array([0.0, 0.0, 0.3]), 3.0)


@pytest.mark.parametrize(
    ("outer", "obstacle", "words"),
    [
        ([along(2), along(3)], Floor(3.0), r"'floor': in every pose 'a' overlaps it by 2\d\d\d mm or more, so that no"),
        ([along(2), along(3)], Box("room", (0.0, 0.0, 0.5), (6.0, 6.0, 6.0)), "'room': in every pose 'a' overlaps it"),
        ([TALL], Box("mount", (0.0, 0.0, 0.1), (0.2, 0.2, 0.2)), "'mount': in every pose 'c' overlaps it"),
        ([along(2), END], Floor(0.1), "'floor': in every pose 'd' overlaps it"),  # where link a may stand
    ],
)
def test_an_obstacle_that_the_arm_is_always_in_is_refused(outer, obstacle, words) -> None:
    with pytest.raises(ConfigError, match=words):
        build_capsule_space(CHAIN, [along(0), along(1), *outer], [obstacle])
