"""Wrong torques of recordings: found by the torque that a fit to all others predicts, and left out of the fit."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dynident.estimators.least_squares import solve_least_squares
from dynident.models import Model
from dynident.motion.log import Log, Motion, thin_motions
from dynident.motion.smoothers.smoother import MAX_SPIKE_SHARE, MAX_WRONG_TORQUE_SHARE, Suspects, select_rare, suspects
from dynident.motion.splines import LONGEST_SPIKE, bridge_gaps, median_sigma
from dynident.regression import BLOCK, EVERYTHING, Regression, Selection
from dynident.runtime import Note, Noun, Use, count, percent
from dynident.runtime.arrays import Array
from dynident.validation import LogValidation, relative_error

Mask = NDArray[np.bool_]

MAX_ENTRIES = 400_000  # samples of all motions together times parameters: enough for a fit that only finds outliers
MIN_UNEXPLAINED_SHARE = 0.5  # share of a spike that the model must leave
MAX_JUMP_RATIO = 1.5  # of the friction that a reversal turns, up to which a step at an end is one
MIN_FROZEN_ERROR = 4.0  # usual residuals by which a frozen torque is wrong, rms over the stretch
# factor by which the equations of a joint that turns freely may raise the residual of any other
MAX_RESIDUAL_GROWTH = 1.02
MAX_CANCELLED_SHARE = 0.1  # of the parts of its torque, the most that may be left
MIN_RESIDUAL_SHARE = 0.01  # of a torque's rms, the least usual residual
MAX_ERROR_SHARE = 0.5  # of an error, that is left without outliers which are its cause
MIN_CLIPPED_EXCESS = 2.0  # usual residuals by which the model exceeds a clipped torque, on average


class HeldOutOutliers(Note):
    """Wrong torques in a held-out ``log``: ``count``, ``joints``, and the ``error`` (%) with and ``without`` them."""

    log: str
    joints: tuple[str, ...]
    count: int
    error: float
    without: float

    @property
    def forbidden(self) -> Use | None:
        """Simulation where they make most of the error, whose cause they then are."""
        return Use.SIMULATION if self.without < MAX_ERROR_SHARE * self.error else None

    def __str__(self) -> str:
        outliers = "is an outlier" if self.count == 1 else "are outliers"
        return (
            f"{self.log}: {count(self.count, 'torque')} of {', '.join(self.joints)} {outliers}, with which the error "
            f"on this held-out log is {percent(self.error)}, and {percent(self.without)} without"
        )


class TorqueOutliers(Noun):
    """Which torques (N, n) of a motion are wrong: ``spikes``, ``frozen`` and ``clipped``, among the ``suspect`` ones,
    and those of joints whose torque was never recorded (``dead``); the ``torque`` (N, n) of the model."""

    suspect: Mask
    spikes: Mask
    frozen: Mask
    clipped: Mask
    dead: Mask
    torque: Array

    @property
    def wrong(self) -> Mask:
        """All wrong torques (N, n), except of joints that were never recorded."""
        return np.asarray(self.spikes | self.frozen | self.clipped)

    @property
    def excluded_torques(self) -> Mask:
        """The torques (N, n) left out of a fit: those of joints in which they are few enough to be outliers."""
        return (
            select_rare(self.spikes, MAX_SPIKE_SHARE)
            | select_rare(np.asarray(self.frozen | self.clipped), MAX_WRONG_TORQUE_SHARE)
            | self.dead
        )


def torque_outliers(
    model: Model,
    motions: Sequence[Motion],
    logs: Sequence[Log],
    selection: Selection = EVERYTHING,
    trained: int | None = None,
) -> tuple[TorqueOutliers | None, ...]:
    """Return for each motion which torques of its log are wrong; None where none is suspect.

    Least squares on all other torques predicts the suspects. A spike is wrong where the prediction leaves most of
    it, a frozen stretch where it is off by four times the typical residual, clipped torques where the prediction
    is beyond them. A torque that never changes was not recorded, unless the joint turns freely: see
    ``_free_joints``. ``min_speed`` (n) is that of the fit, to the first ``trained`` motions (None: to all).
    Raises the errors of ``Regression``.
    """
    suspect_masks = [suspects(log) for log in logs]
    if not any(flags.torques.any() for flags in suspect_masks):
        return (None,) * len(suspect_masks)
    measured_motions = [replace(motion, tau=log.tau) for motion, log in zip(motions, logs, strict=True)]
    trusted_motions = [
        replace(motion, keep=_keep_mask(motion) & ~flags.torques)
        for motion, flags in zip(measured_motions, suspect_masks, strict=True)
    ]
    # Only trusted torques of the training are fitted, so that the suspects cannot hide themselves.
    trusted_masks = [_keep_mask(trusted)[trusted.mask] for trusted in trusted_motions[:trained]]
    if sum(int(flags.sum()) for flags in trusted_masks) <= len(model.parameters):  # too few are left that could tell
        empty_masks = [np.zeros(flags.torques.shape, dtype=bool) for flags in suspect_masks]
        return tuple(
            TorqueOutliers(flags.torques, empty, empty, empty, flags.torque_dead, log.tau)
            for flags, empty, log in zip(suspect_masks, empty_masks, logs, strict=True)
        )
    theta = _fit_parameters(model, trusted_motions[:trained], selection)
    torques = [_model_torque(model, motion, theta) for motion in measured_motions]
    pairs = list(zip(measured_motions, trusted_motions, torques, strict=True))
    residuals = [(motion.tau - torque)[trusted.mask] for motion, trusted, torque in pairs[:trained]]
    # A robust scale of the residual for each joint, over all logs of the training.
    typical_residual = np.array([
        _typical_residual(np.concatenate([e[use[:, j], j] for e, use in zip(residuals, trusted_masks, strict=True)]))
        for j in range(len(model.joints))
    ])  # fmt: skip
    # A joint without any trusted torque has no scale: it is wrong unless it turns freely.
    untested = np.isinf(typical_residual) & np.any(
        [flags.torque_dead.any(axis=0) for flags in suspect_masks[:trained]], axis=0
    )
    if untested.any():
        typical_residual[
            untested & ~_free_joints(model, measured_motions[:trained], trusted_motions[:trained], theta, selection)
        ] = 0.0
    return tuple(
        _confirm_suspects(motion, flags, torque, typical_residual) if flags.torques.any() else None
        for motion, flags, torque in zip(measured_motions, suspect_masks, torques, strict=True)
    )


def _free_joints(
    model: Model,
    motions: Sequence[Motion],
    trusted_motions: Sequence[Motion],
    theta: Array,
    selection: Selection,
) -> Mask:
    """Return which joints (n) have a constant torque in truth, as a passive joint has zero.

    With their equations the others are fitted as well as without (``theta``), and the parts of their torque are
    large but cancel.
    """
    few_motions, few_trusted = (
        thin_motions(part, MAX_ENTRIES // max(len(model.parameters), 10)) for part in (motions, trusted_motions)
    )
    theta_all = _fit_parameters(model, few_motions, selection)
    before, after = (
        np.concatenate([np.where(_keep_mask(x), x.tau - _model_torque(model, x, value), 0.0) for x in few_trusted])
        for value in (theta, theta_all)
    )
    # A constant torque that contradicts the model would make the fit of other joints worse.
    is_worse = bool((np.sum(after**2, axis=0) > MAX_RESIDUAL_GROWTH**2 * np.sum(before**2, axis=0)).any())
    parts = [model.regressor(**motion.states()) * theta_all for motion in few_motions]
    sizes = np.concatenate([np.linalg.norm(part, axis=2) for part in parts])
    # In a passive joint inertia and friction are large, and their sum is not.
    residual = np.concatenate([motion.tau for motion in few_motions]) - np.concatenate(
        [part.sum(axis=2) for part in parts]
    )
    return np.asarray(
        (np.sum(residual**2, axis=0) < MAX_CANCELLED_SHARE**2 * np.sum(sizes**2, axis=0)) & (not is_worse)
    )


def mask_outliers(
    model: Model,
    motions: Mapping[str, Mapping[str, Motion]],
    logs: Mapping[str, Mapping[str, Log]],
    selection: Selection,
) -> dict[str, dict[str, Motion]]:
    """Return the motions of logs by role and name, without the wrong torques of the training.

    Joints whose torque was never recorded are not kept in any log. Raises the errors of ``torque_outliers``.
    """
    keys = [(role, name) for role, by_name in motions.items() for name in by_name]
    pairs = [(motions[role][name], logs[role][name]) for role, name in keys]
    outliers = torque_outliers(
        model, [m for m, _ in pairs], [log for _, log in pairs], selection, len(motions["train"])
    )
    masked_motions: dict[str, dict[str, Motion]] = {role: {} for role in motions}
    for (role, name), (motion, log), motion_outliers in zip(keys, pairs, outliers, strict=True):
        masked_motions[role][name] = (
            without_outliers(motion, motion_outliers, log)
            if role == "train"
            else _keep_recorded_joints(motion, motion_outliers)
        )
    return masked_motions


def held_out_outliers(validations: Sequence[LogValidation]) -> Iterator[HeldOutOutliers]:
    """Yield the effect of wrong torques on the error of each held-out log, judged by the predicted torque."""
    for validation in validations:
        candidates = None if validation.recorded_log is None else suspects(validation.recorded_log)
        if validation.role != "validation" or candidates is None or not candidates.torques.any():
            continue
        typical_residual = median_sigma((validation.motion.tau - validation.predicted_torque)[validation.motion.mask])
        outliers = _confirm_suspects(validation.motion, candidates, validation.predicted_torque, typical_residual)
        wrong: Mask = outliers.wrong & validation.motion.mask[:, None]
        if wrong.any():
            trusted = validation.motion.mask[:, None] & ~wrong
            error = relative_error(validation.motion.tau[trusted], validation.predicted_torque[trusted])
            joints = tuple(validation.motion.joints[j] for j in np.flatnonzero(wrong.any(axis=0)))
            yield HeldOutOutliers(validation.name, joints, int(wrong.sum()), validation.errors.relative_error, error)


def without_outliers(motion: Motion, outliers: TorqueOutliers | None, log: Log) -> Motion:
    """Return the motion of a log without its wrong torques; suspects that are right are kept.

    Wrong torques are replaced by those of the model where a filter would spread them.
    """
    if outliers is None:
        return motion
    wrong = outliers.excluded_torques
    tau = np.where(wrong & ~outliers.dead, outliers.torque, log.tau)
    return replace(motion, tau=tau, keep=(_keep_mask(motion) | outliers.suspect) & ~wrong)


def _keep_recorded_joints(motion: Motion, outliers: TorqueOutliers | None) -> Motion:
    """Return a held-out motion that keeps nothing of the joints whose torque was never recorded."""
    dead = None if outliers is None else outliers.dead
    return motion if dead is None or not dead.any() else replace(motion, keep=_keep_mask(motion) & ~dead)


def _keep_mask(motion: Motion) -> Mask:
    return np.ones(motion.q.shape, dtype=bool) if motion.keep is None else motion.keep


def _fit_parameters(model: Model, motions: Sequence[Motion], selection: Selection) -> Array:
    few_samples = thin_motions(motions, MAX_ENTRIES // max(len(model.parameters), 10))
    return solve_least_squares(Regression(model, few_samples, selection.unfiltered).triangular_factors.stack()).value


def _model_torque(model: Model, motion: Motion, theta: Array) -> Array:
    parts = [slice(start, start + BLOCK) for start in range(0, len(motion), BLOCK)]
    return np.concatenate([model.torque(**motion.states(s), theta=theta) for s in parts])


def _typical_residual(residual: Array) -> float:
    """Return the typical residual; infinite where every torque is suspect, so that nothing can be tested."""
    return float(median_sigma(residual)) if len(residual) else np.inf


def _confirm_suspects(motion: Motion, candidates: Suspects, torque: Array, typical_residual: Array) -> TorqueOutliers:
    """Return the suspects that are wrong."""
    residual = motion.tau - torque
    untested = typical_residual == 0
    # A floor on the scale: a joint that the model fits to rounding would otherwise have outliers everywhere.
    typical_residual = np.maximum(typical_residual, MIN_RESIDUAL_SHARE * np.sqrt(np.mean(motion.tau**2, axis=0)))
    wrong = [np.zeros(residual.shape, dtype=bool) for _ in range(3)]
    for j in range(residual.shape[1]):
        spike = candidates.torque_spikes[:, j]
        if spike.any():
            # Spikes are measured from the torque bridged across them, so that a slow residual does not count.
            measured_spike, predicted_spike = (
                x - bridge_gaps(motion.t, x, spike) for x in (motion.tau[:, j], torque[:, j])
            )
            wrong[0][:, j] = spike & (
                np.abs(measured_spike - predicted_spike) > MIN_UNEXPLAINED_SHARE * np.abs(measured_spike)
            )
            # At an end nothing is seen beyond: a step of friction by a reversal there is no spike.
            jump = MAX_JUMP_RATIO * _friction_jump(motion, torque, j)
            wrong[0][:, j] &= ~(_reversal_samples(motion, j) & (np.abs(measured_spike) <= jump))
        for start, stop in equal_runs(candidates.torque_frozen[:, j], motion.tau[:, j]):
            if np.sqrt(np.mean(residual[start:stop, j] ** 2)) > MIN_FROZEN_ERROR * typical_residual[j]:
                wrong[1][start:stop, j] = True
        clipped = candidates.torque_clipped[:, j]
        # Torque saturates at one extreme value on each side; test both separately.
        for extreme in np.unique(motion.tau[clipped, j]):
            at = clipped & (motion.tau[:, j] == extreme)
            if -np.sign(extreme) * np.mean(residual[at, j]) > MIN_CLIPPED_EXCESS * typical_residual[j]:
                wrong[2][at, j] = True
    is_off = np.sqrt(np.mean(residual**2, axis=0)) > MIN_FROZEN_ERROR * typical_residual
    dead = np.asarray(candidates.torque_dead & (is_off | untested))
    return TorqueOutliers(candidates.torques, wrong[0], wrong[1], wrong[2], dead, torque)


def _reversal_samples(motion: Motion, j: int) -> Mask:
    """Return the samples (N) at the ends of a motion of which the joint reverses, or comes to rest, close by."""
    samples, near = np.zeros(len(motion), dtype=bool), 4 * LONGEST_SPIKE
    for end in (slice(0, near), slice(-near, None)):
        speed, acceleration = np.abs(motion.dq[end, j]).min(), np.abs(motion.ddq[:, j]).max()
        # it stops or starts within a few spikes; the smoothed velocity is the least certain at an end
        if speed <= acceleration * (motion.t[end][-1] - motion.t[end][0]):
            samples[end] = True
    return samples


def _friction_jump(motion: Motion, torque: Array, j: int) -> float:
    """Return the largest step of the model's torque (N, n) where the joint reverses; zero where it never does."""
    turns = np.flatnonzero(np.diff(np.signbit(motion.dq[:, j])))
    return float(np.abs(torque[turns + 1, j] - torque[turns, j]).max(initial=0.0))


def equal_runs(mask: Mask, x: Array) -> list[tuple[int, int]]:
    """Return start and stop of each run of the ``mask`` (N) with one value of x (N)."""
    # A run ends where the mask does, or where the value changes.
    goes_on = mask[1:] & mask[:-1] & (x[1:] == x[:-1])
    start, stop = mask.copy(), mask.copy()
    start[1:] &= ~goes_on
    stop[:-1] &= ~goes_on
    return list(zip(np.flatnonzero(start).tolist(), (np.flatnonzero(stop) + 1).tolist(), strict=True))
