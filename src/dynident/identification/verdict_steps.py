"""Which seconds to leave out of the training, and which speeds it lacks."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dynident.identification.result import Identification
from dynident.motion.log import stack_states, subsample
from dynident.regression import fitted_mask
from dynident.runtime import Finding, brief, number, rough
from dynident.validation import LogValidation


class Remedy(StrEnum):
    """What to do about a reason against a use."""

    CORRECT = "Correct what was found, as the reasons say, and identify again."
    HOLD_OUT = (
        "Record another motion and name it under `validation`; windows of one recording are enough for a first check."
    )
    ANOTHER_MOTION = (
        "Record a held-out motion with other paths and speeds; a repeated motion only shows the robot's repeatability."
    )
    CHECK = (
        "Run `dynident check` on the configuration: it checks signs, gains, units and gravity. Then look at the "
        "largest residuals in the report; other friction terms or less noise in the motion may help."
    )
    TORQUE_COLUMN = "Check that the right torque column is named, and was recorded."
    LONGER_TRAINING = "Record a longer training motion that covers the speeds and accelerations of the held-out one."
    EXCITE = "Record a training motion in which every joint moves: at several speeds, and in many poses of the others."
    CONSISTENT_FIT = (
        "Fit with `estimator: {kind: consistent}`: bodies and friction are then physically consistent, and the "
        "mass matrix is positive definite."
    )
    SIMULATE = (
        "Add `simulation:` to the configuration, with the controller where it is known, else `kind: measured_torque`."
    )
    CONTROLLER_LOOP = (
        "Simulate in closed loop with the controller, where it is known: driven by torque alone, any model drifts."
    )


class ExcitingMotion(StrEnum):
    """How a joint should move to excite a parameter, which acts through velocity, position or acceleration."""

    CONSTANT_SPEEDS = "move {joint} at several constant speeds in both directions"
    MANY_POSES = "move {joint} slowly to and fro in many poses"
    ACCELERATE = "accelerate {joint} harder, in several poses of the others"


@dataclass(frozen=True)
class NextStep:
    """Base of the next steps that follow from the data, besides remedies and unexcited base parameters.

    ``gain``: by how many points (%) the unfiltered error of the held-out log where it is largest (without one, of the
    training log) may fall, None where the data do not tell.
    """

    gain: float | None = field(default=None, kw_only=True)

    def gain_text(self, how: str = "about") -> str:
        """Return what the step may gain as a sentence, an empty text where that is unknown."""
        if self.gain is None:
            return ""
        size = f"{how} {self.gain:.2g}" if self.gain >= MIN_REPORTED_GAIN else f"less than {MIN_REPORTED_GAIN:g}"
        return f" May gain {size} points of the torque error."


@dataclass(frozen=True)
class Sharpen(NextStep):
    """Record a motion that excites a ``parameter`` better.

    Its ``value`` has the standard error ``std`` (both in SI units), which is ``share`` % of the torque.
    ``joint`` is the one to move, None for all of them. At ``faster`` times the speed of the training the parameter
    would be known well, None where speed does not show it better. The gain is that of knowing it exactly.
    """

    parameter: str
    value: float
    std: float
    share: float
    excitation: ExcitingMotion
    joint: str | None
    faster: float | None = None

    def __str__(self) -> str:
        motion = self.excitation.format(joint=self.joint or "the joints")
        speed = f", up to {self.faster:.2g} times the speed" if self.faster is not None and self.faster > 1.05 else ""
        return (
            f"{self.parameter} is {self.value:.3g} +- {self.std:.2g} (one standard error, {rough(self.share)} of the "
            f"torque): {motion}{speed}.{self.gain_text('at most')}"
        )


@dataclass(frozen=True)
class SlowReversals(NextStep):
    """Record slow motion of the ``joints`` through zero speed, or smooth their Coulomb friction.

    Below these ``speeds`` (rad/s, m/s) the residual is larger than elsewhere. ``terms_chosen`` tells that
    friction and minimum speed are the best of those that were tried. The gain is that of a residual no larger
    there.
    """

    joints: tuple[str, ...]
    speeds: tuple[float, ...] = ()
    terms_chosen: bool = False

    def __str__(self) -> str:
        below = f" (below {', '.join(f'{speed:.2g}' for speed in self.speeds)} rad/s or m/s)" if self.speeds else ""
        alternative = "" if self.terms_chosen else ", or try `coulomb_width` or `min_speed`"
        advice = f"{', '.join(self.joints)}: record slow motion through zero speed{alternative}"
        return f"{advice}{below}." + self.gain_text("at most")


@dataclass(frozen=True)
class CheckRipple(NextStep):
    """Record constant speeds of the ``joints`` to see whether the ripple follows the position.

    The gain is that of a model of the whole ripple.
    """

    joints: tuple[str, ...]

    def __str__(self) -> str:
        advice = f"{', '.join(self.joints)}: record constant speeds to see whether the ripple follows the position."
        return advice + self.gain_text("at most")


@dataclass(frozen=True)
class SetRight(NextStep):
    """Correct what a ``finding`` of the checks says of the robot or its model; the gain is that in training."""

    finding: Finding

    def __str__(self) -> str:
        finding = self.finding
        where = ": ".join(filter(None, (finding.source, finding.joint)))
        return f"{where}: {finding.message.remedy}".removeprefix(": ") + self.gain_text()


@dataclass(frozen=True)
class HoldOutFaster(NextStep):
    """Record a held-out motion ``times`` as fast as the fastest one, as fast as the training, for a better verdict."""

    times: float

    def __str__(self) -> str:
        return (
            f"Record a held-out motion {self.times:.2g} times as fast, on other paths: little is seen of the inertias "
            "in a slow one."
        )


@dataclass(frozen=True)
class LeaveOut(NextStep):
    """Leave the seconds from ``start`` to ``stop`` out of a training ``log``.

    Predicted from all others, they have a mean squared residual ``ratio`` times that of the others. The gain is
    cross-validated on these.
    """

    log: str
    start: float
    stop: float
    ratio: float

    def __str__(self) -> str:
        return (
            f"{self.log}: leave {_stretch(self)} out of the training (`window`): predicted from the rest, their "
            f"squared residual is {self.ratio:.2g} times that of the rest. Did the robot touch something "
            f"there?{self.gain_text()}"
        )


@dataclass(frozen=True)
class Cover(NextStep):
    """Record training motion in which a ``joint`` is ``faster`` times as fast as now, up to ``speed`` (rad/s, m/s).

    Held-out motion is beyond the speeds and accelerations of the training, above all from ``start`` to ``stop`` (s) of
    a ``log``. The gain is that of an error there as it is on the rest of that log.
    """

    log: str
    start: float
    stop: float
    joint: str
    faster: float
    speed: float

    def __str__(self) -> str:
        return (
            f"{self.joint}: record a training motion {self.faster:.2g} times as fast, up to {self.speed:.2g} rad/s or "
            f"m/s: {self.log} is beyond what was trained, above all at {_stretch(self)}.{self.gain_text()}"
        )


def _stretch(step: LeaveOut | Cover) -> str:
    return f"{number(step.start, 3)} to {number(step.stop, 3)} s"


MIN_REPORTED_GAIN = 0.01  # points: smaller gains are not given
MIN_GAIN_SHARE = 0.01  # share of the error that a step must gain


def judged_log(identification: Identification) -> LogValidation:
    """Return the held-out log with the largest unfiltered error; the training log, where none was held out."""
    held_out = [log for log in identification.validations if log.role == "validation"]
    return max(
        held_out or identification.validations, key=lambda log: np.nan_to_num(log.errors.relative_error, nan=-1.0)
    )


def gain_points(log: LogValidation, removed: Mapping[str, float]) -> float | None:
    """Return by how many points the error of a log may fall.

    The mean squared residuals of the joints fall by ``removed`` ((N m)^2, N^2), to no less than the noise of the
    sensors. None where this is nothing, or no number.
    """
    errors = log.errors
    squares = {joint: size**2 for joint, size in errors.rmse.items()}
    noise_floor = {joint: errors.sensor_noise.get(joint, 0.0) ** 2 for joint in squares}
    reduction = sum(
        min(max(removed.get(joint, 0.0), 0.0), max(size - noise_floor[joint], 0.0)) for joint, size in squares.items()
    )
    total = sum(squares.values())
    if not (total > 0 and reduction > 0 and np.isfinite(errors.relative_error)):
        return None
    return float(errors.relative_error * (1.0 - np.sqrt(1.0 - reduction / total)))


Array = NDArray[np.float64]
MAX_SAMPLES = 4000  # of all training motions, up to twice as many
N_PARTS = 20  # of all training motions, about
RANK_TOLERANCE = 1e-5  # share of the largest singular value below which the data say nothing
MIN_DIRECTION_SHARE = 1e-3  # share of a direction that must be left where samples are left out


@dataclass(frozen=True, eq=False)
class TrainingParts:
    """Thinned samples of the training: of each its ``log`` (M), time ``t`` (M), and ``part`` (M), by number.

    Rows ``Z`` (M, n, r) and torque ``y`` (M, n) are times the ``weight`` (n) of each joint, zero where the fit leaves
    an equation out; in the coordinates of Z the sum of all Z'Z is one.
    """

    names: tuple[str, ...]
    log: NDArray[np.intp]
    part: NDArray[np.intp]
    t: Array
    Z: Array
    y: Array
    weight: Array

    __repr__ = brief

    @cached_property
    def residual(self) -> Array:
        """The residual (M, n) of the weighted torque of each part, predicted from the others."""
        return self.residual_without(np.zeros(self.y.shape, dtype=bool))

    def residual_without(self, out: NDArray[np.bool_]) -> Array:
        """Return this residual without the equations ``out`` (M, n); nan where the rest determines too little."""
        residual = np.full(self.y.shape, np.nan)
        # Equations left out are subtracted from all normal equations; those of the part itself only once.
        omitted_sums = [self._sums(out & (self.part == k)[:, None]) for k in range(self.count)]
        A, b = (total - sum(sums[i] for sums in omitted_sums) for i, total in enumerate(self._total_sums))
        for k, (part_sums, part_omitted) in enumerate(zip(self._part_sums, omitted_sums, strict=True)):
            try:
                L = np.linalg.cholesky(A - part_sums[0] + part_omitted[0])
            except np.linalg.LinAlgError:
                continue
            # In these coordinates all data have information one: a small pivot is a direction the others do not show.
            if (np.diag(L) ** 2 > MIN_DIRECTION_SHARE).all():
                in_part = self.part == k
                residual[in_part] = self.y[in_part] - self.Z[in_part] @ np.linalg.solve(
                    L.T, np.linalg.solve(L, b - part_sums[1] + part_omitted[1])
                )
        return residual

    @property
    def count(self) -> int:
        """Number of parts."""
        return int(self.part.max(initial=-1)) + 1

    def squares(self, residual: Array, rows: NDArray[np.bool_] | None = None) -> Array:
        """Return the sums of squares (K, n) of the ``residual`` (M, n) over each part, of the ``rows`` (M) alone."""
        squared = np.square(residual) if rows is None else np.where(rows[:, None], np.square(residual), 0.0)
        return np.array([squared[self.part == k].sum(axis=0) for k in range(self.count)])

    @cached_property
    def _part_sums(self) -> list[tuple[Array, Array]]:
        return [self._sums(np.repeat((self.part == k)[:, None], self.y.shape[1], axis=1)) for k in range(self.count)]

    @cached_property
    def _total_sums(self) -> tuple[Array, Array]:
        return np.sum([sums[0] for sums in self._part_sums], axis=0), np.sum(
            [sums[1] for sums in self._part_sums], axis=0
        )

    def _sums(self, mask: NDArray[np.bool_]) -> tuple[Array, Array]:
        Z, y = self.Z[mask], self.y[mask]
        return Z.T @ Z, Z.T @ y


def parts_of(identification: Identification) -> TrainingParts:
    """Return the parts of the training of an identification, each joint weighted by its residual."""
    motions = [log.motion for log in identification.validations if log.role == "train"]
    rows = subsample(motions, MAX_SAMPLES)
    selection = identification.recipe.selection(identification.model.joints)
    pairs = list(zip(motions, rows, strict=True))
    tau, t = (np.concatenate([getattr(motion, name)[indices] for motion, indices in pairs]) for name in ("tau", "t"))
    is_fitted = np.concatenate([fitted_mask(motion, selection.min_speed, indices) for motion, indices in pairs])
    Y = identification.model.regressor(**stack_states(motions, rows))
    size = np.sqrt(np.mean(np.where(is_fitted, tau - Y @ identification.estimate.value, 0.0) ** 2, axis=0))
    weight = 1.0 / np.where(size > 0, size, 1.0)
    X, y = Y * (weight * is_fitted)[:, :, None], tau * weight * is_fitted
    log = np.repeat(np.arange(len(motions)), list(map(len, rows)))
    names = tuple(validation.name for validation in identification.validations if validation.role == "train")
    return TrainingParts(names, log, _part_numbers(list(map(len, rows))), t, X @ _coordinates(X), y, weight)


def _part_numbers(lengths: Sequence[int]) -> NDArray[np.intp]:
    """Return the part number of each sample; no part has samples of two logs."""
    numbers, total = list[NDArray[np.intp]](), sum(lengths) or 1
    for length in lengths:
        count = max(1, round(N_PARTS * length / total))
        start = int(numbers[-1][-1]) + 1 if numbers else 0
        if length:
            numbers.append(start + np.arange(length) * count // length)
    return np.concatenate(numbers) if numbers else np.zeros(0, dtype=np.intp)


def _coordinates(X: Array) -> Array:
    """Return the map (p, r) of rows X (M, n, p) to coordinates in which the sum of their squares is the identity.

    Directions that the rows do not determine are left out.
    """
    scale = np.linalg.norm(X, axis=(0, 1))
    scale = np.where(scale > 0, scale, 1.0)
    _, singular, directions = np.linalg.svd(np.linalg.qr((X / scale).reshape(-1, X.shape[2]), mode="r"))
    is_determined = singular > RANK_TOLERANCE * singular.max(initial=0.0)
    return np.asarray(directions[: len(singular)][is_determined].T / singular[is_determined] / scale[:, None])


MIN_ODD_RATIO = 4.0  # times the median squared residual of the parts of the training: one is looked at from here on
MAX_ODD_SHARE = 0.3  # share of the parts that are odd, at most: more are no exception
MIN_SIGNIFICANCE = 2.0  # standard errors over the parts
MIN_EXCESS = 1.05  # times the largest speed or acceleration of the training
MIN_SAMPLES_BEYOND = 20  # samples beyond
MAX_GAP = 0.3  # s: stretches this near to each other are one


def window_steps(identification: Identification) -> Iterator[NextStep]:
    """Yield which speeds to add to the training, and which seconds to leave out of it."""
    log = judged_log(identification)
    if log.role == "validation" and (step := _coverage_step(identification, log)) is not None:
        yield step
    parts = parts_of(identification)
    if parts.count < 3 or not parts.Z.shape[2] or not np.isfinite(parts.residual).all():
        return
    yield from _odd_parts(parts, log, [joint.name for joint in identification.model.joints])


def _odd_parts(parts: TrainingParts, log: LogValidation, joints: list[str]) -> Iterator[LeaveOut]:
    """Yield the part of the training that the others contradict, with its odd neighbours, if leaving it out helps."""
    size = np.bincount(parts.part, minlength=parts.count)
    if not size.all():  # of so short a training that a part of it has no sample
        return
    squares = parts.squares(parts.residual).sum(axis=1) / size
    is_odd = squares > MIN_ODD_RATIO * np.median(squares)
    if not is_odd.any() or is_odd.mean() > MAX_ODD_SHARE:
        return
    worst = first_odd = last_odd = int(np.argmax(squares))
    log_of_part = np.array([parts.log[parts.part == k][0] for k in range(parts.count)])
    # Neighbouring odd parts of the same log are one event.
    while first_odd > 0 and is_odd[first_odd - 1] and log_of_part[first_odd - 1] == log_of_part[worst]:
        first_odd -= 1
    while last_odd + 1 < parts.count and is_odd[last_odd + 1] and log_of_part[last_odd + 1] == log_of_part[worst]:
        last_odd += 1
    out = (parts.part >= first_odd) & (parts.part <= last_odd)
    gain = _removal_gain(parts, np.repeat(out[:, None], len(joints), axis=1), ~out, log, joints)
    if gain is not None:
        t = parts.t[out]
        odd_mean = float(np.average(squares[first_odd : last_odd + 1], weights=size[first_odd : last_odd + 1]))
        other_mean = float(
            np.average(
                np.delete(squares, range(first_odd, last_odd + 1)),
                weights=np.delete(size, range(first_odd, last_odd + 1)),
            )
        )
        yield LeaveOut(parts.names[log_of_part[worst]], float(t[0]), float(t[-1]), odd_mean / other_mean, gain=gain)


def _removal_gain(
    parts: TrainingParts, out: NDArray[np.bool_], rows: NDArray[np.bool_], log: LogValidation, joints: list[str]
) -> float | None:
    """Return the gain in points, on the cross-validated residual of the rows (M), of leaving equations out.

    None where it is small or may be chance.
    """
    without = parts.residual_without(out)
    if not np.isfinite(without).all():
        return None
    before, after = parts.squares(parts.residual, rows), parts.squares(without, rows)
    change = (before - after).sum(axis=1)
    # Changes by part are nearly independent; their spread gives the error of the sum.
    has_rows = parts.squares(np.ones_like(parts.y), rows).sum(axis=1) > 0
    std = float(np.std(change[has_rows], ddof=1) * np.sqrt(has_rows.sum())) if has_rows.sum() > 1 else np.inf
    if not change.sum() > MIN_SIGNIFICANCE * std:
        return None
    mean = (before - after).sum(axis=0) / rows.sum() / parts.weight**2
    gain = gain_points(log, dict(zip(joints, map(float, mean), strict=True)))
    return gain if gain is not None and gain > MIN_GAIN_SHARE * log.errors.relative_error else None


def _coverage_step(identification: Identification, log: LogValidation) -> Cover | None:
    """Return the speeds of the held-out log beyond those of the training, if its error is larger there."""
    train = [validation.motion for validation in identification.validations if validation.role == "train"]
    motion = log.motion
    ratios = []
    for name in ("dq", "ddq"):
        largest = np.max(
            [np.abs(getattr(train_motion, name)[train_motion.mask]).max(axis=0) for train_motion in train], axis=0
        )
        ratios.append(np.abs(getattr(motion, name)) / np.where(largest > 0, largest, np.inf))
    # Accelerations grow with the square of the speed: both become a factor of speed.
    faster = np.maximum(ratios[0], np.sqrt(ratios[1]))
    beyond = (faster > MIN_EXCESS).any(axis=1) & motion.mask
    inside = motion.mask & ~beyond
    residual = np.where(motion.mask[:, None], motion.tau - log.predicted_torque, 0.0)
    if beyond.sum() < MIN_SAMPLES_BEYOND or inside.sum() < MIN_SAMPLES_BEYOND:
        return None
    error, other_error = (100.0 * np.linalg.norm(residual[rows]) / (np.linalg.norm(motion.tau[rows]) or np.inf)
                   for rows in (motion.mask, inside))  # fmt: skip
    if not error - other_error > MIN_GAIN_SHARE * error:
        return None
    squares = np.square(residual).sum(axis=1)
    # The joint that is beyond its training where most of the squared residual is.
    j = int(np.argmax(((faster > MIN_EXCESS) * squares[:, None])[beyond].sum(axis=0)))
    start, stop = _worst_stretch(motion.t, beyond, squares)
    factor = float(faster[beyond, j].max())
    speed = factor * max(float(np.abs(train_motion.dq[train_motion.mask, j]).max()) for train_motion in train)
    return Cover(log.name, start, stop, motion.joints[j], factor, speed, gain=float(error - other_error))


def _worst_stretch(t: Array, mask: NDArray[np.bool_], squares: Array) -> tuple[float, float]:
    """Return begin and end (s) of the stretch of chosen samples (N) with the largest sum of squares (N)."""
    rows = np.flatnonzero(mask)
    groups = np.split(rows, np.flatnonzero(np.diff(t[rows]) > MAX_GAP) + 1)
    worst = max(groups, key=lambda group: float(squares[group].sum()))
    return float(t[worst[0]]), float(t[worst[-1]])
