"""The demo arm in closed loop, seen by encoders of 17 and 12 bits, identified by every smoother and estimator.

Its drives close their loop over encoders of their own at the motors, which are fine; the log has those of the joints.
All recordings are of one motion: they differ in where the counts begin, and in the noise of the torque, which is
coloured. Workers import this file.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import numpy as np
from demo_files import DAYS, LOG_EVERY, NOISE_CORRELATION, NOISE_SHARE, STEP
from estimators_study import Row, Study, listed, parts
from scipy.signal import lfilter

from dynident.apps.demo.arm import JOINTS, true_model, true_values
from dynident.apps.demo.files import SEED, Day, fourier_motion
from dynident.estimators import Estimate, Estimator, LeastSquares, LinearEstimator, PhysicallyConsistent
from dynident.identification import Identification, Recipe, identify
from dynident.models import Model, Parameter
from dynident.models.simulation import CascadePD, Recording
from dynident.motion.log import Log, Motion
from dynident.motion.smoothers import Smoother, Spline
from dynident.project.parts import build
from dynident.regression import BaseParameters, structural_base_parameters
from dynident.runtime.families import ESTIMATORS, SMOOTHERS
from dynident.validation import free_run

BITS = (17.0, 12.0)  # of an encoder, per turn of its joint
SECONDS, LEAD = 10.0, 1.0  # of a log; before it, which is simulated, too
HALF = LOG_EVERY // 2  # of the cycles whose mean torque is logged
Array = np.ndarray


@cache
def arm() -> tuple[Model, Array, BaseParameters]:
    """The arm, its true parameters, and its base parameters."""
    model = true_model()
    return model, true_values(), structural_base_parameters(model)


@dataclass(frozen=True)
class ClosedLoop:
    """The arm behind a random Fourier series, as its drives lead it; a level is the number of bits of the encoders."""

    name: str = "six joints"
    day: Day = DAYS[0]
    seconds: float = SECONDS

    @cached_property
    def driven(self) -> tuple[Motion, CascadePD]:
        """The exact motion as it is logged, and the drives; simulated once, workers get it with the scenario."""
        lead, rows = round(LEAD / STEP), round(self.seconds / STEP / LOG_EVERY)
        t = STEP * np.arange(-lead, LOG_EVERY * rows + LOG_EVERY, dtype=float)
        q, dq, _ = fourier_motion(np.random.default_rng(SEED), self.day, t)
        still, names = np.zeros_like(q), tuple(joint.name for joint in JOINTS)
        kp, kv, effort = (np.array([float(getattr(x, key)) for x in JOINTS]) for key in ("kp", "kv", "effort"))
        drives = CascadePD(names, t, q, kp, kv, np.ones(len(names)), effort, still)
        start = Motion(t, q, dq, still, still, names, np.ones(len(t), bool), self.name)
        model, theta, _ = arm()
        run = free_run(model, theta, start, drives)
        k = lead + LOG_EVERY * np.arange(rows)
        speed = np.gradient(run.q, STEP, axis=0)
        ddq = (speed[k + HALF] - speed[k - HALF]) / (2 * HALF * STEP)
        tau = np.mean([run.tau[k + x] for x in range(-HALF, HALF)], axis=0)
        return Motion(t[k], run.q[k], speed[k], ddq, tau, names, np.ones(rows, bool), self.name), drives

    @property
    def noise(self) -> Array:
        """Standard deviation (6) of the noise of the torque."""
        return NOISE_SHARE * np.array([joint.effort for joint in JOINTS])

    def record(self, level: float, rng: np.random.Generator) -> Recording:
        """Return a recording by encoders of so many bits."""
        truth, drives = self.driven
        count = 2 * np.pi / 2**level
        begin = rng.uniform(0, count, truth.q.shape[1])
        seen = count * np.round((truth.q + begin) / count) - begin
        log = Log(truth.t, seen, truth.tau + self.noise * coloured(truth.tau.shape, rng), truth.joints, self.name,
                  controller=drives)  # fmt: skip
        return Recording(log, truth, np.full(len(JOINTS), count / np.sqrt(12)), self.noise)

    def bound(self) -> Array:
        """Least standard deviations of the base parameters, were the motion known: the torque's noise is of an AR(1).

        No method can have smaller ones without bias; with errors of the positions they are larger.
        """
        truth, (model, _, base) = self.driven[0], arm()
        Y = model.regressor(truth.q, truth.dq, truth.ddq)[:, :, list(base.independent)]
        fresh = (Y[1:] - NOISE_CORRELATION * Y[:-1]) / np.sqrt(1 - NOISE_CORRELATION**2)
        rows = (np.concatenate([Y[:1], fresh]) / self.noise[:, None]).reshape(-1, base.rank)
        size = np.linalg.norm(rows, axis=0)
        _, values, right = np.linalg.svd(rows / size, full_matrices=False)
        return np.asarray(np.sqrt(np.square(right.T / values).sum(axis=1)) / size)


def coloured(shape: tuple[int, ...], rng: np.random.Generator) -> Array:
    """Noise of variance 1, each sample of which keeps a share of the one before."""
    fresh = rng.standard_normal(shape)
    fresh[1:] *= np.sqrt(1 - NOISE_CORRELATION**2)
    return np.asarray(lfilter([1.0], [1.0, -NOISE_CORRELATION], fresh, axis=0))


@dataclass(frozen=True)
class Identify:
    """``dynident.identify`` with a smoother and an estimator; gives the base parameters."""

    name: str
    smoother: Smoother | tuple[Smoother, ...]
    estimator: Estimator

    def estimate(self, recording: Recording) -> Estimate:
        """Identify the arm whose terms are known from one recording."""
        model, _, base = arm()
        result = identify(model, [recording.log], recipe=Recipe(self.smoother, self.estimator))
        raw_estimate = result.estimate
        named = tuple(Parameter(name, "") for name in base.leading)
        value = base.to_base(raw_estimate.value)
        return Estimate(
            named,
            value,
            covariance(result, base),
            raw_estimate.determined,
            raw_estimate.residual,
            raw_estimate.notes,
        )


def covariance(identification: Identification, base: BaseParameters) -> Array:
    """The covariance of the base parameters that the report's intervals are of."""
    on_data, all_of_it = identification.base.on_data, identification.errors.base_covariance
    if on_data is None:
        return np.asarray(base.combination @ identification.estimate.covariance @ base.combination.T)
    turn = base.combination[:, list(on_data.independent)]
    if all_of_it is None:
        std = identification.errors.base_std
        assert std is not None
        all_of_it = np.diag(np.square(std))
    return np.asarray(turn @ all_of_it @ turn.T)


@cache
def elsewhere(seconds: float) -> tuple[Array, Array]:
    """The regressor of the base parameters along another motion, and its torque, without noise."""
    model, theta, base = arm()
    motion = fourier_motion(np.random.default_rng(SEED + 1), DAYS[1], np.arange(0.0, seconds, STEP * LOG_EVERY))
    return model.regressor(*motion)[:, :, list(base.independent)], model.torque(*motion, theta)


def held_out(estimates: Array) -> Row:
    """Errors (%) of the torque along another motion: the median over the recordings, by joint and of all."""
    Y, tau = elsewhere(DAYS[1].duration)
    _, theta, base = arm()
    left = np.einsum("nji,ri->rnj", Y, estimates - base.to_base(theta))
    joints = 100 * np.linalg.norm(left, axis=1) / np.linalg.norm(tau, axis=0)
    return {"held_out": listed(np.median(joints, axis=0)), "error": float(f"{np.median(joints.mean(axis=1)):.4g}")}


def methods() -> tuple[dict[str, Identify], dict[str, str]]:
    """Every smoother with every estimator, and on the default spline each linear one within physics, too; and which of
    them are not one of the two defaults with another part, with the estimator on the default spline."""
    by_torque = build(SMOOTHERS, {"kind": "spline", "rule": "torque"}, "smoother")
    smoothers = dict(parts(SMOOTHERS)) | {"spline, by torque": by_torque}
    estimators: dict[str, Any] = dict(parts(ESTIMATORS))
    linear: list[tuple[str, Any]] = [(name, x) for name, x in estimators.items() if isinstance(x, LinearEstimator)]
    pairs = {f"{name} + {fit}": (x, part) for name, x in smoothers.items() for fit, part in estimators.items()}
    within = {f"consistent {name}": PhysicallyConsistent(fit=x) for name, x in linear if x != LeastSquares()}
    pairs |= {f"spline + {name}": (Spline(), part) for name, part in within.items()}
    seldom = {
        name: f"spline + {name.partition(' + ')[2]}"
        for name, (x, fit) in pairs.items()
        if x != Spline() and fit != LeastSquares()
    }
    return {name: Identify(name, *pair) for name, pair in pairs.items()}, seldom


def study(names: Sequence[str] = (), levels: Sequence[float] = BITS, scenario: ClosedLoop | None = None) -> Study:
    """The arm with encoders of 17 and 12 bits, by default with all methods."""
    loop, (every, seldom), (_, theta, base) = scenario or ClosedLoop(), methods(), arm()
    _ = loop.driven  # goes to the workers with it
    least = loop.bound()
    some, true = {name: every[name] for name in names or every}, base.to_base(theta)
    few = {name: other for name, other in seldom.items() if {name, other} <= set(some)}
    return Study("arm", [loop], levels, some, true, lambda *_: least, {}, few, held_out, each=False)
