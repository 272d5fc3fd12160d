"""The verdict on a model, and the figures behind it."""

from __future__ import annotations

from dataclasses import dataclass

from dynident.errors import Use
from dynident.identification.verdict.reasons import Reason
from dynident.identification.verdict.steps import Remedy, Step
from dynident.identification.verdict.unknown import Unknown
from dynident.regression import UnexcitedParameters
from dynident.validation import Cause, NoiseFloor

__all__ = ["HeldOut", "LargestResidual", "Use", "Verdict", "WorstRun"]


@dataclass(frozen=True)
class HeldOut:
    """The torque errors (%) of the held-out log and of the training log where they are largest.

    The errors are those after the low-pass of the fit, where it has one; ``unfiltered`` are then the same two logs'
    errors as measured, else None.
    """

    error: float
    training: float
    unfiltered: tuple[float, float] | None


@dataclass(frozen=True)
class WorstRun:
    """The free simulation with the largest ``error``, in % of the motion of a ``joint`` on a ``log``."""

    log: str
    joint: str
    error: float


@dataclass(frozen=True)
class LargestResidual:
    """The ``joint`` and ``log`` with the largest torque residual, and its likely ``causes``.

    ``floor`` is what the sensors allow there, where it is known; ``all_at_floor`` tells that the residuals of all
    joints on the log are at the noise floor, ``over`` times what the sensors allow together.
    """

    joint: str
    log: str
    causes: tuple[Cause, ...]
    floor: NoiseFloor | None = None
    over: float | None = None
    all_at_floor: bool = False


@dataclass(frozen=True)
class Verdict:
    """What a model is good for, all ``reasons`` against more, what to do ``next``, and the figures behind it.

    ``reasons`` are empty only for simulation. ``held_out`` is None where no log was held out, ``run`` where no free
    simulation succeeded, ``residual`` where the torque residual could not be tested. ``unknown`` is what no data can
    show, of a model that is good for something.
    """

    use: Use
    reasons: tuple[Reason, ...]
    next: tuple[Remedy | UnexcitedParameters | Step, ...]
    held_out: HeldOut | None
    run: WorstRun | None
    residual: LargestResidual | None
    unknown: tuple[Unknown, ...] = ()
