"""What the checks find in a robot file alone, as data; ``report/finding_words.py`` puts it into words."""

from __future__ import annotations

from dataclasses import dataclass

from dynident.errors import Note

__all__ = [
    "EmptyRange",
    "EqualLinks",
    "FarCentre",
    "FloatingBase",
    "ImpossibleInertia",
    "InertiaAboutOrigin",
    "LargeGyration",
    "LimitNotPositive",
    "NoLimit",
    "NoMass",
    "OddTotalMass",
    "OnlyShapes",
    "PointMass",
    "SeveralLimbs",
]


@dataclass(frozen=True)
class ImpossibleInertia(Note):
    """How the inertia of a link violates physical consistency, in the words of ``consistency_violations``."""

    violation: str


@dataclass(frozen=True)
class NoMass(Note):
    """The links that a joint moves have no mass."""

    links: tuple[str, ...]


@dataclass(frozen=True)
class FloatingBase(Note):
    """A joint with several coordinates carries the whole robot, which is taken as fixed."""


@dataclass(frozen=True)
class SeveralLimbs(Note):
    """Several joints move limbs of a base with a mass, which is taken as fixed; it may be a trunk."""

    base: str
    joints: tuple[str, ...]


@dataclass(frozen=True)
class OnlyShapes(Note):
    """A link has shapes of files instead of an inertia."""


@dataclass(frozen=True)
class PointMass(Note):
    """A link has a mass (kg) without an inertia about its centre."""

    mass: float


@dataclass(frozen=True)
class FarCentre(Note):
    """The distance (m) of a centre of mass from its link's frame."""

    distance: float


@dataclass(frozen=True)
class LargeGyration(Note):
    """A largest moment (kg m^2) and its radius of gyration (m), large for the mass (kg) and size (m) of the link."""

    moment: float
    gyration: float
    mass: float
    size: float


@dataclass(frozen=True)
class InertiaAboutOrigin(Note):
    """The links whose inertias may be about the origins of their frames."""

    links: tuple[str, ...]


@dataclass(frozen=True)
class EqualLinks(Note):
    """Links with the same mass (kg) and moments; ``alone`` says that there are no others."""

    links: tuple[str, ...]
    mass: float
    alone: bool


@dataclass(frozen=True)
class OddTotalMass(Note):
    """A mass of all links (kg) that no arm has."""

    mass: float


@dataclass(frozen=True)
class EmptyRange(Note):
    """A lower limit of position that is not below the upper one (rad or m)."""

    lower: float
    upper: float


@dataclass(frozen=True)
class LimitNotPositive(Note):
    """A limit that is not positive: of "effort" or "velocity"."""

    quantity: str
    value: float


@dataclass(frozen=True)
class NoLimit(Note):
    """The joints without a limit of "effort" or "velocity"."""

    quantity: str
    joints: tuple[str, ...]
