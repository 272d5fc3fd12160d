"""What results say of the arm, as measurements."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dynident.errors import InputError
from dynident.io.saved import load
from dynident.payload import Evidence
from tests.payload.arms import arm, damaged, result


def test_the_values_differ_from_the_truth_by_about_their_errors() -> None:
    one, (_, theta) = Evidence.of(result()), arm()
    left = one.white() @ (one.value - one.combination @ theta)
    assert 0.5 < np.mean(left**2) < 2
    np.testing.assert_allclose(one.white() @ one.covariance @ one.white().T, np.eye(len(one.value)), atol=1e-6)


def test_a_saved_result_says_the_same(tmp_path: Path) -> None:
    result().save(tmp_path / "result.json")
    again, one = Evidence.of(load(tmp_path / "result.json", model=arm()[0])), Evidence.of(result())
    assert one.by_load is not None
    for name in ("value", "covariance", "by_joint", "shares", "by_load"):
        np.testing.assert_array_equal(getattr(again, name), getattr(one, name))


def test_results_that_do_not_know_their_covariance_are_refused() -> None:
    with pytest.raises(InputError, match="old: does not hold the covariance"):
        Evidence.of(damaged(result()), "old")
    one = Evidence.of(result())
    with pytest.raises(InputError, match="covariance of the base parameters is singular"):
        replace(one, covariance=one.covariance * 0 + 1.0).white()
    with pytest.raises(InputError, match="no standard error"):
        replace(one, covariance=0 * one.covariance).white()
