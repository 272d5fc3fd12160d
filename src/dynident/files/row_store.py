"""Rows of long work in a growing file: parts, each written as a whole, are merged into one table in the end.

Beside a table ``study.parquet`` lies the folder ``study.parquet.parts`` while it grows. Every two seconds the
new rows become one more file there, so that saving a row costs the same however many there are; a killed run
loses only the rows of the last seconds. The next run reads the keys of the table and of the parts; of two
rows with one key, that in the later part counts. The end merges all parts, piece by piece, into the table,
which gets its name when it is complete (in memory, where rows were replaced), and then removes them, the oldest first:
whatever is left of them, the last row of each key still counts.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack, nullcontext, suppress
from pathlib import Path
from threading import RLock, Timer
from types import TracebackType
from typing import TYPE_CHECKING, Any, TypeVar
from uuid import uuid4

from dynident.files.folder import hold_folder, whole_file
from dynident.files.opener import afford, cause, open_input
from dynident.files.results import write_table
from dynident.files.text import call_polars
from dynident.runtime import InputError, Step, join_names, report_progress
from dynident.runtime.jobs import JobOptions, JobResult, run_jobs

if TYPE_CHECKING:
    import polars as pl

J = TypeVar("J")
T = TypeVar("T")
Key = tuple[Any, ...]
SAVE_EVERY = 2.0  # s from a row to the part that holds it
# parts, after each of which this takes as long again, or a long study would leave too many files
PARTS_PER_SLOWDOWN = 1000
MAX_UNSAVED_ROWS = 20_000  # rows in memory that are not yet in a part
ROWS_PER_GROUP = 50_000  # rows of the table that a reader takes at once
KEY_BYTES = 300  # memory of a key
PART_NAME = re.compile(r"(\d{4,})-[0-9a-f]{8}\.parquet")


class RowStore:
    """Rows of a table at ``path`` (Parquet), one for each key; in memory only, where the path is None.

    ``schema`` has the type of each column, ``key`` the columns that identify a row. Rows of an earlier run are known,
    ``key in store``, except those with a value that ``retried`` names for one of their columns; with ``rerun`` none
    is known. A row that is not known stays until a row of its key is added. As a context it holds the table
    exclusively: InputError where another run does, where a file is not of such a table, or the disk is full. The rows
    can be read at any time; those of a file after entering the context.
    """

    def __init__(
        self,
        path: str | Path | None,
        schema: Mapping[str, Any],
        key: Sequence[str],
        *,
        rerun: bool = False,
        retried: Mapping[str, Iterable[Any]] | None = None,
    ) -> None:
        self.path = None if path is None else Path(path)
        self.schema, self.key, self.rerun = dict(schema), tuple(key), rerun
        self.again = {name: list(values) for name, values in (retried or {}).items()}
        self._frames: list[pl.LazyFrame] = []  # the table of an earlier run, or what is in memory
        self._files: list[Path] = []  # the parts, whose rows come after those
        self._known: dict[Key, bool] = {}  # whether the row of a key is known, or only kept until there is another
        self._count, self._replaces = 0, False  # of known rows; whether a key has several rows
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
            stack.enter_context(hold_folder(self.folder))
            parts = [entry for entry in self.folder.iterdir() if PART_NAME.fullmatch(entry.name)]
            # the table first, then the parts by number: a later row of a key replaces an earlier one
            for file in [self.path] * self.path.exists() + sorted(parts, key=_part_number):
                self._read_keys(file)
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
        return bool(self._known.get(key, False))  # type: ignore[call-overload]

    def __len__(self) -> int:
        return self._count

    def add(self, rows: Iterable[Mapping[str, Any]]) -> None:
        """Add rows; a row with a known key replaces the earlier one. They are on the disk within seconds.

        Raises InputError where earlier rows could not be written.
        """
        with self._lock:
            if self._error is not None:
                raise self._error
            for row in rows:
                if unknown := row.keys() - self.schema.keys():
                    raise ValueError(f"the table has no columns {sorted(unknown)}")
                key = tuple(row[name] for name in self.key)
                self._new[key] = row
                self._note(key, is_known=True)
                if len(self._new) >= MAX_UNSAVED_ROWS:
                    self.save()
            if self._new and self.path is not None and self._timer is None:
                # parts become rarer with their number, so that their count stays moderate
                self._timer = Timer(SAVE_EVERY * (1 + len(self._files) // PARTS_PER_SLOWDOWN), self._save_from_timer)
                self._timer.daemon = True
                self._timer.start()

    def fill(
        self,
        work: Callable[[J], Any],
        jobs: Iterable[J],
        key: Callable[[J], Key],
        make_rows: Callable[[JobResult[J, Any]], Iterable[Mapping[str, Any]]],
        options: JobOptions,
        words: str,
    ) -> int:
        """Do the ``work`` of the jobs whose ``key`` is not known, add the rows of each result, and return their number.

        ``words`` name the step that is reported. Where it is stopped or fails, the error says what is kept.
        """
        pending = [job for job in jobs if key(job) not in self]
        report_progress(Step(words, 0, len(pending)))
        try:
            for count, result in enumerate(run_jobs(work, pending, options.executor, limits=options.limits), 1):
                self.add(make_rows(result))
                report_progress(Step(words, count, len(pending)))
        except KeyboardInterrupt as stop:
            stop.add_note(self._stop_hint())
            raise
        except InputError as error:
            raise InputError(f"{error} {self._stop_hint()}") from error
        return len(pending)

    def _stop_hint(self) -> str:
        """Return what is kept of work that was stopped, as a sentence."""
        if self.path is None:
            return "No row is kept; name a folder for the results to keep them."
        if not len(self):
            return "No row was finished; run the same command again."
        return f"Finished rows are kept in {self.path}; run the same command again to go on."

    def save(self) -> None:
        """Write the rows that are not yet in a part; InputError where that fails, and they stay in memory."""
        import polars as pl

        with self._lock:
            if not self._new:
                return
            frame = pl.DataFrame(list(self._new.values()), schema=self.schema)
            if self.folder is None:
                self._frames, self._new = [*self._frames, frame.lazy()], {}
            else:
                # numbered on from the last part, so that the order of the parts is that of their names
                last = _part_number(self._files[-1]) if self._files else 0
                path = write_table(self.folder / f"{last + 1:04d}-{uuid4().hex[:8]}.parquet", frame)
                # both at once, lest Ctrl-C comes between and the rows are written twice
                self._files, self._new = [*self._files, path], {}

    def scan(self) -> pl.LazyFrame:
        """Return all rows as a query, read when it is collected."""
        import polars as pl

        self.save()
        parts = [_scan_files(*self._files)] if self._files else []
        rows = pl.concat([pl.LazyFrame(schema=self.schema), *self._frames, *parts])
        return rows.unique(self.key, keep="last", maintain_order=True) if self._replaces else rows

    def table(self, keys: pl.DataFrame | None = None) -> pl.DataFrame:
        """Return all rows, or those whose keys are in ``keys`` (a table of the key columns)."""
        rows = self.scan()
        if keys is None:
            count = len(self._known)
            afford(16 * count * len(self.schema), f"{self.path}: its {count} rows would take")
        else:
            rows = rows.join(keys.lazy(), on=self.key, how="semi")
        return self._run_query(rows.collect)

    def _save_from_timer(self) -> None:
        with self._lock:
            self._timer = None
            try:
                self.save()
            except Exception as error:  # for the next call
                self._error = error

    def _note(self, key: Key, *, is_known: bool) -> None:
        """Note that there is a row of a key, after which an earlier one does not count."""
        self._replaces |= key in self._known
        self._count += is_known - (key in self)
        self._known[key] = is_known

    def _read_keys(self, file: Path) -> None:
        """Read the keys of a file."""
        import polars as pl

        rows, count = self._open_table(file)
        afford(KEY_BYTES * count, f"{file}: the keys of its {count} rows would take")
        # keys only, in groups of rows, as the table may be larger than the memory
        again = (pl.col(name).is_in(values) for name, values in self.again.items())
        keys = rows.select(*self.key, pl.any_horizontal(pl.lit(self.rerun), *again).alias(""))
        # equal values share one object, which saves most of the memory of the keys
        pools: list[dict[Any, Any]] = [{} for _ in self.key]  # most values stand in many keys
        in_file = set[Key]()
        for start in range(0, count, ROWS_PER_GROUP):
            frame = self._run_query(keys.slice(start, ROWS_PER_GROUP).collect, file)
            for name in self.key:
                if frame[name].null_count():
                    raise _foreign_error(file, f"its column {name!r} has empty cells")
            for *values, unknown in frame.iter_rows():
                key = tuple(pool.setdefault(value, value) for pool, value in zip(pools, values, strict=True))
                if key in in_file:
                    raise _foreign_error(file, "a row stands in it twice")
                in_file.add(key)
                self._note(key, is_known=not unknown)
        if file == self.path:
            self._frames.append(rows)
        else:
            self._files.append(file)

    def _open_table(self, file: Path) -> tuple[pl.LazyFrame, int]:
        """Return the rows of a file, with the columns in their order, and their number."""
        import polars as pl

        with open_input(file, remember=False):  # no pipe, and not too large
            pass
        try:
            schema = call_polars(lambda: dict(pl.read_parquet_schema(file)))
            count = call_polars(lambda: _scan_files(file).select(pl.len()).collect().item())
        except (pl.exceptions.PolarsError, ValueError, OSError) as error:
            raise _damaged_error(file, error) from error
        if reason := self._schema_fault(schema):
            raise _foreign_error(file, reason)
        return _scan_files(file).select(list(self.schema)), int(count)

    def _schema_fault(self, schema: Mapping[str, pl.DataType]) -> str:
        """Return why a schema is not that of the table; empty where it is."""
        for name, kind in self.schema.items():
            if name not in schema:
                return f"it has no column {name!r} (columns {join_names(schema)})"
            if schema[name] != kind:
                return f"its column {name!r} holds {schema[name]}, not {kind}"
        extra = [name for name in schema if name not in self.schema]
        return f"its column {extra[0]!r} is not known (columns {join_names(self.schema)})" if extra else ""

    def _merge(self) -> None:
        """Merge all rows into the table, a piece at a time, and remove the parts."""
        import polars as pl

        if self.path is None or not self._files:
            return
        try:
            with whole_file(self.path) as temporary:
                self._run_query(lambda: self.scan().sink_parquet(temporary, row_group_size=ROWS_PER_GROUP))
        except (pl.exceptions.PolarsError, ValueError, OSError) as error:
            raise InputError(
                f"{self.path}: cannot be written: {cause(error)}; all rows are kept in {self.folder}. Make "
                "room or allow writing, and run the same command again."
            ) from error
        # only after the table has its name: until then the parts hold the rows
        for file in self._files:
            file.unlink(missing_ok=True)
        self._frames, self._files, self._replaces = [_scan_files(self.path)], [], False

    def _run_query(self, read: Callable[[], T], *files: Path) -> T:
        """Run a query over ``files``, by default all of the store; InputError that names a damaged one."""
        import polars as pl

        try:
            return call_polars(read)
        except (pl.exceptions.PolarsError, ValueError, OSError):
            # the query does not tell which file failed: each is read alone
            for file in files or [path for path in (self.path, *self._files) if path is not None and path.exists()]:
                try:
                    call_polars(_scan_files(file).collect)
                except (pl.exceptions.PolarsError, ValueError, OSError) as error:
                    raise _damaged_error(file, error) from error
            raise


def parts_folder(table: Path) -> Path:
    """Return the folder of the parts of a table."""
    return table.with_name(f"{table.name}.parts")


def _scan_files(*files: Path) -> pl.LazyFrame:
    import polars as pl

    return pl.scan_parquet(list(files), glob=False, hive_partitioning=False)


def _part_number(file: Path) -> int:
    match = PART_NAME.fullmatch(file.name)
    return int(match[1]) if match else 0


def _damaged_error(file: Path, error: Exception) -> InputError:
    return InputError(f"{file}: is not a readable table ({error}); delete it and run again: its rows are made anew.")


def _foreign_error(file: Path, reason: str) -> InputError:
    return InputError(f"{file}: holds other rows: {reason}; choose another file or folder.")


def _remove_empty(folder: Path) -> None:
    with suppress(OSError):
        folder.rmdir()
