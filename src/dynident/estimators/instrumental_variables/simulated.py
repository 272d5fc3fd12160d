"""Instruments by simulation: the motion that a model makes under the same reference, which no sensor has seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dynident.errors import InputError, MissingInputError
from dynident.estimators.estimator import Problem
from dynident.estimators.instrumental_variables.instruments import Instruments, log_of
from dynident.estimators.instrumental_variables.notes import InstrumentKind
from dynident.log import Controller, Motion
from dynident.simulation import Broken, Failure, RunsAway, simulated

__all__ = ["controller_of", "failed", "missing", "reason_of", "simulated_instruments"]

Array = NDArray[np.float64]


def controller_of(problem: Problem, k: int) -> Controller | None:
    """Return the controller of the k-th recording, None where it has none."""
    log = log_of(problem, k)
    return None if log is None else log.controller


def simulated_instruments(problem: Problem, k: int, theta: Array) -> Instruments | Failure:
    """Return the motion that the model of a problem makes in the loop of the k-th recording, or why there is none.

    It begins with the state at the first usable sample, whose errors the loop forgets. A controller sees positions when
    they are stamped: there it is simulated, and then shifted to the torque as the motion has been.
    """
    model, motion = problem.model, problem.motions[k]
    stamped = motion.shifted(-motion.time_offset)
    usable = np.flatnonzero(stamped.mask)
    if len(usable) < 2:
        raise InputError(f"{motion.source}: too few usable samples to simulate instruments.")
    rows = slice(int(usable[0]), int(usable[-1]) + 1)
    run = simulated(model, theta, stamped, controller_of(problem, k), rows=rows)
    if run.failure is not None:
        return run.failure
    mask = np.zeros(len(motion), dtype=bool)
    mask[rows] = True
    q, dq, ddq = (one.copy() for one in (stamped.q, stamped.dq, stamped.ddq))
    q[rows], dq[rows], ddq[rows] = run.q, run.dq, run.ddq
    found = replace(stamped, q=q, dq=dq, ddq=ddq, mask=mask, memory=None)
    return Instruments(model.remembering(found.shifted(motion.time_offset)), InstrumentKind.SIMULATED)


def missing(motion: Motion) -> MissingInputError:
    """Return the error where a recording has no controller."""
    return MissingInputError(
        f"{motion.source}: instruments are to be simulated, but the recording does not know its controller. Give its "
        "gains and reference in the section `simulation` (kinds cascade, pd, pid, python; in Python Log.controller), "
        "or leave `instruments` at auto."
    )


def reason_of(failure: Failure) -> str:
    """Return why a simulation failed."""
    if isinstance(failure, RunsAway):
        return f"it runs away after {failure.after:.3g} s"
    return failure.reason if isinstance(failure, Broken) else "its mass matrix is singular"


def failed(motion: Motion, failure: Failure) -> InputError:
    """Return the error where the first model fails in the loop, also with physically consistent parameters."""
    return InputError(
        f"{motion.source}: instruments cannot be simulated: in the loop of the controller the first model fails, that "
        f"of least squares and the physically consistent one alike ({reason_of(failure)}). Check gains, units and "
        "reference of the controller and the terms of the model, or use instruments `repeated` or `lagged`."
    )
