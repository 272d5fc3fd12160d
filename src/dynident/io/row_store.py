"""Rows of long work in a file that grows: parts, each written whole, that are merged into one table in the end.

Beside a table ``study.parquet`` lies the folder ``study.parquet.parts`` while it grows. Every two seconds the new rows
become one more file there, so that saving a row costs the same however many there are; a run that is killed loses
those of the last seconds. Who starts next reads the keys of the table and of the parts. Of two rows with one key that
in the later part counts. The end joins all parts, in pieces, into the table, which takes its name when it is whole, and
then removes them, the oldest first: whatever is left of them, the last row of each key still counts.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack, nullcontext, suppress
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path
from threading import RLock, Timer
from types import TracebackType
from typing import TYPE_CHECKING, Any, TypeVar
from uuid import uuid4

from dynident.errors import InputError, listed
from dynident.io.folder import held, whole_file
from dynident.io.opener import afford, opened
from dynident.io.results import write_table
from dynident.io.text import unpanicked

if TYPE_CHECKING:
    import polars as pl

__all__ = ["RowStore", "parts_folder"]

T = TypeVar("T")
Key = tuple[Any, ...]
SAVE_EVERY = 2.0  # s from a row to the part that holds it
SLOWER = 1000  # parts, after each of which this takes as long again, or a long study would leave too many files
MOST = 20_000  # rows in memory that are not yet in a part
GROUP = 50_000  # rows of the table that a reader takes at once
KEY_BYTES = 300  # memory of a key
PART = re.compile(r"(\d{4,})-[0-9a-f]{8}\.parquet")


@dataclass(frozen=True, eq=False)
class _Part:
    """Rows that belong together: a file, or a table in memory; ``replaced`` are the keys of which a later part has
    another row."""

    rows: pl.LazyFrame
    count: int
    path: Path | None = None
    replaced: list[Key] = field(default_factory=list)


class RowStore:
    """Rows of a table at ``path`` (Parquet), one for each key; in memory only, where that is None.

    ``schema`` has the type of each column, ``key`` the columns that tell a row from all others, ``added`` those that
    older tables lack, empty there. Rows of an earlier run are known, ``key in store``, but for those that have in a
    column one of the values that ``again`` names for it; with ``rerun`` none is. What is not known stays until a row of
    its key is added. As a context it holds the table alone: InputError where another run does, where a file there is
    not of such a table, or the disk is full. The rows may be asked for at any time, of a file from its ``with`` on.
    """

    def __init__(
        self,
        path: str | Path | None,
        schema: Mapping[str, Any],
        key: Sequence[str],
        *,
        rerun: bool = False,
        added: Sequence[str] = (),
        again: Mapping[str, Iterable[Any]] | None = None,
    ) -> None:
        self.path = None if path is None else Path(path)
        self.schema, self.key, self.rerun = dict(schema), tuple(key), rerun
        self.added, self.again = tuple(added), {name: list(values) for name, values in (again or {}).items()}
        self._parts: list[_Part] = []
        self._latest: dict[Key, int] = {}  # the number of the part with the row that counts; ~number of one not known
        self._count = 0
        self._new: dict[Key, Mapping[str, Any]] = {}  # the next part
        self._lock = RLock()
        self._timer: Timer | None = None
        self._error: Exception | None = None
        self._held = ExitStack()

    @property
    def folder(self) -> Path | None:
        """The folder of the parts."""
        return None if self.path is None else parts_folder(self.path)

    def __enter__(self) -> RowStore:
        if self.path is None or self.folder is None:
            return self
        if self.path.suffix.lower() != ".parquet":
            raise InputError(f"{self.path}: rows are kept in Parquet files; give a name that ends in .parquet.")
        with ExitStack() as stack:
            stack.callback(_remove_empty, self.folder)
            stack.enter_context(held(self.folder))
            parts = [one for one in self.folder.iterdir() if PART.fullmatch(one.name)]
            for file in [self.path] * self.path.exists() + sorted(parts, key=_number):
                self._read(file)
            self._held = stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Save all rows and merge the parts into the table; where that fails after an error, they stay as they are."""
        with self._held, suppress(InputError) if isinstance(error, Exception) else nullcontext():
            if self._timer is not None:
                self._timer.cancel()
            self.save()
            self._merge()

    def __contains__(self, key: object) -> bool:
        return key in self._new or self._latest.get(key, -1) >= 0  # type: ignore[call-overload]

    def __len__(self) -> int:
        return self._count

    def add(self, rows: Iterable[Mapping[str, Any]]) -> None:
        """Add rows; one of a key that is known replaces it. They are on the disk within seconds.

        Raises InputError where those before could not be written.
        """
        with self._lock:
            if self._error is not None:
                raise self._error
            for row in rows:
                if unknown := row.keys() - self.schema.keys():
                    raise ValueError(f"the table has no columns {sorted(unknown)}")
                key = tuple(row[name] for name in self.key)
                self._count += key not in self
                self._new[key] = row
                if len(self._new) >= MOST:
                    self.save()
            if self._new and self.path is not None and self._timer is None:
                self._timer = Timer(SAVE_EVERY * (1 + len(self._parts) // SLOWER), self._in_time)
                self._timer.daemon = True
                self._timer.start()

    def save(self) -> None:
        """Write the rows that are not yet in a part; InputError where that is impossible, and they stay in memory."""
        import polars as pl

        with self._lock:
            if not self._new:
                return
            frame, path = pl.DataFrame(list(self._new.values()), schema=self.schema), None
            if self.folder is not None:
                last = _number(self._parts[-1].path) if self._parts else 0
                path = write_table(self.folder / f"{last + 1:04d}-{uuid4().hex[:8]}.parquet", frame)
            for key in self._new:  # in this order: Ctrl-C may come between any two steps
                self._place(key, len(self._parts))
            self._parts.append(_Part(frame.lazy() if path is None else _scan(path), len(frame), path))
            self._new = {}

    def scan(self) -> pl.LazyFrame:
        """Return all rows, to be read when they are collected."""
        import polars as pl

        self.save()
        frames = [pl.LazyFrame(schema=self.schema)]
        for whole, parts in groupby(
            list(self._parts), lambda part: not part.replaced and part.path not in (None, self.path)
        ):
            if whole:
                frames.append(_scan(*(part.path for part in parts)))
                continue
            for part in parts:
                if not part.replaced:
                    frames.append(part.rows)
                elif len(part.replaced) < part.count:
                    kinds = {name: self.schema[name] for name in self.key}
                    gone = pl.LazyFrame(part.replaced, schema=kinds, orient="row")
                    frames.append(part.rows.join(gone, on=self.key, how="anti"))
        return pl.concat(frames)

    def table(self, keys: pl.DataFrame | None = None) -> pl.DataFrame:
        """Return all rows, or those whose keys are among ``keys`` (a table of the columns of the key)."""
        rows = self.scan()
        if keys is None:
            count = sum(part.count for part in self._parts)
            afford(16 * count * len(self.schema), f"{self.path}: its {count} rows would take")
        else:
            rows = rows.join(keys.lazy(), on=self.key, how="semi")
        return self._done(rows.collect)

    def _in_time(self) -> None:
        with self._lock:
            self._timer = None
            try:
                self.save()
            except Exception as error:  # for the next call
                self._error = error

    def _place(self, key: Key, number: int, *, known: bool = True) -> None:
        """Note in which part the row of a key is."""
        before = self._latest.get(key)
        if before is not None:
            part = ~before if before < 0 else before
            if part < number:
                self._parts[part].replaced.append(key)
        self._latest[key] = number if known else ~number

    def _read(self, file: Path) -> None:
        """Read the keys of a file."""
        part, number = self._part(file), len(self._parts)
        self._parts.append(part)
        afford(KEY_BYTES * part.count, f"{file}: the keys of its {part.count} rows would take")
        keys = part.rows.select(*self.key, self._unknown().alias(""))
        shared: list[dict[Any, Any]] = [{} for _ in self.key]  # most values stand in many keys
        for start in range(0, part.count, GROUP):
            frame = self._done(keys.slice(start, GROUP).collect)
            for name in self.key:
                if frame[name].null_count():
                    raise _other(file, f"its column {name!r} has empty cells")
            for *values, unknown in frame.iter_rows():
                key = tuple(one.setdefault(value, value) for one, value in zip(shared, values, strict=True))
                if self._latest.get(key) in (number, ~number):
                    raise _other(file, "a row stands in it twice")
                self._count += (not unknown) - (key in self)
                self._place(key, number, known=not unknown)

    def _part(self, file: Path) -> _Part:
        import polars as pl

        with opened(file, remember=False):  # no pipe, and not too large
            pass
        try:
            schema = unpanicked(lambda: dict(pl.read_parquet_schema(file)))
            count = unpanicked(lambda: _scan(file).select(pl.len()).collect().item())
        except (pl.exceptions.PolarsError, ValueError, OSError) as error:
            raise _damaged(file, error) from error
        if reason := self._foreign(schema):
            raise _other(file, reason)
        columns = (name if name in schema else pl.lit(None, kind).alias(name) for name, kind in self.schema.items())
        return _Part(_scan(file).select(columns), int(count), file)

    def _unknown(self) -> pl.Expr:
        """Tell the rows that count as not known."""
        import polars as pl

        return pl.any_horizontal(pl.lit(self.rerun), *(pl.col(name).is_in(few) for name, few in self.again.items()))

    def _foreign(self, schema: Mapping[str, pl.DataType]) -> str:
        """Return why columns are not those of the table, empty where they are."""
        for name, kind in self.schema.items():
            if name not in schema:
                if name not in self.added:
                    return f"it has no column {name!r} (columns {listed(schema)})"
            elif schema[name] != kind:
                return f"its column {name!r} holds {schema[name]}, not {kind}"
        more = [name for name in schema if name not in self.schema]
        return f"its column {more[0]!r} is not known (columns {listed(self.schema)})" if more else ""

    def _merge(self) -> None:
        """Write all rows to the table, a piece at a time, and remove the parts."""
        import polars as pl

        files = [part.path for part in self._parts if part.path not in (None, self.path)]
        if self.path is None or not files:
            return
        try:
            with whole_file(self.path) as temporary:
                self._done(lambda: self.scan().sink_parquet(temporary, row_group_size=GROUP))
        except (pl.exceptions.PolarsError, ValueError, OSError) as error:
            reason = getattr(error, "strerror", None) or error
            raise InputError(
                f"{self.path}: cannot be written: {reason}; all rows are kept in {self.folder}. Make "
                "room or allow writing, and run the same command again."
            ) from error
        for file in files:
            file.unlink(missing_ok=True)
        self._parts = [_Part(_scan(self.path), len(self._latest), self.path)]

    def _done(self, read: Callable[[], T]) -> T:
        """Read the parts; InputError that names the one that is damaged."""
        import polars as pl

        try:
            return unpanicked(read)
        except (pl.exceptions.PolarsError, ValueError, OSError):
            for part in self._parts:
                try:
                    unpanicked(part.rows.collect)
                except (pl.exceptions.PolarsError, ValueError, OSError) as error:
                    raise _damaged(part.path, error) from error
            raise


def parts_folder(table: Path) -> Path:
    """Return the folder of the parts of a table."""
    return table.with_name(f"{table.name}.parts")


def _scan(*files: Path | None) -> pl.LazyFrame:
    import polars as pl

    return pl.scan_parquet(list(files), glob=False, hive_partitioning=False)  # type: ignore[arg-type]


def _number(file: Path | None) -> int:
    found = PART.fullmatch(file.name) if file else None
    return int(found[1]) if found else 0


def _damaged(file: Path | None, error: Exception) -> InputError:
    return InputError(f"{file}: is not a readable table ({error}); delete it and run again: its rows are made anew.")


def _other(file: Path, reason: str) -> InputError:
    return InputError(f"{file}: holds other rows: {reason}; choose another file or folder.")


def _remove_empty(folder: Path) -> None:
    with suppress(OSError):
        folder.rmdir()
