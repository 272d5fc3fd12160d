"""Episodes of LeRobot data sets, version 2 (a Parquet file for each) and 3 (several in a file).

An episode is named by its data set and number, ``folder/#3``. Its columns are those of the Parquet file; the elements
of a list have the names that ``meta/info.json`` gives them: ``observation.state.elbow``.
"""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from math import isfinite
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from dynident.files.opener import read_text
from dynident.files.parquet import count_rows, read_rows
from dynident.files.tables import INFO_FILE, DataTable, is_data_set, is_episode, read_columns, report_damage
from dynident.runtime import InputError, as_number, choices

FORMATS = ("v2.0", "v2.1", "v3.0")
CALIBRATION_FILE = Path("meta", "calibration.json")
TICKS_PER_TURN = 4096  # of the encoders of these servos
MAX_TEXT_WEIGHT = 20  # memory of JSON as objects, per byte of its text
MAX_EPISODES = 100  # that a folder alone stands for
MAX_ELEMENTS = 100_000  # of all lists, that get names
COUNTERS = ("frame_index", "episode_index", "index", "task_index")  # no signals: read where they are asked for
_FIELD = re.compile(r"\{(\w+)(?::0?(\d))?d?\}")
T = TypeVar("T")


@dataclass(frozen=True)
class DataSet:
    """A data set: its ``folder`` and what ``meta/info.json`` says: version, features, episodes, names of files."""

    folder: Path
    version: str
    features: Mapping[str, Any]
    episodes: int
    chunk_size: int
    data_path: str

    @classmethod
    def of(cls, folder: Path) -> DataSet:
        """Read ``meta/info.json``; InputError where it is missing, damaged, or of another version."""
        path = folder / INFO_FILE
        if not is_data_set(folder):
            raise InputError(f"{folder}: is no LeRobot data set, as it has no {INFO_FILE.as_posix()}.")
        info = _require(_read_json(path), dict, path, "the file")
        version = str(info.get("codebase_version"))
        if version not in FORMATS:
            raise InputError(
                f"{path}: codebase_version {version!r} cannot be read; {choices(version, FORMATS)} LeRobot converts "
                "older data sets."
            )
        chunk_size = _require(info.get("chunks_size", 1000), int, path, "chunks_size")
        return cls(
            folder,
            version,
            _require(info.get("features"), dict, path, "features"),
            _require(info.get("total_episodes"), int, path, "total_episodes"),
            max(chunk_size, 1),
            _require(info.get("data_path"), str, path, "data_path"),
        )

    def require_episode(self, number: int) -> None:
        """Raise InputError where there is no such episode."""
        if number >= self.episodes:
            numbers = f"its episodes are 0 to {self.episodes - 1}" if self.episodes else "it has none"
            raise InputError(f"{self.folder}: has no episode {number}; {numbers}.")

    def data_file(self, number: int) -> Path:
        """Return the Parquet file of an episode; InputError where it cannot be told, or is outside of the folder."""
        places = {"episode_chunk": number // self.chunk_size, "episode_index": number}
        if self.version == "v3.0":
            places |= self._chunk_and_file(number)

        def fill(match: re.Match[str]) -> str:
            name, width = match.groups()
            if name not in places:
                raise InputError(f"{self.folder / INFO_FILE}: data_path has {{{name}}}; {choices(name, places)}")
            return f"{places[name]:0{int(width or 0)}d}"

        # not str.format, by which a text from a file could reach anything
        name = Path(_FIELD.sub(fill, self.data_path))
        if name.is_absolute() or ".." in name.parts:
            raise InputError(f"{self.folder / INFO_FILE}: data_path {self.data_path!r} leads out of the data set.")
        return self.folder / name

    def _chunk_and_file(self, number: int) -> dict[str, int]:
        """Return where the tables of episodes say that an episode of version 3 is."""
        keys = {"chunk_index": "data/chunk_index", "file_index": "data/file_index"}
        for file in sorted(Path(self.folder, "meta", "episodes").glob("chunk-*/file-*.parquet")):
            table = read_columns(file, needed=["episode_index", *keys.values()])
            rows = np.flatnonzero(table.column("episode_index") == number)
            if len(rows):
                return {name: int(table.column(column)[rows[0]]) for name, column in keys.items()}
        raise InputError(
            f"{self.folder}: no table in meta/episodes says where episode {number} is; download this folder, too."
        )

    def column_names(self, column: str, width: int) -> list[str]:
        """Return the names of the elements of a list; numbers where ``meta/info.json`` has no name for each."""
        names = _feature_names(self.features.get(column))
        stems = [name.removesuffix(".pos") for name in names]
        names = stems if len(set(stems)) == len(stems) else names
        if len(names) != width or len(set(names)) < width:
            return [column] if width == 1 else [f"{column}[{k}]" for k in range(width)]
        return [f"{column}.{name}" for name in names]

    def file_names(self) -> dict[str, str]:
        """Return the names of the elements of all lists as the Parquet reader has them, by the names used here."""
        out = dict[str, str]()
        elements = 0
        for column, feature in self.features.items():
            shape = feature.get("shape") if isinstance(feature, Mapping) else None
            # images and the like have several dimensions, and are no columns
            if isinstance(shape, list) and len(shape) == 1 and isinstance(shape[0], int) and shape[0] > 0:
                elements += shape[0]
                if elements > MAX_ELEMENTS:
                    raise InputError(f"{self.folder / INFO_FILE}: its features have more than {MAX_ELEMENTS} elements.")
                plain = [column] if shape[0] == 1 else [f"{column}[{k}]" for k in range(shape[0])]
                names = self.column_names(column, shape[0]) if shape[0] > 1 else plain
                out |= dict(zip(names, plain, strict=True))
        return out


def _feature_names(feature: object) -> list[str]:
    """Return the names of a feature's elements: a list, or one below a key such as "motors"; none where there are
    others."""
    names = feature.get("names") if isinstance(feature, Mapping) else None
    if isinstance(names, Mapping) and len(names) == 1:
        (names,) = names.values()
    is_list = isinstance(names, list) and all(isinstance(name, str) and name.strip() for name in names)
    return list(names) if is_list and isinstance(names, list) else []


def read_episode(path: Path, needed: Collection[str] | None = None) -> DataTable:
    """Read an episode of a data set, or the only one of the folder.

    Scalars are ``calibration.<motor>``, in degrees per unit of a range from -100 to 100, where the file of LeRobot's
    calibration is in ``meta/calibration.json``. Raises InputError where the episode is not there, or is damaged.
    """
    data_set = DataSet.of(path.parent if is_episode(path) else path)
    if not is_episode(path) and data_set.episodes != 1:
        raise InputError(
            f"{path}: is a data set of {data_set.episodes} episodes, each a recording: name one, such as {path}/#0."
        )
    number = int(path.name[1:]) if is_episode(path) else 0
    data_set.require_episode(number)
    file, file_names = data_set.data_file(number), data_set.file_names()
    rows = _rows_of_episode(file, number)
    columns = None if needed is None else {file_names.get(name, name) for name in needed}
    table = read_rows(file, columns, rows)
    names = {plain: name for name, plain in file_names.items()}
    signals = {name: x for name, x in table.columns.items() if needed is not None or name not in COUNTERS}
    return replace(
        table,
        columns=_rename(signals, names, table.source),
        constants=_calibration(data_set.folder),
        faults={**table.faults} | {name: table.faults[column] for name, column in _elements(file_names, table.faults)},
        unread=tuple(
            dict.fromkeys(
                name
                for column in table.unread
                for name in ([key for key, _ in _elements(file_names, [column])] or [column])
            )
        ),
        units={**table.units, "timestamp": "s"},
    )


def _elements(file_names: Mapping[str, str], columns: Collection[str]) -> list[tuple[str, str]]:
    """Return the names of the elements of some columns that are lists, with the column."""
    pairs = ((name, plain.partition("[")[0]) for name, plain in file_names.items())
    return [(name, column) for name, column in pairs if column in columns]


def _rows_of_episode(file: Path, number: int) -> slice:
    """Return the rows of an episode in a file; InputError where it has none, or others lie between."""
    index = read_rows(file, ["episode_index"], slice(0, count_rows(file))).column("episode_index")
    rows = np.flatnonzero(index == number)
    if not len(rows):
        raise InputError(f"{file}: has no row of episode {number}, unlike meta/info.json says; download it again.")
    if rows[-1] - rows[0] + 1 != len(rows):
        raise InputError(f"{file}: the rows of episode {number} lie apart; write them to a file of their own.")
    return slice(int(rows[0]), int(rows[-1]) + 1)


def _rename(columns: Mapping[str, T], names: Mapping[str, str], source: str) -> dict[str, T]:
    """Return columns by other names; InputError where lists have more elements than the features say."""
    for name in columns:
        list_name, is_element, _ = name.partition("[")
        if is_element and name not in names and f"{list_name}[0]" in names:
            width, said = (sum(key.startswith(f"{list_name}[") for key in keys) for keys in (columns, names))
            raise InputError(
                f"{source}: {list_name!r} holds lists of {width} elements, but meta/info.json says {said}; "
                "one of the two is of another data set."
            )
    return {names.get(name, name): column for name, column in columns.items()}


def episode_files(path: Path) -> tuple[Path, ...]:
    """Return the files that an episode is read from; raises InputError as ``read_columns``."""
    with report_damage(path):
        data_set = DataSet.of(path.parent)
        return (data_set.folder / INFO_FILE, data_set.data_file(int(path.name[1:])))


def recordings(logs: Sequence[str], start: Path = Path()) -> list[str]:
    """Return the recordings that are named, seen from ``start``: a data set stands for all of its episodes.

    Raises InputError where it has more than 100, and as ``DataSet.of``.
    """
    names = list[str]()
    for log in logs:
        if not is_data_set(start / log):
            names.append(log)
            continue
        episodes = DataSet.of(start / log).episodes
        if not 0 < episodes <= MAX_EPISODES:
            raise InputError(f"{log}: has {episodes} episodes; name up to {MAX_EPISODES}, such as {log}/#0 {log}/#1.")
        names += [f"{log}/#{k}" for k in range(episodes)]
    return names


def _calibration(folder: Path) -> dict[str, float]:
    """Return degrees per unit of the range from -100 to 100 by motor, where there is a calibration."""
    path = folder / CALIBRATION_FILE
    if not path.exists():
        return {}
    out = {}
    for motor, entry in _require(_read_json(path), dict, path, "the file").items():
        ends = [entry.get(key) if isinstance(entry, Mapping) else None for key in ("range_min", "range_max")]
        low, high = map(as_number, ends)
        if not (isfinite(high - low) and high > low):
            raise InputError(
                f"{path}: range_min and range_max of {motor!r} are {ends[0]} and {ends[1]}; numbers are expected, the "
                "second the larger."
            )
        # a range of 200 units; the direction is that of the recording, as LeRobot turns it by drive_mode
        out[f"calibration.{motor}"] = (high - low) / 200 * 360 / TICKS_PER_TURN
    return out


def _read_json(path: Path) -> Any:
    try:
        return json.loads(read_text(path, weight=MAX_TEXT_WEIGHT))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: is no JSON ({error}).") from error


def _require(value: object, kind: type[T], path: Path, name: str) -> T:
    """Return a value of a kind; InputError where it is of another, or a negative number."""
    if not isinstance(value, kind) or isinstance(value, bool) or (isinstance(value, int) and value < 0):
        words = {dict: "a mapping", int: "a whole number", str: "a text"}[kind]
        raise InputError(f"{path}: {name} is {str(value)[:50]!r}; {words} is expected, as LeRobot writes it.")
    return value
