"""The samples that a model is to explain, and what a residual says of one more unknown."""

from dataclasses import replace

import numpy as np
import pytest

from dynident.checks.misfit import misfit
from tests.checks.moving_arm import MOVED, T, arm, case, truth

RIGHT = case()
LEFT_OUT = np.ones((len(T), 3), dtype=bool)
LEFT_OUT[300:320, 1] = False


def column(j: int = 0) -> np.ndarray:
    return RIGHT.q * (np.arange(3) == j)


def test_its_standard_error_is_the_scatter_over_noises() -> None:
    fit = misfit(RIGHT)
    noise = np.random.default_rng(0).standard_normal((16, *RIGHT.q.shape)) / fit.weight.max(axis=0)
    tests = [test for x in noise for test in misfit(replace(RIGHT, tau=fit.predicted + x)).score_tests([column()])]
    assert np.std([x.value for x in tests]) == pytest.approx(np.mean([x.std for x in tests]), rel=0.5)


def test_a_chance_effect_does_not_hold_in_all_parts() -> None:
    noise = np.random.default_rng(5).standard_normal((10, *RIGHT.q.shape))
    for test in misfit(RIGHT).score_tests(noise):
        assert max(test.share, test.held_out) < 0.01


def test_white_noise_is_known_and_lowers_what_must_be_explained() -> None:
    sigma = (MOVED.tau - arm().torque(MOVED.q, MOVED.dq, MOVED.ddq, truth(arm()))).std(axis=0)
    kept = 20.0 / 50.0 * 0.93  # of its energy below the cut-off
    np.testing.assert_allclose(RIGHT.noise, kept * sigma**2, rtol=0.25)
    assert misfit(RIGHT).min_share < 0.05
    wrong = replace(MOVED, tau=MOVED.tau + 2.0 * np.sin(3.0 * MOVED.q))
    assert misfit(case(wrong)).min_share == 0.1
