"""Instruments by simulation: the motion that a model makes under the same reference, which no sensor has seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dynident.errors import InputError, MissingInputError
from dynident.estimators.estimator import Problem
from dynident.estimators.instrumental_variables.instruments import Instruments
from dynident.estimators.instrumental_variables.notes import InstrumentKind
from dynident.estimators.loops import controller_of, failure_of, no_controller, not_simulated
from dynident.log import Motion
from dynident.simulation import Failure, simulated, ticks

__all__ = ["failed", "missing", "simulated_instruments"]

Array = NDArray[np.float64]


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
    controller = controller_of(problem, k)
    fast = ticks(stamped, controller, rows)
    run = simulated(model, theta, fast.motion, controller, rows=fast.rows)
    failure = failure_of(run, fast.motion.q[fast.rows])
    if failure is not None:
        return failure
    mask = np.zeros(len(motion), dtype=bool)
    mask[rows] = True
    q, dq, ddq = (one.copy() for one in (stamped.q, stamped.dq, stamped.ddq))
    q[rows], dq[rows], ddq[rows] = run.q[fast.at], run.dq[fast.at], run.ddq[fast.at]
    found = replace(stamped, q=q, dq=dq, ddq=ddq, mask=mask, memory=None)
    return Instruments(model.remembering(found.shifted(motion.time_offset)), InstrumentKind.SIMULATED)


def missing(motion: Motion) -> MissingInputError:
    """Return the error where a recording has no controller."""
    return no_controller(motion, "instruments are", "leave `instruments` at auto")


def failed(motion: Motion, failure: Failure) -> InputError:
    """Return the error where the first model fails in the loop, whatever made it."""
    return not_simulated([motion], failure, "instruments `repeated` or `lagged`")
