"""Recordings of the same motion, at any lag, and of others."""

import numpy as np
import pytest

from dynident.motion.log import Log
from dynident.motion.smoothers import Difference
from dynident.regression import repeat_of, repeats_path

T = np.arange(4000) * 0.0025


def log(start: float, seed: int, scale: float = 1.0, noise: float = 0.01) -> Log:
    t = scale * (T + start)
    rng = np.random.default_rng(seed)
    x = np.sin(3 * t) + 0.7 * np.sin(4.1 * t + 1) + 0.4 * np.sin(1.7 * t * np.sqrt(2) + 2)
    q = x + 1e-4 * rng.standard_normal(len(t))
    return Log(T, q[:, None], (20 + 3 * np.cos(x) + noise * rng.standard_normal(len(t)))[:, None], ("a",))


@pytest.mark.parametrize("lag", [-1.3, -0.04, 0.0, 0.04, 0.0013, 2.5])
def test_a_repeat_is_found_at_its_lag(lag: float) -> None:
    result = repeat_of(log(lag, 1), log(0.0, 2))
    assert result.lag == pytest.approx(lag, abs=3e-4)
    assert result.error < 1


@pytest.mark.parametrize("seed", range(5, 15))
def test_another_motion_is_none(seed: int) -> None:
    """A heavy arm, whose torque hardly varies: the positions tell."""
    other = log(0.0, seed, scale=0.6 + 0.03 * seed if seed < 10 else 1.1 + 0.03 * seed)
    assert repeat_of(log(0.0, 100), other).error > 30


def test_the_other_may_be_too_short() -> None:
    assert repeat_of(log(0.0, 1), log(0.0, 1).window(stop=2.0)).error == np.inf


def test_a_sliding_joint_counts_as_much_as_a_turning_one() -> None:
    """A rail of 0.2 m beside a joint that turns by 2 rad; a joint that stands still has only noise to repeat."""

    def both(seed: int, rail: Log) -> Log:
        turning, rng = log(0.0, seed), np.random.default_rng(seed)
        still = 1e-4 * rng.standard_normal((len(T), 1))
        q = np.hstack([turning.q, 0.05 * rail.q, still])
        return Log(T, q, np.repeat(turning.tau, 3, axis=1), ("a", "rail", "still"))

    assert repeat_of(both(1, log(0.0, 1)), both(2, log(0.0, 2))).error < 1
    assert repeat_of(both(1, log(0.0, 1)), both(2, log(0.0, 2, scale=0.7))).error > 30


@pytest.mark.parametrize(("size", "rate"), [(0.9, 1.0), (1.2, 1.0), (1.0, 0.9), (1.0, 1.2), (0.9, 1.1)])
def test_a_motion_of_another_size_or_speed_within_a_quarter_is_a_repeat(size: float, rate: float) -> None:
    smooth = Difference("central")
    other = log(0.0, 2)
    other = Log(other.t / rate, size * other.q, other.tau, other.joints)
    assert repeat_of(log(0.0, 1), other).error > 9
    assert repeats_path(smooth(log(0.0, 1)), smooth(other))


@pytest.mark.parametrize(("size", "rate"), [(0.7, 1.0), (1.4, 1.0), (1.0, 0.7), (1.0, 1.4)])
def test_a_motion_that_is_clearly_larger_or_faster_is_another(size: float, rate: float) -> None:
    other = log(0.0, 2)
    motion = Difference("central")(Log(other.t / rate, size * other.q, other.tau, other.joints))
    assert not repeats_path(Difference("central")(log(0.0, 1)), motion)
