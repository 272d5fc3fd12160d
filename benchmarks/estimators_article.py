"""The article's arm with every smoother and every estimator; workers import this file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from estimators_study import Study, parts

from dynident.apps.article import LEVELS, METHODS, SCENARIOS, ArmScenario, Method, SmoothAndFit
from dynident.apps.article.article import SAMPLING_PERIOD, SPLINE, arm_to_identify
from dynident.estimators import Estimate, LeastSquares
from dynident.identification import Recipe, cramer_rao_bound, identify
from dynident.models.lagrangian import two_link_arm
from dynident.models.simulation import ControllerInput, ControllerSlopes, Recording
from dynident.runtime.families import ESTIMATORS, SMOOTHERS

KNOWN = 1e-3  # of the torque's noise: the bound of a torque that is known
SHOWN = ("raw", "filtered", "spline", "spline-early", "ml")  # as the article has them, and better ones


@dataclass(frozen=True)
class KnownTorque:
    """The controller of the article's arm: u = (A1 sin t, A2 cos t), whatever the joints do.

    What it returns is held for a sample: it is the torque in the middle of it, which moves the arm as u does.
    """

    joints: tuple[str, ...]
    amplitudes: tuple[float, float]

    def __call__(self, t: float, q: np.ndarray, dq: np.ndarray) -> np.ndarray:  # noqa: ARG002
        middle = t + SAMPLING_PERIOD / 2
        return np.array([self.amplitudes[0] * np.sin(middle), self.amplitudes[1] * np.cos(middle)])

    def slopes(self, seen: ControllerInput) -> ControllerSlopes:
        """Return the derivatives by q and dq: none."""
        (rows, n), m = seen.q.shape, seen.state.shape[1]
        by, then = np.zeros((rows, n, n)), np.zeros((rows, m, n))
        return ControllerSlopes((by, by, np.zeros((rows, n, m))), (then, then, np.zeros((rows, m, m))))


@dataclass(frozen=True)
class Driven:
    """A scenario of the article whose log knows its controller, which gives the exact torque."""

    arm: ArmScenario

    @property
    def name(self) -> str:
        return f"{self.arm.name}, torque known"

    def record(self, level: float, rng: np.random.Generator) -> Recording:
        """The same recording with its controller."""
        recording = self.arm.record(level, rng)
        return replace(
            recording, log=replace(recording.log, controller=KnownTorque(recording.log.joints, self.arm.amplitudes))
        )


@dataclass(frozen=True)
class Whole:
    """``dynident.identify`` with the article's spline, known noise and least squares, without the transient: it removes
    the bias by errors of the smoothed motion, and counts them."""

    name: str = "identify"

    def estimate(self, recording: Recording) -> Estimate:
        """Identify; the errors are those that allow for correlated residuals."""
        method = METHODS["spline-early"]
        recipe = Recipe(method.smoother_for(recording), rests="keep")
        result = identify(arm_to_identify(), [method.log(recording)], recipe=recipe)
        return replace(result.estimate, covariance=np.diag(np.square(result.errors.std)))


def methods() -> dict[str, Method]:
    """Methods by name: the article's, every smoother with least squares, every estimator on the article's spline."""
    result: dict[str, Method] = {name: METHODS[name] for name in SHOWN} | {"identify": Whole()}
    for name, smoother in parts(SMOOTHERS):
        if smoother != METHODS["raw"].smoother:
            result[f"smoother {name}"] = SmoothAndFit(f"smoother {name}", smoother)
    for name, estimator in parts(ESTIMATORS):
        if estimator != LeastSquares():
            result[name] = SmoothAndFit(name, SPLINE, estimator=estimator)
    return result


def study(names: Sequence[str] = (), levels: Sequence[float] = LEVELS, scenarios: Sequence[str] = ()) -> Study:
    """The article's scenarios, by default all of all."""
    arms = [SCENARIOS[name] for name in scenarios or SCENARIOS]
    for arm in arms:
        _ = arm.truth  # goes to the workers with it
    every = methods()
    return Study(
        "article",
        arms,
        levels,
        {name: every[name] for name in names or every},
        np.asarray(two_link_arm().values, dtype=float),
        bound,
        {arm.name: Driven(arm) for arm in arms},
    )


@cache
def bound(scenario: str, level: float) -> np.ndarray:
    """Least standard deviations (7) of methods that know the torque as it is measured."""
    return np.asarray(np.sqrt(SCENARIOS[scenario.partition(",")[0]].bound(level)))


@cache
def known_bound(scenario: str, level: float) -> float:
    """The same of a torque that is known, over those of the measured one: rms over the parameters."""
    arm, model = SCENARIOS[scenario], two_link_arm()
    theta = np.asarray(model.values, dtype=float)
    least = cramer_rao_bound(model, theta, arm.truth, np.sqrt(level), KNOWN * arm.sigma_tau, rest=True)
    return float(np.sqrt(np.mean(np.diag(least) / bound(scenario, level) ** 2)))
