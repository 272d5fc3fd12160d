"""The smallest capsule around balls."""

import numpy as np
import pytest

from dynident.models.geometry import OUTER_DIRECTIONS, Balls, fit_capsule, fit_capsule_quickly


def beyond(capsule, balls):
    """By how much each ball reaches out of a capsule (m)."""
    along = capsule.end - capsule.start
    part = np.clip((balls.centres - capsule.start) @ along / max(along @ along, 1e-300), 0, 1)
    nearest = capsule.start + part[:, None] * along
    return np.linalg.norm(balls.centres - nearest, axis=1) + balls.radii - capsule.radius


def points(centres):
    return Balls(np.asarray(centres, dtype=float), np.zeros(len(centres)))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("count", [1, 2, 4, 700])
def test_all_balls_are_inside(seed, count) -> None:
    rng = np.random.default_rng(seed)
    shape = rng.normal(size=(3, 3)) * [0.3, 0.1, 0.02]
    balls = Balls(rng.normal(size=(count, 3)) @ shape, rng.uniform(0, 0.05, count))
    for capsule in (fit_capsule(balls), fit_capsule_quickly(balls)):
        assert beyond(capsule, balls).max() < 2e-3 * capsule.radius + 1e-12


def test_a_capsule_is_found_again() -> None:
    rng = np.random.default_rng(1)
    start, end, radius = np.array([0.1, -0.2, 0.3]), np.array([0.4, 0.1, 0.1]), 0.07
    away = rng.normal(size=(3000, 3))
    away *= radius / np.linalg.norm(away, axis=1, keepdims=True)
    surface = start + rng.uniform(size=(3000, 1)).round() * (end - start) + away
    capsule = fit_capsule(points(surface))
    assert capsule.radius == pytest.approx(radius, rel=0.02)
    ends = sorted(np.array([capsule.start, capsule.end]).tolist())
    assert np.array(ends) == pytest.approx(np.array([start, end]), abs=0.01)


def test_the_search_beats_the_principal_axes() -> None:
    rng = np.random.default_rng(2)
    bent = np.concatenate((rng.uniform(0, [1.0, 0.1, 0.1], (200, 3)), rng.uniform(0, [0.1, 0.4, 0.1], (200, 3))))
    hooks = [[0.1 * x, 0.2, 0] for x in range(4)] + [[0.1 * x, -0.2, 0] for x in range(7, 11)]  # a tilted capsule
    for shape, share in ((bent, 0.97), (np.array([*hooks, [0, -0.2, 0], [1, 0.2, 0]]), 0.5)):
        assert fit_capsule(points(shape)).volume < share * fit_capsule_quickly(points(shape)).volume


def test_the_outermost_are_sought_in_directions_all_around() -> None:
    around = np.random.default_rng(0).normal(size=(4000, 3))
    ball = points(around / np.linalg.norm(around, axis=1, keepdims=True))
    assert len(ball.select_outermost().radii) == OUTER_DIRECTIONS


@pytest.mark.parametrize("wide", [0, 60])
def test_the_axis_is_tilted_from_the_principal_ones(wide) -> None:
    """Small balls on one side at each end of a capsule turn the axes; those across its middle exchange the others."""
    rng = np.random.default_rng(3)
    x, angle = np.repeat([0.5, -0.5, 0.0], (30, 30, wide)), rng.uniform(-0.5, 0.5, 60 + wide)
    side = np.repeat([1.0, -1.0], (30, 30)).tolist() + [1.0, -1.0] * (wide // 2)
    across = 0.09 * np.column_stack((np.cos(angle), np.sin(angle))) * np.array(side)[:, None]
    across[60:] = across[60:, ::-1]
    balls = np.vstack(([1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], np.column_stack((x, across))))
    capsule = fit_capsule(Balls(balls, np.array([0.1, 0.1, *[0.01] * len(x)])))
    assert capsule.volume < 1.15 * np.pi * 0.1**2 * (2.0 + 4 / 3 * 0.1)


def test_points_in_a_place_and_in_a_line() -> None:
    capsule = fit_capsule(points([[1.0, 2.0, 3.0]] * 3))
    assert (capsule.start.tolist(), capsule.end.tolist(), capsule.radius) == ([1, 2, 3], [1, 2, 3], 0)
    line = fit_capsule(points([[0.0, 0.0, 0.0], [0.0, 0.0, 0.1], [0.0, 0.0, 1.0]]))
    assert line.radius < 1e-3
    assert np.linalg.norm(line.end - line.start) == pytest.approx(1, abs=1e-3)
