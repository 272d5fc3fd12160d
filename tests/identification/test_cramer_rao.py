"""The Cramer-Rao bound of eq. (7), exact and banded: published figures, closed forms, any model, its picture."""

import runpy
from pathlib import Path

import numpy as np
import pytest

from dynident.apps.article import SCENARIOS
from dynident.identification import cramer_rao_bound, information, normal_matrices
from dynident.models import Model, RigidBodies
from dynident.models.friction import Offset, Viscous
from dynident.models.lagrangian import pendulum, two_link_arm
from dynident.models.simulation import simulate
from dynident.motion.log import Motion
from dynident.regression import Regression, base_parameters
from dynident.runtime import ModelError
from tests.identification.motions import sines
from tests.robots import ARM

# standard deviations in % of the parameters, from an independent computation with another discretisation
TABLE = {
    ("stated", 1e-8): (0.445, 1.787, 0.817, 0.187, 1.004, 0.040, 0.057),
    ("stated", 1e-4): (0.674, 5.212, 0.968, 0.207, 1.133, 0.043, 0.066),
    ("weak", 1e-8): (9.55, 10.6, 14.2, 0.476, 1.19, 0.583, 0.285),
    ("weak", 1e-4): (19.95, 56.9, 30.5, 0.584, 1.86, 0.650, 0.299),
}


@pytest.mark.parametrize(("name", "level"), TABLE)
def test_the_articles_arm(name: str, level: float) -> None:
    arm, scenario = two_link_arm(), SCENARIOS[name]
    result = cramer_rao_bound(arm, arm.values, scenario.truth, np.sqrt(level), scenario.sigma_tau, rest=True)
    np.testing.assert_allclose(100 * np.sqrt(np.diag(result)) / arm.values, TABLE[name, level], rtol=0.02)


class TestBound:
    def test_a_motion_that_says_nothing(self) -> None:
        """At rest at the bottom no inertia acts."""
        model, t = pendulum(), np.linspace(0, 1, 50)
        still = simulate(model, model.values, lambda s: [0.0], t)
        with pytest.raises(ModelError, match="no bound exists"):
            cramer_rao_bound(model, model.values, still, 1e-3, 0.1)


def total(model, theta, motion, *noise, **options):
    return sum(
        normal_matrix.information() for normal_matrix in normal_matrices(model, theta, motion, *noise, **options)
    )


def robot():
    """A model of bodies with a revolute, a prismatic and a turning joint, on a made motion."""
    bodies = RigidBodies(ARM)
    names = [joint.name for joint in bodies.joints]
    model = Model((bodies, Viscous(bodies.joints), Offset(bodies.joints)))
    t = np.linspace(0, 4, 401)
    rate = np.array([[1.7, 2.3, 1.3], [3.1, 4.3, 3.7]])
    waves = sines(t, [[0.4], [0.3]], rate, [[0.0], [np.pi / 2]])
    theta = np.array([1.0 if x.value is None else x.value for x in model.parameters])
    motion = Motion(t, *waves, model.torque(*waves, theta), tuple(names), np.ones(len(t), bool))
    return model, theta, motion


def test_exact_positions_give_the_covariance_of_least_squares() -> None:
    """Where sigma_q goes to zero the motion is known: S = sum_j Y_j' Y_j / sigma_tau_j^2, here for bodies."""
    model, theta, motion = robot()
    kept = base_parameters(Regression(model, (motion,)).triangular_factors.stack(), model.parameters).independent
    sigma = np.array([0.1, 0.5, 0.2])
    result = total(model, theta, motion, 1e-9, sigma, columns=kept)
    Y = model.regressor(motion.q, motion.dq, motion.ddq)[:, :, list(kept)] / sigma[:, None]
    expected = Y.reshape(-1, len(kept)).T @ Y.reshape(-1, len(kept))
    bound, squares = (np.sqrt(np.diag(np.linalg.inv(S))) for S in (result, expected))
    # a spline through all positions has two freedoms left, its ends: two of 401 torques
    np.testing.assert_allclose(bound, squares, rtol=0.01)
    assert (bound > squares).all()


@pytest.mark.parametrize(("samples", "rest", "rank"), [(2, 0, 0), (3, 0, 1), (4, 0, 2), (2, 1, 1), (3, 1, 2)])
def test_each_position_tells_one_thing_beyond_the_first_state(samples: int, rest: int, rank: int) -> None:
    model = pendulum()
    motion = simulate(model, model.values, lambda s: [0.3 + np.sin(5 * s)], np.arange(samples) * 0.2)
    S = information(model, model.values, motion, 1e-4, 1e-2, rest=bool(rest))
    assert np.linalg.matrix_rank(S, 1.0) == rank


@pytest.mark.parametrize("uneven", [0.0, 0.4])
def test_a_dense_least_squares_problem_gives_the_same(uneven: float) -> None:
    """All residuals by all coefficients and parameters, from scipy's splines, whose knots go on as the samples do."""
    from scipy.interpolate import BSpline

    t = np.cumsum(np.random.default_rng(0).uniform(1.0 - uneven, 1.0 + uneven, 30)) / 15
    model = pendulum()
    motion = simulate(model, model.values, lambda s: [np.sin(5 * s)], t, tolerance=1e-9)
    h = np.diff(t)
    knots = np.concatenate([t[0] - np.cumsum(h[:3])[::-1], t, t[-1] + np.cumsum(h[:-4:-1])])
    B = BSpline(knots, np.eye(len(t) + 2), 3)
    slopes, Y = model.partials(motion.q, motion.dq, motion.ddq, model.values), model.regressor(
        motion.q, motion.dq, motion.ddq
    )  # fmt: skip
    rows = sum(by[:, 0, :1] * B(t, nu) for nu, by in enumerate((slopes.q, slopes.dq, slopes.ddq)))
    J = np.block([[B(t) / 1e-2, np.zeros((len(t), 2))], [rows / 0.1, Y[:, 0] / 0.1]])
    covariance = np.linalg.inv(J.T @ J)[-2:, -2:]
    result = total(model, model.values, motion, 1e-2, 0.1)
    np.testing.assert_allclose(np.linalg.inv(result), covariance, rtol=1e-6)


def test_the_picture_is_fresh() -> None:
    """Where it is stale: .venv/bin/python docs/draw_normal_matrix.py."""
    docs = Path(__file__).parents[2] / "docs"
    made = runpy.run_path(str(docs / "draw_normal_matrix.py"))["drawing"]()
    assert (docs / "normal_matrix.svg").read_text(encoding="utf-8") == made
