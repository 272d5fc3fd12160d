"""Outliers among the torques of the training: suspects that a fit to the rest of the data shows to be wrong."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dynident.errors import Note, brief
from dynident.estimators.linear import solve
from dynident.log import Log, Motion, thinned
from dynident.models import Model
from dynident.regression import BLOCK, Regression
from dynident.smoothers.outliers import FEW, MANY, Suspects, few, suspects
from dynident.splines import bridged, median_sigma
from dynident.validation import LogValidation, relative_error

__all__ = ["HeldOutOutliers", "TorqueOutliers", "held_out_outliers", "masked", "runs", "torque_outliers", "without"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

ENTRIES = 400_000  # samples of all motions together times parameters: enough for a fit that only finds outliers
UNEXPLAINED = 0.5  # share of a spike that the model must leave
FAR = 4.0  # usual residuals by which a frozen torque is wrong, rms over the stretch
WORSE = 1.02  # factor by which the equations of a joint that turns freely may raise the residual of any other
CANCEL = 0.1  # of the parts of its torque, the most that may be left
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
    """Which torques (N, n) of a motion are wrong: ``spikes``, ``frozen`` and ``clipped``, among the ``suspect`` ones,
    and those of joints whose torque was never recorded (``dead``); the ``torque`` (N, n) of the model."""

    suspect: Mask
    spikes: Mask
    frozen: Mask
    clipped: Mask
    dead: Mask
    torque: Array

    __repr__ = brief

    @property
    def wrong(self) -> Mask:
        """All single ones (N, n): without joints that were never recorded."""
        return np.asarray(self.spikes | self.frozen | self.clipped)

    @property
    def masked(self) -> Mask:
        """The torques (N, n) that a fit leaves out: of joints in which they are few enough to be outliers."""
        return few(self.spikes, FEW) | few(np.asarray(self.frozen | self.clipped), MANY) | self.dead


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
    them. A torque that never changes was not recorded, unless the joint turns freely: see ``_turns_freely``.
    ``min_speed`` (n) is that of the fit, to the first ``trained`` motions (None: to all).
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
            TorqueOutliers(one.torques, no, no, no, one.torque_dead, log.tau)
            for one, no, log in zip(seen, none, logs, strict=True)
        )
    theta = _fitted(model, rest[:trained], min_speed)
    torques = [_torque(model, motion, theta) for motion in whole]
    pairs = list(zip(whole, rest, torques, strict=True))
    left = [(motion.tau - torque)[used.mask] for motion, used, torque in pairs[:trained]]
    usual = np.array([
        _usual(np.concatenate([e[use[:, j], j] for e, use in zip(left, kept, strict=True)]))
        for j in range(len(model.joints))
    ])  # fmt: skip
    unknown = np.isinf(usual) & np.any([one.torque_dead.any(axis=0) for one in seen[:trained]], axis=0)
    if unknown.any():
        usual[unknown & ~_turns_freely(model, whole[:trained], rest[:trained], theta, min_speed)] = 0.0
    return tuple(
        _judged(motion, one, torque, usual) if one.torques.any() else None
        for motion, one, torque in zip(whole, seen, torques, strict=True)
    )


def _turns_freely(
    model: Model,
    whole: Sequence[Motion],
    rest: Sequence[Motion],
    theta: Array,
    min_speed: tuple[float, ...] | None,
) -> Mask:
    """Return which joints (n) of a torque that never changes have this torque indeed, as a passive joint has zero.

    With their equations the others are fitted as well as without (``theta``), and the parts of their torque are large
    but cancel out.
    """
    few_whole, few_rest = (thinned(part, ENTRIES // max(len(model.parameters), 10)) for part in (whole, rest))
    both = _fitted(model, few_whole, min_speed)
    before, after = (
        np.concatenate([np.where(_kept(one), one.tau - _torque(model, one, value), 0.0) for one in few_rest])
        for value in (theta, both)
    )
    worse = bool((np.sum(after**2, axis=0) > WORSE**2 * np.sum(before**2, axis=0)).any())
    parts = [model.regressor(**one.states()) * both for one in few_whole]
    sizes = np.concatenate([np.linalg.norm(part, axis=2) for part in parts])
    left = np.concatenate([one.tau for one in few_whole]) - np.concatenate([part.sum(axis=2) for part in parts])
    return np.asarray((np.sum(left**2, axis=0) < CANCEL**2 * np.sum(sizes**2, axis=0)) & (not worse))


def masked(
    model: Model,
    motions: Mapping[str, Mapping[str, Motion]],
    logs: Mapping[str, Mapping[str, Log]],
    min_speed: tuple[float, ...] | None,
) -> dict[str, dict[str, Motion]]:
    """Return the motions of logs by role and name: what is wrong of the torques of the training is not fitted.

    Joints whose torque was never recorded are not kept in any log. Raises the errors of ``torque_outliers``.
    """
    every = [(role, name) for role, named in motions.items() for name in named]
    pairs = [(motions[role][name], logs[role][name]) for role, name in every]
    found = torque_outliers(model, [m for m, _ in pairs], [log for _, log in pairs], min_speed, len(motions["train"]))
    kept: dict[str, dict[str, Motion]] = {role: {} for role in motions}
    for (role, name), (motion, log), one in zip(every, pairs, found, strict=True):
        kept[role][name] = without(motion, one, log) if role == "train" else _recorded(motion, one)
    return kept


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
    tau = np.where(wrong & ~found.dead, found.torque, log.tau)
    return replace(motion, tau=tau, keep=(_kept(motion) | found.suspect) & ~wrong)


def _recorded(motion: Motion, found: TorqueOutliers | None) -> Motion:
    """Return a held-out motion that keeps nothing of the joints whose torque was never recorded."""
    dead = None if found is None else found.dead
    return motion if dead is None or not dead.any() else replace(motion, keep=_kept(motion) & ~dead)


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
    never = usual == 0
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
    off = np.sqrt(np.mean(left**2, axis=0)) > FAR * usual
    dead = np.asarray(seen.torque_dead & (off | never))
    return TorqueOutliers(seen.torques, wrong[0], wrong[1], wrong[2], dead, torque)


def runs(found: Mask, x: Array) -> list[tuple[int, int]]:
    """Return start and stop of each run of what was found (N) with one value of x (N)."""
    goes_on = found[1:] & found[:-1] & (x[1:] == x[:-1])
    start, stop = found.copy(), found.copy()
    start[1:] &= ~goes_on
    stop[:-1] &= ~goes_on
    return list(zip(np.flatnonzero(start).tolist(), (np.flatnonzero(stop) + 1).tolist(), strict=True))
