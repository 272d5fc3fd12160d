"""A mass in the loop of a controller, recorded with noise: known truth for instrumental variables."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dynident.estimators import Problem
from dynident.models import Joint, Model, RotorInertia
from dynident.models.friction import Offset, Viscous
from dynident.models.simulation import PD, simulate_recording
from dynident.motion.log import Log, Motion
from dynident.motion.smoothers import Difference
from dynident.regression import ParallelFilter, Regression, Selection

JOINTS = (Joint("slider", "prismatic"),)
TRUTH = np.array([5.0, 8.0, 0.5])
MODEL = Model((RotorInertia(JOINTS, names=("M",)), Viscous(JOINTS, names=("Fv",)), Offset(JOINTS, names=("offset",))))
STEP = 0.005


def loop(samples: int, kp: float = 400.0, kd: float = 80.0) -> PD:
    """A PD loop with a multisine as reference; it is stable for the mass unless its gains are negative."""
    t = STEP * np.arange(samples)
    reference = 0.1 * np.sin(2.0 * t) + 0.05 * np.sin(5.3 * t) + 0.02 * np.sin(11.0 * t)
    ones = np.ones(1)
    return PD(("slider",), t, reference[:, None], kp * ones, kd * ones, ones, np.inf * ones, np.zeros((samples, 1)))


def driven(samples: int = 2000) -> tuple[Motion, PD]:
    """The motion of the mass in its loop, with the torque that belongs to its velocities and accelerations."""
    controller = loop(samples)
    zero = np.zeros((samples, 1))
    rest = Motion(controller.t, zero, zero, zero, zero, ("slider",), np.ones(samples, dtype=bool), "run")
    run = simulate_recording(MODEL, TRUTH, rest, controller)
    return replace(rest, q=run.q, dq=run.dq, ddq=run.ddq, tau=MODEL.torque(run.q, run.dq, run.ddq, TRUTH)), controller


def recorded(
    truth: Motion, controller: PD | None, seed: int, sigma_q: float = 2e-5, sigma_tau: float = 0.2
) -> tuple[Log, Motion]:
    """A log with white noise, and its motion: the true one with what central differences make of this noise."""
    rng = np.random.default_rng(seed)
    q, tau = (s * rng.standard_normal(x.shape) for x, s in ((truth.q, sigma_q), (truth.tau, sigma_tau)))
    error = Difference()(Log(truth.t, q, tau, truth.joints))
    log = Log(truth.t, truth.q + q, truth.tau + tau, truth.joints, f"log {seed}", controller=controller)
    states = {name: getattr(truth, name) + getattr(error, name) for name in ("q", "dq", "ddq")}
    return log, replace(truth, tau=log.tau, mask=error.mask, source=log.source, **states)


def posed(*recordings: tuple[Log, Motion], low: ParallelFilter | None = None, model: Model = MODEL) -> Problem:
    """The problem of recordings."""
    logs: Sequence[Log] = [log for log, _ in recordings]
    motions = tuple(motion for _, motion in recordings)
    return Problem(model, motions, Regression(model, motions, Selection(low)), tuple(logs))
