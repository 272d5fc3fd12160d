"""Blocked cross-validation: the errors by hand, and common samples, on which leaving out does not win."""

from dataclasses import replace

import numpy as np
import pytest

from dynident.identification.cross_validation import left_out_errors, motion_gain
from dynident.models.lagrangian import two_link_arm
from dynident.motion.log import Motion
from dynident.testing.estimator import multisine_motion

FOLDS = 4


def motion(noise: float = 0.1) -> Motion:
    """A swing of the arm with white noise in its torques."""
    return multisine_motion(two_link_arm(), noise)


def by_hand(case: Motion, keep: np.ndarray, scored: np.ndarray) -> np.ndarray:
    """The errors (folds, n) by lstsq, with each joint relative to its torque."""
    Y = two_link_arm().regressor(case.q, case.dq, case.ddq)
    w = 1 / np.sqrt((case.tau**2 * keep).sum(axis=0))
    result = []
    for part in np.array_split(np.arange(len(case)), FOLDS):
        rest = keep.copy()
        rest[part] = False
        rows = (Y * w[:, None])[rest], (case.tau * w)[rest]
        theta = np.linalg.lstsq(*rows, rcond=None)[0]
        result.append(((case.tau - Y @ theta) ** 2 * scored)[part].sum(axis=0))
    return np.array(result)


def test_the_errors_are_those_by_hand_also_where_other_samples_are_scored_than_fitted() -> None:
    keep, scored = np.ones((2000, 2), dtype=bool), np.ones((2000, 2), dtype=bool)
    full = left_out_errors(two_link_arm(), [motion()], folds=FOLDS)
    np.testing.assert_allclose(full, by_hand(motion(), keep, scored), rtol=1e-8)
    keep[300:500, 1], scored[900:1000] = False, False
    result = left_out_errors(
        two_link_arm(), [replace(motion(), keep=keep)], [replace(motion(), keep=scored)], folds=FOLDS
    )
    np.testing.assert_allclose(result, by_hand(motion(), keep, scored), rtol=1e-8)


def test_the_gain_is_that_of_the_blocks() -> None:
    before, after = (left_out_errors(two_link_arm(), [motion(noise)], folds=FOLDS) for noise in (0.1, 0.05))
    blocks = 100 * ((before - after) / before.sum(axis=0)).mean(axis=1)
    result = motion_gain(two_link_arm(), [motion(0.1)], [motion(0.05)], folds=FOLDS)
    assert result.share == pytest.approx(blocks.sum())
    assert result.share == pytest.approx(75, abs=2)
    assert result.std == pytest.approx(np.sqrt(FOLDS) * blocks.std(ddof=1))
    assert result.sure


def test_leaving_out_bad_samples_gains_by_what_is_fitted_only() -> None:
    """Noise that is left out of the fit is left out of both errors: only the better fit of the rest counts."""
    bad = np.arange(2000) % 10 == 0
    wild = np.random.default_rng(1).standard_normal((2000, 2)) * bad[:, None]
    case = replace(motion(), tau=motion().tau + wild)
    result = motion_gain(two_link_arm(), [case], [replace(case, keep=np.broadcast_to(~bad[:, None], (2000, 2)))])
    assert 0 < result.share < 10
    masked = motion_gain(two_link_arm(), [motion()], [replace(motion(), mask=~bad)])
    assert abs(masked.share) < 1
