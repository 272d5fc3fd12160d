"""Torque errors of an estimate on a log, always also against the unfiltered measurement."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynident.errors import InputError
from dynident.log import Motion, subsample
from dynident.models import MassMatrixCheck, Model
from dynident.regression import BLOCK, ParallelFilter, fast_enough, stretches
from dynident.validation.residuals import ResidualTest, residual_test

__all__ = ["SEED", "LogValidation", "check_mass", "relative_error", "validate"]

Array = NDArray[np.float64]
Role = Literal["train", "validation"]
SEED = 0  # of the random poses, where the caller brings no generator


@dataclass(frozen=True, eq=False)
class LogValidation:
    """Errors of a model on one log, over its reliable samples (inside the mask of the motion).

    ``predicted`` (N, n) torque; ``relative_error`` (%) = 100 |tau - predicted| / |tau| over all joints, against the
    unfiltered measured torque at the log's own rate; ``relative_error_filtered`` the same after the parallel filter and
    decimation, over the rows that the fit uses (None where no filter is configured); ``rmse`` (N m or N) and
    ``per_joint`` (%) by joint name, unfiltered.

    Also by joint name: ``per_joint_filtered`` (%; empty without a filter); ``effort_share``, the rmse in % of the
    effort limit of the robot file (for joints that have one); ``r2`` = 1 - variance of the residual / variance of the
    torque, which ignores constant parts; ``residuals``, tests of the unfiltered residual.
    """

    name: str
    role: Role
    motion: Motion
    predicted: Array
    relative_error: float
    relative_error_filtered: float | None
    rmse: Mapping[str, float]
    per_joint: Mapping[str, float]
    per_joint_filtered: Mapping[str, float] = field(default_factory=dict)
    effort_share: Mapping[str, float] = field(default_factory=dict)
    r2: Mapping[str, float] = field(default_factory=dict)
    residuals: Mapping[str, ResidualTest] = field(default_factory=dict)


def relative_error(measured: Array, predicted: Array) -> float:
    """Return 100 |measured - predicted| / |measured| in percent (nan where the measurement is zero)."""
    size = float(np.linalg.norm(measured))
    return 100.0 * float(np.linalg.norm(measured - predicted)) / size if size > 0 else float("nan")


def validate(
    model: Model,
    theta: ArrayLike,
    motion: Motion,
    *,
    name: str | None = None,
    role: Role = "validation",
    parallel_filter: ParallelFilter | None = None,
    min_speed: tuple[float, ...] | None = None,
) -> LogValidation:
    """Predict the torque of a motion with the parameters theta (p) and compare it with the measured one.

    ``parallel_filter`` and ``min_speed`` are those of the fit; they only affect ``relative_error_filtered``. ``name``
    (default: the motion's source) and ``role`` label the result. Raises InputError where no sample is inside the
    motion's mask, and ModelError where a shape does not fit.

    >>> from dynident.models import simulate
    >>> from dynident.models.gallery import pendulum
    >>> model = pendulum()
    >>> motion = simulate(model, model.values, lambda t: [np.sin(3.0 * t)], np.linspace(0.0, 2.0, 201))
    >>> result = validate(model, 1.1 * model.values, motion)  # 10 % too large
    >>> result.relative_error
    10.00
    """
    if not motion.mask.any():
        raise InputError(f"{motion.source}: no usable sample is left for validation; widen the window, or smooth less.")
    parts = [slice(start, start + BLOCK) for start in range(0, len(motion), BLOCK)]
    torques = [model.torque(motion.q[s], motion.dq[s], motion.ddq[s], np.asarray(theta, dtype=float)) for s in parts]
    predicted = np.concatenate(torques)
    measured, guess = motion.tau[motion.mask], predicted[motion.mask]
    error = np.sqrt(np.mean((measured - guess) ** 2, axis=0))
    filtered = None if parallel_filter is None else _filtered(motion, predicted, parallel_filter, min_speed)
    rmse = dict(zip(motion.joints, map(float, error), strict=True))
    return LogValidation(
        name=name or motion.source,
        role=role,
        motion=motion,
        predicted=predicted,
        relative_error=relative_error(measured, guess),
        relative_error_filtered=None if filtered is None else relative_error(*filtered),
        rmse=rmse,
        per_joint=_by_joint(motion, measured, guess),
        per_joint_filtered={} if filtered is None else _by_joint(motion, *filtered),
        effort_share=_of_limits(model, rmse),
        r2={joint: _r2(measured[:, j], guess[:, j]) for j, joint in enumerate(motion.joints)},
        residuals=_residuals(motion, predicted),
    )


def _of_limits(model: Model, rmse: dict[str, float]) -> dict[str, float]:
    """Return the errors in % of the effort limits, for joints whose limit is known."""
    limits = {joint: limit.effort for joint, limit in model.limits.items() if joint in rmse and limit.effort}
    return {joint: 100.0 * rmse[joint] / effort for joint, effort in limits.items()}


def _by_joint(motion: Motion, measured: Array, predicted: Array) -> dict[str, float]:
    return {joint: relative_error(measured[:, j], predicted[:, j]) for j, joint in enumerate(motion.joints)}


def _r2(measured: Array, predicted: Array) -> float:
    total = float(np.var(measured))
    return 1.0 - float(np.var(measured - predicted)) / total if total > 0 else float("nan")


def _residuals(motion: Motion, predicted: Array) -> dict[str, ResidualTest]:
    """Test the residuals of the longest stretch without a gap."""
    part = max(stretches(motion.mask), key=lambda one: one.stop - one.start)
    residual, dq = (motion.tau - predicted)[part], motion.dq[part]
    step = float(np.diff(motion.t).mean())
    return {joint: residual_test(residual[:, j], dq[:, j], step) for j, joint in enumerate(motion.joints)}


def _filtered(
    motion: Motion, predicted: Array, parallel_filter: ParallelFilter, min_speed: tuple[float, ...] | None
) -> tuple[Array, Array]:
    """Filtering Y and multiplying by theta is filtering Y theta: the filter is linear."""
    sections = parallel_filter.sections(motion)
    pairs, keep = [], fast_enough(motion.dq, min_speed)
    for part in stretches(motion.mask):
        if part.stop - part.start > 1:
            both = np.stack((motion.tau[part], predicted[part]))
            kept = parallel_filter.apply(sections, both.swapaxes(0, 1))[:: parallel_filter.decimate]
            if keep is not None:  # rows that the fit leaves out count as zero on both sides
                kept = kept * keep[part][:: parallel_filter.decimate, None, :]
            pairs.append(kept)
    both = np.concatenate(pairs) if pairs else np.zeros((0, 2, predicted.shape[1]))
    return both[:, 0], both[:, 1]


def check_mass(
    model: Model, theta: ArrayLike, motions: Sequence[Motion], rng: np.random.Generator | None = None, poses: int = 1000
) -> MassMatrixCheck:
    """Check the mass matrix at up to 1000 poses of each motion and as many random ones within the joints' limits.

    A joint without limits is drawn from -pi to pi rad or from -1 to 1 m. ``rng`` draws the poses, by default the same
    ones each time. Raises the errors of the model.
    """
    rng = rng or np.random.default_rng(SEED)
    seen = [motion.q[subsample([motion], 1000)[0]] for motion in motions]
    sides = []
    for joint in model.joints:
        limit, reach = model.limits.get(joint.name), np.pi if joint.kind == "revolute" else 1.0
        known = limit is not None and limit.lower is not None and limit.upper is not None and limit.lower < limit.upper
        sides.append((limit.lower, limit.upper) if limit is not None and known else (-reach, reach))
    lower, upper = np.array(sides, dtype=float).T
    return model.check_mass_matrix(np.concatenate([*seen, rng.uniform(lower, upper, (poses, len(lower)))]), theta)
