"""What every estimator promises."""

from __future__ import annotations

import json
import pickle
from collections.abc import Callable, Mapping
from dataclasses import FrozenInstanceError, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from dynident.estimators import Estimate, Estimator, Problem
from dynident.models import Model
from dynident.models.lagrangian import slider, two_link_arm
from dynident.models.simulation import PD, simulate_recording
from dynident.motion.log import Log, Motion
from dynident.project.parts import build_part, with_settings
from dynident.regression import Regression
from dynident.runtime import MissingInputError
from dynident.runtime.arrays import Array
from dynident.runtime.families import ESTIMATORS, PartFamily


def cannot_be_changed(part: object) -> None:
    """Raise AssertionError unless the part is a frozen dataclass."""
    try:
        part.anything = 1  # type: ignore[attr-defined]
    except FrozenInstanceError:
        return
    raise AssertionError("it is no frozen dataclass")


def builds_itself_from_its_settings(family: PartFamily, part: object) -> None:
    """Raise AssertionError unless the settings of a part, through JSON, build an equal one."""
    settings = json.loads(json.dumps(family.describe(part), allow_nan=False))
    rebuilt = build_part(with_settings(family, type(part), settings, Path()))
    assert rebuilt == part, f"{part} is described as {settings}, which builds {rebuilt}"


SPEED_FACTOR = 5.0  # than the motion: simulations take as long as what they simulate
LOOP_FREQUENCY, DAMPING_RATIO = 40.0, 0.7  # rad/s and share: of the loop, for the mass that each joint has at first
POSITION_NOISE_RATIO = 1e-4  # m or rad of noise of the positions for 1 N m or N of the torque's


def close_loops(problem: Problem) -> Problem:
    """Return the problem of the same motions, followed five times as fast by a PD controller with feedforward.

    The torque has the same noise as before, over the torque of the true parameters of the model; the noise of the
    measured positions is in proportion to it. The regression is of the exact motion.
    """
    pairs = [_simulate_loop(problem.model, motion) for motion in problem.motions]
    motions = tuple(motion for motion, _ in pairs)
    regression = replace(problem.regression, motions=motions)
    return replace(problem, motions=motions, regression=regression, logs=tuple(log for _, log in pairs))


def _simulate_loop(model: Model, motion: Motion) -> tuple[Motion, Log]:
    """Return the motion in the loop of a controller that follows a given motion, with its log."""
    theta = np.asarray(model.values, dtype=float)
    # the noise is what the true parameters leave of the torque
    noise = motion.tau - model.torque(motion.q, motion.dq, motion.ddq, theta)
    t, dq, ddq = motion.t / SPEED_FACTOR, SPEED_FACTOR * motion.dq, SPEED_FACTOR**2 * motion.ddq
    fast = replace(motion, t=t, dq=dq, ddq=ddq, tau=model.torque(motion.q, dq, ddq, theta))
    controller = _make_controller(model, theta, fast)
    run = simulate_recording(model, theta, fast, controller, rows=slice(0, len(t)))
    # the loop holds its torque from sample to sample: at a sample, take the mean of both sides
    tau = 0.5 * (run.tau + np.vstack((run.tau[:1], run.tau[:-1]))) + noise
    noise_std = POSITION_NOISE_RATIO * float(np.std(noise[motion.mask]))
    q = run.q + noise_std * np.random.default_rng(len(t)).standard_normal(run.q.shape)
    tracked = replace(fast, q=run.q, dq=run.dq, ddq=run.ddq, tau=tau)
    return tracked, Log(t, q, tau, motion.joints, motion.source, controller=controller)


def _make_controller(model: Model, theta: Array, fast: Motion) -> PD:
    """Return a controller with gains by the mass of each joint, which holds the mean torque between samples."""
    mass, _ = model.mass_and_bias(fast.q[:1], fast.dq[:1], theta)
    masses, ones = np.diag(mass[0]), np.ones(len(fast.joints))
    feedforward = 0.5 * (fast.tau + np.vstack((fast.tau[1:], fast.tau[-1:])))
    # poles at the frequency of the loop, for the mass of each joint alone
    kp, kd = LOOP_FREQUENCY**2 * masses, 2 * DAMPING_RATIO * LOOP_FREQUENCY * masses
    return PD(fast.joints, fast.t, fast.q, kp, kd, ones, np.inf * ones, feedforward, fast.dq)


MODELS: Mapping[str, Callable[[], Model]] = {
    "arm": two_link_arm,
    "slider": lambda: slider(values=(5.0, 8.0, 3.0, 0.5)),
    "smooth slider": lambda: slider(width=1e-3, values=(5.0, 8.0, 3.0, 0.5)),
}
Check = Callable[[Estimator, Callable[[], Model]], None]


def check_estimator(estimator: Estimator) -> None:
    """Raise AssertionError unless the estimator keeps all promises of its family, on three models of the gallery.

    One that raises MissingInputError is asked again for the same motion in the loop of a controller that its logs know.
    """
    is_frozen_configuration(estimator)
    builds_itself_from_its_settings(ESTIMATORS, estimator)
    for make in MODELS.values():
        for check in ESTIMATOR_CHECKS:
            check(estimator, make)


def truth(model: Model) -> Array:
    """Return the true parameters (p) of a model of the gallery."""
    values = model.values
    assert values is not None
    return values


def multisine_motion(model: Model, noise: float = 0.0, seed: int = 0, samples: int = 2000) -> Motion:
    """Return a multisine per joint with its exact derivatives; the noise is white, on the torque, in N m or N."""
    rng = np.random.default_rng(seed)
    t, n = np.linspace(0, 10, samples), len(model.joints)
    rate = 2 * np.pi * rng.uniform(0.1, 1.0, (5, n))
    size, phase = rng.uniform(0.2, 0.6, (5, n)), rng.uniform(0, 2 * np.pi, (5, n))
    angle = t[:, None, None] * rate + phase
    q = (size * np.sin(angle)).sum(axis=1)
    dq = (size * rate * np.cos(angle)).sum(axis=1)
    ddq = -(size * rate**2 * np.sin(angle)).sum(axis=1)
    tau = model.torque(q, dq, ddq, truth(model)) + noise * rng.standard_normal(q.shape)
    names = tuple(joint.name for joint in model.joints)
    return Motion(t, q, dq, ddq, tau, names, np.ones(samples, dtype=bool), f"run {seed}")


def make_problem(model: Model, *motions: Motion) -> Problem:
    """Return the problem of a model and motions."""
    return Problem(model, motions, Regression(model, motions))


def fit(estimator: Estimator, problem: Problem) -> Estimate:
    """Return the estimate of a problem, in the loop of a controller where the estimator needs one."""
    return fit_with_problem(estimator, problem)[0]


def fit_with_problem(estimator: Estimator, problem: Problem) -> tuple[Estimate, Problem]:
    """Return the estimate as ``fit`` does, and the problem that it solves."""
    try:
        return estimator(problem), problem
    except MissingInputError:
        problem = close_loops(problem)
        return estimator(problem), problem


@lru_cache(maxsize=4)
def fit_noisy(estimator: Estimator, make: Callable[[], Model]) -> tuple[Estimate, Problem]:
    """Return the estimate from a noisy motion of a model, and its problem: once for all checks that look at it."""
    model = make()
    return fit_with_problem(estimator, make_problem(model, multisine_motion(model, noise=0.01)))


def is_frozen_configuration(estimator: Estimator) -> None:
    """It cannot be changed, and a pickled copy is equal to it."""
    cannot_be_changed(estimator)
    assert len({estimator, pickle.loads(pickle.dumps(estimator))}) == 1
    problem = make_problem(two_link_arm(), multisine_motion(two_link_arm(), noise=0.01))
    copy = pickle.loads(pickle.dumps(estimator))
    assert repr(copy) == repr(estimator)
    np.testing.assert_array_equal(fit(copy, problem).value, fit(estimator, problem).value)


def recovers_the_truth_from_exact_data(estimator: Estimator, make: Callable[[], Model]) -> None:
    """Without noise, all digits but the last; nothing is to be noted."""
    model = make()
    estimate = fit(estimator, make_problem(model, multisine_motion(model)))
    allowed = np.maximum(1e-6 * np.abs(truth(model)), estimate.std)
    assert (np.abs(estimate.value - truth(model)) <= allowed).all(), estimate.value
    assert (estimate.std < 1e-3 * np.abs(truth(model))).all(), estimate.std
    assert estimate.notes == (), estimate.notes


def recovers_the_truth_from_noisy_data(estimator: Estimator, make: Callable[[], Model]) -> None:
    """Within four standard errors, which must be neither nothing nor everything."""
    model, (estimate, problem) = make(), fit_noisy(estimator, make)
    assert (np.abs(estimate.value - truth(model)) < 4 * estimate.std).all(), (
        estimate.value - truth(model)
    ) / estimate.std
    assert (estimate.std > 0).all()
    assert (estimate.std < 0.2 * np.abs(truth(model))).all(), estimate.std
    factors = problem.regression.triangular_factors  # with a controller, not only noise: it moves on between samples
    expected = np.sqrt(factors.residual(truth(model)) / factors.rows)
    np.testing.assert_allclose(estimate.residual.sigma, expected, rtol=0.05)


def describes_what_it_estimates(estimator: Estimator, make: Callable[[], Model]) -> None:
    """Names, units and shapes are those of the model."""
    model = make()
    n, p, estimate = len(model.joints), len(model.parameters), fit_noisy(estimator, make)[0]
    assert estimate.parameters == model.parameters
    assert (estimate.value.shape, estimate.covariance.shape, estimate.std.shape) == ((p,), (p, p), (p,))
    assert estimate.residual.sigma.shape == (n,)
    assert (estimate.determined.rank, estimate.residual.samples) == (p, 2000)
    assert 1 <= estimate.determined.condition < 1e4, estimate.determined.condition


def has_a_covariance(estimator: Estimator, make: Callable[[], Model]) -> None:
    """Symmetric, and positive semidefinite as a correlation, where units do not matter."""
    estimate, _ = fit_noisy(estimator, make)
    np.testing.assert_allclose(estimate.covariance, estimate.covariance.T, rtol=1e-12)
    correlation = estimate.covariance / np.outer(estimate.std, estimate.std)
    assert np.linalg.eigvalsh(correlation).min() > -1e-12
    np.testing.assert_allclose(estimate.std**2, np.diag(estimate.covariance))


def is_repeatable(estimator: Estimator, make: Callable[[], Model]) -> None:
    """The same data give the same numbers."""
    reference, problem = fit_noisy(estimator, make)
    estimate = fit(estimator, problem)
    np.testing.assert_array_equal(estimate.value, reference.value)
    np.testing.assert_array_equal(estimate.covariance, reference.covariance)
    assert estimate.notes == reference.notes


def ignores_the_order_of_logs(estimator: Estimator, make: Callable[[], Model]) -> None:
    """Logs are a set."""
    model = make()
    logs = [multisine_motion(model, noise=0.01, seed=seed, samples=200 + 50 * seed) for seed in range(3)]
    estimate, reordered = (
        fit(estimator, make_problem(model, *logs)),
        fit(estimator, make_problem(model, *reversed(logs))),
    )
    np.testing.assert_allclose(reordered.value, estimate.value, rtol=1e-9)
    np.testing.assert_allclose(reordered.std, estimate.std, rtol=1e-9)
    assert reordered.residual.samples == estimate.residual.samples == sum(map(len, logs))


def halves_the_variance_of_a_log_twice(estimator: Estimator, make: Callable[[], Model]) -> None:
    """Twice the data, the same value."""
    model = make()
    log = multisine_motion(model, noise=0.01)
    once, twice = fit_noisy(estimator, make)[0], fit(estimator, make_problem(model, log, log))
    np.testing.assert_allclose(twice.value, once.value, rtol=1e-6)
    np.testing.assert_allclose(twice.std**2, once.std**2 / 2, rtol=0.02)
    np.testing.assert_allclose(twice.residual.sigma, once.residual.sigma, rtol=0.02)


def uses_only_the_mask(estimator: Estimator, make: Callable[[], Model]) -> None:
    """Half of a log is spoilt, and masked out."""
    model = make()
    clean, noisy = multisine_motion(model, noise=0.01), multisine_motion(model, noise=100.0)
    half = clean.select_between(stop=5.0)
    tau = np.where(half.mask[:, None], clean.tau, noisy.tau)
    joints, smoothing = half.joints, {"method": "spoilt"}
    spoilt = Motion(clean.t, clean.q, clean.dq, clean.ddq, tau, joints, half.mask, "spoilt", smoothing)
    estimate, expected = fit(estimator, make_problem(model, spoilt)), fit(estimator, make_problem(model, half))
    np.testing.assert_array_equal(estimate.value, expected.value)
    assert estimate.residual.samples == int(half.mask.sum()) < len(clean)


def has_a_quick_stand_in(estimator: Estimator, make: Callable[[], Model]) -> None:
    """What a search uses in its place, most often itself, finds the truth as well."""
    model = make()
    estimate = fit(estimator.quick(), make_problem(model, multisine_motion(model)))
    np.testing.assert_allclose(estimate.value, truth(model), rtol=1e-5)


ESTIMATOR_CHECKS: tuple[Check, ...] = (
    recovers_the_truth_from_exact_data,
    recovers_the_truth_from_noisy_data,
    describes_what_it_estimates,
    has_a_covariance,
    is_repeatable,
    ignores_the_order_of_logs,
    halves_the_variance_of_a_log_twice,
    uses_only_the_mask,
    has_a_quick_stand_in,
)
