"""Fourier series of logs: what is found of motion that repeats, and what is said of motion that does not."""

import numpy as np
import pytest

from dynident.motion.log import Log
from dynident.motion.smoothers import FourierSeries, Smoother
from dynident.runtime import InputError, MissingInputError

JOINTS = ("a", "b", "c")
T = np.arange(4000) * 2.5e-3


def arm(t: np.ndarray, period: float = 3.7) -> np.ndarray:
    """Three joints with 3, 5 and 4 harmonics."""
    w = 2 * np.pi / period * t
    return np.column_stack(
        (
            np.sin(w) + 0.2 * np.cos(3 * w + 1),
            0.5 * np.cos(2 * w) + 0.1 * np.sin(5 * w),
            0.3 * np.sin(w) * np.cos(3 * w),
        )
    )


def log(q: np.ndarray, t: np.ndarray = T, noise: float = 1e-3, seed: int = 0) -> Log:
    e = np.random.default_rng(seed).standard_normal(q.shape)
    return Log(t, q + noise * e, np.zeros(q.shape), JOINTS, "made")


def test_without_noise_it_is_exact() -> None:
    motion, h = FourierSeries()(log(arm(T), noise=0.0)), 1e-3
    slope = (arm(T + h) - arm(T - h)) / (2 * h)
    bend = (arm(T + h) - 2 * arm(T) + arm(T - h)) / h**2
    np.testing.assert_allclose(motion.q, arm(T), atol=1e-12)
    np.testing.assert_allclose(motion.dq, slope, atol=3e-5 * np.abs(slope).max())
    np.testing.assert_allclose(motion.ddq, bend, atol=3e-5 * np.abs(bend).max())


def test_the_noise_is_found_by_how_periods_differ() -> None:
    """Within 5 % of each of 20 estimates, and of their mean within 1 %; the spline's estimate needs no period."""
    result = np.array([FourierSeries(3.7)(log(arm(T), seed=k)).smoothing["sigma"] for k in range(20)])
    assert np.abs(result / 1e-3 - 1).max() < 0.05
    assert result.mean() == pytest.approx(1e-3, rel=0.01)


def test_noise_that_does_not_repeat_is_told_from_motion_that_does() -> None:
    """A slow noise, which no difference of neighbours shows, is in sigma, and whiteness rejects it."""
    slow = np.convolve(np.random.default_rng(0).standard_normal(4099), np.full(100, 0.1), mode="valid")
    motion = FourierSeries(2.0)(log(arm(T, 2.0) + 2e-3 * slow[:, None]))
    assert motion.smoothing["sigma"][0] == pytest.approx(np.hypot(1e-3, 2e-3 * slow.std()), rel=0.25)
    assert max(motion.smoothing["whiteness"]) < 1e-6


@pytest.mark.parametrize("given", [None, 2.3])
def test_transients_at_the_ends_are_left_out(given: float | None) -> None:
    """A rest of 1 s at either end, then a decaying transient."""
    for q, ends in (
        (arm(np.clip(T, 1.0, 9.0), 2.3), (0.8, 0.8)),
        (arm(T, 2.3) + 0.2 * np.exp(-T / 0.3)[:, None], (0.5, 0)),
    ):
        motion = FourierSeries(given)(log(q))
        how = motion.smoothing
        assert how["start"] > ends[0]
        assert how["stop"] >= ends[1]
        assert not motion.mask[how["start"] > motion.t + 1e-9].any()
        assert how["period"] == pytest.approx(2.3, abs=1e-3)
        assert how["sigma"] == pytest.approx((1e-3,) * 3, rel=0.2)


def test_gaps_and_broken_periods_are_no_harm() -> None:
    t = np.where(T > 4.0, T + 0.7, T)
    how = FourierSeries()(log(arm(t), t)).smoothing
    assert abs(how["period"] - 3.7) < 4 * how["period error"]
    assert how["harmonics"] == (3, 5, 4)
    assert how["sigma"] == pytest.approx((1e-3,) * 3, rel=0.1)


def test_a_joint_at_rest() -> None:
    q = arm(T)
    q[:, 1] = 0.2
    motion = FourierSeries()(log(q))
    assert motion.smoothing["harmonics"] == (3, 0, 4)
    assert not motion.ddq[:, 1].any()
    still = np.ones((4000, 3))
    assert not FourierSeries(2.0)(log(still)).ddq.any()
    with pytest.raises(MissingInputError, match="made: no joint moves, so that no period can be found; give `period`"):
        FourierSeries()(log(still))


REFUSED = {
    "wrong": (FourierSeries(3.6), arm(T), r"period of 3.6 s does not fit: joint '[abc]' .* \d+\S* % .*after 3.7\d* s"),
    "clock": (FourierSeries(0.501), arm(T, 0.5), r"period of 0.501 s does not fit"),
    "drift": (FourierSeries(), arm(T, 2.3) + 0.1 * T[:, None], "the motion does not repeat: joint"),
    "sweep": (FourierSeries(), arm(T**2 / 5, 2.3), r"no two periods of one motion are found in its 9.998 s"),
    "once": (FourierSeries(), arm(T, 7.4), "record two periods, give `period`"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_motion_that_does_not_repeat_is_refused(name: str) -> None:
    part, q, words = REFUSED[name]
    with pytest.raises(MissingInputError, match=words):
        part(log(q))


def test_pulses_that_differ_from_period_to_period_are_refused() -> None:
    """They are less than 1 % of the motion, but much of its acceleration; without them the same motion is taken."""
    q = arm(T, 2.3) + 0.002 * np.sin(40 * np.pi / 2.3 * T)[:, None]
    assert FourierSeries()(log(q, noise=1e-5)).smoothing["harmonics"] == (20, 20, 20)
    pulses = 0.003 * np.sin(50 * T) * (np.sin(1.3 * T) > 0.7)
    with pytest.raises(
        MissingInputError, match=r"does not repeat: .* by 0.\d+ % of its motion and \d+\S* % of its acceleration"
    ):
        FourierSeries()(log(q + pulses[:, None], noise=1e-5))


def test_one_period_is_enough_where_it_is_known() -> None:
    how = FourierSeries(7.4)(log(arm(T, 7.4))).smoothing
    assert how["harmonics"] == (3, 5, 4)
    assert how["sigma"] == pytest.approx((1e-3,) * 3, rel=0.05)
    with pytest.raises(InputError, match=r"9.998 s are less than one period of 20 s; record longer"):
        FourierSeries(20.0)(log(arm(T, 7.4)))


@pytest.mark.parametrize("samples", [3, 4, 5])
def test_a_few_samples_are_refused(samples: int) -> None:
    short: list[Smoother] = [FourierSeries(), FourierSeries(0.02)]
    for part in short:
        with pytest.raises(InputError, match=f"made: {samples} samples are too few for a series; it needs 6"):
            part(log(arm(T[:samples]), T[:samples]))


def test_settings_that_the_log_refuses() -> None:
    with pytest.raises(InputError, match=r"700 harmonics of 3.7 s are too many for 1480 samples a period.*at most 592"):
        FourierSeries(3.7, 700)(log(arm(T)))
    for period in (1e-3, 1e-300, 5e-324):
        with pytest.raises(InputError, match=r"made: a period of \S+ s is shorter than 5 samples, 0.0125 s; correct"):
            FourierSeries(period)(log(arm(T)))
    with pytest.raises(InputError, match=r"too short"):
        FourierSeries(3.7, settle=(9.0, 9.0))(log(arm(T)))
