"""The evidence of a change, and how often chance has it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import f

from dynident.apps.online.candidates import evidence, gains, threshold
from dynident.runtime import ConfigError


def test_evidence_is_minus_the_logarithm_of_the_tail_of_f() -> None:
    gain = np.array([0.0, 1.0, 10.0, 80.0, 300.0])
    for rank in (1, 2, 10):
        np.testing.assert_allclose(evidence(gain, rank, 60.0), -f.logsf(gain / rank, rank, 60.0), rtol=1e-9, atol=1e-12)


def test_evidence_grows_where_the_tail_underflows() -> None:
    found = evidence(np.array([1e4, 1e10, 1e14, 1e18, 1e22]), 2, 60.0)
    assert (np.diff(found) > 0).all()
    assert np.isfinite(found).all()
    np.testing.assert_allclose(np.diff(found)[1:], 30 * np.log(1e4), rtol=1e-6, atol=1e-3)


def test_of_rank_zero_there_is_no_evidence() -> None:
    assert evidence(np.array([5.0]), np.array([0]), 60.0).tolist() == [0.0]


def test_gains_are_of_the_directions_that_are_shown() -> None:
    information = np.array([np.diag([4.0, 0.0]), np.diag([4.0, 4.0]), np.zeros((2, 2))])
    found, rank = gains(np.array([[2.0, 0.0], [2.0, 4.0], [0.0, 0.0]]), information, information)
    np.testing.assert_allclose(found, [1.0, 5.0, 0.0])
    assert rank.tolist() == [1, 2, 0]


def test_the_threshold_rises_by_one_where_the_rate_falls_by_e() -> None:
    limits = [threshold(rate, 5.0, (2, 2), 60.0, np.random.default_rng(0), 120).evidence for rate in (1.0, np.exp(-1))]
    assert limits[1] - limits[0] == pytest.approx(1.0)


@pytest.mark.parametrize("rate", [0.0, -1.0, np.nan, np.inf])
def test_a_rate_that_is_none_is_refused(rate: float) -> None:
    with pytest.raises(ConfigError, match="false alarms a day"):
        threshold(rate, 5.0, (2,), 60.0, np.random.default_rng(0), 120)
