"""The logs of a fleet: found by a pattern, or listed in a table."""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, date, datetime, time
from difflib import get_close_matches
from hashlib import sha256
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Self

from pydantic import BeforeValidator, StrictBool, ValidationInfo, model_validator

from dynident.files.lerobot import recordings
from dynident.files.opener import (
    content,
    file_stamp,
    is_address,
    local_file,
    matching_files,
    real_path,
    remember_inputs,
    strip_scheme,
)
from dynident.files.results import read_table, table_kind
from dynident.files.tables import INFO_FILE, is_episode
from dynident.files.text import call_polars
from dynident.files.yaml_text import load_yaml
from dynident.project.config import config_text
from dynident.project.fields import CountOrEach, Name, Number, Section, TimeOffsetValue, Windows, bounded_reader
from dynident.project.result_format import section_schema
from dynident.runtime import ConfigError, InputError, choices, join_names

if TYPE_CHECKING:
    import polars as pl

RECIPE, NOTE, TABLE, REPORT, RUNS = "recipe.yaml", "fleet.json", "fleet.parquet", "report.html", "runs"
FILES = (RECIPE, NOTE, TABLE, REPORT)

PARTS = f"{TABLE}.parts"

# readable names of folders on any system: no device of Windows, no point at either end
PLAIN_NAME = re.compile(r"(?!(?i:con|prn|aux|nul|com\d|lpt\d)(\.|$))[\w-]([\w.-]{0,78}[\w-])?", re.ASCII)
PlainSettings = Mapping[str, Any]

FIELD = re.compile(r"\{([^{}]*)\}")
WILDCARDS = re.compile(r"(\*\*/?|\*|\?|\{[^{}]*\})")
FIELDS = ("robot", "date", "type")
REQUIRED_COLUMNS = ("log", "robot", "date")
COLUMNS = (*REQUIRED_COLUMNS, "type", "hold_out")
FORMATS = ("%Y-%m-%d_%H-%M-%S", "%Y-%m-%dT%H-%M-%S", "%Y-%m-%d_%H-%M", "%Y%m%d_%H%M%S", "%Y%m%d-%H%M%S",
           "%Y-%m-%d-%H-%M-%S", "%Y_%m_%d", "%Y/%m/%d")  # fmt: skip
DATE_FORMAT_HINT = "give `date_format`, such as %d.%m.%Y, if they are written in another way than in ISO 8601"


def folder_names(names: Iterable[str]) -> dict[str, str]:
    """Return a folder for each name, by name: readable, the same in every run, and never one for two names.

    A name of letters, digits, points, hyphens and underscores is its own folder. In others, in those that are too
    long, and those that are alike on a system that ignores case, what is odd is an underscore, and a digest follows.

    >>> folder_names(["arm-1", "../etc"])
    {'arm-1': 'arm-1', '../etc': '_etc=f7f9121fdb53'}
    """
    folders = dict.fromkeys(names, "")
    count = Counter(map(str.casefold, folders))
    for name in folders:
        folders[name] = name if PLAIN_NAME.fullmatch(name) and count[name.casefold()] == 1 else _digest_name(name)
    return folders


def _digest_name(name: str) -> str:
    """Return a name of a folder that no other has: a plain one has no =."""
    digest = sha256(name.encode("utf-8", "surrogatepass")).hexdigest()[:12]
    return f"{re.sub(r'[^a-zA-Z0-9-]+', '_', name)[:60]}={digest}"


def is_result(file: Path, out: Path) -> bool:
    """Whether a file is one that a fleet writes to its folder ``out``; others may be there, too."""
    top = next(iter(file.relative_to(out).parts), None) if file.is_relative_to(out) else None
    return top in (*FILES, RUNS, PARTS)


def _read_file_name(value: object, info: ValidationInfo) -> Path:
    """Read a file name; a relative one starts at the folder of the configuration."""
    if not isinstance(value, str | Path) or not str(value).strip():
        raise ValueError("a file name is expected")
    return Path((info.context or {}).get("folder", "."), str(value))


Share = Annotated[float, BeforeValidator(bounded_reader(1e-4, 0.5))]  # a smaller rate needs too many draws
FileName = Annotated[Path, BeforeValidator(_read_file_name)]


class RobotChanges(Section):
    """What differs from the recipe for one robot: keys of ``model`` (such as a calibrated ``file`` or ``base_tilt``),
    and of the channels by joint (``gain``, ``offset``, ``column``), ``transmission``, ``zero`` and ``time_offset``.

    ``type`` is that of the robot: those of one type are compared with each other.
    """

    type: Name | None = None
    model: str | PlainSettings = {}  # noqa: RUF012 -- pydantic copies it
    position: Mapping[Name, PlainSettings] = {}
    torque: Mapping[Name, PlainSettings] = {}
    transmission: Mapping[Name, Mapping[Name, Number]] = {}
    zero: Mapping[Name, Number] = {}
    time_offset: TimeOffsetValue | None = None

    @model_validator(mode="after")
    def _check_terms(self) -> Self:
        if isinstance(self.model, Mapping) and "terms" in self.model:
            raise ValueError("`model.terms` are those of the recipe for all robots, so that they can be compared")
        return self

    @property
    def changes(self) -> dict[str, Any]:
        """The settings to merge into those of the recipe."""
        set_fields = {name: getattr(self, name) for name in self.model_fields_set - {"type"}}
        return {name: value for name, value in set_fields.items() if value not in (None, {})}


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
    logs: Name | None = None
    table: Name | None = None
    date_format: Name | None = None
    window: Windows = ()
    width: CountOrEach = None
    type: Name = "robot"
    robots: Mapping[Name, RobotChanges] = {}
    false_alarms: Share = 0.01
    reports: StrictBool = True

    @model_validator(mode="after")
    def _check_logs_or_table(self) -> Self:
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
    return FleetSettings.read(data, str(path), folder=path.parent)


@dataclass(frozen=True)
class FleetLog:
    """One recording of one robot: ``log`` is its path, as seen from the fleet's configuration, or its address.

    ``stamp`` tells whether the file is as it was, "" where there is none. ``hold_out`` is the recording to judge the
    model by. ``fault`` says why the log cannot be identified, before it is read.
    """

    robot: str
    log: str
    date: datetime | None
    type: str
    stamp: str = ""
    hold_out: str = ""
    fault: str = ""


def fleet_logs(
    settings: FleetSettings, folder: Path, out: Path | None = None
) -> tuple[list[FleetLog], tuple[str, ...]]:
    """Return the logs of a fleet whose configuration is in ``folder``, by robot and date, and warnings.

    A pattern does not find the results, which are in the folder ``out``. A log without a readable date, or without a
    file, has a ``fault``. Raises ConfigError where the pattern or table cannot be used or has no log, InputError where
    files cannot be listed.
    """
    logs, warnings = _logs_by_pattern(settings, folder, out) if settings.logs else _logs_by_table(settings, folder)
    if not logs:
        where = "write one in each row." if settings.table else f"the pattern starts in {folder.resolve()}."
        raise InputError(f"{settings.logs or settings.table}: there is no log; {where}")
    if all(log.date is None for log in logs):
        raise ConfigError(f"no date of {len(logs)} logs can be read: {logs[0].fault}.")
    robots = list(dict.fromkeys(log.robot for log in logs))
    absent = [name for name in settings.robots if name not in robots]
    if absent:
        warnings = (*warnings, f"robots: there is no log of {join_names(absent)}; {choices(absent[0], robots)}")
    for log in logs:
        if log.stamp and not is_address(log.log):
            remember_inputs(folder / log.log)
    return sorted(logs, key=lambda log: (log.robot, log.date or datetime.max, log.log)), warnings


def _logs_by_pattern(settings: FleetSettings, folder: Path, out: Path | None) -> tuple[list[FleetLog], tuple[str, ...]]:
    pattern = settings.logs or ""
    _check_fields(pattern)
    inside = strip_scheme(pattern)
    name_pattern = re.compile(_field_expression(inside))
    logs, results = [], 0
    glob = FIELD.sub("*", pattern.replace("[", "[[]"))  # a field is anything within one folder
    files, links = matching_files(glob, folder)
    for file in files:
        if not (fields := name_pattern.fullmatch(file.match_name)):
            continue
        # a wide pattern also matches the results of earlier runs
        if out is not None and not is_address(file.name) and is_result(real_path(folder / file.name), real_path(out)):
            results += 1
        else:
            for log in recordings([file.name], folder):
                log_stamp = file.stamp if log == file.name else _table_stamp(log, folder)[0]
                logs.append(_fleet_log({"log": log, **fields.groupdict()}, settings, log_stamp))
    if results and not logs:
        raise InputError(
            f"{pattern}: there is no log but those where results are written; choose a folder beside {out}."
        )
    repeats = f"logs: {join_names(links, 3)}: links to folders that are listed already, whose logs count once."
    return logs, (repeats,) if links else ()


def _check_fields(pattern: str) -> None:
    fields = FIELD.findall(pattern)
    for name in fields:
        if name not in FIELDS:
            raise ConfigError(f"logs: {pattern!r} has the field {name!r}; {choices(name, FIELDS)} Anything else is *.")
    for name in FIELDS[:2]:
        if name not in fields:
            raise ConfigError(
                f"logs: {pattern!r} lacks the field {{{name}}}; write such as logs/{{robot}}/{{date}}.csv."
            )


def _field_expression(pattern: str) -> str:
    """Return the expression that finds the fields in names; a field that stands twice has one value."""
    words, used_fields = "", set[str]()
    for part in WILDCARDS.split(pattern):
        name = part[1:-1]
        if part.startswith("{"):
            words += f"(?P={name})" if name in used_fields else f"(?P<{name}>[^/]+?)"
            used_fields.add(name)
        else:
            words += {"**/": "(?:.*/)?", "**": ".*", "*": "[^/]*", "?": "[^/]"}.get(part, re.escape(part))
    return words


def _logs_by_table(settings: FleetSettings, folder: Path) -> tuple[list[FleetLog], tuple[str, ...]]:
    name = settings.table or ""
    with local_file(name, folder) as path:
        remember_inputs(path)
        table = _read_fleet_table(path, name)
    for column in REQUIRED_COLUMNS:
        if column not in table.columns:
            raise ConfigError(f"{name}: has no column {column!r}; {choices(column, table.columns)}")
    unknown = [column for column in table.columns if column not in COLUMNS]
    unknown.sort(key=lambda entry: not get_close_matches(entry, COLUMNS))  # misspelt ones first
    warnings = [f"{name}: the column {entry!r} is not used; {choices(entry, COLUMNS)}" for entry in unknown[:3]]
    if unknown[3:]:
        warnings.append(f"{name}: nor are {join_names(unknown[3:])}.")
    logs: dict[tuple[str, str], FleetLog] = {}
    for row, cells in enumerate(table.select([entry for entry in COLUMNS if entry in table.columns]).to_dicts(), 1):
        absent = [column for column in ("log", "robot") if cells[column] is None or not str(cells[column]).strip()]
        if absent:
            warnings.append(f"{name}: row {row} is left out: it has no {' and no '.join(absent)}.")
            continue
        log = _fleet_log(cells, settings, *_table_stamp(str(cells["log"]).strip(), folder))
        # two names of one file are one log
        key = log.robot, os.path.realpath(folder / log.log) if log.stamp and not is_address(log.log) else log.log
        if logs.setdefault(key, log) is not log:
            warnings.append(f"{name}: row {row} is left out: it lists {log.log!r} of robot {log.robot!r} again.")
    return list(logs.values()), tuple(warnings)


def _table_stamp(name: str, folder: Path) -> tuple[str, str]:
    """Return the stamp of a log, and why it cannot be had where a store does not answer: that row alone fails."""
    try:
        # of an episode, the stamp of its data set
        file = f"{Path(name).parent.as_posix()}/{INFO_FILE.as_posix()}" if is_episode(Path(name)) else name
        return file_stamp(file, folder), ""
    except InputError as error:
        return "", str(error).rstrip(".")


def _read_fleet_table(path: Path, name: str) -> pl.DataFrame:
    """Return a table, of CSV as texts: a serial number 007 is no 7."""
    import polars as pl

    if table_kind(path) == ".parquet":
        return read_table(path)
    data = content(path, weight=20, remember=False)
    try:
        return call_polars(lambda: pl.read_csv(BytesIO(data), infer_schema=False))
    except (pl.exceptions.PolarsError, ValueError) as error:
        raise ConfigError(f"{name}: is no table of texts between commas ({error}).") from error


def _fleet_log(cells: Mapping[str, Any], settings: FleetSettings, stamp: str, fault: str = "") -> FleetLog:
    robot, log = str(cells["robot"]).strip(), str(cells["log"]).strip()
    robot_changes = settings.robots.get(robot)
    kind = str(cells.get("type") or (robot_changes.type if robot_changes else None) or settings.type)
    day = parse_date(cells["date"], settings.date_format)
    faults = [fault] if fault else list(_log_faults(cells, day, stamp, settings.date_format))
    return FleetLog(robot, log, day, kind, stamp, str(cells.get("hold_out") or ""), "; ".join(faults))


def _log_faults(cells: Mapping[str, Any], day: datetime | None, stamp: str, format_: str | None) -> Iterator[str]:
    if not stamp:
        yield f"{cells['log']}: there is no such file"
    if day is None:
        how = f"it is not as date_format {format_!r} says" if format_ else DATE_FORMAT_HINT
        yield f"the date {str(cells['date'])!r} of {cells['log']} cannot be read: {how}"


def parse_date(raw_date: object, format_: str | None = None) -> datetime | None:
    """Return a date, with the time of day where there is one; with a zone as UTC. None where it cannot be read.

    >>> parse_date("2026-11-22_10-30-00")
    datetime.datetime(2026, 11, 22, 10, 30)
    """
    if isinstance(raw_date, datetime):
        return _naive_utc(raw_date)
    if isinstance(raw_date, date):
        return datetime.combine(raw_date, time())
    text = str(raw_date).strip() if raw_date is not None else ""
    # ISO 8601 first, then formats that are common in file names
    if format_ is None:
        with suppress(ValueError):
            return _naive_utc(datetime.fromisoformat(text))
    for pattern in (format_,) if format_ else FORMATS:
        with suppress(ValueError):
            return _naive_utc(datetime.strptime(text, pattern))
    return None


def _naive_utc(moment: datetime) -> datetime:
    return moment.astimezone(UTC).replace(tzinfo=None) if moment.tzinfo else moment
