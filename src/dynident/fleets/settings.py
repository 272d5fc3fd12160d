"""The settings of a fleet: its recipe, where its logs are, and what differs between its robots."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import BeforeValidator, StrictBool, ValidationError, ValidationInfo, model_validator

from dynident.errors import ConfigError
from dynident.io.config import config_text
from dynident.io.fields import CountOrEach, Delay, Name, Number, Section, Windows, as_number
from dynident.io.schema import section_schema
from dynident.io.wording import worded
from dynident.io.yaml_text import load_yaml

__all__ = ["FleetSettings", "RobotChanges", "fleet_schema", "read_fleet_settings"]


def _file(value: object, info: ValidationInfo) -> Path:
    """Read a file name; a relative one starts at the folder of the configuration."""
    if not isinstance(value, str | Path) or not str(value).strip():
        raise ValueError("a file name is expected")
    return Path((info.context or {}).get("folder", "."), str(value))


def _text(value: object) -> str:
    if not isinstance(value, str) or not value.strip():
        raise ValueError("a text is expected")
    return value


def _share(value: object) -> float:
    number = as_number(value)
    if not LEAST <= number <= MOST:
        raise ValueError(f"a share from {LEAST} to {MOST} is expected, such as 0.01 for 1 %")
    return number


Share = Annotated[float, BeforeValidator(_share)]
FileName = Annotated[Path, BeforeValidator(_file)]
Text = Annotated[str, BeforeValidator(_text)]
Settings = Mapping[str, Any]
LEAST, MOST = 1e-4, 0.5  # of false alarms: a smaller rate needs too many draws


class RobotChanges(Section):
    """What differs from the recipe for one robot: keys of ``model`` (such as a calibrated ``file`` or ``base_tilt``),
    and of the channels by joint (``gain``, ``offset``, ``column``), ``transmission``, ``zero`` and ``delay``.

    ``type`` is that of the robot: those of one type are compared with each other.
    """

    type: Name | None = None
    model: str | Settings = {}  # noqa: RUF012 -- pydantic copies it
    position: Mapping[Name, Settings] = {}
    torque: Mapping[Name, Settings] = {}
    transmission: Mapping[Name, Mapping[Name, Number]] = {}
    zero: Mapping[Name, Number] = {}
    delay: Delay | None = None

    @model_validator(mode="after")
    def _same_terms(self) -> Self:
        if isinstance(self.model, Mapping) and "terms" in self.model:
            raise ValueError("`model.terms` are those of the recipe for all robots, so that they can be compared")
        return self

    @property
    def changes(self) -> dict[str, Any]:
        """The settings to merge into those of the recipe."""
        given = {name: getattr(self, name) for name in self.model_fields_set - {"type"}}
        return {name: value for name, value in given.items() if value not in (None, {})}


class FleetSettings(Section):
    """Many logs of many robots, all identified with one recipe.

    ``recipe`` is a configuration, whose own logs do not count. ``logs`` is a pattern of file names or addresses with
    fields, ``logs/{robot}/{date}.parquet``; or ``table`` a file (CSV, Parquet) with a row for each log and the columns
    log, robot, date, and where wanted type and hold_out. ``date_format`` is that of dates as ``strptime`` has it, where
    they are not as in ISO 8601. ``window`` and ``width`` are those of each log. ``type`` is that of robots which have
    no other. ``robots`` says what differs, by robot. Of robots in which nothing changes, the share ``false_alarms`` is
    reported nevertheless. Without ``reports`` no files of single runs are kept.
    """

    recipe: FileName
    logs: Text | None = None
    table: Text | None = None
    date_format: Text | None = None
    window: Windows = ()
    width: CountOrEach = None
    type: Name = "robot"
    robots: Mapping[Name, RobotChanges] = {}
    false_alarms: Share = 0.01
    reports: StrictBool = True

    @model_validator(mode="after")
    def _one(self) -> Self:
        if (self.logs is None) == (self.table is None):
            raise ValueError("needs either `logs` (a pattern such as logs/{robot}/{date}.parquet) or `table` (a file)")
        return self


def fleet_schema() -> dict[str, Any]:
    """Return the JSON schema of the configuration of a fleet."""
    return section_schema(FleetSettings, "dynident fleet")


def read_fleet_settings(path: Path) -> FleetSettings:
    """Read the configuration (YAML) of a fleet; relative file names in it start at its folder.

    Raises ConfigError with the path of the wrong setting, its value and the choices.
    """
    data = load_yaml(config_text(path), str(path))
    try:
        return FleetSettings.model_validate(data, context={"folder": path.parent})
    except ValidationError as error:
        raise ConfigError(worded(error, data, str(path))) from None
