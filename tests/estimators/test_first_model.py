"""The first model of a simulation: the right one of several minima, and what is tried without a mass."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from dynident.apps.article import SCENARIOS
from dynident.apps.article.article import SAMPLING_PERIOD, SPLINE, arm_to_identify
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
from dynident.models.simulation import PD, Failure, Function, Recording, Singular, record, simulate, simulate_recording
from dynident.motion.log import Log, Motion
from dynident.motion.smoothers import Difference, KalmanSmoother
from dynident.regression import Regression
from dynident.runtime import InputError, progress_to
from dynident.testing.estimator import make_problem, multisine_motion

ARM = two_link_arm()
FIRST = Singular()
Array = np.ndarray


def unknown(model: Model) -> Model:
    """The model without its values, which may not be a start."""
    reference = (
        replace(term, unknowns=tuple(replace(each, value=None) for each in term.unknowns))
        if isinstance(term, Lagrangian)
        else replace(term, values=None)
        for term in model.terms
    )
    return replace(model, terms=tuple(reference))


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

        first_model = find_first_model(problem, FIRST, tried)
        assert not isinstance(first_model, Failure)
        assert first_model[1:] == ("done", kind)
        np.testing.assert_array_equal(first_model[0], seen[-1])
    assert find_first_model(problem, FIRST, lambda _: Singular()) is FIRST


def test_a_mass_matrix_by_the_least_change_of_the_torque() -> None:
    """Where least squares has none, the truth, which has one, leaves more of the torque."""
    for seed in (0, 4):
        problem = loud(ARM, seed)
        plain = LeastSquares(weights="per_joint")(problem).value
        assert isinstance(massive(problem)(plain), Failure)
        first_model = find_first_model(problem, FIRST, massive(problem))
        assert not isinstance(first_model, Failure)
        assert first_model[2] is FirstModel.MASS
        residual = problem.regression.triangular_factors.residual
        weights = 1.0 / residual(plain)
        assert 1.0 < weights @ residual(first_model[0]) / 2.0 < weights @ residual(np.array(ARM.values)) / 2.0


def test_no_mass_is_invented_where_the_data_contradict_it() -> None:
    problem = loud(ARM, 0, noise=0.01)
    (motion,) = problem.motions
    for wrong in (-motion.tau, 0 * motion.tau):
        against = make_problem(problem.model, replace(motion, tau=wrong))
        assert find_first_model(against, FIRST, massive(against)) is FIRST


def swung(seed: int, noise: float = 1.5) -> Problem:
    """A pendulum in a loop, with so much noise of the torque (N m) that least squares finds an inertia below zero."""
    arm, t = pendulum(), np.arange(301) * 0.01
    path, still, ones = 0.5 * np.sin(2 * t[:, None]), np.zeros((301, 1)), np.ones(1)
    loop = PD(("pivot",), t, path, 4 * ones, 0.4 * ones, ones, np.inf * ones, still)
    begin = Motion(t, still, still, still, still, ("pivot",), np.ones(301, dtype=bool), "swing")
    run = simulate_recording(arm, np.array(arm.values), begin, loop)
    tau = run.tau + noise * np.random.default_rng(seed).standard_normal(still.shape)
    motion, model = replace(begin, q=run.q, dq=run.dq, ddq=run.ddq, tau=tau), unknown(arm)
    log = Log(t, run.q, tau, motion.joints, controller=loop)
    return Problem(model, (motion,), Regression(model, (motion,)), (log,))


@pytest.mark.parametrize("estimator", [AugmentedKalman(), Didim(2), InstrumentalVariables("simulated"), OutputError()])
def test_all_that_simulate_begin_there_and_say_so(estimator: Estimator) -> None:
    problem = swung(0)
    assert LeastSquares()(problem).value[0] < 0
    estimate = estimator(problem)
    assert StartedElsewhere(FirstModel.MASS) in estimate.notes
    if isinstance(estimator, OutputError):  # what is known of the loop is exact, and so are the positions
        np.testing.assert_allclose(estimate.value, pendulum().values, rtol=1e-4)


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
        result = OutputError()(problem)
    assert steps[:4] == [
        "simulating first models (0 of 3)",
        "simulating first models (1 of 3)",
        "simulating first models (2 of 3)",
        "simulating (0 of 30)",
    ]
    assert steps[4] == "simulating (1 of 30)"
    assert StartedElsewhere(FirstModel.SMOOTHED) in result.notes
    np.testing.assert_allclose(result.value, TRUTH, rtol=2e-3)


def test_an_open_simulation_starts_from_positions_when_they_were_stamped() -> None:
    motion = swinging()
    log = record(motion, 0.0, 0.0, np.random.default_rng(0)).log
    early = (motion.shift(0.01),)
    (shots,) = open_shots(Problem(PENDULUM, early, Regression(PENDULUM, early), (log,)), 0, np.inf)
    np.testing.assert_allclose(shots.motion.q, motion.q, atol=1e-4)
    np.testing.assert_array_equal(shots.measured, log.q)


SIGMA = 3e-3
START = 0.25  # s: the transient before is not used


@pytest.fixture(scope="module")
def swing() -> Recording:
    t = np.arange(751) * 0.004
    motion = simulate(PENDULUM, PENDULUM.values, lambda s: np.array([0.6 * np.sin(2 * s)]), t)
    return record(motion, SIGMA, 0.01, np.random.default_rng(0))


@pytest.fixture(scope="module")
def article_problem() -> Problem:
    """The article's arm at its highest noise: of its spline, the mass matrix is not positive definite."""
    scenario, model = SCENARIOS["tabulated"], arm_to_identify()
    log = scenario.record(1e-4, np.random.default_rng(0)).log
    first, second = scenario.amplitudes

    def law(t: float, q: np.ndarray, dq: np.ndarray, reference: np.ndarray) -> np.ndarray:
        return np.array([first * np.sin(t + SAMPLING_PERIOD / 2), second * np.cos(t + SAMPLING_PERIOD / 2)])

    still, ones = np.zeros_like(log.q), np.ones(2)
    log = replace(log, controller=Function(log.joints, log.t, still, law, ones, 1e9 * ones, still))
    motion = replace(SPLINE, sigma=1e-2)(log).select_between(start=START)
    return Problem(model, (motion,), Regression(model, (motion,)), (log,))


def test_what_simulates_starts_there_where_the_first_model_has_no_mass(article_problem: Problem) -> None:
    q = article_problem.motions[0].q[::50]
    model, plain = article_problem.model, LeastSquares(weights="per_joint")(article_problem).value
    assert not model.check_mass_matrix(q, plain).positive
    assert model.check_mass_matrix(q, fit_resmoothed(article_problem, KalmanSmoother())).positive
    result = AugmentedKalman()(article_problem)
    assert (result.value > 0).all()
    assert (result.std > 0).all()


def test_where_that_fails_too_the_first_error_stands(article_problem: Problem) -> None:
    (motion,) = article_problem.motions
    wrong = replace(motion, tau=-motion.tau)
    without = replace(
        article_problem, logs=(), motions=(wrong,), regression=Regression(article_problem.model, (wrong,))
    )
    with pytest.raises(InputError, match="the Kalman filter diverged"):
        AugmentedKalman()(without)
