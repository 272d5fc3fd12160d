"""A finding on a log, a robot file or both: severity, place, what is wrong and what to do."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from dynident.errors.note import Note, Severity, Use

__all__ = ["Finding"]


@dataclass(frozen=True)
class Finding:
    """One finding: ``severity``, the ``joint`` it concerns (None: all of them), and what was found.

    ``message`` is a note with the figures, of ``checks`` or of the stage that made it, which ``report`` puts
    into words with the remedy; it is a string where it comes from below, from reading a file or an error caught.
    ``topic`` groups findings of the same kind, None where there is no group; ``source`` is the log or file and ``link``
    the link concerned, each empty where there is none.
    """

    severity: Severity
    joint: str | None
    message: str | Note
    topic: StrEnum | None = None
    source: str = ""
    link: str = ""

    @property
    def forbids(self) -> Use | None:
        """The use that it forbids: any where it is an error, else what its note forbids."""
        if self.severity is Severity.ERROR:
            return Use.CONTROL
        return self.message.forbidden if isinstance(self.message, Note) else None

    @property
    def removed(self) -> tuple[tuple[str, float], ...]:
        """What setting it right removes of the residual, by joint, as its note says."""
        return self.message.removed if isinstance(self.message, Note) else ()
