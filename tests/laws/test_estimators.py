"""What every estimator promises: one suite for the whole family. A new estimator is added to ESTIMATORS."""

import pickle
from collections.abc import Callable
from dataclasses import FrozenInstanceError

import numpy as np
import pytest

from dynident.estimators import Consistent, Estimator, LeastSquares, MaximumLikelihood, Problem
from dynident.gallery import slider, two_link_arm
from dynident.log import Motion
from dynident.model import Model
from dynident.regression import Regression

ESTIMATORS: list[Estimator] = [LeastSquares(), LeastSquares(weights="per_joint"), Consistent(), MaximumLikelihood()]
MODELS: dict[str, Callable[[], Model]] = {
    "arm": two_link_arm,
    "slider": lambda: slider(values=(5.0, 8.0, 3.0, 0.5)),
    "smooth slider": lambda: slider(width=1e-3, values=(5.0, 8.0, 3.0, 0.5)),
}
every_estimator = pytest.mark.parametrize("estimator", ESTIMATORS, ids=repr)
every_model = pytest.mark.parametrize("make", MODELS.values(), ids=MODELS)


def truth(model: Model) -> np.ndarray:
    values = model.values
    assert values is not None
    return values


def motion(model: Model, noise: float = 0.0, seed: int = 0, samples: int = 2000) -> Motion:
    """A multisine per joint with its exact derivatives; the noise is white, on the torque, in N m or N."""
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


def problem(model: Model, *motions: Motion) -> Problem:
    return Problem(model, motions, Regression(model, motions))


@every_model
@every_estimator
class TestEveryEstimator:
    def test_recovers_the_truth_from_exact_data(self, estimator: Estimator, make: Callable[[], Model]) -> None:
        model = make()
        found = estimator(problem(model, motion(model)))
        allowed = np.maximum(1e-6 * np.abs(truth(model)), found.std)
        assert (np.abs(found.value - truth(model)) <= allowed).all()
        assert (found.std < 1e-3 * np.abs(truth(model))).all()
        assert found.notes == ()

    def test_recovers_the_truth_from_noisy_data(self, estimator: Estimator, make: Callable[[], Model]) -> None:
        """Within four standard errors, which must be neither nothing nor everything."""
        model = make()
        found = estimator(problem(model, motion(model, noise=0.01)))
        assert (np.abs(found.value - truth(model)) < 4 * found.std).all()
        assert (found.std > 0).all()
        assert (found.std < 0.2 * np.abs(truth(model))).all()
        np.testing.assert_allclose(found.sigma, 0.01, rtol=0.1)

    def test_describes_what_it_estimates(self, estimator: Estimator, make: Callable[[], Model]) -> None:
        model = make()
        n, p, made = len(model.joints), len(model.parameters), motion(model, noise=0.01)
        found = estimator(problem(model, made))
        assert found.names == model.names
        assert found.units == tuple(parameter.unit for parameter in model.parameters)
        assert (found.value.shape, found.covariance.shape, found.std.shape) == ((p,), (p, p), (p,))
        assert found.sigma.shape == (n,)
        assert (found.rank, found.samples) == (p, len(made))
        assert 1 <= found.condition < 1e4

    def test_covariance_is_one(self, estimator: Estimator, make: Callable[[], Model]) -> None:
        """Symmetric, and positive semidefinite as a correlation, where units do not matter."""
        model = make()
        found = estimator(problem(model, motion(model, noise=0.01)))
        np.testing.assert_allclose(found.covariance, found.covariance.T, rtol=1e-12)
        correlation = found.covariance / np.outer(found.std, found.std)
        assert np.linalg.eigvalsh(correlation).min() > -1e-12
        np.testing.assert_allclose(found.std**2, np.diag(found.covariance))

    def test_is_repeatable(self, estimator: Estimator, make: Callable[[], Model]) -> None:
        model = make()
        posed = problem(model, motion(model, noise=0.01))
        first, again = estimator(posed), estimator(posed)
        afresh = estimator(problem(model, motion(model, noise=0.01)))
        for other in (again, afresh):
            np.testing.assert_array_equal(other.value, first.value)
            np.testing.assert_array_equal(other.covariance, first.covariance)
            assert other.notes == first.notes

    def test_order_of_the_logs_does_not_matter(self, estimator: Estimator, make: Callable[[], Model]) -> None:
        model = make()
        logs = [motion(model, noise=0.01, seed=seed, samples=500 + 100 * seed) for seed in range(3)]
        found, turned = estimator(problem(model, *logs)), estimator(problem(model, *reversed(logs)))
        np.testing.assert_allclose(turned.value, found.value, rtol=1e-9)
        np.testing.assert_allclose(turned.std, found.std, rtol=1e-9)
        assert turned.samples == found.samples == sum(map(len, logs))

    def test_a_log_twice_halves_the_variance(self, estimator: Estimator, make: Callable[[], Model]) -> None:
        model = make()
        log = motion(model, noise=0.01)
        once, twice = estimator(problem(model, log)), estimator(problem(model, log, log))
        np.testing.assert_allclose(twice.value, once.value, rtol=1e-6)
        np.testing.assert_allclose(twice.std**2, once.std**2 / 2, rtol=0.02)
        np.testing.assert_allclose(twice.sigma, once.sigma, rtol=0.02)

    def test_uses_only_the_samples_of_the_mask(self, estimator: Estimator, make: Callable[[], Model]) -> None:
        """Half of a log is spoilt, and masked out."""
        model = make()
        clean, other = motion(model, noise=0.01), motion(model, noise=100.0)
        half = clean.between(stop=5.0)
        tau = np.where(half.mask[:, None], clean.tau, other.tau)
        joints, how = half.joints, {"method": "spoilt"}
        spoilt = Motion(clean.t, clean.q, clean.dq, clean.ddq, tau, joints, half.mask, "spoilt", how)
        found, expected = estimator(problem(model, spoilt)), estimator(problem(model, half))
        np.testing.assert_array_equal(found.value, expected.value)
        assert found.samples == int(half.mask.sum()) < len(clean)


@every_estimator
def test_is_frozen_configuration(estimator: Estimator) -> None:
    with pytest.raises(FrozenInstanceError):
        estimator.anything = 1  # type: ignore[attr-defined]
    assert len({estimator, pickle.loads(pickle.dumps(estimator))}) == 1


@every_estimator
def test_survives_pickling(estimator: Estimator) -> None:
    model = two_link_arm()
    posed = problem(model, motion(model, noise=0.01))
    copy = pickle.loads(pickle.dumps(estimator))
    assert copy == estimator
    assert repr(copy) == repr(estimator)
    np.testing.assert_array_equal(copy(posed).value, estimator(posed).value)
