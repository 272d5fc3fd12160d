"""What a payload identification has to say of its result, as data."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from dynident.errors import Note, Severity
from dynident.payload.body import Component

__all__ = ["GainsUnknown", "NoPayload", "NotShown", "OtherArm", "PayloadOrDrift", "SameRecording"]


@dataclass(frozen=True)
class NotShown(Note):
    """The motion with the payload does not show ``components`` of it, of standard errors ``std`` (SI).

    Ten seconds of turning ``joint`` alone, back and forth at up to ``speed`` (``unit`` rad/s, m/s), would lower them to
    ``then``; no joint is named where none would by itself.
    """

    advises: ClassVar[bool] = True
    components: tuple[Component, ...]
    std: tuple[float, ...]
    joint: str = ""
    speed: float = 0.0
    unit: str = "rad/s"
    then: tuple[float, ...] = ()


@dataclass(frozen=True)
class PayloadOrDrift(Note):
    """``share`` of the variance of a ``component`` is due to drift of friction and offsets since the arm was
    identified: the data do not tell it from the payload. ``unloaded``: whether recordings without it were given."""

    advises: ClassVar[bool] = True
    component: Component
    share: float
    unloaded: bool


@dataclass(frozen=True)
class GainsUnknown(Note):
    """The gains of the drives limit the mass: ``std`` (kg) in all, of which ``data`` (kg) were left if they were known.
    ``common`` (%) is how wrong all may be together."""

    severity: ClassVar[Severity] = Severity.INFO
    std: float
    data: float
    common: float


@dataclass(frozen=True)
class NoPayload(Note):
    """The mass (kg) is less than three standard errors from nothing, so that nothing else is known of it."""

    mass: float
    std: float


@dataclass(frozen=True)
class OtherArm(Note):
    """What payload, drift and gains leave of the differences is ``factor`` times what the standard errors allow, by
    which these were multiplied."""

    factor: float


@dataclass(frozen=True)
class SameRecording(Note):
    """A recording ``source`` without the payload is one that the result was made from; it counts there already."""

    severity: ClassVar[Severity] = Severity.INFO
    source: str
