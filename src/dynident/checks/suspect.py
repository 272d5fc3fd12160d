"""Suspects: single unknowns that a model takes for known, tested one by one and then found by Gauss-Newton steps."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.checks.case import Case
from dynident.checks.finding import Topic
from dynident.checks.misfit import Evidence, Misfit, misfit
from dynident.checks.robot_notes import Quantity, Rival, WrongValue
from dynident.errors import brief

__all__ = ["Found", "Others", "Suspect", "convincing", "promising", "refined"]

Array = NDArray[np.float64]
Others = tuple[Rival, ...]

CERTAIN = 6.0  # standard errors from zero: many unknowns are tested, and the errors are themselves uncertain
STEPS = 8
SETTLED = 0.1  # of a standard error: a smaller step ends the search


@dataclass(frozen=True, eq=False)
class Suspect:
    """An unknown of a ``joint`` (None: of all): the derivative of the torque by it, at zero, in a fit; the case with it
    set right; and the note on its value, standard error, share and the others that explain as much.

    ``limit`` is the largest plausible value; of suspects that explain about the same that of the lowest ``order`` is
    named. ``in_use`` is the case as the user meets it: its motion, where that is wrong in the log only.
    """

    joint: str | None
    topic: Topic
    derivative: Callable[[Misfit], Array]
    corrected: Callable[[Case, float], Case]
    note: Callable[[float, float, float, Others], WrongValue]
    limit: float
    order: int
    in_use: Callable[[Case, float], Case] = lambda case, _: case

    __repr__ = brief


@dataclass(frozen=True, eq=False)
class Found:
    """A suspect with its ``value`` and ``std``, the ``share`` that it explains, and the case with it set right."""

    suspect: Suspect
    value: float
    std: float
    share: float
    case: Case

    __repr__ = brief

    @property
    def rival(self) -> Rival:
        """The same in short, for the note of another one."""
        quantity = Quantity(self.suspect.topic.value)
        value = float(np.exp(self.value)) if quantity in ("gain", "clock") else self.value
        return Rival(self.suspect.joint or "", quantity, value)


def convincing(evidence: Evidence, worth: float) -> bool:
    """Tell whether an unknown explains enough, in the whole data and in each part, to be no chance."""
    clear = evidence.share > worth and evidence.held_out > worth and evidence.agreed  # what is quick is asked first
    return clear and abs(evidence.value) > CERTAIN * evidence.std


def promising(fit: Misfit, suspects: Sequence[Suspect]) -> Iterator[tuple[Suspect, Evidence]]:
    """Yield the suspects whose one step is convincing, with what it explains."""
    found = fit.evidence(one.derivative(fit) for one in suspects)
    for one, evidence in zip(suspects, found, strict=True):
        if evidence is not None and convincing(evidence, fit.worth / 2):
            yield one, evidence


def refined(fit: Misfit, suspect: Suspect) -> Found | None:
    """Return the value of a suspect by Gauss-Newton steps; None where it is not plausible, or explains too little."""
    case, value, std = fit.case, 0.0, np.inf
    weight = fit.weight.max(axis=0)
    for _ in range(STEPS):
        now = misfit(case, weight)
        (evidence,) = now.evidence([suspect.derivative(now)])
        if evidence is None:
            return None
        step = float(np.clip(evidence.value, -suspect.limit / 2, suspect.limit / 2))
        case, value, std = suspect.corrected(case, step), value + step, evidence.std
        if abs(value) > suspect.limit:
            return None
        if abs(step) < SETTLED * std:
            break
    share = 1.0 - misfit(case, weight).size / fit.size
    return Found(suspect, value, std, share, case) if share > fit.worth and abs(value) > CERTAIN * std else None
