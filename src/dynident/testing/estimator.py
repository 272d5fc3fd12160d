"""What every estimator promises."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from dynident.errors import MissingInputError
from dynident.estimators import Estimate, Estimator, Problem, quick
from dynident.io.families import ESTIMATORS
from dynident.log import Motion
from dynident.models import Model
from dynident.models.gallery import slider, two_link_arm
from dynident.regression import Regression
from dynident.testing.looped import in_loops
from dynident.testing.settings import builds_itself_from_its_settings, cannot_be_changed

__all__ = ["ESTIMATOR_CHECKS", "MODELS", "check_estimator", "known_motion", "posed"]

Array = NDArray[np.float64]
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


def known_motion(model: Model, noise: float = 0.0, seed: int = 0, samples: int = 2000) -> Motion:
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


def posed(model: Model, *motions: Motion) -> Problem:
    """Return the problem of a model and motions."""
    return Problem(model, motions, Regression(model, motions))


def fitted(estimator: Estimator, problem: Problem) -> Estimate:
    """Return the estimate; where it needs a controller, that of the same motion and noise in the loop of one."""
    return asked(estimator, problem)[0]


def asked(estimator: Estimator, problem: Problem) -> tuple[Estimate, Problem]:
    """Return the estimate as ``fitted`` does, and the problem that it is of."""
    try:
        return estimator(problem), problem
    except MissingInputError:
        problem = in_loops(problem)
        return estimator(problem), problem


def is_frozen_configuration(estimator: Estimator) -> None:
    """It cannot be changed, and a pickled copy is equal to it."""
    cannot_be_changed(estimator)
    assert len({estimator, pickle.loads(pickle.dumps(estimator))}) == 1
    problem = posed(two_link_arm(), known_motion(two_link_arm(), noise=0.01))
    copy = pickle.loads(pickle.dumps(estimator))
    assert repr(copy) == repr(estimator)
    np.testing.assert_array_equal(fitted(copy, problem).value, fitted(estimator, problem).value)


def recovers_the_truth_from_exact_data(estimator: Estimator, make: Callable[[], Model]) -> None:
    """Without noise, all digits but the last; nothing is to be noted."""
    model = make()
    found = fitted(estimator, posed(model, known_motion(model)))
    allowed = np.maximum(1e-6 * np.abs(truth(model)), found.std)
    assert (np.abs(found.value - truth(model)) <= allowed).all(), found.value
    assert (found.std < 1e-3 * np.abs(truth(model))).all(), found.std
    assert found.notes == (), found.notes


def recovers_the_truth_from_noisy_data(estimator: Estimator, make: Callable[[], Model]) -> None:
    """Within four standard errors, which must be neither nothing nor everything."""
    model = make()
    found, problem = asked(estimator, posed(model, known_motion(model, noise=0.01)))
    assert (np.abs(found.value - truth(model)) < 4 * found.std).all(), (found.value - truth(model)) / found.std
    assert (found.std > 0).all()
    assert (found.std < 0.2 * np.abs(truth(model))).all(), found.std
    left = problem.regression.triangular_factors  # with a controller, not only noise: it moves on between samples
    expected = np.sqrt(left.residual(truth(model)) / left.rows)
    np.testing.assert_allclose(found.residual.sigma, expected, rtol=0.05)


def describes_what_it_estimates(estimator: Estimator, make: Callable[[], Model]) -> None:
    """Names, units and shapes are those of the model."""
    model = make()
    n, p, made = len(model.joints), len(model.parameters), known_motion(model, noise=0.01)
    found = fitted(estimator, posed(model, made))
    assert found.parameters == model.parameters
    assert (found.value.shape, found.covariance.shape, found.std.shape) == ((p,), (p, p), (p,))
    assert found.residual.sigma.shape == (n,)
    assert (found.determined.rank, found.residual.samples) == (p, len(made))
    assert 1 <= found.determined.condition < 1e4, found.determined.condition


def has_a_covariance(estimator: Estimator, make: Callable[[], Model]) -> None:
    """Symmetric, and positive semidefinite as a correlation, where units do not matter."""
    model = make()
    found = fitted(estimator, posed(model, known_motion(model, noise=0.01)))
    np.testing.assert_allclose(found.covariance, found.covariance.T, rtol=1e-12)
    correlation = found.covariance / np.outer(found.std, found.std)
    assert np.linalg.eigvalsh(correlation).min() > -1e-12
    np.testing.assert_allclose(found.std**2, np.diag(found.covariance))


def is_repeatable(estimator: Estimator, make: Callable[[], Model]) -> None:
    """The same data give the same numbers."""
    model = make()
    problem = posed(model, known_motion(model, noise=0.01))
    first, again = fitted(estimator, problem), fitted(estimator, problem)
    afresh = fitted(estimator, posed(model, known_motion(model, noise=0.01)))
    for other in (again, afresh):
        np.testing.assert_array_equal(other.value, first.value)
        np.testing.assert_array_equal(other.covariance, first.covariance)
        assert other.notes == first.notes


def ignores_the_order_of_logs(estimator: Estimator, make: Callable[[], Model]) -> None:
    """Logs are a set."""
    model = make()
    logs = [known_motion(model, noise=0.01, seed=seed, samples=500 + 100 * seed) for seed in range(3)]
    found, turned = fitted(estimator, posed(model, *logs)), fitted(estimator, posed(model, *reversed(logs)))
    np.testing.assert_allclose(turned.value, found.value, rtol=1e-9)
    np.testing.assert_allclose(turned.std, found.std, rtol=1e-9)
    assert turned.residual.samples == found.residual.samples == sum(map(len, logs))


def halves_the_variance_of_a_log_twice(estimator: Estimator, make: Callable[[], Model]) -> None:
    """Twice the data, the same value."""
    model = make()
    log = known_motion(model, noise=0.01)
    once, twice = fitted(estimator, posed(model, log)), fitted(estimator, posed(model, log, log))
    np.testing.assert_allclose(twice.value, once.value, rtol=1e-6)
    np.testing.assert_allclose(twice.std**2, once.std**2 / 2, rtol=0.02)
    np.testing.assert_allclose(twice.residual.sigma, once.residual.sigma, rtol=0.02)


def uses_only_the_mask(estimator: Estimator, make: Callable[[], Model]) -> None:
    """Half of a log is spoilt, and masked out."""
    model = make()
    clean, other = known_motion(model, noise=0.01), known_motion(model, noise=100.0)
    half = clean.between(stop=5.0)
    tau = np.where(half.mask[:, None], clean.tau, other.tau)
    joints, how = half.joints, {"method": "spoilt"}
    spoilt = Motion(clean.t, clean.q, clean.dq, clean.ddq, tau, joints, half.mask, "spoilt", how)
    found, expected = fitted(estimator, posed(model, spoilt)), fitted(estimator, posed(model, half))
    np.testing.assert_array_equal(found.value, expected.value)
    assert found.residual.samples == int(half.mask.sum()) < len(clean)


def has_a_quick_stand_in(estimator: Estimator, make: Callable[[], Model]) -> None:
    """What a search uses in its place, most often itself, finds the truth as well."""
    model = make()
    found = fitted(quick(estimator), posed(model, known_motion(model)))
    np.testing.assert_allclose(found.value, truth(model), rtol=1e-5)


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
