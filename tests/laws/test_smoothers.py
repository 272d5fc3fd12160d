"""What every smoother promises: one suite for the whole family. A new smoother is added to SMOOTHERS."""

from __future__ import annotations

import numpy as np
import pytest

from dynident.errors import InputError
from dynident.log import Log
from dynident.smoothers import Butterworth, Delayed, Difference, Smoother, Spline
from dynident.splines import GCV, REML, Fixed, Interpolation, smooth

SMOOTHERS = [
    Difference(),
    Difference("central"),
    Butterworth(),
    Butterworth(orders=(2, 2, 2), cutoffs=(40.0, 40.0, 40.0)),
    Spline(),
    Spline(sigma=1e-4),
    Spline(sigma={"b": 1e-4}),
    Spline(GCV()),
    Spline(REML()),
    Spline(Fixed(lam=1e-7)),
    Spline(Interpolation()),
    Delayed(Spline(), 0.0),
]
NOISY = [s for s in SMOOTHERS if isinstance(s, Spline)]


def motion(t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Two joints that move slowly enough for the article's 2 Hz filter."""
    q = np.column_stack((np.sin(1.5 * t), 0.5 * np.cos(2 * t) + 0.1 * t))
    dq = np.column_stack((1.5 * np.cos(1.5 * t), -np.sin(2 * t) + 0.1))
    ddq = np.column_stack((-2.25 * np.sin(1.5 * t), -2 * np.cos(2 * t)))
    return q, dq, ddq


def recorded(noise: float = 0.0, n: int = 4000, h: float = 2.5e-3, jitter: float = 0.0, start: float = 0.0) -> Log:
    rng = np.random.default_rng(7)
    t = start + np.arange(n) * h + jitter * h * rng.uniform(-0.5, 0.5, n)
    q = motion(t)[0]
    tau = rng.standard_normal(q.shape)
    return Log(t, q + noise * rng.standard_normal(q.shape), tau, ("a", "b"), "made")


@pytest.mark.parametrize("smoother", SMOOTHERS, ids=repr)
class TestEverySmoother:
    def test_keeps_what_is_not_its_own(self, smoother: Smoother) -> None:
        log = recorded(1e-4)
        made = smoother(log)
        np.testing.assert_array_equal(made.t, log.t)
        np.testing.assert_array_equal(made.tau, log.tau)
        assert (made.joints, made.source) == (log.joints, log.source)
        assert made.q.shape == made.dq.shape == made.ddq.shape == log.q.shape
        assert "method" in made.smoothing

    def test_recovers_a_smooth_motion_without_noise(self, smoother: Smoother) -> None:
        made = smoother(recorded(0.0))
        for found, true, within in zip((made.q, made.dq, made.ddq), motion(made.t), (1e-3, 1e-2, 3e-2), strict=True):
            assert np.abs(found - true)[made.mask].max() < within * np.abs(true).max()

    def test_is_linear_in_scale_and_shift(self, smoother: Smoother) -> None:
        """Another zero of the encoder changes q by it and nothing else."""
        log = recorded(1e-4)
        moved = smoother(Log(log.t, log.q + 2.0, log.tau, log.joints))
        made = smoother(log)
        np.testing.assert_allclose(moved.q, made.q + 2.0, atol=1e-8)
        np.testing.assert_allclose(moved.dq, made.dq, atol=1e-7 * np.abs(made.dq).max())
        np.testing.assert_allclose(moved.ddq, made.ddq, atol=1e-5 * np.abs(made.ddq).max())

    def test_time_may_start_anywhere(self, smoother: Smoother) -> None:
        log = recorded(1e-4)
        later = smoother(Log(log.t + 1024.0, log.q, log.tau, log.joints))
        np.testing.assert_allclose(later.ddq, smoother(log).ddq, atol=2e-4 * np.abs(later.ddq).max())

    def test_joints_do_not_mix(self, smoother: Smoother) -> None:
        log = recorded(1e-4)
        alone = smoother(log.select(("b",)))
        np.testing.assert_allclose(alone.ddq[:, 0], smoother(log).ddq[:, 1], atol=1e-6 * np.abs(alone.ddq).max())

    def test_vouches_for_the_middle_and_not_for_the_ends_it_cannot_know(self, smoother: Smoother) -> None:
        made = smoother(recorded(1e-4))
        used = np.flatnonzero(made.mask)
        assert (np.diff(used) == 1).all()
        assert len(used) > len(made) // 2
        assert not made.mask[-1]

    def test_is_frozen_and_repeatable(self, smoother: Smoother) -> None:
        log = recorded(1e-4)
        np.testing.assert_array_equal(smoother(log).ddq, smoother(log).ddq)
        with pytest.raises(AttributeError):
            smoother.ends = 1  # type: ignore[attr-defined, misc]
        with pytest.raises(ValueError, match="read-only"):
            smoother(log).ddq[0, 0] = 1.0

    def test_too_few_samples(self, smoother: Smoother) -> None:
        """Three samples: a refusal in words, or numbers, never a crash or a NaN."""
        try:
            made = smoother(recorded(n=3))
        except InputError as error:
            words = str(error)
        else:
            words = "samples" if np.isfinite(made.ddq).all() else "not finite"
        assert "samples" in words or "made" in words


@pytest.mark.parametrize("smoother", NOISY, ids=repr)
def test_splines_take_irregular_times_as_they_are(smoother: Spline) -> None:
    made = smoother(recorded(0.0, jitter=0.9))
    true = motion(made.t)[2]
    assert np.abs(made.ddq - true)[made.mask].max() < 3e-2 * np.abs(true).max()


@pytest.mark.parametrize("delay", [0.003, -0.0071, 0.25])
def test_a_delayed_spline_is_the_spline_at_later_times(delay: float) -> None:
    """Between samples a cubic spline's second derivative is straight: the shift is exact."""
    log = recorded(1e-4, jitter=0.3)
    fit = smooth(log.t, log.q)
    made = Delayed(Spline(), delay)(log)
    seen = (log.t + delay >= log.t[0]) & (log.t + delay <= log.t[-1])
    for order, found in enumerate((made.q, made.dq, made.ddq)):
        expected = fit(log.t[seen] + delay, order)
        assert np.abs(found[seen] - expected).max() < 1e-9 * np.abs(expected).max()
    assert not made.mask[~seen].any()
    np.testing.assert_array_equal(made.tau, log.tau)
