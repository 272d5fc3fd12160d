"""The table of a fleet: one row for each log, and the histories in it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from dynident.fleets.history import History
from dynident.jobs import Status

if TYPE_CHECKING:
    from datetime import datetime

    import polars as pl

__all__ = ["KEY", "histories_of", "packed", "residuals_of", "schema", "unpacked"]

Array = NDArray[np.float64]
KEY = ("robot", "log", "recipe", "stamp")
DAY = 86_400.0  # s


def schema() -> dict[str, Any]:
    """Return the columns of the table, and their types.

    ``robot``, ``type``, ``log`` (its path or address as the fleet names it), ``date``; ``recipe``: digest of the recipe
    of that robot; ``stamp`` of the file, another one where it has changed; ``status`` (a ``Status`` of jobs),
    ``reason`` why there is no result; ``seconds`` it took, ``version`` of dynident; ``samples`` in use, ``verdict`` (a
    ``Use``; null where no log was held out); torque ``error`` (%) of all joints, ``errors`` (n) by joint, ``held_out``
    (n) those on a log that was held out, empty without; ``value`` (b) and ``information`` (b (b + 1) / 2, ``packed``)
    of the base parameters, and the ``residual`` (n) that they leave of the torque of each joint (N m, N; nan where the
    log does not tell it); ``folder`` of the run's result and report in that of the fleet, empty without.
    """
    import polars as pl

    floats = pl.List(pl.Float64)
    return {
        "robot": pl.String, "type": pl.String, "log": pl.String, "date": pl.Datetime("us"), "recipe": pl.String,
        "stamp": pl.String, "status": pl.String, "reason": pl.String, "seconds": pl.Float64,
        "version": pl.String, "samples": pl.Int64, "verdict": pl.String, "error": pl.Float64, "errors": floats,
        "held_out": floats, "value": floats, "information": floats, "residual": floats, "folder": pl.String,
    }  # fmt: skip


def packed(matrix: Array) -> list[float]:
    """Return the lower triangle of a symmetric matrix (b, b), row by row: b (b + 1) / 2 numbers."""
    return list(map(float, matrix[np.tril_indices(len(matrix))]))


def unpacked(numbers: Array, size: int) -> Array:
    """Return the symmetric matrices (..., b, b) of packed ones (..., b (b + 1) / 2)."""
    rows, columns = np.tril_indices(size)
    out = np.zeros((*np.shape(numbers)[:-1], size, size))
    out[..., rows, columns] = out[..., columns, rows] = numbers
    return out


def histories_of(rows: pl.DataFrame, start: datetime | None) -> Iterator[History]:
    """Yield the history of each robot that has a result, from the table of one recipe; days count from ``start``."""
    for robot, logs in _robots(rows):
        value = np.array(logs["value"].to_list(), dtype=float)
        information = unpacked(np.array(logs["information"].to_list(), dtype=float), value.shape[1])
        yield History(robot, tuple(logs["log"]), _days(logs, start), value, information)


def residuals_of(rows: pl.DataFrame, start: datetime | None) -> Iterator[History]:
    """Yield what the model leaves of the torque of each of these robots: value (K, n) is the logarithm of residuals.

    Its information is that of white residuals, twice the samples; what more it scatters is found from the fleet.
    """
    for robot, logs in _robots(rows):
        residual = np.array(logs["residual"].to_list(), dtype=float)
        told = np.isfinite(residual) & (residual > 0)
        information = 2.0 * logs["samples"].to_numpy()[:, None] * told
        value = np.log(np.where(told, residual, 1.0))
        yield History(
            robot, tuple(logs["log"]), _days(logs, start), value, information[:, :, None] * np.eye(value.shape[1])
        )


def _robots(rows: pl.DataFrame) -> Iterator[tuple[str, pl.DataFrame]]:
    import polars as pl

    good = rows.filter(pl.col("status") == Status.OK).sort("robot", "date", "log")
    for (robot,), logs in good.group_by("robot", maintain_order=True):
        yield str(robot), logs


def _days(logs: pl.DataFrame, start: datetime | None) -> Array:
    return np.array([(one - start).total_seconds() / DAY for one in logs["date"]])
