"""Problems whose logs know the controller that made them: for estimators that simulate its loop."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dynident.estimators import Problem
from dynident.log import Log, Motion
from dynident.models import Model
from dynident.simulation import PD, simulated

__all__ = ["in_loops"]

Array = NDArray[np.float64]
FASTER = 5.0  # than the motion: simulations take as long as what they simulate
STIFF, DAMPED = 40.0, 0.7  # rad/s and share: of the loop, for the mass that each joint has at first
SEEN = 1e-4  # m or rad of noise of the positions for 1 N m or N of the torque's


def in_loops(problem: Problem) -> Problem:
    """Return the problem of the same motions, led five times as fast by a PD controller with feedforward.

    The torque has the noise that it had, over the torque of the true parameters of the model; that of the measured
    positions is in proportion. The regression is of the exact motion.
    """
    pairs = [_led(problem.model, motion) for motion in problem.motions]
    motions = tuple(motion for motion, _ in pairs)
    regression = replace(problem.regression, motions=motions)
    return replace(problem, motions=motions, regression=regression, logs=tuple(log for _, log in pairs))


def _led(model: Model, motion: Motion) -> tuple[Motion, Log]:
    """Return a motion in the loop of a controller that follows a motion, with its log."""
    theta = np.asarray(model.values, dtype=float)
    noise = motion.tau - model.torque(motion.q, motion.dq, motion.ddq, theta)
    t, dq, ddq = motion.t / FASTER, FASTER * motion.dq, FASTER**2 * motion.ddq
    fast = replace(motion, t=t, dq=dq, ddq=ddq, tau=model.torque(motion.q, dq, ddq, theta))
    drives = _drives(model, theta, fast)
    run = simulated(model, theta, fast, drives, rows=slice(0, len(t)))
    tau = 0.5 * (run.tau + np.vstack((run.tau[:1], run.tau[:-1]))) + noise
    size = SEEN * float(np.std(noise[motion.mask]))
    q = run.q + size * np.random.default_rng(len(t)).standard_normal(run.q.shape)
    led = replace(fast, q=run.q, dq=run.dq, ddq=run.ddq, tau=tau)
    return led, Log(t, q, tau, motion.joints, motion.source, controller=drives)


def _drives(model: Model, theta: Array, fast: Motion) -> PD:
    """Return drives with gains by the mass of each joint, which hold the mean torque between samples."""
    mass, _ = model.mass_and_bias(fast.q[:1], fast.dq[:1], theta)
    own, one = np.diag(mass[0]), np.ones(len(fast.joints))
    feedforward = 0.5 * (fast.tau + np.vstack((fast.tau[1:], fast.tau[-1:])))
    kp, kd = STIFF**2 * own, 2 * DAMPED * STIFF * own
    return PD(fast.joints, fast.t, fast.q, kp, kd, one, np.inf * one, feedforward, fast.dq)
