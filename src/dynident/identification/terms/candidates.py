"""The kinds of terms that are tried on a joint: one line each, from the simplest on."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol, runtime_checkable

import numpy as np

from dynident.models import (
    AsymmetricViscous,
    Coulomb,
    Dahl,
    Drift,
    Joint,
    LoadCoulomb,
    LoadDahl,
    LoadViscous,
    Offset,
    Power,
    RotorInertia,
    Spring,
    Stribeck,
    Term,
    Viscous,
    WideCoulomb,
)

__all__ = ["KINDS", "PLAIN", "Kind", "Proposes", "Seen", "kind_of_class", "these"]

WIDTHS = tuple((0.005 * 1.25 ** np.arange(21)).tolist())  # of the rms speed; others make up for coarser ones
WIDE = tuple((0.1 * 1.25 ** np.arange(12)).tolist())  # likewise: beside the sign, over which friction still rises
VELOCITIES = (0.1, 0.14, 0.2, 0.3, 0.5)  # likewise; a smaller one is a width
LENGTHS = tuple((1e-4 * 1.25 ** np.arange(28)).tolist())  # of the reach
EXPONENTS = (0.3, 0.5, 0.7, 1.5, 2.0, 3.0)
SHARP = (0.01, 0.02, 0.03, 0.045)  # of the rms speed: widths of the sign of Stribeck friction


@dataclass(frozen=True)
class Seen:
    """What the training shows of a ``joint``, one of ``joints``: its rms ``speed`` (rad/s, m/s), how far it moves, its
    ``reach`` (rad, m), and the ``duration`` (s) of the longest recording."""

    joints: tuple[Joint, ...]
    joint: Joint
    speed: float
    reach: float
    duration: float


@runtime_checkable
class Proposes(Protocol):
    """A class of terms that says how it is tried on a joint."""

    @classmethod
    def proposed(cls, seen: Any, /) -> Sequence[Term]:
        """Return the term on the joint of ``Seen`` alone, in all sizes of one shape that are to be tried."""


@dataclass(frozen=True)
class Kind:
    """A ``name`` and the ``sizes`` of a term on one joint, which count as one trial.

    A ``strict`` kind needs two standard errors. One that is ``presumed`` belongs to the plain set: it stays unless it
    is seen to do nothing. A ``dry`` one is friction with the sign of the motion: another of these ends the presumption.
    One that ``reaches`` must hold further out than it was fitted, and is not tried where its ``needs_load`` cannot be
    met.
    """

    name: str
    sizes: Callable[[Seen], Sequence[Term]]
    strict: bool = False
    presumed: bool = False
    dry: bool = False
    reaches: bool = False
    needs_load: bool = False


def kind_of_class(name: str, part: type[Proposes]) -> Kind:
    """Return the kind of a class of terms that proposes its own sizes, such as a user's: a strict one."""
    return Kind(name, part.proposed, strict=True, needs_load=bool(getattr(part, "needs_load", False)))


def _alone(part: Callable[..., Term], seen: Seen) -> Sequence[Term]:
    """Return a term without constants on the joint."""
    return (part(seen.joints, on=(seen.joint.name,)),)


def _scaled(part: Callable[..., Term], name: str, scale: str, shares: Sequence[float], seen: Seen) -> Sequence[Term]:
    """Return a term with a constant ``name`` at shares of what is seen, ``scale``."""
    on, size = (seen.joint.name,), float(getattr(seen, scale))
    return tuple(part(seen.joints, on=on, **{name: share * size}) for share in shares)


def _stribeck(seen: Seen) -> Sequence[Term]:
    return tuple(
        one
        for width in SHARP
        for one in _scaled(partial(Stribeck, width=width * seen.speed), "velocity", "speed", VELOCITIES, seen)
    )


def _power(seen: Seen) -> Sequence[Term]:
    return tuple(Power(seen.joints, on=(seen.joint.name,), exponent=one) for one in EXPONENTS)


def _spring(order: int, seen: Seen) -> Sequence[Term]:
    return (Spring(seen.joints, on=(seen.joint.name,), order=order),)


def these(terms: tuple[Term, ...], _: Seen) -> tuple[Term, ...]:
    """Return terms whatever is seen."""
    return terms


KINDS = (
    Kind("offset", partial(_alone, Offset), presumed=True),
    Kind("viscous", partial(_alone, Viscous), presumed=True),
    Kind("coulomb", partial(_scaled, Coulomb, "width", "speed", (0.0, *WIDTHS)), presumed=True, dry=True),
    Kind("rotor", partial(_alone, RotorInertia), presumed=True),
    Kind("load_coulomb", partial(_scaled, LoadCoulomb, "width", "speed", WIDTHS), dry=True, needs_load=True),
    Kind("load_viscous", partial(_alone, LoadViscous), needs_load=True),
    Kind("stribeck", _stribeck),
    Kind("asymmetric_viscous", partial(_alone, AsymmetricViscous)),
    Kind("dahl", partial(_scaled, Dahl, "length", "reach", LENGTHS), dry=True),
    Kind("load_dahl", partial(_scaled, LoadDahl, "length", "reach", LENGTHS), dry=True, needs_load=True),
    Kind("power", _power, strict=True),
    Kind("wide_coulomb", partial(_scaled, WideCoulomb, "width", "speed", WIDE), strict=True),
    Kind("spring", partial(_spring, 1), strict=True, reaches=True),
    Kind("spring", partial(_spring, 2), strict=True, reaches=True),
    Kind("drift", partial(_scaled, Drift, "time", "duration", (0.3, 1.0, 3.0)), strict=True),
)
PLAIN = ("offset", "rotor", "viscous", "coulomb")
