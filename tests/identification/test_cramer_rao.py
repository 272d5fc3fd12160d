"""The Cramer-Rao bound of eq. (7): published figures for the article's arm, closed forms, and what it refuses."""

import numpy as np
import pytest

from dynident.apps.article import SCENARIOS
from dynident.identification import cramer_rao_bound, information
from dynident.models.lagrangian import pendulum, two_link_arm
from dynident.models.simulation import simulate, simulate_many
from dynident.runtime import ConfigError, ModelError

# standard deviations in % of the parameters, from an independent computation with another discretisation
TABLE = {
    ("stated", 1e-8): (0.445, 1.787, 0.817, 0.187, 1.004, 0.040, 0.057),
    ("stated", 1e-6): (0.518, 3.088, 0.882, 0.188, 1.008, 0.041, 0.059),
    ("stated", 1e-4): (0.674, 5.212, 0.968, 0.207, 1.133, 0.043, 0.066),
    ("weak", 1e-8): (9.55, 10.6, 14.2, 0.476, 1.19, 0.583, 0.285),
    ("weak", 1e-6): (12.3, 20.7, 18.5, 0.499, 1.26, 0.597, 0.287),
    ("weak", 1e-4): (19.95, 56.9, 30.5, 0.584, 1.86, 0.650, 0.299),
}


@pytest.mark.parametrize(("name", "level"), TABLE)
def test_the_articles_arm(name: str, level: float) -> None:
    arm, scenario = two_link_arm(), SCENARIOS[name]
    found = cramer_rao_bound(arm, arm.values, scenario.truth, np.sqrt(level), scenario.sigma_tau, rest=True)
    np.testing.assert_allclose(100 * np.sqrt(np.diag(found)) / arm.values, TABLE[name, level], rtol=0.02)


def swing(samples: int = 201):
    model = pendulum()
    t = np.linspace(0, 2, samples)
    return model, simulate(model, model.values, lambda s: [np.sin(5 * s)], t)


class TestBound:
    def test_exact_positions_give_the_covariance_of_least_squares(self) -> None:
        """Without noise in q the torque alone is left, on a regressor that is known."""
        model, motion = swing()
        found = information(model, model.values, motion, 1e-9, 0.1)
        Z = model.regressor(motion.q, motion.dq, motion.ddq)[:, 0]
        np.testing.assert_allclose(found, Z.T @ Z / 0.01, rtol=3e-3)

    def test_agrees_with_finite_differences(self) -> None:
        """The free torque's normal equations from motions that were simulated again with each unknown changed."""
        model, motion = swing(41)
        theta, t, n = np.asarray(model.values), motion.t, 41

        def positions(x: np.ndarray) -> np.ndarray:
            """Positions (B, N) of all runs x (B, N + 2 + p) at once: torques at the samples, initial state, theta."""
            torques, start, values = np.split(x, [n, n + 2], axis=1)

            def torque(s: float) -> np.ndarray:
                k = int(np.clip(np.searchsorted(t, s, side="right"), 1, n - 1))
                part = (s - t[k - 1]) / (t[k] - t[k - 1])
                return ((1 - part) * torques[:, k - 1] + part * torques[:, k])[:, None]

            made = simulate_many(model, values, torque, t, start[:, :1], start[:, 1:], tolerance=1e-11)
            return np.stack([one.q[:, 0] for one in made])

        at = np.concatenate([motion.tau[:, 0], [0.0, 0.0], theta])
        size = 1e-4 * np.where(at == 0, 1.0, np.abs(at))
        size[:n] = 1e-4
        ahead, behind = np.split(positions(np.concatenate([at + np.diag(size), at - np.diag(size)])), 2)
        J = ((ahead - behind) / (2 * size[:, None])).T
        full = J.T @ J / 1e-6
        full[:n, :n] += np.eye(n) / 0.01
        m = n + 2
        expected = full[m:, m:] - full[m:, :m] @ np.linalg.solve(full[:m, :m], full[:m, m:])
        found = information(model, theta, motion, 1e-3, 0.1)
        np.testing.assert_allclose(found, expected, rtol=0.02, atol=0.01 * np.abs(expected).max())

    def test_two_recordings_add_up(self) -> None:
        model, motion = swing()
        one = cramer_rao_bound(model, model.values, motion, 1e-3, 0.1)
        np.testing.assert_allclose(
            cramer_rao_bound(model, model.values, (motion, motion), 1e-3, 0.1), one / 2, rtol=1e-9
        )

    def test_knowing_the_start_helps(self) -> None:
        model, motion = swing()
        known, unknown = (information(model, model.values, motion, 1e-3, 0.1, rest=rest) for rest in (True, False))
        more = np.linalg.eigvalsh(known - unknown)
        assert more[-1] > 1.0
        assert more[0] > -1e-9 * more[-1]

    def test_refuses_a_deviation_that_is_not_positive(self) -> None:
        model, motion = swing()
        with pytest.raises(ConfigError, match="sigma_q is 0"):
            cramer_rao_bound(model, model.values, motion, 0.0, 0.1)

    def test_a_motion_that_says_nothing(self) -> None:
        """At rest at the bottom no inertia acts."""
        model, t = pendulum(), np.linspace(0, 1, 50)
        still = simulate(model, model.values, lambda s: [0.0], t)
        with pytest.raises(ModelError, match="no bound exists"):
            cramer_rao_bound(model, model.values, still, 1e-3, 0.1)
