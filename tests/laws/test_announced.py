"""What a design announces is what fits find: a motion, followed in closed loop, recorded many times and identified.

Of N runs, N times the squared ratio of the error found to the standard error announced is distributed as chi-squared
with N degrees of freedom. With 100 runs, a right announcement is within 0.8 and 1.25 for 99.8 % of the seeds, parameter
by parameter; one that is wrong for a single parameter by a factor of 1.5 is within them for less than 1 %.
"""

import importlib
from dataclasses import replace

import numpy as np
import pytest

from dynident.apps.excitation import Program, design, min_fit_speeds
from dynident.apps.excitation.search import Plan, Stage
from dynident.estimators import LeastSquares, Problem
from dynident.models.simulation import CascadePD
from dynident.motion.log import Log, Motion
from dynident.motion.smoothers import Spline
from dynident.regression import Regression, Selection
from dynident.validation import free_run
from tests.apps.excitation.arms import LIMITS, MODEL, THETA
from tests.apps.excitation.requests import OPEN, REQUEST

RUNS = 100
STEP, EVERY = 2e-3, 2  # s: the cycle of the drives, of which each second is recorded
COUNT = 2 * np.pi / 2**17  # rad
GAINS = np.array([100.0, 30.0])  # N m s/rad
SLOW = tuple(min_fit_speeds(MODEL, LIMITS))  # below, a joint may be held by friction


def followed(path):
    """Positions (N, n) and the torque about each, of an arm that follows a path as its drives can."""
    t = np.arange(0.0, path.duration, STEP)
    q, dq = path.states(t)[:2]
    still = np.zeros_like(q)
    start = Motion(t, q, dq, still, still, LIMITS.joints, np.ones(len(t), dtype=bool), "path")
    loop = CascadePD(LIMITS.joints, t, q, np.full(2, 40.0), GAINS, np.ones(2), 2 * LIMITS.torque, GAINS * dq)
    run = free_run(MODEL, THETA, start, loop)
    rows = np.arange(EVERY, len(run.t), EVERY)
    return run.t[rows], run.q[rows], (run.tau[rows - 1] + run.tau[rows]) / 2  # held before a sample, and after it


def fit_path(path, sigma, basis, rng):
    """Errors (runs, r) of the base parameters by least squares."""
    t, q, tau = followed(path)
    errors = []
    for _ in range(RUNS):
        begin = rng.uniform(0.0, COUNT, 2)
        seen = COUNT * np.round((q + begin) / COUNT) - begin
        motion = Spline()(Log(t, seen, tau + sigma * rng.standard_normal(tau.shape), LIMITS.joints))
        problem = Problem(MODEL, (motion,), Regression(MODEL, (motion,), Selection(None, SLOW)))
        errors.append(basis.to_base(LeastSquares(weights="per_joint")(problem).value - THETA))
    return np.array(errors)


def ratios(program, duration):
    """Errors fit_path (runs, r) over the standard errors announced."""
    module = importlib.import_module("dynident.apps.excitation.design")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "Plan", lambda starts: Plan(starts, (Stage(1.0, 12), Stage(0.1, 12))))
        patch.setattr(module, "QUICK", Plan(1, (Stage(1.0, 6),)))
        request = replace(REQUEST, program=program, duration=duration, rate=1 / STEP / EVERY)
        made = design(MODEL, THETA, LIMITS, OPEN, request, np.random.default_rng(0))
    told = made.expected
    errors = fit_path(made.trajectory, request.sigma, told.basis, np.random.default_rng(1))
    return errors / told.std


@pytest.mark.parametrize(
    ("program", "duration"), [(Program.MOTION, REQUEST.duration), (Program.GRAVITY, 25.0), (Program.FRICTION, 30.0)]
)
def test_errors_found_are_those_announced(program, duration):
    rms = np.sqrt(np.square(ratios(program, duration)).mean(axis=0))
    assert ((rms > 0.8) & (rms < 1.25)).all(), rms
