"""The results of an export: the text, its verification, and both together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from dynident.errors import brief

__all__ = ["Export", "FileError", "Proof", "Written"]


@dataclass(frozen=True)
class Written:
    """The text of a model; ``left_out`` describes what its format cannot hold; ``notes`` are remarks."""

    text: str
    left_out: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    __repr__ = brief


@dataclass(frozen=True)
class Proof:
    """The verification of a text: its torque, loaded again, against that of the model without the terms left out.

    ``readers`` is the norm of the difference by reader, relative to the norm of a joint's torque, at the worst joint,
    over ``samples`` states; ``skipped`` says why other readers could not be used.
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
class FileError:
    """The relative torque errors (%) of the identified model and of a file on a log; ``role`` is that of the log."""

    log: str
    role: str
    model: float
    file: float


@dataclass(frozen=True)
class Export:
    """A file to be written, or, in ``refusal``, the reason why not: wrong for the format, or not verified.

    ``errors`` are those of the file's own dynamics on the logs, where these are known.
    """

    format: str
    file: str
    written: Written | None = None
    proof: Proof | None = None
    refusal: str = ""
    errors: tuple[FileError, ...] = ()

    __repr__ = brief

    @property
    def ready(self) -> bool:
        """Whether there is a text, and it is verified."""
        return self.written is not None and self.proof is not None and self.proof.proven
