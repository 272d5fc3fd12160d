"""Spikes and frozen stretches: found where they were put, and in no clean signal."""

import numpy as np
import pytest

from dynident.motion.splines import bridge_gaps, frozen_samples, spikes, torn_ends

T = np.arange(5000) * 1e-3
NOISE = 1e-4


def signal(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.sin(5 * T) + 0.3 * np.sin(17 * T + seed) + NOISE * rng.standard_normal(len(T))


@pytest.mark.parametrize("seed", range(20))
def test_no_clean_signal_has_any(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x = signal(seed)
    stick = np.cumsum(np.sign(np.sin(3 * T)) * np.minimum(np.abs(3 * np.sin(3 * T)), 1)) * 1e-3
    coloured = np.convolve(rng.standard_normal(len(T) + 60), np.exp(-np.arange(50) / 10), "same")[: len(T)]
    steps = np.sign(np.sin(3 * T + seed)) + 0.01 * rng.standard_normal(len(T))
    growing = np.sin(3 * T) + 0.01 * np.abs(np.cos(3 * T)) * rng.standard_normal(len(T))
    both = np.column_stack([x, np.round(x / 3e-4) * 3e-4, stick, stick + 1e-3 * coloured, steps, growing])
    assert spikes(T, both).sum() == 0
    assert frozen_samples(T, both).sum() == 0
    rest = np.where(T < 0.01, 0.0, 1 - np.cos(3 * np.maximum(T - 0.01, 0)))
    ends = np.column_stack([both[:, :2], rest, np.round(rest / 3e-4) * 3e-4, 0 * T, np.sin(5 * T)])
    assert torn_ends(T, ends).sum() == 0
    assert torn_ends(T, ends[::-1]).sum() == 0


def test_spikes_of_ten_deviations_are_found_and_nothing_else() -> None:
    """Nine of ten are found, of 400; with that rate the share has a standard error of 1.5 %."""
    hits = 0
    for seed in range(20):
        rng, x = np.random.default_rng(seed), signal(seed)
        rows = rng.choice(np.arange(50, 4950, 60), 20, replace=False)
        x[rows] += 10 * NOISE * rng.choice([-1, 1], 20)
        result = np.flatnonzero(spikes(T, x))
        assert set(result) <= set(rows)
        hits += len(result)
    assert hits >= 0.85 * 400


@pytest.mark.parametrize("width", [1, 2, 3, 5])
def test_wide_spikes_are_found_whole(width: int) -> None:
    x = signal(0)
    x[777 : 777 + width] += 0.01
    assert np.flatnonzero(spikes(T, x)).tolist() == list(range(777, 777 + width))


def test_the_first_and_last_eight_samples_are_not_looked_at() -> None:
    for row, seen in ((7, False), (8, True), (len(T) - 9, True), (len(T) - 8, False)):
        x = signal(0)
        x[row] += 0.01
        assert np.flatnonzero(spikes(T, x)).tolist() == [row] * seen


def test_late_readings_are_no_spikes() -> None:
    rows = np.arange(len(T))
    rows[1000:1004], rows[3000:3003] = 999, 2999
    coarse = np.round(np.sin(5 * T) / 1e-4) * 1e-4
    assert spikes(T, coarse[rows]).sum() == 0


def test_a_frozen_stretch_is_found_and_a_rest_is_not() -> None:
    x = signal(1)
    x[1000:1300] = x[1000]
    assert np.flatnonzero(frozen_samples(T, x)).tolist() == list(range(1000, 1300))
    rest = np.round(np.sin(5 * np.clip(T, 1.0, None)) / 1e-3) * 1e-3
    assert frozen_samples(T, rest).sum() == 0
    assert frozen_samples(T[:31], x[985:1016]).sum() == 0  # too short to tell
    assert frozen_samples(T[:1000], np.full(1000, 2.0)).sum() == 0


def test_the_bridge_follows_the_curve() -> None:
    x, gone = np.sin(5 * T), np.zeros(len(T), dtype=bool)
    gone[[0, 777]] = gone[2000:2020] = True
    y = np.where(gone, 50.0, x)
    assert np.abs(bridge_gaps(T, y, gone) - x).max() < 1e-5
    gone[:20] = True
    assert bridge_gaps(T, y, gone)[0] == pytest.approx(x[20])


@pytest.mark.parametrize("width", [1, 2, 5])
def test_torn_ends_are_found_and_continued(width: int) -> None:
    """The continuation is a parabola through 8 samples: 5 samples on, its error is about 8 times the noise."""
    x = signal(0)
    torn = x.copy()
    torn[:width], torn[-width:] = 0.5, 7.0
    result = torn_ends(T, torn)
    assert np.flatnonzero(result).tolist() == [*range(width), *range(len(T) - width, len(T))]
    assert np.abs(bridge_gaps(T, torn, result) - x).max() < 30 * NOISE


@pytest.mark.parametrize("mirrored", [False, True])
def test_a_frozen_stretch_needs_eight_samples_beyond_the_end_that_jumps(mirrored: bool) -> None:
    """Held back to the value it leaves with, it jumps at its start alone."""
    for start, seen in ((8, True), (7, False)):
        x = np.sin(np.pi * np.arange(400) / 200)  # a whole period: the ends are near each other
        x[start:60] = x[59]
        held = frozen_samples(T[:400], x[::-1] if mirrored else x)
        expected = range(340, 400 - start) if mirrored else range(start, 60)
        assert np.flatnonzero(held).tolist() == (list(expected) if seen else [])


def test_a_spike_of_rounded_values_is_higher_than_twice_their_steps() -> None:
    """Slow, where a step is 1, and at two and a half a sample, where the largest is 3."""
    slow, fast = np.floor(0.04 * np.arange(600)), np.floor(0.005 * np.arange(600.0) ** 2)
    for x, row, height, seen in (
        (slow, 312, 3, True),
        (slow, 312, -3, True),
        (fast, 250, 5, False),
        (fast, 250, 7, True),
    ):
        y = x.copy()
        y[row] += height
        assert np.flatnonzero(spikes(T[:600], y)).tolist() == [row] * seen


def test_a_bridge_to_three_samples_starts_at_their_line() -> None:
    """The line through 0, 1, 0 is 1/3; the cubic between 1/3 and 0, both level, is half of it in the middle."""
    t, x = np.arange(20.0), np.zeros(20)
    x[1] = 1.0
    gone = (t >= 3) & (t <= 6)
    bridge = bridge_gaps(np.delete(t, 4), np.delete(x, 4), np.delete(gone, 4))  # 4.5 lies midway between 2 and 7
    np.testing.assert_allclose(np.interp(5.0, np.delete(t, 4), bridge), (1 / 3) * (1 - 3 * 0.6**2 + 2 * 0.6**3))
