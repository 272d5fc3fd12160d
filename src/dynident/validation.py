"""Judges an estimate: its torque on a log, always also against the unfiltered measurement."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynident.errors import InputError
from dynident.log import Motion
from dynident.model import Model
from dynident.regression import BLOCK, Parallel, moving, stretches

__all__ = ["LogValidation", "relative_error", "validate"]

Array = NDArray[np.float64]
Role = Literal["train", "validation"]


@dataclass(frozen=True, eq=False)
class LogValidation:
    """Errors of a model on one log, over the samples that its motion vouches for.

    ``predicted`` (N, n) torque; ``relative_error`` (%) = 100 |tau - predicted| / |tau| over all joints, against the
    unfiltered measured torque at the log's own rate; ``relative_error_filtered`` the same after the parallel filter and
    decimation, over the rows that the fit uses (None where no filter is configured); ``rmse`` (N m or N) and
    ``per_joint`` (%) by joint name, unfiltered.
    """

    name: str
    role: Role
    motion: Motion
    predicted: Array
    relative_error: float
    relative_error_filtered: float | None
    rmse: Mapping[str, float]
    per_joint: Mapping[str, float]


def relative_error(measured: Array, predicted: Array) -> float:
    """Return 100 |measured - predicted| / |measured| in percent (nan where nothing was measured but zeros)."""
    size = float(np.linalg.norm(measured))
    return 100.0 * float(np.linalg.norm(measured - predicted)) / size if size > 0 else float("nan")


def validate(
    model: Model,
    theta: ArrayLike,
    motion: Motion,
    *,
    name: str | None = None,
    role: Role = "validation",
    parallel: Parallel | None = None,
    slow: tuple[float, ...] | None = None,
) -> LogValidation:
    """Predict the torque of a motion with the parameters theta (p) and compare it with the measured one.

    ``parallel`` and ``slow`` are those of the fit: they make ``relative_error_filtered`` and touch nothing else.
    Raises InputError where the motion's mask leaves no sample, and ModelError where a shape does not fit.
    """
    if not motion.mask.any():
        raise InputError(f"{motion.source}: no sample is left to judge the model on; widen the window, or smooth less.")
    parts = [slice(start, start + BLOCK) for start in range(0, len(motion), BLOCK)]
    torques = [model.torque(motion.q[s], motion.dq[s], motion.ddq[s], np.asarray(theta, dtype=float)) for s in parts]
    predicted = np.concatenate(torques)
    measured, guess = motion.tau[motion.mask], predicted[motion.mask]
    error = np.sqrt(np.mean((measured - guess) ** 2, axis=0))
    return LogValidation(
        name=name or motion.source,
        role=role,
        motion=motion,
        predicted=predicted,
        relative_error=relative_error(measured, guess),
        relative_error_filtered=None if parallel is None else _filtered_error(motion, predicted, parallel, slow),
        rmse=dict(zip(motion.joints, map(float, error), strict=True)),
        per_joint={joint: relative_error(measured[:, j], guess[:, j]) for j, joint in enumerate(motion.joints)},
    )


def _filtered_error(motion: Motion, predicted: Array, parallel: Parallel, slow: tuple[float, ...] | None) -> float:
    """Filtering Y and multiplying by theta is filtering Y theta: the filter is linear."""
    sections = parallel.sections(motion)
    pairs, keep = [], moving(motion.dq, slow)
    for part in stretches(motion.mask):
        if part.stop - part.start > 1:
            both = np.stack((motion.tau[part], predicted[part]))
            kept = parallel.apply(sections, both.swapaxes(0, 1))[:: parallel.decimate]
            if keep is not None:  # rows that the fit leaves out count as zero on both sides
                kept = kept * keep[part][:: parallel.decimate, None, :]
            pairs.append(kept)
    both = np.concatenate(pairs) if pairs else np.zeros((0, 2, predicted.shape[1]))
    return relative_error(both[:, 0], both[:, 1])
