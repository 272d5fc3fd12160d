"""The smallest capsule around balls."""

import numpy as np
import pytest

from dynident.models.geometry import Balls


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
    for capsule in (balls.capsule(), balls.quick_capsule()):
        assert beyond(capsule, balls).max() < 2e-3 * capsule.radius + 1e-12


def test_a_capsule_is_found_again() -> None:
    rng = np.random.default_rng(1)
    start, end, radius = np.array([0.1, -0.2, 0.3]), np.array([0.4, 0.1, 0.1]), 0.07
    away = rng.normal(size=(3000, 3))
    away *= radius / np.linalg.norm(away, axis=1, keepdims=True)
    surface = start + rng.uniform(size=(3000, 1)).round() * (end - start) + away
    capsule = points(surface).capsule()
    assert capsule.radius == pytest.approx(radius, rel=0.02)
    ends = sorted(np.array([capsule.start, capsule.end]).tolist())
    assert np.array(ends) == pytest.approx(np.array([start, end]), abs=0.01)
