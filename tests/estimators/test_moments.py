"""The equations of instruments, streamed: against dense algebra, least squares, and a rank that is deficient."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dynident.estimators.instrument_moments import moments_of, score_information
from dynident.estimators.instruments import InstrumentKind, Instruments
from dynident.estimators.least_squares import LinearFit, solve_least_squares, weight_joints
from dynident.models import Joint, Model, RotorInertia
from dynident.models.friction import Coulomb, Offset, Viscous
from dynident.models.lagrangian import two_link_arm
from dynident.motion.log import Motion
from dynident.regression import ParallelFilter, Regression, Selection
from dynident.regression import linear_problem as module

ARM = two_link_arm()
NAMES = ("joint1", "joint2")
WEIGHTS = np.array([2.0, 0.5])


def motion(seed: int, samples: int = 300, holes: bool = False) -> Motion:
    rng = np.random.default_rng(seed)
    q, dq, ddq, tau = rng.standard_normal((4, samples, 2))
    mask = np.ones(samples, dtype=bool)
    keep = None
    if holes:
        mask[100:104] = False
        keep = rng.random((samples, 2)) > 0.2
    return Motion(0.01 * np.arange(samples), q, dq, ddq, tau, NAMES, mask, f"run {seed}", keep=keep)


def noisy(one: Motion, seed: int, size: float = 0.3) -> Motion:
    rng = np.random.default_rng(seed)
    q, dq, ddq = (x + size * rng.standard_normal(x.shape) for x in (one.q, one.dq, one.ddq))
    return replace(one, q=q, dq=dq, ddq=ddq)


def solved(rows: Regression, others: Regression, weights: np.ndarray = WEIGHTS):
    factor, rank = weight_joints(rows.triangular_factors, weights, rows.model.parameters)
    return moments_of(rows, others, LinearFit(factor, rank, rows.triangular_factors.total, weights)), rank


def dense(regression: Regression, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """All rows, weighted, by joint and sample."""
    blocks = list(regression.blocks())
    keep = [np.ones(b.tau.shape) if b.keep is None else b.keep for b in blocks]
    Y = np.concatenate([b.Y * (k * weights)[:, :, None] for b, k in zip(blocks, keep, strict=True)])
    tau = np.concatenate([b.tau * k * weights for b, k in zip(blocks, keep, strict=True)])
    return Y.reshape(-1, Y.shape[2]), tau.ravel()


@pytest.mark.parametrize("low", [None, ParallelFilter(3, 8.0)])
def test_is_the_just_identified_solution_of_dense_matrices(low, monkeypatch: pytest.MonkeyPatch) -> None:
    """(W' D^2 X)^-1 W' D^2 y of all rows at once; with gaps, rows that are left out, and a filter."""
    monkeypatch.setattr(module, "BLOCK", 64)
    some = motion(1, holes=low is None), motion(2, 200)
    rows = Regression(ARM, some, Selection(low))
    others = replace(rows, motions=tuple(noisy(one, 9) for one in some))
    (X, y), (W, _) = (dense(one, WEIGHTS) for one in (rows, others))
    found, _ = solved(rows, others)
    np.testing.assert_allclose(found.value, np.linalg.solve(W.T @ X, W.T @ y), rtol=1e-9)
    residual = (y - X @ found.value).reshape(-1, 2) / WEIGHTS
    expected = np.square(residual).sum(axis=0) / found.rows
    np.testing.assert_allclose(found.residual(found.to_basis(found.value)), expected, rtol=1e-9)


def test_the_regressor_as_its_own_instrument_is_least_squares() -> None:
    rows = Regression(ARM, (motion(3),))
    found, rank = solved(rows, rows)
    factor, _ = weight_joints(rows.triangular_factors, WEIGHTS, ARM.parameters)
    np.testing.assert_allclose(found.value, solve_least_squares(factor, rank).value, rtol=1e-12)
    strength = found.strength(300.0)
    assert strength.correlation == pytest.approx(1.0, abs=1e-9)
    assert strength.statistic > 1e6


def test_the_covariance_is_that_of_dense_matrices_where_residuals_are_white() -> None:
    """A^-1 (sum_j w_j^4 s_j^2 W_j' W_j) A^-T, but for what the estimate of a long-run covariance scatters."""
    one = motion(4, 20_000)
    truth = np.array(ARM.values)
    one = replace(one, tau=ARM.torque(one.q, one.dq, one.ddq, truth) + one.tau * (0.1, 3.0))
    rows = Regression(ARM, (one,))
    others = replace(rows, motions=(noisy(one, 5),))
    found, rank = solved(rows, others)
    given = [Instruments(others.motions[0], InstrumentKind.LAGGED)]
    information, independent = score_information(found, rows, others, given, rank)
    (X, _), (W, _) = (dense(each, WEIGHTS) for each in (rows, others))
    bread = np.linalg.inv(W.T @ X)
    weighted_rows = W * np.tile(WEIGHTS * (0.1, 3.0), len(one))[:, None]
    expected = bread @ (weighted_rows.T @ weighted_rows) @ bread.T
    std = np.sqrt(np.diag(np.linalg.inv(information)))
    np.testing.assert_allclose(std, np.sqrt(np.diag(expected)), rtol=0.25)
    assert 2000 <= independent <= 20_000


def test_what_the_data_do_not_determine_stays_so() -> None:
    """Two masses on the same joint: their sum is found, their share is that of least norm."""
    joints = (Joint("joint1"), Joint("joint2"))
    model = Model(
        (
            RotorInertia(joints),
            RotorInertia(joints, names=("b1", "b2")),
            Viscous(joints),
            Coulomb(joints),
            Offset(joints),
        )
    )
    one = motion(6)
    truth = np.arange(1.0, 11.0)
    one = replace(one, tau=model.torque(one.q, one.dq, one.ddq, truth))
    rows = Regression(model, (one,))
    found, rank = solved(rows, replace(rows, motions=(noisy(one, 7),)))
    assert rank.rank == 8
    np.testing.assert_allclose(found.value[:4], [2.0, 3.0, 2.0, 3.0], rtol=1e-8)
    np.testing.assert_allclose(found.value[4:], truth[4:], rtol=1e-8)


def test_strength_is_the_smallest_correlation_and_its_direction() -> None:
    """An instrument of the offset is exact, that of the speed is nearly noise: F = N r^2 / (1 - r^2)."""
    joints = (Joint("joint1"), Joint("joint2"))
    model = Model((Viscous(joints), Offset(joints)))
    one = motion(8, 4000)
    other = replace(one, dq=one.dq * (0.1, 1.0) + np.random.default_rng(1).standard_normal(one.dq.shape) * (1.0, 0.01))
    rows = Regression(model, (one,))
    found, _ = solved(rows, replace(rows, motions=(other,)), np.ones(2))
    strength = found.strength(4000.0)
    r = float(np.sum(one.dq[:, 0] * other.dq[:, 0]) / np.linalg.norm(one.dq[:, 0]) / np.linalg.norm(other.dq[:, 0]))
    assert strength.correlation == pytest.approx(abs(r), rel=0.1)
    assert strength.statistic == pytest.approx(4000 * strength.correlation**2 / (1 - strength.correlation**2))
    assert np.argmax(np.abs(strength.direction)) == 0
