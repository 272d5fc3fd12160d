"""Rows of long work in a file that grows: parts, each written whole, that are merged into one table in the end."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import polars as pl

__all__ = ["RowStore"]


class RowStore:
    """Rows of a table at ``path`` (Parquet), one for each key; in memory only, where that is None.

    ``schema`` has the type of each column, ``key`` the columns that tell a row from all others. As a context it holds
    the table alone: InputError where another run does, or where a file there is not such a table.
    """

    def __init__(
        self, path: str | Path | None, schema: Mapping[str, Any], key: Sequence[str], *, rerun: bool = False
    ) -> None:
        self.path = None if path is None else Path(path)
        self.schema, self.key, self.rerun = dict(schema), tuple(key), rerun
        self._rows: dict[tuple[Any, ...], dict[str, Any]] = {}

    def __enter__(self) -> RowStore:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Merge the parts into the table."""

    def __contains__(self, key: object) -> bool:
        return key in self._rows

    def __len__(self) -> int:
        return len(self._rows)

    def add(self, rows: Sequence[Mapping[str, Any]]) -> None:
        """Add rows; one of a key that is known replaces it. They are on the disk within seconds."""
        for row in rows:
            self._rows[tuple(row[name] for name in self.key)] = dict(row)

    def table(self) -> pl.DataFrame:
        """Return all rows."""
        import polars as pl

        return pl.DataFrame(list(self._rows.values()), schema=self.schema)
