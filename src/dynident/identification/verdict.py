"""The verdict on a model, and the figures behind it."""

from __future__ import annotations

import re
from dataclasses import dataclass

from dynident.identification.unobservable import Unobservable
from dynident.identification.verdict_reasons import NoFreeRun, Reason
from dynident.identification.verdict_steps import NextStep, Remedy
from dynident.regression import UnexcitedParameters
from dynident.runtime import Use, count, number, percent, rough
from dynident.validation import AT_FLOOR, Cause, FloorOrigin, NoiseFloor, causes_text

NAMED_REASONS = 2  # reasons that the second sentence names
LITTLE = 1.5  # times the noise of the sensors: a residual below is little
SENTENCE_END = re.compile(r"\.\s+(?=[A-Z])")  # inside a reason
_USE_SENTENCES = {
    Use.DO_NOT_USE: "Do not use this model yet",
    Use.CONTROL: "Good for control (feedforward, gravity compensation) on motions like these",
    Use.SIMULATION: "Good for simulation and control on motions like these",
}


@dataclass(frozen=True)
class HeldOut:
    """The torque errors (%) of the held-out log and of the training log where they are largest.

    The errors are those after the low-pass of the fit, where it has one; ``unfiltered`` are then the same two logs'
    errors as measured, else None.
    """

    error: float
    training: float
    unfiltered: tuple[float, float] | None

    def __str__(self) -> str:
        held_out = f"the torque error is {percent(self.error)} on held-out motion"
        if self.unfiltered is None:
            return f"{held_out} and {percent(self.training)} in training"
        measured, trained = self.unfiltered
        filtered = f"{held_out} after the low-pass of the fit ({percent(self.training)} in training)"
        return f"{filtered}, and {percent(measured)} as measured ({percent(trained)} in training)"


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

    def __str__(self) -> str:
        if self.all_at_floor and self.over is not None:
            return (
                f"The torque residual is at the noise floor: on {self.log} it is {self.over:.2f} times the noise of "
                f"the sensors, and at each joint at most {AT_FLOOR:g} times with 95 % confidence."
            )
        relative = "The torque residual" if self.floor is None else "Relative to noise, the torque residual"
        place = f"{relative} is largest in {self.joint} ({self.log})"
        if self.floor is not None and self.floor.is_reached:
            return f"{place}, where it is at the noise floor, {self.floor.ratio:.2f} times the noise of the sensors."
        causes = f"points to {causes_text(self.causes, self.floor)}" if self.causes else "has no clear cause"
        if self.floor is None:
            return f"{place} and {causes}."
        noise = "white noise" if self.floor.origin is FloorOrigin.WHITE else "noise"
        size = f"{number(self.floor.ratio, 2)} times the {noise} of the sensors"
        is_little = self.floor.ratio < LITTLE
        return f"{place}, only {size}; what remains {causes}." if is_little else f"{place}, {size}, and {causes}."


@dataclass(frozen=True)
class Verdict:
    """What a model is good for, all ``reasons`` against more, what to do ``next``, and the figures behind it.

    ``reasons`` are empty only for simulation. ``held_out`` is None where no log was held out, ``run`` where no free
    simulation succeeded, ``residual`` where the torque residual could not be tested. ``unknown`` is what no data can
    show, of a model that is good for something.
    """

    use: Use
    reasons: tuple[Reason, ...]
    next: tuple[Remedy | UnexcitedParameters | NextStep, ...]
    held_out: HeldOut | None
    run: WorstRun | None
    residual: LargestResidual | None
    unknown: tuple[Unobservable, ...] = ()

    def __str__(self) -> str:
        return " ".join(self.sentences())

    def sentences(self) -> tuple[str, ...]:
        """Return the verdict in sentences: use and errors, reasons against more use, residual, what stays unknown.

        Of a reason its first sentence is there; ``reasons`` have the others, such as what to do about it.
        """
        use = _USE_SENTENCES[self.use]
        opening = f"{use}: {'no log was held out' if self.held_out is None else self.held_out}."
        residual = "The torque residual could not be tested." if self.residual is None else str(self.residual)
        unknown = (
            f"No recording of this robot can reveal {', or '.join(map(str, self.unknown))}. Check this by other means."
        )
        return opening, self._reasons_sentence(), residual, *((unknown,) if self.unknown else ())

    @property
    def names_all(self) -> bool:
        """Whether the sentences have all that the reasons say."""
        return len(self.reasons) <= NAMED_REASONS and all(_lead_of(reason) == str(reason) for reason in self.reasons)

    def _reasons_sentence(self) -> str:
        if not self.reasons and self.run is not None:
            return (
                "Its mass matrix is positive definite in all poses tested, and the error of its free simulation is "
                f"at most {rough(self.run.error)} of the motion ({self.run.joint}, {self.run.log})."
            )
        clauses = list(map(_lead_of, self.reasons[:NAMED_REASONS]))
        is_untested = all(isinstance(reason, NoFreeRun) for reason in self.reasons)
        limit = "Not tested for simulation: " if is_untested else "Not for simulation: "
        text = "Against its use: " if self.use is Use.DO_NOT_USE else limit
        for k, clause in enumerate(clauses):
            # A reason that ends with a question mark closes its sentence, so the next one begins another
            if text.endswith("?"):
                text += f" And {clause.removeprefix('and ')}"
            else:
                text += f"; {clause}" if k else clause
        text += "" if text.endswith("?") else "."
        more = len(self.reasons) - NAMED_REASONS
        return text if more < 1 else f"{text} There {'is' if more == 1 else 'are'} {count(more, 'more reason')}."


def _lead_of(reason: Reason) -> str:
    """Return the first sentence of a reason."""
    return SENTENCE_END.split(str(reason), maxsplit=1)[0]
