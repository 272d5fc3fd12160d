"""The Savitzky-Golay smoother: the window that it takes, its mask and its errors."""

import numpy as np
import pytest

from dynident.motion.log import Log
from dynident.motion.smoothers import SavitzkyGolay, Spline
from dynident.runtime import InputError


def log(n: int = 4000, h: float = 0.0025, noise: float = 1e-4, seed: int = 0, colour: int = 1) -> Log:
    """Two joints with noise, white or the running mean of so many samples."""
    t = np.arange(n) * h
    q = np.column_stack((np.sin(1.5 * t) + 0.3 * np.sin(6 * t), np.cos(2 * t)))
    e = np.random.default_rng(seed).standard_normal((n + colour - 1, 2))
    e = np.apply_along_axis(np.convolve, 0, e, np.full(colour, 1 / np.sqrt(colour)), mode="valid")
    return Log(t, q + noise * e, np.zeros((n, 2)), ("a", "b"), "made")


def acceleration_error(smoother: SavitzkyGolay | Spline, data: Log) -> float:
    """Rms error of joint a's acceleration in the middle of a log, as a share of it."""
    true = -2.25 * np.sin(1.5 * data.t) - 10.8 * np.sin(6 * data.t)
    middle = slice(len(data) // 4, 3 * len(data) // 4)
    return float(np.sqrt(np.mean(np.square(smoother(data).ddq[middle, 0] - true[middle]) / np.mean(true**2))))


@pytest.mark.parametrize("noise", [1e-5, 1e-3])
@pytest.mark.parametrize("colour", [1, 5])
def test_the_window_is_nearly_the_best_for_the_acceleration(noise: float, colour: int) -> None:
    """Within a quarter of the least error of all windows, whatever the size and the colour of the noise."""
    data = log(noise=noise, colour=colour)
    best = min(acceleration_error(SavitzkyGolay(window), data) for window in np.geomspace(0.1, 1.0, 10))
    assert acceleration_error(SavitzkyGolay(), data) < 1.25 * best


def test_where_both_orders_miss_the_motion_no_window_is_taken() -> None:
    """A window of seconds would make a fast motion vanish in both, which then agree."""
    t = np.arange(6000) * 0.005
    q = np.sin(0.3 * t) + 0.02 * np.sin(12 * t) + 1e-4 * np.random.default_rng(0).standard_normal(6000)
    motion = SavitzkyGolay()(Log(t, q[:, None], q[:, None], ("a",)))
    assert motion.smoothing["window"][0] < 0.5
    true = -0.09 * np.sin(0.3 * t) - 2.88 * np.sin(12 * t)
    assert np.abs(motion.ddq[:, 0] - true)[motion.mask].max() < 0.1 * 2.88


def test_a_joint_at_rest_has_an_infinite_window() -> None:
    data = log()
    q = np.column_stack((data.q[:, 0], np.full(len(data), 0.3)))
    motion = SavitzkyGolay()(Log(data.t, q, data.tau, data.joints))
    used = SavitzkyGolay().as_used(motion)
    assert used.window == {"a": motion.smoothing["window"][0], "b": np.inf}
    np.testing.assert_array_equal(used(log()).ddq[:, 1], 0.0)


def test_a_gap_is_masked_and_does_not_widen_the_noise() -> None:
    data = log()
    t = np.where(data.t > 5.0, data.t + 2.0, data.t)
    q = np.sin(3 * t) + 1e-4 * np.random.default_rng(0).standard_normal(len(t))
    motion = SavitzkyGolay()(Log(t, q[:, None], q[:, None], ("a",)))
    half = motion.smoothing["window"][0] / 2
    near = (motion.t > 5.0 - 0.9 * half) & (motion.t < 7.0 + 0.9 * half)
    assert not motion.mask[near].any()
    assert motion.mask[(motion.t > half) & (motion.t < 5.0 - 1.1 * half)].all()
    assert motion.smoothing["noise"][0] == pytest.approx(1e-4, rel=0.05)
    assert np.abs(motion.ddq[:, 0] + 9 * np.sin(3 * t))[motion.mask].max() < 0.03


def test_the_shortest_logs() -> None:
    with pytest.raises(InputError, match=r"made: 6 samples are too few for polynomials of order 4, which need 7"):
        SavitzkyGolay()(log(6))
    assert SavitzkyGolay()(log(7)).mask.sum() == 1
    with pytest.raises(InputError, match=r"4 samples, 0.0075 s, are too short for a window of 0.1 s|too few"):
        SavitzkyGolay(0.1, 2)(log(4))


@pytest.mark.parametrize(
    ("part", "words"),
    [
        (SavitzkyGolay(0.001), r"made: a window of 0.001 s holds 1 samples; polynomials of order 4 need at least 7"),
        (SavitzkyGolay(30.0), r"4000 samples, 10 s, are too short for a window of 30 s"),
        (SavitzkyGolay(1e300), r"are too short for a window of 1e\+300 s"),
    ],
)
def test_a_window_that_does_not_fit_the_log(part: SavitzkyGolay, words: str) -> None:
    with pytest.raises(InputError, match=words):
        part(log())


def test_a_log_without_a_window_free_of_gaps_is_refused() -> None:
    data = log(400)
    t = data.t + 0.5 * (np.arange(400) // 20)
    with pytest.raises(InputError, match=r"every window of 41 samples has a gap in it; smooth less"):
        SavitzkyGolay(40 * 0.0025)(Log(t, data.q, data.tau, data.joints, "made"))
