"""The nouns of an export: what was written, its proof, and both together with what a format could not take."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from dynident.errors import brief

__all__ = ["Export", "Proof", "Written"]


@dataclass(frozen=True)
class Written:
    """The text of a model; ``left_out`` says in words what its format cannot hold, ``notes`` the rest."""

    text: str
    left_out: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    __repr__ = brief


@dataclass(frozen=True)
class Proof:
    """A written text, loaded again: its torque against that of the identified model without what is left out.

    ``readers`` is the norm of the difference by reader, relative to the norm of a joint's torque, at the worst joint,
    over ``samples`` states; ``skipped`` says why other readers could not be asked.
    """

    readers: Mapping[str, float]
    samples: int
    skipped: tuple[str, ...] = ()
    limit: float = 1e-8

    @property
    def agreement(self) -> float:
        """The largest difference of all readers; infinite where none could read the text."""
        return max(self.readers.values(), default=float("inf"))

    @property
    def proven(self) -> bool:
        """Whether every reader agrees within the limit."""
        return self.agreement <= self.limit


@dataclass(frozen=True)
class Export:
    """A file to be written, or, in ``refusal``, why it is not: the model cannot be put so, or the proof failed."""

    format: str
    file: str
    written: Written | None = None
    proof: Proof | None = None
    refusal: str = ""

    __repr__ = brief

    @property
    def ready(self) -> bool:
        """Whether there is a text, and it is proven."""
        return self.written is not None and self.proof is not None and self.proof.proven
