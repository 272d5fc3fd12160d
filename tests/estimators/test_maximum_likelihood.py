"""Maximum likelihood of eq. (7) on the article's arm: against the bound, outliers, a moving start, failure."""

from dataclasses import replace

import numpy as np
import pytest

from dynident.article import SCENARIOS
from dynident.bound import bound
from dynident.errors import ConfigError
from dynident.estimators import Estimate, MaximumLikelihood, Problem
from dynident.gallery import two_link_arm
from dynident.likelihood import fit
from dynident.log import Log
from dynident.regression import Regression
from dynident.smoothers import Spline

ARM = two_link_arm()
TRUE = np.array(ARM.values)


def recording(name: str, level: float, seed: int) -> Log:
    return SCENARIOS[name].record(level, np.random.default_rng(seed)).log


def posed(log: Log, level: float) -> Problem:
    motions = (Spline(sigma=np.sqrt(level), ends=0.0)(log.window(0.25)),)
    return Problem(ARM, motions, Regression(ARM, motions), (log,))


def estimate(name: str, level: float, seed: int, **settings) -> Estimate:
    return MaximumLikelihood(**settings)(posed(recording(name, level, seed), level))


@pytest.mark.parametrize(("name", "level"), [("stated", 1e-8), ("stated", 1e-4), ("weak", 1e-8), ("weak", 1e-4)])
def test_reaches_the_bound(name: str, level: float) -> None:
    """Eight runs: the mean square error in units of the bound is chi-square with about 8 degrees of freedom."""
    runs = [estimate(name, level, seed, start="rest", profile=None) for seed in range(8)]
    scenario = SCENARIOS[name]
    least = np.diag(bound(ARM, TRUE, scenario.truth(), np.sqrt(level), scenario.sigma_tau, rest=True))
    error = np.array([run.value - TRUE for run in runs])
    assert {run.status for run in runs} == {"ok"}
    assert ((error**2).mean(axis=0) < 3.0 * least).all()
    assert min(run.value[1] for run in runs) > 0
    np.testing.assert_allclose(runs[0].sigma, scenario.sigma_tau, rtol=0.05)


def test_follows_the_transient_better_than_free_torques_allow() -> None:
    found = estimate("stated", 1e-8, 0, start="rest")
    scenario = SCENARIOS["stated"]
    least = np.sqrt(np.diag(bound(ARM, TRUE, scenario.truth(), 1e-4, scenario.sigma_tau, rest=True)))
    assert found.std[1] < 0.6 * least[1]
    assert abs(found.value[1] - TRUE[1]) < 4 * found.std[1]


def test_huber_bounds_outliers() -> None:
    log, rng = recording("stated", 1e-6, 1), np.random.default_rng(2)
    hit = rng.random(log.tau.shape) < 0.02
    spoilt = replace(log, tau=log.tau + np.where(hit, 5.0, 0.0))
    errors = []
    for huber in (None, 1.345):
        found = MaximumLikelihood(start="rest", steps=False, huber=huber, rounds=3)(posed(spoilt, 1e-6))
        errors.append(np.abs(found.value[3] / TRUE[3] - 1))
    assert errors[1] < 0.5 * errors[0]


def test_a_moving_start_is_noticed() -> None:
    log = recording("stated", 1e-8, 0)
    moving = MaximumLikelihood(start="test")(posed(log.window(3.0), 1e-8))
    assert "do not start from rest" in moving.status
    assert MaximumLikelihood(start="test")(posed(log, 1e-8)).status == "ok"


def test_intervals_are_by_profile_likelihood_where_information_is_weak() -> None:
    found = estimate("weak", 1e-4, 0, start="rest", profile=0.2)
    below, above = found.value - found.interval[:, 0], found.interval[:, 1] - found.value
    assert abs(above[1] - below[1]) > 0.01 * above[1]
    assert found.interval[1, 0] > 0
    np.testing.assert_allclose(above[3:], 1.96 * found.std[3:], rtol=0.15)  # they follow the weak one, little


def test_failure_returns_the_start_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_) -> None:
        raise np.linalg.LinAlgError("no luck")

    monkeypatch.setattr(fit, "_step", fails)
    found = estimate("stated", 1e-6, 0)
    assert found.status == "maximum likelihood failed, this is the least-squares start: no luck"
    np.testing.assert_allclose(found.value, TRUE, rtol=0.3)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"start": "yes"}, "start = 'yes'"),
        ({"spacing": 0.0}, "spacing = 0"),
        ({"rounds": 0}, "rounds = 0"),
        ({"weight": 2.0}, "weight = 2"),
    ],
)
def test_refuses_bad_settings(settings: dict, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        MaximumLikelihood(**settings)
