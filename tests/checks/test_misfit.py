"""What a residual says of one more unknown: against regressions with the column, and on noise that is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dynident.checks.misfit import misfit
from tests.checks.moving_arm import arm, case, motion, truth

RIGHT = case()


def column(j: int = 0) -> np.ndarray:
    found = np.zeros_like(RIGHT.q)
    found[:, j] = RIGHT.q[:, j]
    return found


def test_an_unknown_is_found_as_if_it_had_been_fitted_with_all_others() -> None:
    spring = replace(RIGHT, tau=RIGHT.tau + 0.3 * column())
    fit = misfit(spring)
    weight = fit.weight.max(axis=0)
    (found,) = fit.score_tests([column()])
    assert found is not None
    whole = misfit(replace(spring, extra=(column(),)), weight)
    assert found.share == pytest.approx(1.0 - whole.size / fit.size, rel=1e-9)
    assert found.value == pytest.approx(0.3, abs=5 * found.std)
    assert found.by_joint[0] == pytest.approx(found.by_joint.max())
    assert 0.9 * found.share < found.held_out < found.share
    assert found.has_constant_sign


def test_its_standard_error_is_the_scatter_over_noises() -> None:
    fit = misfit(RIGHT)
    values, stds = [], []
    for seed in range(16):
        noise = np.random.default_rng(seed).standard_normal(RIGHT.q.shape) / fit.weight.max(axis=0)
        (found,) = misfit(replace(RIGHT, tau=fit.predicted + noise)).score_tests([column()])
        values.append(found.value)
        stds.append(found.std)
    assert np.std(values) == pytest.approx(np.mean(stds), rel=0.5)


def test_what_the_model_has_already_cannot_be_seen() -> None:
    fit = misfit(RIGHT)
    for x in (RIGHT.dq, RIGHT.ddq, np.ones_like(RIGHT.q)):
        own = np.zeros_like(x)
        own[:, 2] = x[:, 2]
        assert list(fit.score_tests([own])) == [None]


def test_a_chance_effect_does_not_hold_in_all_parts() -> None:
    fit = misfit(RIGHT)
    rng = np.random.default_rng(5)
    for _ in range(10):
        (found,) = fit.score_tests([rng.standard_normal(RIGHT.q.shape)])
        assert found is not None
        assert max(found.share, found.held_out) < 0.01


def test_white_noise_is_known_and_lowers_what_must_be_explained() -> None:
    moved = motion(noise=0.02)
    clean = arm().torque(moved.q, moved.dq, moved.ddq, truth(arm()))
    sigma = (moved.tau - clean).std(axis=0)
    kept = 20.0 / 50.0 * 0.93  # of its energy below the cut-off
    np.testing.assert_allclose(case(moved).noise, kept * sigma**2, rtol=0.25)
    assert misfit(case(moved)).min_share < 0.05
    wrong = replace(moved, tau=moved.tau + 2.0 * np.sin(3.0 * moved.q))
    assert misfit(case(wrong)).min_share == 0.1


def test_what_is_left_free_has_the_values_of_the_file() -> None:
    model = arm()
    fit = misfit(RIGHT)
    assert fit.theta.shape == (len(model.parameters),)
    np.testing.assert_allclose(RIGHT.torque(fit.theta), fit.predicted, atol=1e-6 * np.abs(fit.predicted).max())
    mass = [x.name for x in model.parameters].index("shoulder.mass")
    assert fit.theta[mass] == pytest.approx(4.0)  # a mass on a vertical axis is not seen at all
