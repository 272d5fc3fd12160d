"""Why a simulation ends early: data, which reports word and estimators act on."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Broken", "Failure", "RunsAway", "Singular"]


@dataclass(frozen=True)
class Failure:
    """Base of the reasons for which a free simulation ends early."""


@dataclass(frozen=True)
class RunsAway(Failure):
    """The simulated position diverges ``after`` so many seconds."""

    after: float


@dataclass(frozen=True)
class Singular(Failure):
    """The mass matrix is singular."""


@dataclass(frozen=True)
class Broken(Failure):
    """The model cannot be evaluated, for a ``reason`` (the error's message)."""

    reason: str
