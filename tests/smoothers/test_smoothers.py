"""Each smoother's own facts: the article's equations, its masks and its errors."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import butter, filtfilt

from dynident.errors import ConfigError, InputError
from dynident.log import Log
from dynident.smoothers import Butterworth, Difference, Spline
from dynident.splines import Fixed


def log(n: int = 4001, h: float = 0.0025, noise: float = 1e-3) -> Log:
    t = np.arange(n) * h
    q = np.column_stack((np.sin(t), np.cos(2 * t))) + noise * np.random.default_rng(0).standard_normal((n, 2))
    return Log(t, q, np.zeros((n, 2)), ("a", "b"), "made")


def test_forward_differences_as_printed() -> None:
    """Eqs. (47)-(48), with the two last samples not vouched for."""
    made, data = Difference()(log()), log().q
    dq = (data[1:] - data[:-1]) / 0.0025
    np.testing.assert_allclose(made.dq[:-1], dq, rtol=1e-9)
    np.testing.assert_allclose(made.ddq[:-2], (dq[1:] - dq[:-1]) / 0.0025, rtol=1e-6, atol=1e-8)
    np.testing.assert_array_equal(np.flatnonzero(~made.mask), [3999, 4000])


def test_central_differences_are_exact_for_a_parabola_on_any_grid() -> None:
    t = np.cumsum(np.random.default_rng(0).uniform(0.5, 2, 50))
    made = Difference("central")(Log(t, (t**2 - 3 * t)[:, None], np.zeros((50, 1)), ("a",)))
    np.testing.assert_allclose(made.dq[made.mask, 0], (2 * t - 3)[made.mask], rtol=1e-10)
    np.testing.assert_allclose(made.ddq[made.mask], 2.0, rtol=1e-8)


def test_butterworth_is_the_articles() -> None:
    """butter(3, 0.05), butter(3, 0.015), butter(4, 0.01) and filtfilt, as NOTES correct eq. (53)."""
    data = log()
    made = Butterworth()(data)
    q = data.q
    dq = np.diff(q, axis=0, append=0) / 0.0025
    dq[-1] = dq[-2]
    for order, fraction, x, found in ((3, 0.05, q, made.q), (3, 0.015, dq, made.dq)):
        b, a = butter(order, fraction)
        np.testing.assert_allclose(found, filtfilt(b, a, x, axis=0, padlen=3 * order), atol=1e-9 * np.abs(x).max())
    b, a = butter(3, 0.05)
    assert np.abs(a - [1, -2.6862, 2.4197, -0.7302]).max() < 5e-5
    true = -np.sin(made.t)
    assert np.abs(made.ddq[:, 0] - true)[made.mask].max() < 0.05


def test_butterworth_settles() -> None:
    made = Butterworth()(log())
    assert 1.5 < made.t[made.mask][0] < 2.0
    article = Butterworth(settle=(1.7475, 0.0))(log())
    assert article.t[article.mask][0] == pytest.approx(1.7475)
    assert article.t[article.mask][-1] == pytest.approx(10.0 - 2 * 0.0025)


def test_butterworth_refuses_irregular_times() -> None:
    t = np.arange(400) * 0.0025
    t[200:] += 0.001
    with pytest.raises(InputError, match=r"made: the step after t = 0.4975 s is 0.0035 s.*Use the spline smoother"):
        Butterworth()(Log(t, np.sin(t)[:, None], np.zeros((400, 1)), ("a",), "made"))


def test_butterworth_refuses_a_cutoff_above_half_the_rate() -> None:
    with pytest.raises(InputError, match="a cut-off of 10 Hz does not lie below half the sampling rate"):
        Butterworth()(log(h=0.05))


@pytest.mark.parametrize(
    ("build", "words"),
    [
        (lambda: Difference("backward"), "did you mean|Known: 'forward', 'central'"),  # type: ignore[arg-type]
        (lambda: Butterworth(orders=(3, 3, 0)), "filter orders"),
        (lambda: Butterworth(cutoffs=(10, -3, 2)), "three positive frequencies"),
        (lambda: Butterworth(settle=(-1, 0)), "settle is"),
        (lambda: Spline(ends=-1), "ends is -1"),
        (lambda: Spline(sigma={"c": 1.0})(log()), "sigma names the joint 'c'.*'a', 'b'"),
    ],
)
def test_bad_settings(build, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        build()


def test_spline_tells_how_it_smoothed() -> None:
    made = Spline(sigma={"b": 2e-3})(log())
    assert made.smoothing["sigma"][1] == 2e-3
    assert made.smoothing["sigma"][0] == pytest.approx(1e-3, rel=0.1)
    assert made.smoothing["S"] == pytest.approx((4001, 4001))
    assert all(0.01 < width < 1.0 for width in made.smoothing["bandwidth"])


def test_spline_beats_raw_differences_by_far() -> None:
    true = -np.sin(log().t)
    spline, raw = Spline(sigma=1e-3)(log()), Difference()(log())
    error = [np.sqrt(np.mean((made.ddq[:, 0] - true)[made.mask] ** 2)) for made in (spline, raw)]
    assert error[0] < 0.05
    assert error[1] > 100


def test_a_spline_too_wide_for_the_log_is_said() -> None:
    with pytest.raises(InputError, match="too short"):
        Spline(Fixed(lam=0.64))(log(n=200))  # a bandwidth of 0.2 s


def test_a_joint_that_double_precision_cannot_smooth_is_named() -> None:
    t = np.arange(60_000) * 1e-6
    made = Log(t, np.sin(40 * t)[:, None] * [1.0, 2.0], np.zeros((len(t), 2)), ("wrist", "hand"), "run")
    with pytest.raises(InputError, match="run: joint 'wrist' cannot be smoothed with these settings"):
        Spline(Fixed(lam=20000.0**4 * 1e-18))(made)


@pytest.mark.parametrize("size", [1.0, 1e-4])
@pytest.mark.parametrize("kind", ["noise", "flicker"])
def test_a_joint_that_stands_still_has_no_velocity(kind: str, size: float) -> None:
    rng, n = np.random.default_rng(5), 3000
    rest = 1e-5 * rng.standard_normal(n) if kind == "noise" else 1e-4 * (rng.uniform(size=n) > 0.7)
    t = np.arange(n) * 0.002
    moving = size * np.sin(3 * t) + 1e-5 * size * rng.standard_normal(n)
    made = Spline()(Log(t, np.column_stack([0.4 + rest, moving]), np.zeros((n, 2)), ("still", "moving")))
    assert np.ptp(made.q[:, 0]) == 0
    assert not made.dq[:, 0].any()
    assert not made.ddq[:, 0].any()
    assert np.abs(made.dq[made.mask, 1] - 3 * size * np.cos(3 * t[made.mask])).max() < 0.01 * size
