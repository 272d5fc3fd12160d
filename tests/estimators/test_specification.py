"""Whether noise explains how far two fits are apart: seldom denied where it does, denied where it does not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dynident.estimators import GeneralisedLeastSquares, LeastSquares, Problem
from dynident.estimators.noise import HausmanTest
from dynident.estimators.notes import WhiteningCostly
from dynident.regression import ParallelFilter, Regression, Selection, Whitening, rank_of
from dynident.runtime import progress_to
from dynident.testing.estimator import multisine_motion
from tests.estimators.coloured import ARM, COLOURED, S, noisy

SLOW = Whitening((np.array([0.999]), np.array([0.99])), S)
RUNS, SAMPLES = 40, 400


def test_slow_noise_is_seldom_taken_for_what_the_model_lacks() -> None:
    """Least squares takes slow noise for motion: the other fit leaves more of the torque, and is right."""
    more = noted = denied = 0
    for seed in range(RUNS):
        given = noisy(SLOW, seed, SAMPLES)
        found, plain = GeneralisedLeastSquares()(given), LeastSquares(weights="per_joint")(given)
        more += bool((found.residual.sigma / plain.residual.sigma).max() > 1.1)
        costly = [note for note in found.notes if isinstance(note, WhiteningCostly)]
        noted += len(costly)
        denied += sum(note.forbidden is not None for note in costly)
    assert noted == more >= 5
    assert denied <= 3  # of a rate of 2 %, more in 1 % of all seeds


def _apart(low: ParallelFilter | None) -> tuple[HausmanTest, Whitening]:
    motion = replace(multisine_motion(ARM, samples=1500), mask=np.arange(1500) % 700 > 20)
    plain = Regression(ARM, (motion,), Selection(low))
    return HausmanTest(plain, LeastSquares().reduced(Problem(ARM, (motion,), plain))), COLOURED


def test_the_distance_is_that_of_the_torques() -> None:
    apart, _ = _apart(None)
    by = np.random.default_rng(0).standard_normal((len(ARM.parameters), 2))
    start = apart.fit.solution.value
    rest = [apart.plain.triangular_factors.residual(start + one).sum() for one in (0.0 * by[:, 0], *by.T)]
    np.testing.assert_allclose(apart.distance(by), np.array(rest[1:]) - rest[0], rtol=1e-6)


def test_the_noise_that_is_drawn_is_that_which_was_found() -> None:
    """Of rows that are decimated, and in stretches: those that follow each other have the noise of neighbours."""
    for low in (None, ParallelFilter(decimate=2)):
        apart, noise = _apart(low)
        (drawn,) = apart._draw_noise(noise, 200, np.random.default_rng(0))
        rows = np.arange(21, 700, 1 if low is None else 2)
        first, second = drawn[rows, 1][1:], drawn[rows, 1][:-1]
        np.testing.assert_allclose(np.mean(first * second) / np.mean(second**2), 0.9, atol=0.01)
        u = first - 0.9 * second
        np.testing.assert_allclose(np.mean(u**2), S[1, 1], rtol=0.03)
        assert not drawn[~apart.plain.motions[0].mask].any()


def test_what_chance_explains() -> None:
    for low in (None, ParallelFilter(decimate=2)):
        apart, noise = _apart(low)
        rank = rank_of(replace(apart.plain, whitening=noise).triangular_factors.stack())
        usual = np.sqrt(np.diag(rank.inverse))
        steps: list[str] = []
        with progress_to(steps.append):
            assert apart.is_chance(0.5 * usual, noise, rank)
            assert not apart.is_chance(30.0 * usual, noise, rank)
        assert steps[0] == "simulating the noise (0 of 99)"
