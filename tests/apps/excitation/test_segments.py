"""Nearest points of segments: against a search over a grid, with derivatives that are continuous."""

import numpy as np
import pytest

from dynident.apps.excitation.clearance import body_distance, segment_distance, signed_distance
from dynident.models import Box, Cylinder, Floor

SHARES = np.linspace(0, 1, 201)
BODIES = (
    Floor(0.1),
    Box("box", (0.1, -0.1, 0.2), (0.4, 0.5, 0.3)),
    Box("turned", (0.1, 0.0, 0.2), (0.4, 0.5, 0.3), ((0.6, 0.8, 0.0), (-0.8, 0.6, 0.0), (0.0, 0.0, 1.0))),
    Cylinder("post", (0.1, 0.2), 0.3, -0.2, 0.4),
    Cylinder("endless", (0.1, 0.2), 0.3),
)


def searched(p, u, r, v):
    """The least distance of points on both segments."""
    one, other = p + SHARES[:, None] * u, r + SHARES[:, None] * v
    return float(np.linalg.norm(one[:, None] - other, axis=2).min())


def drawn(seed, count=60):
    return np.random.default_rng(seed).uniform(-0.5, 0.5, (count, 4, 3)).swapaxes(0, 1)


def test_distances_are_at_most_a_millimetre_less_than_those_found_by_searching() -> None:
    p, u, r, v = drawn(0)
    distance, _, _ = segment_distance(p, u, r, v)
    true = np.array([searched(*one) for one in zip(p, u, r, v, strict=True)])
    far = true > 0.05
    assert far.sum() > 30
    # the grid is too coarse by up to (1 / 400)^2 of a length squared over the distance
    assert (distance[far] < true[far] + 1e-6).all()
    assert (distance[far] > true[far] - 1e-3).all()


def test_segments_without_a_length_are_points() -> None:
    p, r = np.array([[0.0, 0.0, 0.3]]), np.zeros((1, 3))
    distance, point, away = segment_distance(p, 0 * p, r, 0 * r)
    assert distance == pytest.approx(0.3, abs=2e-4)
    assert point.tolist() == p.tolist()
    assert np.linalg.norm(away) == pytest.approx(1, abs=1e-3)


def slope(move, q, step=1e-6):
    return (move(q + step) - move(q - step)) / (2 * step)


@pytest.mark.parametrize("lift", [0.2, 0.005, 0.0])
def test_the_derivative_is_continuous_where_segments_become_parallel_or_cross(lift) -> None:
    def turned(angle):
        u = np.array([[np.cos(angle), 0.1 * angle, np.sin(angle)]])
        return segment_distance(-0.5 * u + 0.02, u, np.array([[-0.4, lift, 0.0]]), np.array([[1.0, 0.0, 0.0]]))[0][0]

    slopes = np.array([slope(turned, angle) for angle in np.linspace(-0.05, 0.05, 201)])
    assert np.abs(np.diff(slopes)).max() < 0.05  # it would jump by about 1


def test_the_derivative_by_a_point_is_that_of_moving_the_segment() -> None:
    p, u, r, v = drawn(1)
    _, _, away = segment_distance(p, u, r, v)
    for axis in np.eye(3):
        assert slope(lambda x, a=axis: segment_distance(p + x * a, u, r, v)[0], 0.0) == pytest.approx(
            away @ axis, abs=1e-6
        )
        assert slope(lambda x, a=axis: segment_distance(p, u, r + x * a, v)[0], 0.0) == pytest.approx(
            -away @ axis, abs=1e-6
        )


@pytest.mark.parametrize("body", BODIES, ids=lambda body: getattr(body, "name", "floor"))
def test_distances_to_bodies_are_those_found_by_searching(body) -> None:
    p, u, _, _ = drawn(2)
    distance, _, away = body_distance(p, u, signed_distance(body))
    true = signed_distance(body)(p[:, None] + SHARES[:, None] * u[:, None])[0].min(axis=1)
    assert (distance < true + 1e-6).all()
    assert (distance > true - 3e-3).all()  # inside a box there is a kink, which the grid may miss
    assert (distance > 0).any()
    assert (distance < 0).any()
    for axis in np.eye(3):
        moved = slope(lambda x, a=axis: body_distance(p + x * a, u, signed_distance(body))[0], 0.0)
        assert moved == pytest.approx(away @ axis, abs=1e-4)


def test_a_segment_through_a_box_is_pushed_out_the_shorter_way() -> None:
    box = Box("box", (0.0, 0.0, 0.0), (1.0, 0.2, 1.0))
    distance, _, away = body_distance(np.array([[-0.1, 0.05, 0.0]]), np.array([[0.2, 0.0, 0.0]]), signed_distance(box))
    assert distance[0] == pytest.approx(-0.05, abs=1e-3)
    assert away[0] == pytest.approx([0, 1, 0], abs=1e-9)
