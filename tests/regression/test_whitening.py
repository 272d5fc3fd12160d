"""Whitened rows: those of a dense computation, in stretches, blocks, parts and pulls."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter

from dynident.models.lagrangian import two_link_arm
from dynident.motion.log import Motion
from dynident.regression import (
    ParallelFilter,
    Regression,
    Selection,
    Whitening,
    divide_regression,
    factors_of_parts,
    merge_factors,
    preceding_counts,
)
from dynident.runtime import ConfigError
from dynident.testing.estimator import multisine_motion

Array = NDArray[np.float64]
ARM = two_link_arm()
S = np.array([[2.0, 0.8], [0.8, 1.0]]) * 1e-4
NOISE = Whitening((np.array([0.9, -0.3, 0.1]), np.array([0.5])), S)
WAYS = [
    (None, None, NOISE),
    (None, (0.3, 0.2), NOISE),
    (ParallelFilter(decimate=3), (0.3, 0.2), NOISE),
    (None, None, replace(NOISE, covariance=np.diag([2e-4, 1e-4]))),
]


def holed(samples: int = 2600) -> Motion:
    """More samples than a block, with gaps."""
    motion = multisine_motion(ARM, 0.01, samples=samples)
    mask = motion.mask.copy()
    mask[[700, 701, 704]] = False
    mask[900:1000] = False
    return replace(motion, mask=mask)


def variance_before(a: Array, k: int) -> tuple[Array, float]:
    """The best predictor from k rows, and the variance of its error over that of an innovation, by Yule and Walker."""
    zeros = np.zeros(4000)
    zeros[0] = 1.0
    response = lfilter([1.0], np.append(1.0, -a), zeros)
    covariance = np.array([response[: len(response) - h] @ response[h:] for h in range(k + 1)])
    if not k:
        return np.zeros(0), covariance[0]
    R = covariance[np.abs(np.subtract.outer(np.arange(k), np.arange(k)))]
    solution = np.linalg.solve(R, covariance[1:])
    return solution, covariance[0] - solution @ covariance[1:]


def dense(plain: Regression, noise: Whitening) -> tuple[Array, int]:
    """X' V^-1 X of [X | y], row by row, and the number of rows."""
    p, stretches, end = len(plain.model.parameters), [], None
    for k, kept, block in plain.placed_blocks(plain.model.structure):
        rows = np.concatenate([block.regressor(), block.tau.T[:, :, None]], axis=2)
        stretches += [] if end == (k, kept.start) else [[]]
        stretches[-1].append((rows, np.ones(rows.shape[:2], dtype=bool) if block.keep is None else block.keep.T))
        end = k, kept.stop
    best = [[variance_before(a, k) for k in range(len(a) + 1)] for a in noise.coefficients]
    G, count = np.zeros((p + 1, p + 1)), 0
    for stretch in stretches:
        rows, used = (np.concatenate(x) for x in zip(*stretch, strict=True))
        result = np.zeros_like(rows)
        for j, predictors in enumerate(best):
            age = preceding_counts(used[:, j])
            for t in np.flatnonzero(used[:, j]):
                reference, variance = predictors[k := min(age[t], len(predictors) - 1)]
                result[t, j] = (rows[t, j] - reference @ rows[t - 1 - np.arange(k), j]) / np.sqrt(variance)
        for t in range(len(rows)):
            some = np.flatnonzero(used[t])
            G += result[t, some].T @ np.linalg.inv(noise.covariance[np.ix_(some, some)]) @ result[t, some]
            count += len(some)
    return G, count


@pytest.mark.parametrize(("low", "slow", "noise"), WAYS)
def test_rows_are_those_of_a_dense_computation(
    low: ParallelFilter | None, slow: tuple[float, ...] | None, noise: Whitening
) -> None:
    plain = Regression(ARM, (holed(),), Selection(low, slow))
    regression = replace(plain, whitening=noise)
    G, rows = dense(plain, noise)
    assert regression.triangular_factors.total == rows
    R = regression.triangular_factors.stack()
    np.testing.assert_allclose(R.T @ R, G, atol=1e-12 * np.abs(G).max())
    parts = merge_factors(factors_of_parts(regression, divide_regression(regression, 300))).stack()
    np.testing.assert_allclose(parts.T @ parts, G, atol=1e-12 * np.abs(G).max())
    if low is None:  # with a filter, the ends of a stretch are not treated apart
        torque = regression.motions[0].tau[:, :, None] * np.eye(2)
        pulls = regression.weighted_products([torque]).sum(axis=1)
        np.testing.assert_allclose(pulls, G[:-1, -1], atol=1e-12 * np.abs(G).max())
    Y = [block.Y.reshape(-1, 7) for block in regression.blocks()]
    used = [np.ones(b.tau.shape, dtype=bool) if b.keep is None else b.keep for b in regression.blocks()]
    X = np.concatenate([y[u.ravel()] for y, u in zip(Y, used, strict=True)])
    np.testing.assert_allclose(X.T @ X, G[:-1, :-1], atol=1e-12 * np.abs(G).max())


@pytest.mark.parametrize(
    ("coefficients", "covariance", "words"),
    [
        ((np.array([1.0]), np.zeros(0)), np.eye(2), "joint 1: the autoregression is not stable"),
        ((np.zeros(0), np.array([0.5, 0.6])), np.eye(2), "joint 2: the autoregression is not stable"),
        ((np.zeros(0), np.array([np.nan])), np.eye(2), "joint 2: the autoregression is not stable"),
        ((np.zeros(0),) * 2, np.ones((2, 2)), "not positive definite"),
        ((np.zeros(0),) * 2, np.diag([1.0, 0.0]), "not positive definite"),
        ((np.zeros(0),) * 2, np.array([[1.0, 0.5], [0.2, 1.0]]), "no symmetric matrix of the 2 joints"),
        ((np.zeros(0),) * 2, np.eye(3), "no symmetric matrix of the 2 joints"),
    ],
)
def test_what_is_no_noise_is_refused(coefficients: tuple[Array, ...], covariance: Array, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        Whitening(coefficients, covariance)


def test_noise_of_other_joints_is_refused() -> None:
    with pytest.raises(ConfigError, match="whitening is of 1 joints, the model has 2"):
        Regression(ARM, (holed(),), whitening=Whitening((np.zeros(0),), np.eye(1)))
