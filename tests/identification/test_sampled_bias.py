"""The bias by errors of the motion from samples of many pieces, and how sure it is."""

from __future__ import annotations

import numpy as np
import pytest

from dynident.estimators import LeastSquares, Problem
from dynident.identification.motion_errors import RepetitionFactors, repeat_piece, sampled_bias
from dynident.identification.repetition import pieces_of
from dynident.models import Model
from dynident.models.friction import Coulomb, Viscous
from dynident.models.lagrangian import pendulum
from dynident.models.simulation import record
from dynident.motion.log import Motion
from dynident.motion.smoothers import Spline
from dynident.motion.splines import NORMAL_95
from dynident.regression import Regression
from dynident.validation import clustered_std

ARM = pendulum()
MODEL = Model((*ARM.terms, Viscous(ARM.joints, values=(0.05,)), Coulomb(ARM.joints, values=(0.1,), width=0.1)))
TRUTH = np.asarray(MODEL.values)
SMOOTHER = Spline(factor=1.4)
PIECES, SAMPLES = 16, 1000


def motion(rng: np.random.Generator) -> Motion:
    """A piece of a recording, unlike the others."""
    t = np.arange(SAMPLES)[:, None] * 0.005
    q, dq, ddq = np.zeros((3, SAMPLES, 1))
    for w in rng.uniform((1, 3, 7), (3, 7, 11)):
        size, phase = rng.uniform(0.5, 2.0) / w, rng.uniform(0, 6)
        q = q + size * np.sin(w * t + phase)
        dq = dq + w * size * np.cos(w * t + phase)
        ddq = ddq - w**2 * size * np.sin(w * t + phase)
    names = tuple(joint.name for joint in MODEL.joints)
    return Motion(t[:, 0], q, dq, ddq, MODEL.torque(q, dq, ddq, TRUTH), names, np.ones(SAMPLES, dtype=bool))


def corrected(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the errors of a corrected estimate, its standard errors as if the correction were exact, and with its
    error: of a quarter of the samples of each piece."""
    rng = np.random.default_rng(seed)
    logs = [record(motion(rng), 3e-3, 0.002, rng).log for _ in range(PIECES)]
    motions = tuple(SMOOTHER(one) for one in logs)
    regression = Regression(MODEL, motions)
    value = LeastSquares()(Problem(MODEL, motions, regression)).value
    part = np.arange(SAMPLES // 4)
    repeated = [
        repeat_piece(MODEL, piece, value, regression, rng)
        for log, one in zip(logs, motions, strict=True)
        for piece in pieces_of(MODEL, log.rows(part, ""), one.shift(0.0, part), SMOOTHER, value, 1.0)
    ]
    found = sampled_bias(repeated, MODEL, np.ones(1))
    assert found is not None
    parts = [Regression(MODEL, (one,)).triangular_factors for one in motions]
    plain = clustered_std(lambda: parts, regression, value)
    wide = np.sqrt(plain**2 + np.diag(found.covariance) + found.remainder**2)
    return value - found.bias - TRUTH, plain, wide


def test_intervals_that_count_the_error_of_the_correction_hold() -> None:
    """Of 20 x 4 intervals at least 85 % hold (four deviations below 95 %)."""
    errors, plain, wide = (np.array(one) for one in zip(*map(corrected, range(20)), strict=True))
    assert np.mean(np.abs(errors) < NORMAL_95 * wide) > 0.85
    assert (
        np.mean(np.abs(errors) < NORMAL_95 * plain) < np.mean(np.abs(errors) < NORMAL_95 * wide) - 0.1
    )  # not by the rest alone


def test_pieces_without_rows_do_not_count_and_one_is_too_few() -> None:
    rng = np.random.default_rng(0)
    one = motion(rng)
    log = record(one, 3e-3, 0.01, rng).log
    like = Regression(MODEL, (SMOOTHER(log),))
    (piece,) = pieces_of(MODEL, log, like.motions[0], SMOOTHER, TRUTH, 1.0)
    found = repeat_piece(MODEL, piece, TRUTH, like, rng)
    empty = like.triangular_factors.__class__(np.zeros_like(found.once.factors), np.zeros_like(found.once.rows))
    none = RepetitionFactors(empty, empty)
    assert sampled_bias([found, none], MODEL, np.ones(1)) is None
    both, more = sampled_bias([found, found], MODEL, np.ones(1)), sampled_bias([found, none, found], MODEL, np.ones(1))
    assert both is not None
    assert more is not None
    np.testing.assert_allclose(more.bias, both.bias, rtol=1e-9)
    np.testing.assert_allclose(both.covariance, 0.0, atol=1e-12 * np.square(both.bias).max())
    assert both.remainder == pytest.approx(more.remainder)
