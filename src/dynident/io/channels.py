"""Signals of a recording as a configuration names them: by joint, of a column in a unit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Self

from pydantic import Field, StrictBool, model_validator

from dynident.errors import ConfigError, choices
from dynident.io.fields import Amount, Gain, Name, Positive, Section
from dynident.models import Joint

__all__ = ["POSITIONS", "TORQUES", "VELOCITIES", "Angle", "Channel", "PositionChannel", "known_names", "same_names"]

POSITIONS = {"revolute": "angle", "prismatic": "length"}
VELOCITIES = {"revolute": "angular velocity", "prismatic": "velocity"}
TORQUES = {"revolute": "torque", "prismatic": "force"}


class Channel(Section):
    """A signal in ``unit``: gain * (column, or the sum of columns times their coefficients) + offset."""

    column: Name | None = None
    sum: dict[Name, Amount] | None = Field(None, min_length=1)
    gain: Gain = 1.0
    offset: Amount = 0.0
    unit: str

    @model_validator(mode="after")
    def _one(self) -> Self:
        if (self.column is None) == (self.sum is None):
            raise ValueError("needs either `column` or `sum` (a mapping of columns to coefficients)")
        return self

    @property
    def terms(self) -> Mapping[str, float | str]:
        """Coefficients by column."""
        return {self.column: 1.0} if self.column is not None else self.sum or {}


class Angle(Channel):
    """A position as a robot gives it, whose columns start anew at ``wraps``, in the unit of the columns."""

    wraps: Positive | None = None


class PositionChannel(Angle):
    """A position; with ``multi_turn`` a revolute joint may make any number of turns."""

    multi_turn: StrictBool = False


def known_names(section: str, given: Mapping[str, object], joints: Sequence[Joint]) -> None:
    """Raise ConfigError where one of the names is that of no joint."""
    names = [joint.name for joint in joints]
    for name in given:
        if name not in names:
            raise ConfigError(f"{section}.{name}: there is no joint {name!r}; {choices(name, names)}")


def same_names(section: str, given: Mapping[str, object], joints: Sequence[Joint]) -> None:
    """Raise ConfigError unless the names are those of the joints."""
    known_names(section, given, joints)
    for name in (joint.name for joint in joints):
        if name not in given:
            still = (
                " A joint of a robot file that the logs lack can stand still: give its position in `lock` of `model`."
            )
            raise ConfigError(
                f"{section}: joint {name!r} of the model is missing; add a line `{name}: ...` like that of the others."
                + (still if section in ("position", "torque") else "")
            )
