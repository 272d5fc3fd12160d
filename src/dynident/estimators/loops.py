"""What estimators that simulate need of a recording: its log and controller, and the errors where these do not do."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dynident.errors import InputError, MissingInputError
from dynident.estimators.estimator import Problem
from dynident.log import Controller, Log, Motion
from dynident.simulation import Broken, Failure, RunsAway, Simulated

__all__ = ["controller_of", "failure_of", "log_of", "no_controller", "not_simulated", "reason_of"]

AWAY, LEAST = 30.0, 0.1  # times the range of the recorded motion; of the widest range, what counts as that of a joint


def log_of(problem: Problem, k: int) -> Log | None:
    """Return the log behind the k-th motion of a problem, None where the problem has none."""
    if len(problem.logs) != len(problem.motions) or len(problem.logs[k]) != len(problem.motions[k]):
        return None
    return problem.logs[k]


def controller_of(problem: Problem, k: int) -> Controller | None:
    """Return the controller of the k-th recording, None where it has none."""
    log = log_of(problem, k)
    return None if log is None else log.controller


def no_controller(motion: Motion, what: str, instead: str) -> MissingInputError:
    """Return the error where a recording has no controller, for ``what`` is to be simulated, or else ``instead``."""
    return MissingInputError(
        f"{motion.source}: {what} to be simulated, but the recording does not know its controller. Give its gains "
        "and reference in the section `simulation` (kinds cascade, pd, pid, file.py:function; in Python "
        f"Log.controller), or {instead}."
    )


def failure_of(run: Simulated, q: NDArray[np.float64]) -> Failure | None:
    """Return why a simulated loop is of no use beside the recorded positions q (N, n): it failed, or a joint is many
    times the range of its motion away, which limits of the drives may keep finite; None where it is of use."""
    if run.failure is not None:
        return run.failure
    span = np.ptp(q, axis=0)
    size = np.where(span.max(initial=0.0) > 0, np.maximum(span, LEAST * span.max(initial=0.0)), np.inf)
    far = np.flatnonzero((np.abs(run.q - q) > AWAY * size).any(axis=1))
    return RunsAway(float(run.t[far[0]] - run.t[0])) if len(far) else None


def reason_of(failure: Failure) -> str:
    """Return why a simulation failed."""
    if isinstance(failure, RunsAway):
        return f"it runs away after {failure.after:.3g} s"
    return failure.reason if isinstance(failure, Broken) else "its mass matrix is singular"


def not_simulated(motions: Sequence[Motion], failure: Failure, instead: str) -> InputError:
    """Return the error where no first model can be simulated; ``instead`` is what else can be used."""
    return InputError(
        f"{', '.join(one.source for one in motions)}: no first model can be simulated, neither that of least squares "
        "nor one of a Kalman smoother, a physically consistent one, that of the robot file, or one whose mass matrix "
        f"is made positive definite ({reason_of(failure)}). Check gains, units and reference of the controller and the "
        f"terms of the model, or use {instead}."
    )
