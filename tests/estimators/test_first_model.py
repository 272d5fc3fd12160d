"""The first model of a simulation: the right one of several minima, and what is tried without a mass."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from dynident.apps.article import SCENARIOS
from dynident.apps.article.article import SPLINE, arm_to_identify
from dynident.estimators import (
    AugmentedKalman,
    Didim,
    Estimator,
    InstrumentalVariables,
    LeastSquares,
    OutputError,
    Problem,
)
from dynident.estimators.notes import FirstModel, StartedElsewhere
from dynident.estimators.simulated_recordings import find_first_model, fit_resmoothed, open_shots
from dynident.models import Lagrangian, Model
from dynident.models.lagrangian import pendulum, two_link_arm
from dynident.models.simulation import PD, Failure, Singular, record, simulate, simulate_recording
from dynident.motion.log import Log, Motion
from dynident.motion.smoothers import Difference, KalmanSmoother
from dynident.regression import Regression
from dynident.runtime import progress_to
from dynident.testing.estimator import make_problem, multisine_motion

ARM = two_link_arm()
FIRST = Singular()
Array = np.ndarray


def unknown(model: Model) -> Model:
    """The model without its values, which may not be a start."""
    known = (
        replace(one, unknowns=tuple(replace(each, value=None) for each in one.unknowns))
        if isinstance(one, Lagrangian)
        else replace(one, values=None)
        for one in model.terms
    )
    return replace(model, terms=tuple(known))


def loud(model: Model, seed: int, noise: float = 1.0, samples: int = 200) -> Problem:
    """A problem of exact motion with so much noise of the torque (N m) that least squares may find no mass."""
    return make_problem(unknown(model), multisine_motion(model, noise, seed, samples))


def massive(problem: Problem) -> Callable[[Array], Array | Failure]:
    """Try the mass matrix everywhere."""
    return lambda theta: theta if problem.model.check_mass_matrix(problem.motions[0].q, theta).positive else Singular()


def test_all_are_tried_in_turn_and_the_first_that_works_is_taken() -> None:
    problem = make_problem(ARM, multisine_motion(ARM, 0.01, samples=200))
    every = [FirstModel.KALMAN, FirstModel.CONSISTENT, FirstModel.NOMINAL, FirstModel.MASS]
    for count, kind in enumerate(every):
        seen: list[Array] = []

        def tried(theta: Array, seen: list[Array] = seen, count: int = count) -> str | Failure:
            seen.append(theta)
            return "done" if len(seen) > count else Singular()

        found = find_first_model(problem, FIRST, tried)
        assert not isinstance(found, Failure)
        assert found[1:] == ("done", kind)
        np.testing.assert_array_equal(found[0], seen[-1])
    assert find_first_model(problem, FIRST, lambda _: Singular()) is FIRST


def test_a_mass_matrix_by_the_least_change_of_the_torque() -> None:
    """Where least squares has none, the truth, which has one, leaves more of the torque."""
    for seed in (0, 4):
        problem = loud(ARM, seed)
        plain = LeastSquares(weights="per_joint")(problem).value
        assert isinstance(massive(problem)(plain), Failure)
        found = find_first_model(problem, FIRST, massive(problem))
        assert not isinstance(found, Failure)
        assert found[2] is FirstModel.MASS
        left = problem.regression.triangular_factors.residual
        weights = 1.0 / left(plain)
        assert 1.0 < weights @ left(found[0]) / 2.0 < weights @ left(np.array(ARM.values)) / 2.0


def test_no_mass_is_invented_where_the_data_contradict_it() -> None:
    problem = loud(ARM, 0, noise=0.01)
    (motion,) = problem.motions
    for wrong in (-motion.tau, 0 * motion.tau):
        against = make_problem(problem.model, replace(motion, tau=wrong))
        assert find_first_model(against, FIRST, massive(against)) is FIRST


def swung(seed: int, noise: float = 1.5) -> Problem:
    """A pendulum in a loop, with so much noise of the torque (N m) that least squares finds an inertia below zero."""
    arm, t = pendulum(), np.arange(501) * 0.01
    path, still, one = 0.5 * np.sin(2 * t[:, None]), np.zeros((501, 1)), np.ones(1)
    loop = PD(("pivot",), t, path, 4 * one, 0.4 * one, one, np.inf * one, still)
    begin = Motion(t, still, still, still, still, ("pivot",), np.ones(501, dtype=bool), "swing")
    run = simulate_recording(arm, np.array(arm.values), begin, loop)
    tau = run.tau + noise * np.random.default_rng(seed).standard_normal(still.shape)
    motion, model = replace(begin, q=run.q, dq=run.dq, ddq=run.ddq, tau=tau), unknown(arm)
    log = Log(t, run.q, tau, motion.joints, controller=loop)
    return Problem(model, (motion,), Regression(model, (motion,)), (log,))


@pytest.mark.parametrize("estimator", [AugmentedKalman(), Didim(2), InstrumentalVariables("simulated"), OutputError()])
def test_all_that_simulate_begin_there_and_say_so(estimator: Estimator) -> None:
    problem = swung(0)
    assert LeastSquares()(problem).value[0] < 0
    found = estimator(problem)
    assert StartedElsewhere(FirstModel.MASS) in found.notes
    if isinstance(estimator, OutputError):  # what is known of the loop is exact, and so are the positions
        np.testing.assert_allclose(found.value, pendulum().values, rtol=1e-4)


PENDULUM = pendulum()
TRUTH = np.array(PENDULUM.values)
T = np.arange(1001) * 0.005


@cache
def swinging() -> Motion:
    return simulate(PENDULUM, TRUTH, lambda s: [np.sin(2 * s) + np.sin(3 * s)], T, tolerance=1e-9)


def noisy_swing(sigma: float) -> Problem:
    """A pendulum whose positions are noisy."""
    log = record(swinging(), sigma_q=sigma, sigma_tau=1e-3, rng=np.random.default_rng(0)).log
    motions = (Difference()(log),)
    return Problem(PENDULUM, motions, Regression(PENDULUM, motions), (log,))


def test_begins_with_the_fit_that_is_nearest_when_simulated() -> None:
    problem = noisy_swing(1e-3)
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


def test_an_open_simulation_starts_from_positions_when_they_were_stamped() -> None:
    motion = swinging()
    log = record(motion, 0.0, 0.0, np.random.default_rng(0)).log
    early = (motion.shift(0.01),)
    (shots,) = open_shots(Problem(PENDULUM, early, Regression(PENDULUM, early), (log,)), 0, np.inf)
    np.testing.assert_allclose(shots.motion.q, motion.q, atol=1e-4)
    np.testing.assert_array_equal(shots.measured, log.q)


def test_what_simulates_starts_there_where_the_first_model_has_no_mass() -> None:
    """The article's arm at its highest noise: of its spline, the mass matrix is not positive definite."""
    log, model = SCENARIOS["tabulated"].record(1e-4, np.random.default_rng(0)).log, arm_to_identify()
    motion = replace(SPLINE, sigma=1e-2)(log).select_between(start=0.25)  # s: the transient before is not used
    problem = Problem(model, (motion,), Regression(model, (motion,)), (log,))
    q, plain = motion.q[::50], LeastSquares(weights="per_joint")(problem).value
    assert not model.check_mass_matrix(q, plain).positive
    assert model.check_mass_matrix(q, fit_resmoothed(problem, KalmanSmoother())).positive
    found = AugmentedKalman()(problem)
    assert (found.value > 0).all()
    assert (found.std > 0).all()
