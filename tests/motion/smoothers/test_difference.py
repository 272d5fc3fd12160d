"""Differences, raw and by Butterworth's filters: the article's equations, their masks and errors."""

import numpy as np
import pytest
from scipy.signal import butter, filtfilt

from dynident.motion.log import Log
from dynident.motion.smoothers import Butterworth, Difference
from dynident.runtime import InputError


def log(n: int = 4001, h: float = 0.0025, noise: float = 1e-3) -> Log:
    t = np.arange(n) * h
    q = np.column_stack((np.sin(t), np.cos(2 * t))) + noise * np.random.default_rng(0).standard_normal((n, 2))
    return Log(t, q, np.zeros((n, 2)), ("a", "b"), "made")


def test_butterworth_is_the_articles() -> None:
    """butter(3, 0.05), butter(3, 0.015), butter(4, 0.01) and filtfilt, as NOTES correct eq. (53)."""
    data = log()
    made = Butterworth()(data)
    q = data.q
    dq = np.diff(q, axis=0, append=0) / 0.0025
    dq[-1] = dq[-2]
    for order, fraction, x, result in ((3, 0.05, q, made.q), (3, 0.015, dq, made.dq)):
        b, a = butter(order, fraction)
        np.testing.assert_allclose(result, filtfilt(b, a, x, axis=0, padlen=3 * order), atol=1e-9 * np.abs(x).max())
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


def test_butterworth_takes_what_is_longer_than_the_padding_of_its_filters() -> None:
    """Three times the order, and a sample more to extend from."""
    smoother = Butterworth(orders=(1, 2, 4), cutoffs=(50.0, 50.0, 50.0), settle=(0.0, 0.0))
    assert np.isfinite(smoother(log(14)).ddq).all()
    with pytest.raises(InputError, match="made: 13 samples are too few for a filter of order 4"):
        smoother(log(13))


def test_forward_differences_as_printed() -> None:
    """Eqs. (47)-(48), with the two last samples masked."""
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
