"""What to record or to change next, with what it may gain, the largest gain first."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from dynident.errors import Note
from dynident.identification.result import Identification
from dynident.identification.verdict.gain import WORTH, judged_log, points
from dynident.identification.verdict.steps import (
    CheckRipple,
    ExcitingMotion,
    SetRight,
    Sharpen,
    SlowReversals,
    Step,
)
from dynident.identification.verdict.windows import window_steps
from dynident.log import subsample
from dynident.regression import UnexcitedParameters
from dynident.validation import SLOW, Cause, LogValidation, Reversals, Ripple

__all__ = ["next_steps"]

Array = NDArray[np.float64]
UNSURE = 0.3  # standard error over value from which a parameter wants better data
EFFECT = 1.0  # %, of the torque, that the standard error must be worth for that
MOST = 5  # next steps on single parameters
SAMPLES = 500  # of the training, and of the log that is judged
RANK = 1e-6  # share of the largest singular value below which the training says nothing


def next_steps(found: Identification) -> tuple[UnexcitedParameters | Step, ...]:
    """Return what to record or change next, beyond the remedies of the reasons.

    Steps are ordered by their gain; those whose gain is not known come last, parameters that are not excited first of
    them.
    """
    steps = (*_set_right(found), *window_steps(found), *_unsure(found), *_of_residuals(found))
    known = sorted((one for one in steps if one.gain is not None), key=lambda one: -(one.gain or 0.0))
    return (*known, *found.base.unexcited, *(one for one in steps if one.gain is None))


def _set_right(found: Identification) -> Iterator[SetRight]:
    """Yield the findings of the checks that say what they cost in training, where it is worth something, or that are
    advice."""
    log = judged_log(found)
    for one in found.findings:
        gain = points(log, dict(one.removed))
        worth = gain is not None and gain > WORTH * log.errors.relative_error
        if worth or (isinstance(one.message, Note) and one.message.advises):
            yield SetRight(one, gain=gain)


def _of_residuals(found: Identification) -> Iterator[Step]:
    """Yield what the tests of the residuals point to."""
    held = [log for log in found.validations if log.role == "validation"] or list(found.validations)
    causes = {joint: test.causes for log in held for joint, test in log.residuals.items()}
    log = judged_log(found)
    tests = {joint: (test, log.errors.rmse[joint] ** 2) for joint, test in log.residuals.items()}
    if joints := _joints_with(causes, Reversals):
        more = {j: size * max(test.reversal_share - test.slow_share, 0.0) for j, (test, size) in tests.items()}
        speeds = SLOW * np.sqrt(np.mean(log.motion.dq[log.motion.mask] ** 2, axis=0))
        told = tuple(float(speeds[log.motion.joints.index(joint)]) for joint in joints)
        chosen = found.calibration.terms is not None and bool(found.calibration.terms.trials)
        yield SlowReversals(joints, told, chosen, gain=_of(log, more, joints))
    if joints := _joints_with(causes, Ripple):
        more = {joint: size * max(test.peak_share, 0.0) for joint, (test, size) in tests.items()}
        yield CheckRipple(joints, gain=_of(log, more, joints))


def _of(log: LogValidation, removed: Mapping[str, float], joints: Sequence[str]) -> float | None:
    return points(log, {joint: removed.get(joint, 0.0) for joint in joints})


def _joints_with(causes: Mapping[str, tuple[Cause, ...]], kind: type[Cause]) -> tuple[str, ...]:
    return tuple(joint for joint, given in causes.items() if any(isinstance(one, kind) for one in given))


def _unsure(found: Identification) -> Iterator[Sharpen]:
    """Yield the motions that would improve the least accurate parameters, of those that matter to the torque."""
    basis = found.base.on_data
    if basis is None:
        value, names, std = found.estimate.value, found.estimate.names, found.errors.std_hac
        leads: tuple[int, ...] = tuple(range(len(value)))
    else:
        value, names, leads = basis.to_base(found.estimate.value), basis.groupings, basis.independent
        std = found.errors.best_base
    if std is None:
        return
    columns, torque = _training(found)
    share = 100.0 * std * np.linalg.norm(columns, axis=(0, 1))[list(leads)] / (np.linalg.norm(torque) or 1.0)
    unsure = np.flatnonzero((std > UNSURE * np.abs(value)) & (share > EFFECT) & np.isfinite(std))
    chosen = sorted(map(int, unsure), key=lambda k: -share[k])[:MOST]
    gains = _known_exactly(found, columns, list(leads), chosen, std)
    for k, gain in zip(chosen, gains, strict=True):
        how, joint = _motion_for(found, leads[k])
        needed = min(std[k] / (UNSURE * np.abs(value[k]) or np.inf), share[k] / EFFECT)
        faster = float(np.sqrt(needed)) if how is ExcitingMotion.ACCELERATE else None
        figures = float(value[k]), float(std[k]), float(share[k])
        yield Sharpen(names[k], *figures, how, joint, faster, gain=gain)


def _training(found: Identification) -> tuple[Array, Array]:
    """Return regressor (M, n, p) and torque (M, n) of some samples of the training."""
    motions = [log.motion for log in found.validations if log.role == "train"]
    columns, torque = [], []
    for motion in motions:
        (rows,) = subsample([motion], SAMPLES)
        columns.append(found.model.regressor(**motion.states(rows)))
        torque.append(motion.tau[rows])
    return np.concatenate(columns), np.concatenate(torque)


def _known_exactly(
    found: Identification, columns: Array, leads: list[int], chosen: Sequence[int], std: Array
) -> list[float | None]:
    """Return the points that knowing each of the parameters exactly gains on the log that is judged.

    The others would change with it: with the covariance C of all, the torque Y C e_k / sqrt(C_kk) is then known, whose
    size is that by the standard error. C is taken from the regressor of the training, up to its scale.
    """
    log = judged_log(found)
    (rows,) = subsample([log.motion], SAMPLES)
    motion = log.motion
    weight = found.estimate.residual.sigma
    weight = 1.0 / np.where(weight > 0, weight, 1.0)
    X = (columns[:, :, leads] * weight[:, None]).reshape(-1, len(leads))
    size = np.linalg.norm(X, axis=0)
    size = np.where(size > 0, size, 1.0)
    C = np.linalg.pinv((X / size).T @ (X / size), rcond=RANK, hermitian=True)
    Y = found.model.regressor(**motion.states(rows))[:, :, leads] / size
    gains = []
    for k in chosen:
        torque = Y @ C[:, k] / (C[k, k] or np.inf) * size[k] * std[k]
        removed = np.mean(torque**2, axis=0)
        gains.append(points(log, dict(zip(motion.joints, map(float, removed), strict=True))))
    return gains


def _motion_for(found: Identification, column: int) -> tuple[ExcitingMotion, str | None]:
    """Return the motion that excites a parameter, which acts on the torque by position, velocity or acceleration."""
    model, n = found.model, len(found.model.joints)
    rng = np.random.default_rng(0)
    q, dq, ddq = rng.uniform(-1.0, 1.0, (3, 20, n))
    still, memory = np.zeros_like(q), rng.uniform(-1.0, 1.0, (20, model.memory))
    whole, standing, starting = (
        np.abs(model.regressor(q, *rates)[:, :, column])
        for rates in ((dq, ddq, memory), (still, still, 0 * memory), (still, ddq, 0 * memory))
    )
    least = 1e-9 * whole.max()  # a share, so that the unit does not count
    acting = [joint.name for joint, size in zip(model.joints, whole.max(axis=0), strict=True) if size > least]
    joint = acting[-1] if acting else None
    role = model.parameters[column].role
    if role in ("viscous", "coulomb"):
        return ExcitingMotion.CONSTANT_SPEEDS, joint
    if standing.max() > least:
        return ExcitingMotion.MANY_POSES, joint
    if starting.max() > least:
        return ExcitingMotion.ACCELERATE, joint
    return ExcitingMotion.CONSTANT_SPEEDS, joint
