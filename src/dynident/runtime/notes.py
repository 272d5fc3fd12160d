"""Notes and findings: what a stage has to say of its result, as data that say themselves by ``str``."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from enum import Enum, StrEnum
from typing import ClassVar, Self, TypeVar, dataclass_transform

from dynident.runtime.errors import InputError, join_names
from dynident.runtime.saved_fields import TaggedUnion
from dynident.runtime.text import short

MAX_NAMES = 8  # places of like findings that are listed


class Severity(StrEnum):
    """How serious a finding or a note is: it gives wrong numbers, should be looked at, or is for information."""

    ERROR = "error"
    WARNING = "warning"
    INFO = "info"

    @property
    def prefix(self) -> str:
        """What stands before a message of this severity."""
        return "Note: " if self is Severity.INFO else f"{self.value.capitalize()}: "


class WordedEnum(StrEnum):
    """Base of choices whose value is for programs, and that have ``words`` for a sentence."""

    words: str

    def __new__(cls, value: str, words: str = "") -> Self:
        """Make a text that has words."""
        choice = str.__new__(cls, value)
        choice._value_, choice.words = value, words
        return choice


class Use(StrEnum):
    """What a model is good for; simulation includes control."""

    SIMULATION = "good for simulation"
    CONTROL = "good for control"
    DO_NOT_USE = "do not use"


@dataclass_transform(frozen_default=True, field_specifiers=(field,))
class Statement:
    """Base of data that say themselves by ``str``; each class derived from it is a frozen dataclass."""

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        dataclass(frozen=True)(cls)


class Note(Statement, TaggedUnion):
    """Base of all notes: the fields hold the figures, ``str`` is the sentence, mostly without a full stop.

    The type determines severity and bearing. ``topic`` is a stable name for programs, empty where there is none.
    ``forbids`` is the use for which a model with such a note is no good: simulation, or control and with it any use.
    ``advises``: whether it is a next step, though it does not say what that gains. ``key_figure`` is the name of the
    field that tells like findings apart, empty where there is none.
    """

    severity: ClassVar[Severity] = Severity.WARNING
    topic: ClassVar[str] = ""
    forbids: ClassVar[Use | None] = None
    advises: ClassVar[bool] = False
    key_figure: ClassVar[str] = ""

    @property
    def forbidden(self) -> Use | None:
        """The use that this note forbids: that of its type, unless its figures decide."""
        return self.forbids

    @property
    def removed(self) -> tuple[tuple[str, float], ...]:
        """By how much the mean squared residual ((N m)^2, N^2) of joints in training falls when the cause is corrected.

        Empty where the note does not say.
        """
        return ()

    @property
    def remedy(self) -> str:
        """What to do about it, in short; all of the note where there is no shorter text."""
        return str(self)

    @property
    def figures(self) -> str:
        """Size and rows that each of several like findings has of its own, empty where there are none."""
        return short(getattr(self, self.key_figure)) if self.key_figure else ""


class Remark(Note):
    """A warning given as text, from reading a file or a configuration."""

    text: str

    def __str__(self) -> str:
        return self.text


class ConfigRemark(Remark):
    """A probable mistake in a configuration, from which other findings may follow."""

    forbids = Use.CONTROL


@dataclass(frozen=True)
class Finding:
    """One finding: the ``message``, what was found, and the ``joint`` it concerns (None: all of them).

    ``source`` is the log or file and ``link`` the link concerned, each empty where there is none. ``severity`` is that
    of the message unless it is given. ``str`` is the place and the message.
    """

    message: Note
    joint: str | None = None
    source: str = ""
    link: str = ""
    severity: Severity = None  # type: ignore[assignment]  # never None when it is made

    def __post_init__(self) -> None:
        object.__setattr__(self, "severity", self.severity or self.message.severity)

    def __str__(self) -> str:
        part = f"link {self.link!r}" if self.link else f"joint {self.joint!r}" if self.joint else ""
        return ": ".join(filter(None, (self.source, part, self.text)))

    @property
    def text(self) -> str:
        """What was found and what to do, in sentences."""
        text = str(self.message)
        return text if text.endswith((".", "?")) else f"{text}."

    @property
    def topic(self) -> str:
        """What the finding is about: a stable name for programs."""
        return self.message.topic

    @property
    def forbids(self) -> Use | None:
        """The use that the finding forbids: any where it is an error, else what its note forbids."""
        return Use.CONTROL if self.severity is Severity.ERROR else self.message.forbidden

    @property
    def kind(self) -> tuple[object, ...]:
        """What like findings share: severity, type, and the choices among the fields; of remarks their text."""
        choices = tuple(value for value in vars(self.message).values() if isinstance(value, (bool, Enum)))
        return self.severity, type(self.message), choices, self.text if isinstance(self.message, Remark) else ""


def place_and_text(findings: Sequence[Finding]) -> tuple[str, str]:
    """Return the place and the text of the first of several like findings; the text names the places of the others."""
    main, *similar = findings
    part, text = main.link or main.joint or "", main.text
    same_source = [_place_with_figures(x.link or x.joint or "", x) for x in similar if x.source == main.source]
    other_sources = [_place_with_figures(x.source, x, x.joint) for x in similar if x.source != main.source]
    if same_source:
        text += f" Likewise {join_names(same_source, MAX_NAMES)}."
    if other_sources:
        text += f" Also in {join_names(dict.fromkeys(other_sources), MAX_NAMES)}."
    return " ".join(filter(None, (f"{main.source}:" if main.source and part else main.source, part))), text


def _place_with_figures(place: str, finding: Finding, joint: str | None = None) -> str:
    figures = finding.message.figures
    return f"{place} ({': '.join(filter(None, (joint, figures)))})" if figures else place


def require(findings: Iterable[Finding], source: str) -> None:
    """Raise InputError that lists every finding that is an error, one per line; do nothing where there is none."""
    errors = [str(finding) for finding in findings if finding.severity is Severity.ERROR]
    if errors:
        raise InputError(f"{source}: " + "\n  ".join(errors))


Message = TypeVar("Message", Note, Finding, Note | Finding)


class Messages(tuple[Message, ...]):
    """Notes and findings; printed, each is a line that begins with its severity."""

    __slots__ = ()

    def __repr__(self) -> str:
        return "\n".join(f"{message.severity.prefix}{message}" for message in self)
