"""A stream of samples: smoothing with a fixed lag, regressor, recursive least squares, of arms with friction."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from bodies import states
from factors import arm
from numpy.typing import NDArray

Call = Callable[[], object]
Array = NDArray[np.float64]
STEP, SIGMA = 5e-3, 1e-5  # s, of ``states``; rad, of an encoder
SAMPLES = 5000
MEMORIES: dict[str, Any] = {"everything kept": np.inf, "groups": {"friction": 60.0, "payload": 5.0}}  # s


def tracked(_: str, joints: int, size: int, memory: str) -> Call:
    """Positions and torques to an estimate, so many samples at a time, by a tracker that has seen twice as many."""
    from dynident.apps.online import Tracker, estimate_smoothing
    from dynident.regression import GroupKind

    result, log = identified(joints)
    given = MEMORIES[memory]
    reference = given if isinstance(given, float) else {GroupKind(kind): value for kind, value in given.items()}
    tracker = Tracker(result, estimate_smoothing(result, log), memory=reference)
    now = 0.0

    def on() -> Any:
        nonlocal now
        t = now + np.arange(1, SAMPLES + 1) * STEP
        for k in range(0, SAMPLES, size):
            tracker.push(t[k : k + size], log.q[k : k + size], log.tau[k : k + size])
        now = float(t[-1])
        return tracker.fit.rows

    on()
    on()
    return on


def smoothed(_: str, joints: int, size: int) -> Call:
    """Positions to derivatives, with the lag that leaves 1e-10 of the error at a cut."""
    from dynident.apps.online import FixedLag, estimate_smoothing

    result, log = identified(joints)
    stream, now = FixedLag(log.joints, estimate_smoothing(result, log)), 0.0

    def on() -> Any:
        nonlocal now
        t = now + np.arange(1, SAMPLES + 1) * STEP
        for k in range(0, SAMPLES, size):
            stream.push(t[k : k + size], log.q[k : k + size], log.tau[k : k + size])
        now = float(t[-1])

    on()
    return on


def updated(_: str, joints: int, size: int) -> Call:
    """States to an estimate."""
    from dynident.apps.online import RecursiveLeastSquares

    q, dq, ddq = states(joints, SAMPLES)
    tau = np.random.default_rng(1).standard_normal(q.shape)
    t, fit = np.arange(SAMPLES) * STEP, RecursiveLeastSquares(arm(joints))

    def on() -> Any:
        for k in range(0, SAMPLES, size):
            rows = slice(k, k + size)
            fit.update(t[rows], q[rows], dq[rows], ddq[rows], tau[rows])
        return fit.rows

    return on


@cache
def identified(joints: int) -> tuple[Any, Any]:
    """An arm that was identified, and the recording."""
    from dynident.estimators import LeastSquares
    from dynident.identification import Recipe, identify
    from dynident.motion.log import Log
    from dynident.motion.smoothers import Spline

    model = arm(joints)
    q, dq, ddq = states(joints, SAMPLES)
    t, rng = STEP * np.arange(SAMPLES, dtype=np.float64), np.random.default_rng(2)
    theta = np.array([0.5 if parameter.value is None else parameter.value for parameter in model.parameters])
    tau = model.torque(q, dq, ddq, theta) + 0.1 * rng.standard_normal(q.shape)
    log = Log(t, q + SIGMA * rng.standard_normal(q.shape), tau, tuple(joint.name for joint in model.joints))
    recipe = Recipe(Spline(sigma=SIGMA), LeastSquares(weights="per_joint"), outliers="keep", rests="keep")
    return identify(model, {"log": log}, (), recipe), log
