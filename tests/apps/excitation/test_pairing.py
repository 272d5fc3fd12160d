"""Which pairs are watched."""

import numpy as np
import pytest

import dynident as dy
from dynident.apps.excitation import build_space
from dynident.apps.excitation.clearance import neighbours, refuse_contact
from dynident.apps.excitation.exact_space import build_capsule_space, sample_poses
from dynident.models import Box, Capsule, Floor
from dynident.models.geometry import build_geometry
from dynident.runtime import ConfigError, InputError
from tests.robots import joint, link, urdf

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


def test_all_pairs_are_watched_but_a_body_and_the_next() -> None:
    space = build_capsule_space(CHAIN, [along(k) for k in range(-1, 4)], [Floor(-2.0)])
    assert set(space.pairs[:6]) == {("base", "b"), ("base", "c"), ("base", "d"), ("a", "c"), ("a", "d"), ("b", "d")}
    assert space.pairs[6:] == tuple((name, "floor") for name in "abcd")
    assert space.left_out == ()


def test_a_body_without_capsules_is_no_neighbour() -> None:
    assert neighbours(CHAIN, {-1, 0, 2, 3}) == {frozenset((0, -1)), frozenset((2, 0)), frozenset((3, 2))}
    space = build_capsule_space(CHAIN, [along(k) for k in (-1, 0, 2, 3)])
    assert set(space.pairs) == {("base", "c"), ("base", "d"), ("a", "d")}


def test_pairs_that_touch_in_nearly_every_pose_are_left_out_and_named() -> None:
    space = build_capsule_space(CHAIN, [along(k) for k in range(4)], [Floor(0.1)])
    assert set(space.left_out) == {("a", "floor")}
    near = build_capsule_space(CHAIN, [along(0, 0.4, 0.2), along(1), along(2, 0.1, 0.25)])
    assert set(near.left_out) == {("a", "c")}
    assert ("a", "c") not in near.pairs


def test_links_that_are_always_near_are_left_out_before_they_touch() -> None:
    beside = [along(0, 0.4), along(1), along(2, 0.1, 0.345)]  # up to 15 mm apart
    turned = np.array([3.0, 0.0, 3.0, 3.0])
    space = build_capsule_space(CHAIN, beside, lower=-turned, upper=turned)
    assert space.left_out == (("a", "c"),)
    assert build_capsule_space(CHAIN, beside, lower=-turned, upper=turned, clearance=0.0).left_out == ()
    high = build_capsule_space(CHAIN, [along(0, 0.0)], [Floor(0.04)])
    assert high.distances(np.zeros((1, 4)))[0, 0] == pytest.approx(0.02, abs=1e-3)
    assert high.left_out == ()
    assert build_capsule_space(CHAIN, [along(0, 0.0)], [Floor(0.04)], clearance=0.03).left_out == (("a", "floor"),)


def test_ranges_that_are_given_count() -> None:
    ends = np.full(4, 0.01)
    kept = build_capsule_space(CHAIN, [along(0), along(2)], lower=-ends, upper=ends)
    assert kept.pairs == ()  # neighbours, as b has no capsule
    assert kept.left_out == ()
    hanging = np.array([2.75, 0.0, 0.0, 0.0])
    floor = build_capsule_space(CHAIN, [along(0)], [Floor(-0.1)], hanging - ends, hanging + ends)
    assert floor.left_out == (("a", "floor"),)
    assert build_capsule_space(CHAIN, [along(0)], [Floor(-0.1)]).left_out == ()


def test_boxes_of_its_own_do_not_meet_the_first_body() -> None:
    own = Box("base", (0.0, 0.0, -0.2), (1.0, 1.0, 0.4))
    space = build_capsule_space(CHAIN, [along(k) for k in range(4)], [Floor(-2.0)], own_boxes=[own])
    assert [pair for pair in space.pairs if pair[1] == "base"] == [("b", "base"), ("c", "base"), ("d", "base")]
    assert [pair for pair in space.pairs if pair[1] == "floor"] == [(name, "floor") for name in "abcd"]


def test_poses_are_the_same_each_time_and_fill_the_range() -> None:
    low, high = np.array([-1.0, 0.0, 2.0]), np.array([1.0, 4.0, 2.5])
    found = sample_poses(low, high, 500)
    assert found.tolist() == sample_poses(low, high, 500).tolist()
    share = (found - low) / (high - low)
    assert (share >= 0).all()
    assert (share < 1).all()
    octants = np.unique((share < 0.5) @ [1, 2, 4], return_counts=True)[1]
    assert octants.min() > 50


def test_a_start_in_contact_is_refused_with_the_pair() -> None:
    space = build_capsule_space(
        CHAIN, [along(k) for k in range(-1, 4)], [Box("table", (0.0, 0.0, 1.5), (1.0, 1.0, 0.2))]
    )
    bent = np.array([0.0, 2.8, 0.0, 0.0])
    with pytest.raises(
        InputError, match=r"the start: '[a-z]*' and '[a-z]*' overlap by \d+ mm, and 10 mm are to be kept"
    ):
        refuse_contact(space, np.zeros(4), 0.01, "the start")
    refuse_contact(space, np.array([0.0, 0.5, 0.5, 0.5]), 0.01, "the start")
    with pytest.raises(InputError, match=r"are \d+ mm apart, and 500 mm"):
        refuse_contact(space, np.array([0.0, 0.5, 0.5, 0.5]), 0.5, "the start")
    assert space.distances(bent[None]).min() < 0


def test_the_space_of_a_geometry_has_its_capsules_and_boxes() -> None:
    space = build_space(build_geometry(CHAIN), [Floor(-1.0)])
    assert [one.link for one in space.capsules] == ["a", "b", "c", "d"]  # the base has no shape
    assert ("d", "floor") in space.pairs


@pytest.mark.parametrize(
    ("obstacle", "words"),
    [
        (Floor(3.0), r"'floor': in every pose 'a' overlaps it by 2\d\d\d mm or more, so that no motion"),
        (Box("room", (0.0, 0.0, 0.5), (6.0, 6.0, 6.0)), "'room': in every pose 'a' overlaps it"),
        (Box("mount", (0.0, 0.0, 0.1), (0.2, 0.2, 0.2)), "'mount': in every pose 'c' overlaps it"),
    ],
)
def test_an_obstacle_that_the_arm_is_always_in_is_refused(obstacle, words) -> None:
    tall = [along(0), along(1), Capsule("c", 2, np.array([0.0, 0.0, -3.0]), np.array([0.0, 0.0, 3.0]), 3.0)]
    with pytest.raises(ConfigError, match=words):
        build_capsule_space(CHAIN, tall if "mount" in words else [along(k) for k in range(4)], [obstacle])


def test_a_link_may_stand_on_the_floor_but_not_the_end_of_the_arm() -> None:
    assert build_capsule_space(CHAIN, [along(k) for k in range(4)], [Floor(0.1)]).left_out == (("a", "floor"),)
    end = [along(0), along(1), along(2), Capsule("d", 3, np.zeros(3), np.array([0.0, 0.0, 0.3]), 3.0)]
    with pytest.raises(ConfigError, match="'floor': in every pose 'd' overlaps it"):
        build_capsule_space(CHAIN, end, [Floor(0.1)])
