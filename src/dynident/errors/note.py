"""Notes that a stage attaches to its result, as data: ``report`` puts them into words."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import ClassVar

__all__ = ["Note", "Remark", "Severity"]


class Severity(StrEnum):
    """How serious a finding or a note is: it gives wrong numbers, should be looked at, or is for information."""

    ERROR = "error"
    WARNING = "warning"
    INFO = "info"


@dataclass(frozen=True)
class Note:
    """Base of all notes; the type determines the severity, the fields hold the figures."""

    severity: ClassVar[Severity] = Severity.WARNING


@dataclass(frozen=True)
class Remark(Note):
    """A warning given as text, from reading a file or a configuration."""

    text: str
