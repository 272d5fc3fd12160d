"""Factors in folds, of which the fit of all samples is made."""

from __future__ import annotations

import numpy as np

from dynident.apps.tuning.quick_fit import fold_factors
from dynident.motion.smoothers import Spline
from dynident.regression import ParallelFilter, Regression, Selection, merge_factors
from tests.apps.tuning.arms import MODEL, recording


def test_folds_together_are_all_samples() -> None:
    motions = tuple(Spline()(recording(seed, 3.0)) for seed in (1, 2))
    regression = Regression(MODEL, motions, Selection(ParallelFilter(decimate=3), (0.1, 0.0, 0.0)))
    folds = fold_factors(regression)
    assert len(folds) == 5
    assert min(fold.rows.min() for fold in folds) > 0
    merged, expected = merge_factors(folds), regression.triangular_factors
    np.testing.assert_array_equal(merged.rows, expected.rows)
    for R, expected_R in zip(merged.factors, expected.factors, strict=True):
        np.testing.assert_allclose(R.T @ R, expected_R.T @ expected_R, atol=1e-9 * np.square(expected_R).sum())
