"""One step of an arm: against its simulation by small steps, and where friction is stiff."""

import numpy as np
import pytest

from dynident.estimators.augmented_kalman_steps import Dynamics, FilterStep
from dynident.models.lagrangian import slider, two_link_arm

ARM = two_link_arm()
RNG = np.random.default_rng(0)
THETA = np.array(ARM.values)
STEP = np.array([1e-4])


def step_of(step: np.ndarray, motion: np.ndarray, residual: np.ndarray) -> FilterStep:
    return FilterStep(step, motion, residual, np.zeros_like(residual))


def simulated(x: np.ndarray, tau: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """q and dq after a step of the two-link arm, by 20 steps of the midpoint rule."""
    q, dq, h = x[:, :2], x[:, 2:4], STEP[0] / 20
    for _ in range(20):
        middle = dq + h / 2 * ARM.forward_dynamics(q, dq, tau, theta)
        dq, q = dq + h * ARM.forward_dynamics(q + h / 2 * dq, middle, tau, theta), q + h * middle
    return np.concatenate([q, dq], axis=1)


def test_derivatives_are_those_of_the_motion():
    one = Dynamics(ARM, THETA, np.eye(7) * 1e-3, 0.0)
    x, tau = RNG.uniform(-1, 1, (1, 4)), RNG.standard_normal((1, 2))
    after = simulated(x, tau, THETA)
    middle = (x + after) / 2
    motion = np.stack([middle[:, :2], middle[:, 2:], (after - x)[:, 2:] / STEP[0]])
    F, G, c = one.linearise(step_of(STEP, motion, tau - ARM.torque(*motion, THETA)))
    np.testing.assert_allclose(c[0, :4], 0.0, atol=1e-4 * np.abs(after - x).max())
    for k in range(4):
        d = np.eye(4)[[k]] * 1e-4
        by = (simulated(x + d, tau, THETA) - simulated(x - d, tau, THETA))[0] / 2e-4
        np.testing.assert_allclose(F[0, :4, k], by, atol=2e-3 * np.abs(by).max())
    for k in range(7):
        d = np.eye(7)[k] * 1e-4
        by = (simulated(x, tau, THETA + d) - simulated(x, tau, THETA - d))[0] / 0.2
        np.testing.assert_allclose(F[0, :4, 4 + k], by, atol=5e-3 * np.abs(F[0, :4, 4:]).max())
    for k in range(2):
        d = np.eye(2)[[k]] * 1e-2
        by = (simulated(x, tau + d, THETA) - simulated(x, tau - d, THETA))[0] / 2e-2
        np.testing.assert_allclose(G[0, :4, k], by, atol=5e-3 * np.abs(by).max())


@pytest.mark.parametrize("step", [0.01, 10.0])
def test_stiff_friction_is_no_trouble(step):
    """A mass of 1 mg with viscous friction: a velocity is gone after a step, and nothing overflows."""
    model = slider(values=(1e-6, 1.0, 0.0, 0.0))
    still, h = np.zeros((1, 1)), np.array([step])
    F, G, _ = Dynamics(model, np.array(model.values), np.zeros((4, 0)), 0.0).linearise(
        step_of(h, np.zeros((3, 1, 1)), still)
    )
    np.testing.assert_allclose(F[0], [[1.0, 1e-6], [0.0, 0.0]], atol=1e-9)
    np.testing.assert_allclose(G[0, 0, 0], step, rtol=1e-3)
