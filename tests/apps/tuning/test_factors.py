"""Factors in folds, of which any choice of terms and joints is a part."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dynident.apps.tuning import Bench
from dynident.apps.tuning.quick_fit import (
    columns_in,
    digest,
    fold_factors,
    keep_unfitted,
    select_columns,
    without_joints,
)
from dynident.models import Model
from dynident.motion.log import Motion
from dynident.motion.smoothers import Spline
from dynident.regression import ParallelFilter, Regression, Selection, merge_factors
from tests.apps.tuning.arms import JOINTS, MODEL, recording


def motions() -> tuple[Motion, ...]:
    return tuple(Spline()(recording(seed, 3.0)) for seed in (1, 2))


def test_folds_together_are_the_whole() -> None:
    regression = Regression(MODEL, motions(), Selection(ParallelFilter(decimate=3), (0.1, 0.0, 0.0)))
    folds = fold_factors(regression)
    assert len(folds) == 5
    assert min(one.rows.min() for one in folds) > 0
    together, whole = merge_factors(folds), regression.triangular_factors
    np.testing.assert_array_equal(together.rows, whole.rows)
    for one, other in zip(together.factors, whole.factors, strict=True):
        np.testing.assert_allclose(one.T @ one, other.T @ other, atol=1e-9 * np.square(other).sum())


def test_columns_of_more_terms_are_those_of_fewer() -> None:
    some = Model(MODEL.terms[:2])
    columns = columns_in(MODEL, some)
    assert columns is not None
    assert columns_in(some, MODEL) is None
    (part,) = select_columns(fold_factors(Regression(MODEL, motions()), 1), columns)
    whole = Regression(some, motions()).triangular_factors
    for one, other in zip(part.factors, whole.factors, strict=True):
        np.testing.assert_allclose(one.T @ one, other.T @ other, atol=1e-9 * np.square(other).sum())


def test_joints_are_left_out_of_what_is_known() -> None:
    plain, log = motions()[0], recording(1, 3.0)
    keep = np.ones(plain.q.shape, dtype=bool)
    keep[:, 1] = False
    narrow = replace(plain, keep=keep)
    assert digest([keep_unfitted(narrow, (JOINTS[1],))], [log]) == digest([plain], [log]) != digest([narrow], [log])
    keep[100, 0] = False
    odd = keep_unfitted(replace(plain, keep=keep), (JOINTS[1],))
    assert odd.keep is not None
    assert np.argwhere(~odd.keep).tolist() == [[100, 0], [100, 1]]
    (some,) = without_joints(fold_factors(Regression(MODEL, (plain,)), 1), [1])
    other = Regression(MODEL, (narrow,)).triangular_factors
    np.testing.assert_array_equal(some.rows, other.rows)
    np.testing.assert_allclose(np.abs(some.factors), np.abs(other.factors), atol=1e-9)


def test_terms_and_joints_are_fitted_from_stored_factors(arm: Bench) -> None:
    """Nothing of the regressor is computed again."""
    tuning = arm.start.with_degree(0.25)
    arm.fit(tuning)
    known = len(arm._known.factors._known)
    for changed in (tuning.with_terms(1, ("offset",)), replace(tuning, unfitted=(JOINTS[0],))):
        arm.fit(replace(changed, estimator="consistent"))
    assert len(arm._known.factors._known) == known
