"""Instruments from another pass of the same motion, in another recording or later in the same: its noise is another."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dynident.errors import MissingInputError
from dynident.estimators.estimator import Problem
from dynident.estimators.instrumental_variables.instruments import Instruments
from dynident.estimators.instrumental_variables.notes import InstrumentKind
from dynident.log import Motion
from dynident.regression.repeat import repeated_rows

__all__ = ["not_repeated", "repeated_instruments"]

Rows = NDArray[np.intp]
SAME = 1e-9  # of a joint's range: positions that are as near are the same samples
COPIED = 0.1  # share of such samples from which a recording is no other pass


def repeated_instruments(problem: Problem, k: int) -> Instruments | None:
    """Return the other pass that shares most samples with the k-th motion; None where it is not passed again.

    A copy of the same samples has the same noise, and is none.
    """
    motion = problem.motions[k]
    others = {other: m for m, other in reversed(list(enumerate(problem.motions)))}  # each once
    found = (_from(motion, other, m) for other, m in others.items())
    return max((one for one in found if one), key=lambda one: int(one.motion.mask.sum()), default=None)


def _from(motion: Motion, other: Motion, m: int) -> Instruments | None:
    pairs = repeated_rows(motion, other)
    if pairs is None or _copied(motion, other, *pairs):
        return None
    partner = np.full(len(motion), -1, dtype=np.intp)
    if other is motion:  # what is passed again is a pass of what passes it
        partner[pairs[1]] = pairs[0]
    partner[pairs[0]] = pairs[1]
    mask, at = partner >= 0, np.maximum(partner, 0)
    memory = None if other.memory is None else other.memory[at]
    found = replace(motion, q=other.q[at], dq=other.dq[at], ddq=other.ddq[at], mask=mask, memory=memory)
    return Instruments(found, InstrumentKind.REPEATED, None, m, partner)


def _copied(motion: Motion, other: Motion, rows: Rows, others: Rows) -> bool:
    """Whether samples of two motions are the same ones: those of a moving joint never agree to all digits."""
    span = np.ptp(motion.q, axis=0)
    near = np.abs(motion.q[rows] - other.q[others]) <= SAME * span
    return bool(near[:, span > 0].all(axis=1).mean() > COPIED)


def not_repeated(motion: Motion) -> MissingInputError:
    """Return the error where a motion has no other pass."""
    return MissingInputError(
        f"{motion.source}: instruments `repeated` need another recording of the same motion in the training, or a "
        "motion that repeats itself, and there is none. Record it twice, or leave `instruments` at auto."
    )
