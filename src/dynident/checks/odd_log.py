"""Logs that do not fit together with the others: the robot, its payload or the recording has changed between them.

The test is Chow's (1960), by what is left and not by its significance, which no model of a real robot would pass.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from dynident.checks.case import Case, case_of
from dynident.checks.finding import Finding, Topic
from dynident.checks.robot_notes import OddLog
from dynident.errors import Severity
from dynident.log import Motion
from dynident.models import Model
from dynident.regression import ParallelFilter

__all__ = ["odd_log_findings"]

Array = NDArray[np.float64]
SAMPLES = 1000  # of all motions, up to twice as many
ROWS = 5  # equations of a log for each parameter: fewer are explained by any fit of their own
POOR = 2.0  # %, of the torque: a smaller error of all logs together is none
RANK = 1e-7  # share of the largest singular value below which the data say nothing
MUCH = 0.6  # times that error: with a fit of its own for the odd log it is below; real robots have 0.86 and more


def odd_log_findings(
    model: Model,
    motions: Sequence[Motion],
    held_out: Mapping[str, Motion],
    parallel_filter: ParallelFilter | None = None,
    min_speed: tuple[float, ...] | None = None,
) -> Iterator[Finding]:
    """Yield the log that, with a fit of its own, lets plain least squares leave far less of all torques; of two logs,
    the second.

    Errors are root mean squares over the joints, so that small torques count as large ones. Each fit is judged by what
    it is made of, so that noise in one log, or a motion that the others do not excite, makes it no odd one.
    """
    enough = ROWS * len(model.parameters) // len(model.joints)
    # of a log without torque more is said elsewhere
    logs = [one for one in (*motions, *held_out.values()) if one.mask.sum() >= enough and one.tau[one.mask].any()]
    if len(logs) < 2:
        return
    factors = _factors(case_of(model, logs, parallel_filter, min_speed, max(SAMPLES, enough * len(logs))))
    torque = float(np.linalg.norm(np.concatenate([one[:, -1] for one in factors])))
    before = 100.0 * _left(factors) / (torque or np.inf)
    if not before > POOR:
        return
    apart = [np.hypot(_left([*factors[:k], *factors[k + 1 :]]), _left([factors[k]])) for k in range(len(logs))]
    odd = int(np.argmin(apart)) if len(logs) > 2 else 1
    after = 100.0 * float(apart[odd]) / torque
    if after < MUCH * before:
        yield Finding(Severity.WARNING, None, OddLog(before, after), Topic.ODD_LOG, source=logs[odd].source)


def _factors(case: Case) -> list[Array]:
    """Return for each log the triangular factor (k, p + 1) of regressor and torque, relative to that of all logs."""
    size = np.sqrt((case.tau**2 * case.keep).sum(axis=0) / np.maximum(case.keep.sum(axis=0), 1))
    weight = case.keep / np.where(size > 0, size, np.inf)
    Y = case.model.regressor(**case.states)
    X = np.concatenate([Y, case.tau[:, :, None]], axis=2) * weight[:, :, None]
    parts = np.split(X, np.cumsum(case.lengths)[:-1])
    return [np.asarray(np.linalg.qr(one.reshape(-1, one.shape[2]), mode="r")) for one in parts]


def _left(factors: Sequence[Array]) -> float:
    """Return the norm of what one fit to all of these logs leaves of their torque."""
    stacked = np.concatenate(factors)
    A, y = stacked[:, :-1], stacked[:, -1]
    scale = np.linalg.norm(A, axis=0)
    A = A / np.where(scale > 0, scale, 1.0)
    return float(np.linalg.norm(y - A @ np.linalg.lstsq(A, y, rcond=RANK)[0]))
