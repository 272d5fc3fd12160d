"""What plain fits of the training show: torque without gravity or friction, slow motion, logs that repeat."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from dynident.checks import log_notes as notes
from dynident.checks.finding import Finding, Topic
from dynident.checks.units import joint_errors, least_error
from dynident.errors import Severity
from dynident.estimators.linear import solve
from dynident.log import Log
from dynident.models import HasGravity
from dynident.regression import Regression
from dynident.validation import REPEATED, repeat_of

__all__ = ["compensation_findings", "friction_findings", "repeat_findings", "slow_findings"]

BETTER = 0.8  # of the error with gravity: without it, a fit must be better by that much
NEAR = 0.3  # share of gravity from which on it is not compensated
STEP = 0.05  # of the share, for the curvature of the error
SAME = 1e-4  # %, difference of logs that hold the same samples
WEAK = 1 / 3  # of the residual: less of the torque from accelerations does not show inertias
POOR = 30.0  # %: what a fit leaves of a torque that another fault explains
STRONG = 3.0  # times the residual: more shows them well
FRICTION = ("viscous", "coulomb")
SLIDING = 1.0  # %, of a joint's torque: drives and gears have several times this friction


def compensation_findings(few: Regression) -> Iterator[Finding]:
    """Yield where the torque fits the model far better without gravity, which then was compensated before logging.

    The share of gravity is fitted, the parameters being eliminated at each trial; its error is that of white residuals.
    """
    from scipy.optimize import minimize_scalar

    if not any(isinstance(term, HasGravity) and any(term.gravity) for term in few.model.terms):
        return

    def error(share: float) -> float:
        return least_error(replace(few, model=few.model.with_gravity(lambda g: share * g)))

    before, after = least_error(few), error(0.0)
    if not after < BETTER * before:
        return
    factor = float(minimize_scalar(error, bounds=(-NEAR, NEAR), method="bounded", options={"xatol": 1e-3}).x)
    if abs(factor) > 0.9 * NEAR:
        return
    least, *sides = (error(factor + side) ** 2 for side in (0.0, -STEP, STEP))
    curvature = max((sides[0] + sides[1] - 2 * least) / STEP**2, 1e-12)
    count = sum(int(one.mask.sum()) for one in few.motions) * len(few.model.joints)
    std = float(np.sqrt(2 * least / (count * curvature)))
    note = notes.GravityCompensated(factor, std, before, after)
    yield Finding(Severity.WARNING, None, note, Topic.COMPENSATED)


def friction_findings(few: Regression) -> Iterator[Finding]:
    """Yield that no joint shows the friction that the model has: the torque is then not that of the drives."""
    roles = np.array([one.role for one in few.model.parameters])
    factors = few.triangular_factors.factors
    size = np.square(factors[:, :, -1]).sum(axis=1)
    moved = all(factors[:, :, np.flatnonzero(roles == role)].any() for role in FRICTION)
    if not moved or not size.all() or (joint_errors(few) > POOR).any():
        return
    theta = solve(few.triangular_factors.stacked(1 / np.sqrt(size))).value
    torque = factors[:, :, :-1] @ np.where(np.isin(roles, FRICTION), theta, 0.0)
    share = 100.0 * np.sqrt(np.square(torque).sum(axis=1) / size)
    if (share < SLIDING).all():
        yield Finding(Severity.WARNING, None, notes.NoFriction(float(share.max())), Topic.FRICTION)


def slow_findings(few: Regression) -> Iterator[Finding]:
    """Yield where accelerations explain less of every joint's torque than a third of what the fit leaves."""
    slow = tuple(replace(one, ddq=np.zeros_like(one.ddq)) for one in few.motions)
    whole, still = joint_errors(few), joint_errors(replace(few, motions=slow))
    share = np.sqrt(np.maximum(still**2 - whole**2, 0.0))
    used = few.triangular_factors.factors[:, :, -1].any(axis=1)
    if used.any() and (whole[used] < POOR).all() and (share[used] < WEAK * whole[used]).all():
        k = int(np.argmax(np.where(used, share / np.maximum(whole, 1e-12), -1.0)))
        faster = float(np.sqrt(STRONG * whole[k] / max(share[k], 1e-3 * whole[k])))
        yield Finding(Severity.WARNING, None, notes.SlowMotion(float(share[k]), float(whole[k]), faster), Topic.SLOW)


def repeat_findings(logs: Mapping[str, Mapping[str, Log]]) -> Iterator[Finding]:
    """Yield which held-out logs hold samples of the training, or repeat one of its motions, at any lag."""
    for name, held in logs.get("validation", {}).items():
        for other, log in logs.get("train", {}).items():
            found = repeat_of(held, log.select(held.joints))
            if found.error < SAME:
                note = notes.SameData(other, found.lag)
                yield Finding(Severity.WARNING, None, note, Topic.REPEAT, source=name)
                break
            if found.error < REPEATED:
                alike = notes.RepeatedMotion(other, found.lag, found.error)
                yield Finding(Severity.WARNING, None, alike, Topic.REPEAT, source=name)
                break
