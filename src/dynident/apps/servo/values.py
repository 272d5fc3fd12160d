"""What is sought of an arm of servos: values by joint, and the entries of them that a fit moves."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from enum import StrEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dynident.runtime import Noun
from dynident.runtime.arrays import Array

MAX_DROP = 2.0  # of a logarithm, in one step
MAX_RISE, RETURN_VALUE = 3.0, 0.1  # factor in one step, and SI, to which a value near zero may come back in one
LONGEST_DELAY = 1.0  # s, that a search comes to
MIN_VALUE = 1e-8  # SI: of what is positive; it stands for zero


class Quantity(StrEnum):
    """What a parameter is, by the name of its field in ``ServoValues``; units of joints that turn."""

    ARMATURE = "armature"
    DAMPING = "damping"
    FRICTIONLOSS = "frictionloss"
    KP = "kp"
    OFFSET = "offset"
    COMMAND_OFFSET = "command_offset"
    MASS = "mass"
    DELAY = "delay"

    @property
    def positive(self) -> bool:
        """Whether it is above zero, so that its steps are relative."""
        return self not in (Quantity.OFFSET, Quantity.COMMAND_OFFSET, Quantity.DELAY)


FRICTION = (Quantity.ARMATURE, Quantity.DAMPING, Quantity.FRICTIONLOSS)


class Entry(NamedTuple):
    """One number of ``ServoValues``: a quantity, and the index of its joint (0 for the delay, which all share)."""

    quantity: Quantity
    k: int


class ServoValues(Noun):
    """The values of an arm of n servos, by joint (n) in SI, and the delay (s) from command to position.

    The torque of a joint is kp (command + command_offset - offset - q) - kd dq within +-limit, and where kp is zero
    command + command_offset - kd dq: a commanded torque. ``offset`` is what the encoder shows too much, ``mass`` a
    factor on mass and inertia of the body that the joint moves.
    """

    armature: Array
    damping: Array
    frictionloss: Array
    kp: Array
    kd: Array
    limit: Array
    offset: Array
    command_offset: Array
    mass: Array
    delay: float

    @property
    def shift(self) -> Array:
        """What is added (n) to commands; those of positions are in the frame of the encoders."""
        return self.command_offset - np.where(self.takes_torque, 0.0, self.offset)

    @property
    def takes_torque(self) -> NDArray[np.bool_]:
        """Whether the command of a joint (n) is a torque."""
        return np.asarray(self.kp == 0)

    def drive_torques(self, command: Array, q: Array, dq: Array) -> Array:
        """Return the torques (N, n) of the servos at encoder positions and speeds (N, n)."""
        side = np.where(self.takes_torque, command + self.command_offset, self.kp * (command + self.command_offset - q))
        return np.asarray(np.clip(side - self.kd * dq, -self.limit, self.limit))

    def entry(self, entry: Entry) -> float:
        """Return a number of the values."""
        return float(np.atleast_1d(getattr(self, entry.quantity))[entry.k])

    def changed(self, entries: Sequence[Entry], numbers: Sequence[float]) -> ServoValues:
        """Return the values with other numbers; a delay is not negative."""
        fields: dict[str, Array | float] = {}
        for (quantity, k), number in zip(entries, numbers, strict=True):
            if quantity is Quantity.DELAY:
                fields["delay"] = max(float(number), 0.0)
                continue
            array = np.array(fields.get(quantity, getattr(self, quantity)))
            array[k] = number
            fields[quantity] = array
        return replace(self, **fields)  # type: ignore[arg-type]

    def moved(self, entries: Sequence[Entry], steps: Sequence[float] | Array) -> ServoValues:
        """Return the values after steps (p) of a search: relative ones of what is positive, which stays so."""
        numbers = []
        for entry, step in zip(entries, steps, strict=True):
            number = self.entry(entry)
            if entry.quantity.positive:
                # up by the share, so that a value near zero comes back at once; down by a logarithm
                if step > 0:
                    number = min(number * (1 + step), max(MAX_RISE * number, RETURN_VALUE))
                else:
                    number = max(number * math.exp(max(step, -MAX_DROP)), MIN_VALUE)
            else:
                number += step
                number = min(number, LONGEST_DELAY) if entry.quantity is Quantity.DELAY else number
            numbers.append(number)
        return self.changed(entries, numbers)
