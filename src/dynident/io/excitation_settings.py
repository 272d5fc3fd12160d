"""The settings of a designed motion: section ``excitation`` of a configuration, or a file of its own."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, ValidationError, ValidationInfo, model_validator

from dynident.errors import ConfigError
from dynident.excitation.request import Request
from dynident.io.fields import Name, NonNegative, Number, Positive, PositiveOrEach, Section, as_number
from dynident.io.wording import worded

__all__ = [
    "BoxSettings",
    "CylinderSettings",
    "ExcitationSettings",
    "JointLimitSettings",
    "excitation_settings",
    "settings_in",
]

MARGIN = 0.9  # at most, of each range


def _share(value: object) -> float:
    if not 0.0 <= (number := as_number(value)) <= MARGIN:
        raise ValueError(f"a share from 0 to {MARGIN} is expected, such as 0.1 for 10 %")
    return number


def _within(least: float, most: float, unit: str) -> Callable[[object], float]:
    """Return a reader of numbers from ``least`` to ``most``, beyond which a value can only be a mistake."""

    def read(value: object) -> float:
        if not least <= (number := as_number(value)) <= most:
            raise ValueError(f"a number from {least:g} to {most:g} {unit} is expected")
        return number

    return read


def _few(most: int) -> Callable[[object], int]:
    """Return a reader of whole numbers from 1 to ``most``."""

    def read(value: object) -> int:
        number = as_number(value)
        if not (1 <= number <= most and number == int(number)):
            raise ValueError(f"a whole number from 1 to {most} is expected")
        return int(number)

    return read


def _seed(value: object) -> int:
    number = as_number(value)
    if not (0 <= number < 2**63 and number == int(number)):
        raise ValueError("a whole number of at least 0 is expected")
    return int(number)


def _folder(value: object, info: ValidationInfo) -> Path:
    """Return the whole path of a folder; a relative one starts at that of the settings."""
    if not isinstance(value, str | Path) or not str(value).strip():
        raise ValueError("the name of a folder is expected")
    return Path(os.path.abspath(Path((info.context or {}).get("folder", ".")) / value))


Folder = Annotated[Path, BeforeValidator(_folder)]
Share = Annotated[float, BeforeValidator(_share)]
Seconds = Annotated[float, BeforeValidator(_within(0.1, 3600.0, "s"))]
Rate = Annotated[float, BeforeValidator(_within(1.0, 20_000.0, "Hz"))]
Harmonics = Annotated[int, BeforeValidator(_few(50))]
Starts = Annotated[int, BeforeValidator(_few(1000))]
Seed = Annotated[int, BeforeValidator(_seed)]


class JointLimitSettings(Section):
    """Limits of one joint, in rad or m, per s, s^2 and s^3, and N m or N; those left out are the robot file's, or made
    by a rule."""

    lower: Number | None = None
    upper: Number | None = None
    velocity: Positive | None = None
    acceleration: Positive | None = None
    jerk: Positive | None = None
    torque: Positive | None = None

    @model_validator(mode="after")
    def _range(self) -> Self:
        if self.lower is not None and self.upper is not None and self.lower >= self.upper:
            raise ValueError(f"`lower` must be below `upper`, but {self.lower:g} >= {self.upper:g}")
        return self


class BoxSettings(Section):
    """A box to keep clear of: its ``centre`` and ``size`` (m) along the axes x, y and z of the root link."""

    name: Name
    centre: tuple[Number, Number, Number]
    size: tuple[Positive, Positive, Positive]


class CylinderSettings(Section):
    """An upright cylinder to keep clear of, about ``centre`` (x, y), from ``bottom`` to ``top`` (null: without end), in
    m."""

    name: Name
    centre: tuple[Number, Number]
    radius: Positive
    bottom: Number | None = None
    top: Number | None = None

    @model_validator(mode="after")
    def _height(self) -> Self:
        if self.bottom is not None and self.top is not None and self.bottom >= self.top:
            raise ValueError(f"`bottom` must be below `top`, but {self.bottom:g} >= {self.top:g}")
        return self


class ExcitationSettings(Section):
    """What motion to design, within which limits, and what to keep clear of.

    ``rate`` (Hz) is that of the recording, ``file_rate`` that of the files of the motion (null: the same). ``margin``
    is the share of each limit that is kept free. ``noise`` (N m, N) is that of the torques, one number or by joint;
    null: as the logs or the result show it, else by rule. ``start`` is the pose at rest where the motion begins and
    ends, by joint (rad, m); joints left out are at zero. ``floor`` (m) is a height along z of the root link.
    ``packages`` are the folders of the packages (``package://``) that hold the robot's meshes, or those around them.
    """

    program: Literal["motion", "friction", "gravity", "all"] = "motion"
    criterion: Literal["d", "a", "condition"] = "d"
    parameters: tuple[Name, ...] = ()
    family: Literal["fourier", "bspline"] = "fourier"
    duration: Seconds = Request.duration
    period: Seconds = Request.period
    harmonics: Harmonics = Request.harmonics
    rate: Rate = Request.rate
    file_rate: Rate | None = None
    noise: PositiveOrEach = None
    start: Mapping[Name, Number] | None = None
    starts: Starts = Request.starts
    seed: Seed = 0
    margin: Share = 0.1
    limits: Mapping[Name, JointLimitSettings] = {}
    clearance: NonNegative = Request.clearance
    floor: Number | None = None
    boxes: Annotated[tuple[BoxSettings, ...], Field(max_length=100)] = ()
    cylinders: Annotated[tuple[CylinderSettings, ...], Field(max_length=100)] = ()
    packages: Annotated[tuple[Folder, ...], Field(max_length=100)] = ()

    @model_validator(mode="after")
    def _criterion(self) -> Self:
        if self.parameters and self.criterion != "a":
            raise ValueError("`parameters`, those that matter, go with `criterion: a`")
        return self

    @model_validator(mode="after")
    def _names(self) -> Self:
        names = [*(one.name for one in self.boxes), *(one.name for one in self.cylinders)]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"two of `boxes` and `cylinders` have the name {name!r}; give each its own")
        return self


def settings_in(data: Any, source: str, *, alone: bool) -> Mapping[str, Any]:
    """Return the section ``excitation`` of a file's content; in one that is ``alone``, it may be all there is.

    Raises ConfigError where it is no mapping.
    """
    whole = data if isinstance(data, Mapping) else {}
    section = data if alone and "excitation" not in whole else whole.get("excitation")
    if not isinstance(section, Mapping | None):
        raise ConfigError(f"{source}: a mapping of settings is expected, such as `duration: 30`.")
    return section or {}


def excitation_settings(data: Mapping[str, Any], source: str, folder: str | Path = ".") -> ExcitationSettings:
    """Return settings, checked; file names are relative to ``folder``. ConfigError, led by ``source``, where one is
    wrong."""
    try:
        return ExcitationSettings.model_validate(dict(data), context={"folder": folder})
    except ValidationError as error:
        raise ConfigError(worded(error, dict(data), source)) from None
