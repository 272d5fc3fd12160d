"""What a motion will tell is what least squares finds of it."""

import numpy as np
import pytest

from dynident.apps.excitation import expected_accuracy
from dynident.apps.excitation.design import torque_information, unexcited_parameters
from dynident.motion.log import Motion
from dynident.regression import Regression, Selection, base_std
from tests.apps.excitation.arms import MODEL, THETA
from tests.apps.excitation.requests import BASIS

SIGMA = np.array([0.4, 0.1])


def states(samples=3000, still=()):
    rng = np.random.default_rng(0)
    found = rng.uniform(-2.0, 2.0, (3, samples, 2))
    found[1:, :, list(still)] = 0.0
    found[0][:, list(still)] = 0.7
    return found


def test_the_errors_are_those_of_least_squares_with_known_noise():
    q, dq, ddq = states()
    found = expected_accuracy(MODEL, THETA, torque_information(MODEL, states(), 1 / SIGMA**2), BASIS)
    names = tuple(joint.name for joint in MODEL.joints)
    motion = Motion(np.arange(len(q)) / 100.0, q, dq, ddq, np.zeros_like(q), names, np.ones(len(q), dtype=bool), "x")
    factors = Regression(MODEL, (motion,)).triangular_factors
    np.testing.assert_allclose(found.std, base_std(BASIS, factors, SIGMA, 1 / SIGMA), rtol=1e-6)
    Y = MODEL.regressor(q, dq, ddq)[:, :, list(BASIS.independent)] / SIGMA[:, None]
    X = Y.reshape(-1, BASIS.rank)
    assert found.log_det == pytest.approx(np.linalg.slogdet(X.T @ X)[1])
    assert found.condition == pytest.approx(np.linalg.cond(X / np.linalg.norm(X, axis=0)), rel=1e-6)
    np.testing.assert_allclose(found.value, BASIS.to_base(THETA))
    assert found.open_parameters == ()
    assert unexcited_parameters(MODEL, torque_information(MODEL, states(), 1 / SIGMA**2), found) == ()


def test_slow_samples_count_as_little_as_in_a_fit():
    q, dq, ddq = states()
    slow = np.array([0.5, 0.1])
    found = expected_accuracy(MODEL, THETA, torque_information(MODEL, states(), 1 / SIGMA**2, slow), BASIS)
    names = tuple(joint.name for joint in MODEL.joints)
    motion = Motion(np.arange(len(q)) / 100.0, q, dq, ddq, np.zeros_like(q), names, np.ones(len(q), dtype=bool), "x")
    factors = Regression(MODEL, (motion,), selection=Selection(min_speed=tuple(slow))).triangular_factors
    np.testing.assert_allclose(found.std, base_std(BASIS, factors, SIGMA, 1 / SIGMA), rtol=1e-6)


def test_what_stays_open_is_said_with_the_joint_that_would_show_it():
    information = torque_information(MODEL, states(still=(1,)), 1 / SIGMA**2)
    found = expected_accuracy(MODEL, THETA, information, BASIS)
    assert {"Fv_bend", "Fc_bend"} <= set(found.open_parameters)
    assert "Fv_lift" not in found.open_parameters
    assert (found.log_det, found.condition) == (-np.inf, np.inf)
    notes = unexcited_parameters(MODEL, information, found)
    assert notes
    assert {joint for note in notes for joint in note.joints} == {"bend"}


def test_relative_errors_are_of_the_values():
    found = expected_accuracy(MODEL, np.zeros_like(THETA), torque_information(MODEL, states(), 1 / SIGMA**2))
    assert np.isinf(found.relative).all()
    found = expected_accuracy(MODEL, THETA, torque_information(MODEL, states(), 1 / SIGMA**2), BASIS)
    k = found.basis.leading.index("Fv_lift")
    assert found.relative[k] == pytest.approx(100 * found.std[k] / 1.0)


def test_what_is_known_before_adds_up_on_base_parameters():
    prior = np.diag(np.linspace(1.0, 2.0, len(THETA)))
    nothing = expected_accuracy(MODEL, THETA, np.zeros((26, 26)), BASIS, prior)
    np.testing.assert_allclose(
        nothing.std, np.sqrt(np.diag(BASIS.combination @ np.diag(1 / np.diag(prior)) @ BASIS.combination.T))
    )
    assert unexcited_parameters(MODEL, np.zeros((26, 26)), nothing, prior) == ()
