"""Outliers among the torques of the training: suspects that a fit to the rest of the data shows to be wrong."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dynident.errors import Note, brief
from dynident.estimators.least_squares import solve
from dynident.log import Log, Motion, thinned
from dynident.models import Model
from dynident.regression import BLOCK, Regression
from dynident.smoothers.outliers import FEW, MANY, Suspects, few, suspects
from dynident.splines import bridged, median_sigma
from dynident.validation import LogValidation, relative_error

__all__ = ["HeldOutOutliers", "TorqueOutliers", "held_out_outliers", "runs", "torque_outliers", "without"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

ENTRIES = 400_000  # samples of all motions together times parameters: enough for a fit that only finds outliers
UNEXPLAINED = 0.5  # share of a spike that the model must leave
FAR = 4.0  # usual residuals by which a frozen torque is wrong, rms over the stretch
LEAST = 0.01  # of a torque's rms, the least usual residual
OUTWARD = 2.0  # usual residuals by which the model exceeds a clipped torque, on average


@dataclass(frozen=True)
class HeldOutOutliers(Note):
    """``count`` torques of ``joints`` in a held-out ``log`` are wrong; its error (%) as measured and without them."""

    log: str
    joints: tuple[str, ...]
    count: int
    error: float
    without: float


@dataclass(frozen=True, eq=False)
class TorqueOutliers:
    """Which torques (N, n) of a motion are wrong: ``spikes``, ``frozen`` and ``clipped``, among the ``suspect`` ones;
    the ``torque`` (N, n) of the model."""

    suspect: Mask
    spikes: Mask
    frozen: Mask
    clipped: Mask
    torque: Array

    __repr__ = brief

    @property
    def wrong(self) -> Mask:
        """All of them (N, n)."""
        return np.asarray(self.spikes | self.frozen | self.clipped)

    @property
    def masked(self) -> Mask:
        """The torques (N, n) that a fit leaves out: of joints in which they are few enough to be outliers."""
        return few(self.spikes, FEW) | few(np.asarray(self.frozen | self.clipped), MANY)


def torque_outliers(
    model: Model,
    motions: Sequence[Motion],
    logs: Sequence[Log],
    min_speed: tuple[float, ...] | None = None,
    trained: int | None = None,
) -> tuple[TorqueOutliers | None, ...]:
    """Return for each motion which torques of its log are wrong; None where none is suspect.

    Least squares on all other torques predicts the suspects. A spike is wrong where the prediction leaves most of it,
    a frozen stretch where it is off by four times the usual residual, clipped torques where the prediction is beyond
    them. ``min_speed`` (n) is that of the fit, to the first ``trained`` motions (None: to all).
    Raises the errors of ``Regression``.
    """
    seen = [suspects(log) for log in logs]
    if not any(one.torques.any() for one in seen):
        return (None,) * len(seen)
    whole = [replace(motion, tau=log.tau) for motion, log in zip(motions, logs, strict=True)]
    rest = [_rest(motion, one) for motion, one in zip(whole, seen, strict=True)]
    kept = [_kept(used)[used.mask] for used in rest[:trained]]
    if sum(int(one.sum()) for one in kept) <= len(model.parameters):  # too few are left that could tell
        none = [np.zeros(one.torques.shape, dtype=bool) for one in seen]
        return tuple(
            TorqueOutliers(one.torques, no, no, no, log.tau) for one, no, log in zip(seen, none, logs, strict=True)
        )
    theta = _fitted(model, rest[:trained], min_speed)
    torques = [_torque(model, motion, theta) for motion in whole]
    pairs = list(zip(whole, rest, torques, strict=True))
    left = [(motion.tau - torque)[used.mask] for motion, used, torque in pairs[:trained]]
    usual = np.array([
        _usual(np.concatenate([e[use[:, j], j] for e, use in zip(left, kept, strict=True)]))
        for j in range(len(model.joints))
    ])  # fmt: skip
    return tuple(
        _judged(motion, one, torque, usual) if one.torques.any() else None
        for motion, one, torque in zip(whole, seen, torques, strict=True)
    )


def held_out_outliers(judged: Sequence[LogValidation]) -> Iterator[HeldOutOutliers]:
    """Yield of each held-out log whose torques are wrong what they are of its error, by the predicted torque."""
    for one in judged:
        seen = None if one.recorded is None else suspects(one.recorded)
        if one.role != "validation" or seen is None or not seen.torques.any():
            continue
        usual = median_sigma((one.motion.tau - one.predicted)[one.motion.mask])
        found = _judged(one.motion, seen, one.predicted, usual)
        wrong: Mask = found.wrong & one.motion.mask[:, None]
        if wrong.any():
            right = one.motion.mask[:, None] & ~wrong
            error = relative_error(one.motion.tau[right], one.predicted[right])
            joints = tuple(one.motion.joints[j] for j in np.flatnonzero(wrong.any(axis=0)))
            yield HeldOutOutliers(one.name, joints, int(wrong.sum()), one.errors.relative_error, error)


def without(motion: Motion, found: TorqueOutliers | None, log: Log) -> Motion:
    """Return the motion of a log whose wrong torques are not fitted, and are those of the model where a filter spreads
    them.

    Suspects that are right are kept.
    """
    if found is None:
        return motion
    wrong = found.masked
    tau = np.where(wrong, found.torque, log.tau)
    return replace(motion, tau=tau, keep=(_kept(motion) | found.suspect) & ~wrong)


def _kept(motion: Motion) -> Mask:
    return np.ones(motion.q.shape, dtype=bool) if motion.keep is None else motion.keep


def _rest(motion: Motion, seen: Suspects) -> Motion:
    return replace(motion, keep=_kept(motion) & ~seen.torques)


def _fitted(model: Model, motions: Sequence[Motion], min_speed: tuple[float, ...] | None) -> Array:
    few_samples = thinned(motions, ENTRIES // max(len(model.parameters), 10))
    return solve(Regression(model, few_samples, min_speed=min_speed).triangular_factors.stacked()).value


def _torque(model: Model, motion: Motion, theta: Array) -> Array:
    parts = [slice(start, start + BLOCK) for start in range(0, len(motion), BLOCK)]
    return np.concatenate([model.torque(**motion.states(s), theta=theta) for s in parts])


def _usual(left: Array) -> float:
    """Return the usual residual; infinite where every torque is suspect, so that nothing shows which are wrong."""
    return float(median_sigma(left)) if len(left) else np.inf


def _judged(motion: Motion, seen: Suspects, torque: Array, usual: Array) -> TorqueOutliers:
    """Return the suspects that are wrong."""
    left = motion.tau - torque
    usual = np.maximum(usual, LEAST * np.sqrt(np.mean(motion.tau**2, axis=0)))
    wrong = [np.zeros(left.shape, dtype=bool) for _ in range(3)]
    for j in range(left.shape[1]):
        spike = seen.torque_spikes[:, j]
        if spike.any():
            high, explained = (x - bridged(motion.t, x, spike) for x in (motion.tau[:, j], torque[:, j]))
            wrong[0][:, j] = spike & (np.abs(high - explained) > UNEXPLAINED * np.abs(high))
        for start, stop in runs(seen.torque_frozen[:, j], motion.tau[:, j]):
            if np.sqrt(np.mean(left[start:stop, j] ** 2)) > FAR * usual[j]:
                wrong[1][start:stop, j] = True
        clipped = seen.torque_clipped[:, j]
        for extreme in np.unique(motion.tau[clipped, j]):
            at = clipped & (motion.tau[:, j] == extreme)
            if -np.sign(extreme) * np.mean(left[at, j]) > OUTWARD * usual[j]:
                wrong[2][at, j] = True
    return TorqueOutliers(seen.torques, wrong[0], wrong[1], wrong[2], torque)


def runs(found: Mask, x: Array) -> list[tuple[int, int]]:
    """Return start and stop of each run of what was found (N) with one value of x (N)."""
    goes_on = found[1:] & found[:-1] & (x[1:] == x[:-1])
    start, stop = found.copy(), found.copy()
    start[1:] &= ~goes_on
    stop[:-1] &= ~goes_on
    return list(zip(np.flatnonzero(start).tolist(), (np.flatnonzero(stop) + 1).tolist(), strict=True))
