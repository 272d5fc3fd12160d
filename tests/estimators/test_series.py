"""Logs in pieces of steps."""

from dataclasses import replace

import numpy as np
import pytest

from dynident.estimators.augmented_kalman_steps import group_size, series_of, smooth_model
from dynident.models.lagrangian import slider, two_link_arm
from dynident.runtime import InputError
from dynident.testing.estimator import make_problem, multisine_motion, truth

ARM = two_link_arm()


@pytest.mark.parametrize("samples", [4000, 500])
def test_steps_have_the_torque_of_their_samples(samples):
    motion = multisine_motion(ARM)
    problem = make_problem(ARM, motion)
    found = series_of(problem, samples, np.ones(2), (np.zeros((2000, 2)),), (motion.tau,))
    group = group_size(motion, samples)
    assert group == (1 if samples == 4000 else 4)
    assert found.active.all(axis=1).any()
    h = motion.t[1]
    np.testing.assert_allclose(found.step, group * h)
    np.testing.assert_array_equal(found.offset, 0.0)  # the positions of the motion are those that were measured
    np.testing.assert_allclose(found.motion[2, 0, 0], (motion.dq[group] - motion.dq[0]) / (group * h))
    whole = (found.mean[0] * found.active[0, :, None]).sum(axis=0) * group * h
    rows = int(found.active[0].sum()) * group
    np.testing.assert_allclose(whole, np.trapezoid(motion.tau[: rows + 1], dx=h, axis=0), atol=1e-3)
    np.testing.assert_allclose(found.noise, 1 / np.sqrt(group))


def test_torques_that_are_not_fitted_hardly_count():
    motion = multisine_motion(ARM)
    keep = np.ones((2000, 2), dtype=bool)
    keep[:200, 1] = False
    found = series_of(
        make_problem(ARM, replace(motion, keep=keep)), 4000, np.ones(2), (np.zeros((2000, 2)),), (motion.tau,)
    )
    assert (found.noise[0, :100, 1] > 99).all()
    assert (found.noise[0, :100, 0] == 1).all()


def test_too_short():
    short = multisine_motion(ARM, samples=2000).select_between(stop=0.03)
    with pytest.raises(InputError, match="at least 12"):
        series_of(make_problem(ARM, short), 4000, np.ones(2), (np.zeros((2000, 2)),), (short.tau,))


def test_a_sign_is_uncertain_where_it_may_change_within_a_step():
    model = slider(values=(5.0, 8.0, 3.0, 0.5))
    motion = multisine_motion(model)
    smooth, widths, (uncertain,) = smooth_model(make_problem(model, motion), truth(model), 0.005)
    far = np.abs(motion.dq) > 6 * widths[0]
    assert uncertain[far].max() < 0.01
    assert uncertain[np.abs(motion.dq) < widths[0]].max() > 1.0
    assert smooth is not model
