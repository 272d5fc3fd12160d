"""The logs of a fleet: found by a pattern, or listed in a table."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, date, datetime, time
from difflib import get_close_matches
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dynident.errors import ConfigError, InputError, choices, listed
from dynident.fleets.folders import is_result
from dynident.fleets.settings import FleetSettings
from dynident.io.opener import content, keep, real
from dynident.io.places import is_address, local_file, matching, placed, stamp_of
from dynident.io.results import read_table, table_kind
from dynident.io.text import unpanicked

if TYPE_CHECKING:
    import polars as pl

__all__ = ["FleetLog", "fleet_logs", "parse_date"]

FIELD = re.compile(r"\{([^{}]*)\}")
WILD = re.compile(r"(\*\*/?|\*|\?|\{[^{}]*\})")
FIELDS = ("robot", "date", "type")
NEEDED = ("log", "robot", "date")
COLUMNS = (*NEEDED, "type", "hold_out")
FORMATS = ("%Y-%m-%d_%H-%M-%S", "%Y-%m-%dT%H-%M-%S", "%Y-%m-%d_%H-%M", "%Y%m%d_%H%M%S", "%Y%m%d-%H%M%S",
           "%Y-%m-%d-%H-%M-%S", "%Y_%m_%d", "%Y/%m/%d")  # fmt: skip
OTHERWISE = "give `date_format`, such as %d.%m.%Y, if they are written in another way than in ISO 8601"


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
    found, warnings = _by_pattern(settings, folder, out) if settings.logs else _by_table(settings, folder)
    if not found:
        raise InputError(f"{settings.logs or settings.table}: there is no log; {_where(settings, folder)}")
    if all(one.date is None for one in found):
        raise ConfigError(f"no date of {len(found)} logs can be read: {found[0].fault}.")
    robots = list(dict.fromkeys(one.robot for one in found))
    absent = [name for name in settings.robots if name not in robots]
    if absent:
        warnings = (*warnings, f"robots: there is no log of {listed(absent)}; {choices(absent[0], robots)}")
    for one in found:
        if one.stamp and not is_address(one.log):
            keep(folder / one.log)
    return sorted(found, key=lambda one: (one.robot, one.date or datetime.max, one.log)), warnings


def _where(settings: FleetSettings, folder: Path) -> str:
    return "write one in each row." if settings.table else f"the pattern starts in {folder.resolve()}."


def _by_pattern(settings: FleetSettings, folder: Path, out: Path | None) -> tuple[list[FleetLog], tuple[str, ...]]:
    pattern = settings.logs or ""
    _check_fields(pattern)
    inside = placed(pattern)
    named = re.compile(_regex(inside))
    found, results = [], 0
    for file in matching(_glob(pattern), folder):
        if not (fields := named.fullmatch(file.matched)):
            continue
        if out is not None and not is_address(file.name) and is_result(real(folder / file.name), real(out)):
            results += 1
        else:
            found.append(_log({"log": file.name, **fields.groupdict()}, settings, file.stamp))
    if results and not found:
        raise InputError(
            f"{pattern}: there is no log but those where results are written; choose a folder beside {out}."
        )
    return found, ()


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


def _glob(pattern: str) -> str:
    """Return a pattern for ``glob``: a field is anything within one folder."""
    return FIELD.sub("*", pattern.replace("[", "[[]"))


def _regex(pattern: str) -> str:
    """Return the expression that finds the fields in names; a field that stands twice has one value."""
    words, seen = "", set[str]()
    for part in WILD.split(pattern):
        name = part[1:-1]
        if part.startswith("{"):
            words += f"(?P={name})" if name in seen else f"(?P<{name}>[^/]+?)"
            seen.add(name)
        else:
            words += {"**/": "(?:.*/)?", "**": ".*", "*": "[^/]*", "?": "[^/]"}.get(part, re.escape(part))
    return words


def _by_table(settings: FleetSettings, folder: Path) -> tuple[list[FleetLog], tuple[str, ...]]:
    name = settings.table or ""
    with local_file(name, folder) as path:
        keep(path)
        table = _read(path, name)
    for column in NEEDED:
        if column not in table.columns:
            raise ConfigError(f"{name}: has no column {column!r}; {choices(column, table.columns)}")
    unknown = [column for column in table.columns if column not in COLUMNS]
    unknown.sort(key=lambda one: not get_close_matches(one, COLUMNS))  # misspelt ones first
    warnings = [f"{name}: the column {one!r} is not used; {choices(one, COLUMNS)}" for one in unknown[:3]]
    if unknown[3:]:
        warnings.append(f"{name}: nor are {listed(unknown[3:])}.")
    found = []
    for row, given in enumerate(table.select([one for one in COLUMNS if one in table.columns]).to_dicts(), 1):
        for column in ("log", "robot"):
            if given[column] is None or not str(given[column]).strip():
                raise ConfigError(f"{name}: row {row} has no {column}.")
        found.append(_log(given, settings, stamp_of(str(given["log"]), folder)))
    count = Counter((one.robot, one.log) for one in found)
    if twice := [key for key, times in count.items() if times > 1]:
        raise ConfigError(f"{name}: lists the log {twice[0][1]!r} of robot {twice[0][0]!r} twice.")
    return found, tuple(warnings)


def _read(path: Path, name: str) -> pl.DataFrame:
    """Return a table, of CSV as texts: a serial number 007 is no 7."""
    import polars as pl

    if table_kind(path) == ".parquet":
        return read_table(path)
    data = content(path, weight=20, remember=False)
    try:
        return unpanicked(lambda: pl.read_csv(BytesIO(data), infer_schema=False))
    except (pl.exceptions.PolarsError, ValueError) as error:
        raise ConfigError(f"{name}: is no table of texts between commas ({error}).") from error


def _log(given: Mapping[str, Any], settings: FleetSettings, stamp: str) -> FleetLog:
    robot, log = str(given["robot"]).strip(), str(given["log"]).strip()
    own = settings.robots.get(robot)
    kind = str(given.get("type") or (own.type if own else None) or settings.type)
    day = parse_date(given["date"], settings.date_format)
    faults = list(_faults(given, day, stamp, settings.date_format))
    return FleetLog(robot, log, day, kind, stamp, str(given.get("hold_out") or ""), "; ".join(faults))


def _faults(given: Mapping[str, Any], day: datetime | None, stamp: str, format_: str | None) -> Iterator[str]:
    if not stamp:
        yield f"{given['log']}: there is no such file"
    if day is None:
        how = f"it is not as date_format {format_!r} says" if format_ else OTHERWISE
        yield f"the date {str(given['date'])!r} of {given['log']} cannot be read: {how}"


def parse_date(given: object, format_: str | None = None) -> datetime | None:
    """Return a date, with the time of day where there is one; with a zone as UTC. None where it cannot be read.

    >>> parse_date("2026-11-22_10-30-00")
    datetime.datetime(2026, 11, 22, 10, 30)
    """
    if isinstance(given, datetime):
        return _plain(given)
    if isinstance(given, date):
        return datetime.combine(given, time())
    text = str(given).strip() if given is not None else ""
    if format_ is None:
        with suppress(ValueError):
            return _plain(datetime.fromisoformat(text))
    for one in (format_,) if format_ else FORMATS:
        with suppress(ValueError):
            return _plain(datetime.strptime(text, one))
    return None


def _plain(given: datetime) -> datetime:
    return given.astimezone(UTC).replace(tzinfo=None) if given.tzinfo else given
