"""Notes that a stage attaches to its result, as data: ``report`` puts them into words. What they forbid."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import ClassVar

__all__ = ["Note", "Remark", "Severity", "Use"]


class Severity(StrEnum):
    """How serious a finding or a note is: it gives wrong numbers, should be looked at, or is for information."""

    ERROR = "error"
    WARNING = "warning"
    INFO = "info"


class Use(StrEnum):
    """What a model is good for; simulation includes control."""

    SIMULATION = "good for simulation"
    CONTROL = "good for control"
    DO_NOT_USE = "do not use"


@dataclass(frozen=True)
class Note:
    """Base of all notes; the type determines severity and bearing, the fields hold the figures.

    ``forbids`` is the use for which a model with such a note is no good: simulation, or control and with it any use.
    ``advises``: whether it is a next step, though it does not say what that gains.
    """

    severity: ClassVar[Severity] = Severity.WARNING
    forbids: ClassVar[Use | None] = None
    advises: ClassVar[bool] = False

    @property
    def forbidden(self) -> Use | None:
        """The use that this note forbids: that of its type, where its figures do not decide."""
        return self.forbids

    @property
    def removed(self) -> tuple[tuple[str, float], ...]:
        """By how much the mean squared residual ((N m)^2, N^2) of joints in training falls where what the note says is
        set right; empty where it does not say."""
        return ()


@dataclass(frozen=True)
class Remark(Note):
    """A warning given as text, from reading a file or a configuration."""

    text: str
