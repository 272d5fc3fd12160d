"""Distances of capsules and obstacles, against searches, with derivatives and bounds of their rates."""

from functools import partial

import numpy as np
import pytest

import dynident as dy
from dynident.apps.excitation.clearance import body_distance, segment_distance, signed_distance
from dynident.apps.excitation.exact_space import build_capsule_space
from dynident.models import Box, Capsule, Cylinder, Floor
from dynident.models.geometry import LipschitzDistances
from tests.robots import ARM, joint, link, urdf

TURNED = Box("turned", (-0.5, -0.4, 0.6), (0.4, 0.5, 0.3), ((0.6, 0.8, 0.0), (-0.8, 0.6, 0.0), (0.0, 0.0, 1.0)))
TABLE, ENDLESS = Box("table", (0.6, 0.0, 0.2), (0.4, 0.4, 0.4)), Cylinder("endless", (-0.4, 0.3), 0.1)
AROUND = (Floor(-0.3), TABLE, TURNED, ENDLESS, Cylinder("post", (0.1, 0.7), 0.2, -0.2, 0.4))
MIMIC = '<mimic joint="first" multiplier="-0.5" offset="0.2"/>'
BRANCHED = urdf(
    *(link(name, 1.0) for name in ("base", "a", "b", "c", "d")),
    joint("first", "revolute", "base", "a", (0.0, 0.0, 0.3), axis=(0.0, 1.0, 0.0)),
    joint("second", "continuous", "a", "b", (0.3, 0.0, 0.0), (0.3, 0.0, 0.0)),
    joint("third", "prismatic", "a", "c", (0.0, 0.3, 0.0), axis=(0.0, 0.6, 0.8)),
    joint("follower", "revolute", "c", "d", (0.0, 0.2, 0.0), inside=MIMIC),
)
ROBOTS = pytest.mark.parametrize("xml", [ARM, BRANCHED], ids=["slide", "branched and mimic"])


def space_of(xml):
    """Capsules of random places around the links, the root link too, and a ball at the last, among obstacles."""
    bodies, rng = dy.RigidBodies(xml), np.random.default_rng(0)
    names = [bodies.file.root, *(body.name for body in bodies.arm.bodies)]
    places = rng.uniform(-0.2, 0.2, (len(names), 2, 3))
    places[-1, 1] = places[-1, 0]
    capsules = [Capsule(name, k - 1, *places[k], 0.02 + 0.01 * k) for k, name in enumerate(names)]
    return build_capsule_space(bodies, capsules, AROUND)


def slope(move, q, step=1e-6):
    return (move(q + step) - move(q - step)) / (2 * step)


@pytest.mark.parametrize("lift", [0.2, 0.005, 0.0])
def test_the_derivative_is_continuous_where_segments_become_parallel_or_cross(lift) -> None:
    def turned(angle):
        u = np.array([[np.cos(angle), 0.1 * angle, np.sin(angle)]])
        return segment_distance(-0.5 * u + 0.02, u, np.array([[-0.4, lift, 0.0]]), np.array([[1.0, 0.0, 0.0]]))[0][0]

    slopes = np.array([slope(turned, angle) for angle in np.linspace(-0.05, 0.05, 201)])
    assert np.abs(np.diff(slopes)).max() < 0.05  # it would jump by about 1


def test_a_segment_through_a_box_is_pushed_out_the_shorter_way() -> None:
    box = Box("box", (0.0, 0.0, 0.0), (1.0, 0.2, 1.0))
    p, u = np.array([[-0.1, 0.05, 0.0]]), np.array([[0.2, 0.0, 0.0]])
    distance, _, away = body_distance(p, u, partial(signed_distance, box))
    assert distance[0] == pytest.approx(-0.05, abs=1e-3)
    assert away[0] == pytest.approx([0, 1, 0], abs=1e-9)


POST = Cylinder("post", (0.0, 0.0), 0.3, 0.0, 1.0)
CRATE = Box("crate", (1.0, 2.0, 3.0), (2.0, 4.0, 6.0), ((0, 1, 0), (-1, 0, 0), (0, 0, 1)))  # 4 wide along x


@pytest.mark.parametrize(
    ("body", "point", "distance", "away"),
    [
        (POST, (1.0, 0.0, 0.5), 0.7, (1, 0, 0)),
        (POST, (0.0, 0.1, 1.2), 0.2, (0, 0, 1)),
        (POST, (0.0, 0.0, -0.5), 0.5, (0, 0, -1)),
        (POST, (0.0, 0.7, 1.3), 0.5, (0, 0.8, 0.6)),
        (POST, (0.0, 0.25, 0.5), -0.05, (0, 1, 0)),
        (ENDLESS, (-0.4, 0.35, 9.0), -0.05, (0, 1, 0)),
        (ENDLESS, (-0.6, 0.3, -9.0), 0.1, (-1, 0, 0)),
        (Floor(0.2), (3.0, 1.0, 0.5), 0.3, (0, 0, 1)),
        (CRATE, (6.0, 2.0, 3.0), 3.0, (1, 0, 0)),
        (CRATE, (2.0, 1.1, 4.0), -0.1, (0, -1, 0)),
        (CRATE, (1.0, 6.0, -4.0), 5.0, (0, 0.6, -0.8)),
    ],
)
def test_distances_to_obstacles_are_signed_and_point_away(body, point, distance, away) -> None:
    value, normal = signed_distance(body, np.array([point]))
    assert value[0] == pytest.approx(distance)
    assert normal[0] == pytest.approx(away)


@ROBOTS
def test_distances_are_those_found_by_searching(xml) -> None:
    space = space_of(xml)
    q = np.random.default_rng(2).uniform(-1, 1, (20, len(space.bodies.joints)))
    placed, shares = space.bodies.placements(q), np.linspace(0, 1, 201)[:, None]
    capsules = {capsule.link: capsule for capsule in space.capsules}
    obstacles = {obstacle.name: obstacle for obstacle in AROUND}

    def axis(capsule):
        return placed.points(np.full(201, capsule.body), capsule.start + shares * (capsule.end - capsule.start))

    for (name, other), distance in zip(space.pairs, space.distances(q).T, strict=True):
        points = axis(capsules[name])
        if other in obstacles:
            least, radius = signed_distance(obstacles[other], points)[0].min(axis=1), 0.0
            # at least the true distance, but for the grid, which may miss a kink inside of a box
            assert (distance > least - capsules[name].radius - 3e-3).all()
        else:
            gaps = np.linalg.norm(points[:, :, None] - axis(capsules[other])[:, None], axis=3)
            least, radius = gaps.min(axis=(1, 2)), capsules[other].radius
        far = least > 0.05
        true = least[far] - capsules[name].radius - radius
        assert (distance[far] < true + 1e-6).all()
        assert (distance[far] > true - 1.1e-3).all()


@ROBOTS
def test_the_derivatives_are_those_of_the_distances(xml) -> None:
    space = space_of(xml)
    n = len(space.bodies.joints)
    q = np.random.default_rng(1).uniform(-1.5, 1.5, (80, n))
    distances, slopes = space.gradients(q)
    assert slopes.shape == (80, len(space.pairs), n)
    assert distances == pytest.approx(space.distances(q))
    for k, unit in enumerate(np.eye(n)):
        assert slope(lambda x, unit=unit: space.distances(q + x * unit), 0.0) == pytest.approx(slopes[..., k], abs=2e-5)
    assert np.abs(slopes).max() > 0.1


@ROBOTS
def test_no_distance_changes_faster(xml) -> None:
    space = space_of(xml)
    assert isinstance(space, LipschitzDistances)
    ends = [(limit.lower or -3.0, limit.upper or 3.0) for limit in space.bodies.limits.values()]
    q = np.random.default_rng(0).uniform(*np.transpose(ends), (3000, len(ends)))
    distances, slopes = space.gradients(q)
    shallow = np.abs(slopes) * (distances > 0)[..., None]
    assert (shallow.max(axis=0) <= space.steepest).all()
    assert (shallow.max(axis=0) > 0.3 * space.steepest).mean() > 0.4
    assert (slopes[:, space.steepest == 0] == 0).all()
