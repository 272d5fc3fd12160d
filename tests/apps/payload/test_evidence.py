"""What results say of the arm, as measurements."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dynident.apps.payload import ArmEvidence
from dynident.project.saved import load
from dynident.runtime import InputError
from tests.apps.payload.arms import arm, damaged, result


def test_the_values_differ_from_the_truth_by_about_their_errors() -> None:
    one, (_, theta) = ArmEvidence.of(result()), arm()
    left = one.whitening_matrix() @ (one.value - one.combination @ theta)
    assert 0.5 < np.mean(left**2) < 2
    np.testing.assert_allclose(
        one.whitening_matrix() @ one.covariance @ one.whitening_matrix().T, np.eye(len(one.value)), atol=1e-6
    )


def test_a_saved_result_says_the_same(tmp_path: Path) -> None:
    result().save(tmp_path / "result.json")
    again, one = ArmEvidence.of(load(tmp_path / "result.json", model=arm()[0])), ArmEvidence.of(result())
    assert one.by_load is not None
    for name in ("value", "covariance", "by_joint", "shares", "by_load"):
        np.testing.assert_array_equal(getattr(again, name), getattr(one, name))


def test_results_that_do_not_know_their_covariance_are_refused() -> None:
    with pytest.raises(InputError, match="old: does not hold the covariance"):
        ArmEvidence.of(damaged(result()), "old")
    one = ArmEvidence.of(result())
    with pytest.raises(InputError, match="covariance of the base parameters is singular"):
        replace(one, covariance=one.covariance * 0 + 1.0).whitening_matrix()
    with pytest.raises(InputError, match="no standard error"):
        replace(one, covariance=0 * one.covariance).whitening_matrix()
