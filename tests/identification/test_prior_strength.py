"""The strength of the prior: it helps where training is short, and is none where the file is wrong or says nothing."""

from dataclasses import replace

import numpy as np
import pytest

from dynident.estimators import LeastSquares, PhysicallyConsistent, Problem, bodies_of, parameter_scales
from dynident.identification import find_prior_strength
from dynident.identification.prior_strength import with_strength
from dynident.regression import Regression
from tests.estimators.arms import arm, error, problem

AUTO = PhysicallyConsistent()


def errors(text: str, seed: int, samples: int) -> tuple[float, float, float]:
    """Errors (%) on motion 2.5 times as fast, without the prior and with the strength that is found, and this."""
    slow = problem(text, speed=0.4, seed=seed, samples=samples, seconds=8.0)
    fast = problem(text, speed=1.0, seed=seed + 100, samples=400, wrong=0.0)
    prior_strength = find_prior_strength(slow.model, slow.motions, AUTO)
    chosen = with_strength(AUTO, prior_strength)(slow).value
    return error(fast, AUTO(slow).value), error(fast, chosen), prior_strength.strength


def test_a_file_that_is_off_by_a_quarter_helps_short_and_slow_training() -> None:
    rows = np.array([errors(arm(off=0.25, seed=seed), seed, 150) for seed in range(2)])
    assert (rows[:, 2] > 0).all()
    assert rows[:, 1].mean() < 0.97 * rows[:, 0].mean()
    assert (rows[:, 1] < 1.05 * rows[:, 0]).all()


@pytest.mark.parametrize("inertias", ["none", "zero"])
def test_a_file_without_inertias_has_no_strength(inertias: str) -> None:
    posed = problem(arm(inertias=inertias), samples=200)
    assert find_prior_strength(posed.model, posed.motions, AUTO) is None


def test_only_what_is_to_be_chosen_is() -> None:
    posed = problem(arm(), samples=200)
    for estimator in (LeastSquares(), replace(AUTO, strength=0.1), replace(AUTO, prior="none")):
        assert find_prior_strength(posed.model, posed.motions, estimator) is None
        assert with_strength(estimator, None) is estimator
    few = posed.motions[0].shift(0.0, np.arange(30))
    assert find_prior_strength(posed.model, [few], AUTO) is None


def test_the_stronger_the_prior_the_nearer_the_file() -> None:
    """In units of the usual sizes; the data alone at zero, the file in the limit."""
    posed = problem(arm(off=0.3), samples=200)
    nominal = np.array([parameter.value or 0.0 for parameter in posed.model.parameters])[:60]
    parameters = posed.model.parameters
    size = parameter_scales(parameters, bodies_of(parameters), np.ones(len(parameters)), 1.0)[:60]
    far = [
        np.linalg.norm((PhysicallyConsistent(strength=x)(posed).value[:60] - nominal) / size)
        for x in (0.0, 1e-2, 1.0, 1e3)
    ]
    assert far == sorted(far, reverse=True)
    assert far[-1] < 0.1 * far[0]
    few = Problem(posed.model, posed.motions, Regression(posed.model, posed.motions))
    np.testing.assert_array_equal(AUTO(few).value, PhysicallyConsistent(strength=0.0)(few).value)
