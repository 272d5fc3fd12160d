"""What plain fits of the training show: torque without gravity, motion too slow for inertias, logs that repeat."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dynident.checks import log_notes as notes
from dynident.checks.finding import Finding, Topic
from dynident.checks.units import least_error, thin
from dynident.errors import Severity
from dynident.log import Log, Motion
from dynident.models import HasGravity, Model
from dynident.validation import REPEATED, repeat_of

__all__ = ["compensation_findings", "repeat_findings", "slow_findings"]

Array = NDArray[np.float64]

BETTER = 0.8  # of the error with gravity: without it, a fit must be better by that much
NEAR = 0.3  # share of gravity from which on it is not compensated
STEP = 0.05  # of the share, for the curvature of the error
SAME = 1e-4  # %, difference of logs that hold the same samples
WEAK = 1 / 3  # of the residual: less of the torque from accelerations does not show inertias
POOR = 30.0  # %: what a fit leaves of a torque that another fault explains
STRONG = 3.0  # times the residual: more shows them well


def compensation_findings(
    model: Model, motions: Sequence[Motion], min_speed: tuple[float, ...] | None
) -> Iterator[Finding]:
    """Yield where the torque fits the model far better without gravity, which then was compensated before logging.

    The share of gravity is fitted, the parameters being eliminated at each trial; its error is that of white residuals.
    """
    from scipy.optimize import minimize_scalar

    if not any(isinstance(term, HasGravity) and any(term.gravity) for term in model.terms):
        return
    small = thin(model, motions)

    def error(share: float) -> float:
        return least_error(_under(model, share), small, min_speed)

    before, after = error(1.0), error(0.0)
    if not after < BETTER * before:
        return
    factor = float(minimize_scalar(error, bounds=(-NEAR, NEAR), method="bounded", options={"xatol": 1e-3}).x)
    if abs(factor) > 0.9 * NEAR:
        return
    least, *sides = (error(factor + side) ** 2 for side in (0.0, -STEP, STEP))
    curvature = max((sides[0] + sides[1] - 2 * least) / STEP**2, 1e-12)
    count = sum(int(one.mask.sum()) for one in small) * len(model.joints)
    std = float(np.sqrt(2 * least / (count * curvature)))
    note = notes.GravityCompensated(factor, std, before, after)
    yield Finding(Severity.WARNING, None, note, Topic.COMPENSATED)


def _under(model: Model, share: float) -> Model:
    terms = (
        one.with_gravity(tuple(share * g for g in one.gravity)) if isinstance(one, HasGravity) else one
        for one in model.terms
    )
    return replace(model, terms=tuple(terms))


def slow_findings(
    model: Model,
    motions: Sequence[Motion],
    min_speed: tuple[float, ...] | None = None,  # noqa: ARG001
) -> Iterator[Finding]:
    """Yield where accelerations explain less of every joint's torque than a third of what the fit leaves."""
    small = thin(model, motions)
    use = [one.mask for one in small]
    tau = np.concatenate([one.tau[mask] for one, mask in zip(small, use, strict=True)])
    size = np.sqrt(np.mean(tau**2, axis=0))
    weight = 1 / np.where(size > 0, size, np.inf)
    whole, still = (_left(model, small, use, tau, weight, acceleration) for acceleration in (1.0, 0.0))
    share = np.sqrt(np.maximum(still**2 - whole**2, 0.0))
    told = size > 0
    if told.any() and (whole[told] < POOR).all() and (share[told] < WEAK * whole[told]).all():
        k = int(np.argmax(np.where(told, share / np.maximum(whole, 1e-12), -1.0)))
        faster = float(np.sqrt(STRONG * whole[k] / max(share[k], 1e-3 * whole[k])))
        yield Finding(Severity.WARNING, None, notes.SlowMotion(float(share[k]), float(whole[k]), faster), Topic.SLOW)


def _left(
    model: Model,
    motions: Sequence[Motion],
    use: Sequence[NDArray[np.bool_]],
    tau: Array,
    weight: Array,
    acceleration: float,
) -> Array:
    """Return what least squares leaves of each torque (n), in % of its rms, with accelerations times a factor."""
    pairs = zip(motions, use, strict=True)
    Y = np.concatenate([model.regressor(one.q, one.dq, acceleration * one.ddq)[mask] for one, mask in pairs])
    A = (Y * weight[:, None]).reshape(-1, Y.shape[2])
    scale = np.linalg.norm(A, axis=0)
    A = A / np.where(scale > 0, scale, 1.0)
    y = (tau * weight).ravel()
    left = (y - A @ np.linalg.lstsq(A, y, rcond=1e-10)[0]).reshape(tau.shape)
    return np.asarray(100.0 * np.sqrt(np.mean(left**2, axis=0)))


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
