"""One step of an arm: its derivatives against differences, and its motion against finer steps."""

import numpy as np

from dynident.estimators.augmented_kalman.dynamics import Dynamics
from dynident.models.gallery import two_link_arm

ARM = two_link_arm()
RNG = np.random.default_rng(0)
THETA = np.array(ARM.values)


def test_slopes_are_those_of_the_step():
    """To second order in the step, at the middle of which they are taken."""
    one, step = Dynamics(ARM, THETA, np.eye(7) * 1e-3, 1, 0.0), np.array([1e-4])
    x = np.concatenate([RNG.uniform(-1, 1, (1, 4)), np.zeros((1, 7))], axis=1)
    tau = RNG.standard_normal((1, 2))
    ddq = ARM.forward_dynamics(x[:, :2], x[:, 2:4], tau, THETA)
    F, G = one.slopes(step, x[:, :2], x[:, 2:4], ddq)
    for k in range(11):
        d = np.eye(11)[[k]] * 1e-5
        by = (one.moved(step, x + d, tau, 0 * tau) - one.moved(step, x - d, tau, 0 * tau))[0] / 2e-5
        np.testing.assert_allclose(F[0, :, k], by, atol=2e-3 * np.abs(by).max())
    for k in range(2):
        d = np.eye(2)[[k]] * 1e-4
        by = (one.moved(step, x, tau + d, 0 * tau) - one.moved(step, x, tau - d, 0 * tau))[0] / 2e-4
        np.testing.assert_allclose(G[0, 2:4, k], by[2:4], rtol=5e-3)
    np.testing.assert_allclose(one.push(step, x)[0, 2:4, :2], G[0, 2:4, :2], rtol=5e-2, atol=1e-6)


def test_parts_and_steps_of_their_own():
    x = np.concatenate([RNG.uniform(-1, 1, (2, 4)), np.zeros((2, 7))], axis=1)
    tau, slope, step = RNG.standard_normal((2, 2)), RNG.standard_normal((2, 2)), np.array([0.01, 0.02])
    coarse, fine = (Dynamics(ARM, THETA, np.eye(7), parts, 0.0).moved(step, x, tau, slope) for parts in (20, 80))
    np.testing.assert_allclose(coarse, fine, atol=1e-5)
    alone = Dynamics(ARM, THETA, np.eye(7), 20, 0.0).moved(step[1:], x[1:], tau[1:], slope[1:])
    np.testing.assert_allclose(coarse[1:], alone, rtol=1e-12)
