"""What was tried of the terms of each joint, and which of them were chosen."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from typing import ClassVar

from dynident.errors import InputError, Note, Severity, brief
from dynident.models import Term

__all__ = ["NotChosen", "Outcome", "PlainTerms", "TermChoice", "TooFewSamplesError", "Trial"]


class Outcome(Enum):
    """What became of a trial."""

    ENTERED = "entered"
    TOO_SMALL = "too small"  # the gain is less than the least share
    WITHIN_ERROR = "within error"  # the gain is less than one standard error of the blocks, or two of a strict kind
    REFUTED_FASTER = "refuted by faster motion"
    REFUTED_FURTHER = "refuted further out"
    REFUTED_BY_LOG = "refuted by another recording"
    NEGATIVE = "negative"  # a coefficient that physics does not let be negative
    NOT_EXCITED = "not excited"
    REDUNDANT = "redundant"  # it had entered, and others made it needless


class TooFewSamplesError(InputError):
    """There are too few samples to choose the terms by."""


@dataclass(frozen=True)
class PlainTerms(Note):
    """The terms are the plain set: there are too few samples to choose others by."""

    severity: ClassVar[Severity] = Severity.INFO


@dataclass(frozen=True)
class NotChosen(Note):
    """Parameters that settings of the estimator name, and that the model with the terms chosen does not have."""

    names: tuple[str, ...]


@dataclass(frozen=True)
class Trial:
    """A ``kind`` of term that was tried on one ``joint``, with its best ``settings``, beside all others chosen for it.

    ``gain`` is what it removes of the squared cross-validated error of the joint (%), with its standard error ``std``
    from the blocks of time. ``faster`` and ``faster_std`` are the same where the slow samples are fitted and the fast
    ones judged by; None where this was not asked.
    """

    joint: str
    kind: str
    settings: tuple[tuple[str, object], ...]
    gain: float
    std: float
    outcome: Outcome
    faster: float | None = None
    faster_std: float | None = None


@dataclass(frozen=True)
class TermChoice:
    """The ``terms`` chosen for the joints, and all ``trials`` in the order in which they were made.

    ``before`` and ``after`` are the cross-validated errors (%) of the n ``joints`` with the plain set (offset, viscous
    and Coulomb friction) and with the terms chosen; ``min_speed`` (n), in rad/s or m/s, is the speed below which the
    samples of a joint are left out of its fit. ``load`` are the parameters of the bodies that the load was found with.
    Without trials, the terms are the plain set with rotor inertia, and the errors nan: there were too few samples.
    """

    joints: tuple[str, ...]
    terms: tuple[Term, ...]
    trials: tuple[Trial, ...]
    before: tuple[float, ...]
    after: tuple[float, ...]
    min_speed: tuple[float, ...]
    load: tuple[float, ...] | None = field(default=None, repr=False)

    __repr__ = brief

    def of(self, joint: str) -> tuple[Trial, ...]:
        """Return the trials of a joint."""
        return tuple(one for one in self.trials if one.joint == joint)
