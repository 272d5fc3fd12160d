"""What a stage has to say about its result, as data: ``report`` makes the words."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import ClassVar

__all__ = ["Note", "Remark", "Severity"]


class Severity(StrEnum):
    """How serious a finding or a note is: what gives wrong numbers, what to look at, what is good to know."""

    ERROR = "error"
    WARNING = "warning"
    INFO = "info"


@dataclass(frozen=True)
class Note:
    """Base of all notes; the type says how serious it is, the fields hold the figures."""

    severity: ClassVar[Severity] = Severity.WARNING


@dataclass(frozen=True)
class Remark(Note):
    """A warning that comes as text, from a reader of files or from a configuration."""

    text: str
