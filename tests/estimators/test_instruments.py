"""Instruments: their equations against dense algebra, scores of two passes, and motions from before and after."""

from dataclasses import replace

import numpy as np
import pytest

from dynident.estimators.instrument_moments import _add_partner_scores, moments_of
from dynident.estimators.instruments import InstrumentKind, Instruments, cutoff_frequency, lag_of
from dynident.estimators.least_squares import LinearFit, weight_joints
from dynident.models.lagrangian import two_link_arm
from dynident.motion.filters import butterworth, zero_phase
from dynident.motion.log import Log, Motion
from dynident.regression import ParallelFilter, Regression, Selection
from dynident.regression import linear_problem as module
from tests.estimators.looped import driven

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


def noisy(case: Motion, seed: int, size: float = 0.3) -> Motion:
    rng = np.random.default_rng(seed)
    q, dq, ddq = (x + size * rng.standard_normal(x.shape) for x in (case.q, case.dq, case.ddq))
    return replace(case, q=q, dq=dq, ddq=ddq)


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
    others = replace(rows, motions=tuple(noisy(x, 9) for x in some))
    (X, y), (W, _) = (dense(x, WEIGHTS) for x in (rows, others))
    result, _ = solved(rows, others)
    np.testing.assert_allclose(result.value, np.linalg.solve(W.T @ X, W.T @ y), rtol=1e-9)
    residual = (y - X @ result.value).reshape(-1, 2) / WEIGHTS
    expected = np.square(residual).sum(axis=0) / result.rows
    np.testing.assert_allclose(result.residual(result.to_basis(result.value)), expected, rtol=1e-9)


MOTION, _ = driven(60)


def instruments(other: int, partner: np.ndarray) -> Instruments:
    return Instruments(MOTION, InstrumentKind.REPEATED, None, other, partner)


def test_paired_samples_are_added_once() -> None:
    """The second recording is 5 samples late, of both each third sample is left; the last ones have no partner."""
    n = 60
    there, back = np.arange(n) + 5, np.arange(n) - 5
    there[there >= n] = -1
    back[back < 0] = -1
    at, places = np.arange(0, n, 3), np.arange(2, n, 3)
    u, v = np.ones((len(at), 1)), np.full((len(places), 1), 10.0)
    _add_partner_scores((at, u), (places, v), instruments(1, there), instruments(0, back))
    assert set(np.unique(u)) <= {1.0, 11.0}
    assert float(u.sum() + v.sum()) == len(at) + 10.0 * len(places)
    assert (u[there[at] >= 0] == 11.0).all()
    assert (u[there[at] < 0] == 1.0).all()


STEP = 0.01
T = STEP * np.arange(400)


def polynomial(seed: int = 0) -> Motion:
    p = np.polynomial.Polynomial(np.random.default_rng(seed).standard_normal(6))
    q, dq, ddq = (x(T - 2.0)[:, None] for x in (p, p.deriv(), p.deriv(2)))
    return Motion(T, q, dq, ddq, 0 * q, ("slider",), np.ones(len(T), dtype=bool))


@pytest.mark.parametrize("low", [5.0, 12.0])
def test_the_cutoff_is_that_of_a_low_pass(low: float) -> None:
    """Order 1 forward and backward passes half of the amplitude at its cut-off, in the presence of a large motion."""
    rng = np.random.default_rng(1)
    t = STEP * np.arange(20_000)
    before = (np.sin(2 * t) + 1e-4 * rng.standard_normal(len(t)))[:, None]
    after = zero_phase(butterworth(1, low, 1 / STEP), before[:, 0], 100)[:, None]
    assert cutoff_frequency(before, after) * 0.5 / STEP == pytest.approx(low, rel=0.1)
    assert cutoff_frequency(before, before) == 1.0
    assert cutoff_frequency(before[:8], before[:8]) == 1.0


def test_the_lag_grows_with_smoothing_and_filter() -> None:
    rng = np.random.default_rng(2)
    motion = polynomial()
    assert lag_of(motion, None, None) == pytest.approx(3 * STEP)
    slow = lag_of(motion, None, ParallelFilter(cutoff=5.0))
    assert slow > 1.5 * lag_of(motion, None, ParallelFilter(cutoff=10.0)) > 4 * STEP
    noisy = Log(T, motion.q + 1e-3 * rng.standard_normal(motion.q.shape), motion.tau, motion.joints)
    assert lag_of(motion, noisy, None) > lag_of(motion, None, None)
