"""The first model of a simulation: noise that is differentiated must not lead it to another minimum."""

from __future__ import annotations

import numpy as np

from dynident.estimators import LeastSquares, OutputError, Problem
from dynident.estimators.notes import FirstModel, StartedElsewhere
from dynident.models.lagrangian import pendulum
from dynident.models.simulation import record, simulate
from dynident.motion.smoothers import Difference
from dynident.regression import Regression
from dynident.runtime import progress_to

ARM = pendulum()
TRUTH = np.array(ARM.values)
T = np.arange(2001) * 0.005


def noisy(sigma: float) -> Problem:
    """A pendulum whose positions are noisy."""
    motion = simulate(ARM, TRUTH, lambda s: [np.sin(2 * s) + np.sin(3 * s)], T)
    log = record(motion, sigma_q=sigma, sigma_tau=1e-3, rng=np.random.default_rng(0)).log
    motions = (Difference()(log),)
    return Problem(ARM, motions, Regression(ARM, motions), (log,))


def test_begins_with_the_fit_that_is_nearest_when_simulated() -> None:
    problem = noisy(1e-3)
    assert LeastSquares()(problem).value[0] < 0.1 * TRUTH[0]
    steps: list[str] = []
    with progress_to(steps.append):
        found = OutputError()(problem)
    assert steps[:4] == [
        "simulating first models (0 of 3)",
        "simulating first models (1 of 3)",
        "simulating first models (2 of 3)",
        "simulating (0 of 30)",
    ]
    assert steps[4] == "simulating (1 of 30)"
    assert StartedElsewhere(FirstModel.SMOOTHED) in found.notes
    np.testing.assert_allclose(found.value, TRUTH, rtol=2e-3)


def test_begins_with_least_squares_where_this_is_as_near() -> None:
    motion = simulate(ARM, TRUTH, lambda s: [np.sin(2 * s) + np.sin(3 * s)], T)
    found = OutputError()(Problem(ARM, (motion,), Regression(ARM, (motion,))))
    assert not [note for note in found.notes if isinstance(note, StartedElsewhere)]
    np.testing.assert_allclose(found.value, TRUTH, rtol=1e-3)
