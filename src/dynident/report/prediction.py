"""The report of ``dynident predict``: errors on new recordings, and the table of measured and predicted torques."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from dynident.models import Joint
from dynident.report.page import UNIT, Column, PageTable, number

if TYPE_CHECKING:
    import polars as pl

    from dynident.validation import LogValidation

__all__ = ["prediction_frame", "prediction_table"]


def prediction_table(found: Sequence[LogValidation], joints: Sequence[Joint]) -> PageTable:
    """Return the errors per log and joint, for logs with measured torques."""
    rows: list[tuple[str, ...]] = []
    for log in found:
        errors = log.errors
        rows.append((log.name, "all", number(errors.relative_error, 3), number(errors.all_over_noise, 2), "-", "-"))
        rows += [
            (
                log.name,
                one.name,
                number(errors.per_joint[one.name], 3),
                number(errors.over_noise.get(one.name), 2),
                number(errors.rmse[one.name], 3),
                one.effort,
            )
            for one in joints
        ]
    words = (Column("log", numeric=False), Column("joint", numeric=False))
    numbers = map(Column, ("error, %", "times white noise", "rmse"))
    columns = (*words, *numbers, UNIT)
    return PageTable(columns, tuple(rows), "Torque error per log and joint, unfiltered")


def prediction_frame(found: Sequence[tuple[LogValidation, bool]]) -> pl.DataFrame:
    """Return all logs as one table, given with whether their torques were measured.

    Columns: log, t (s), used (False where smoothing is not accurate, at the ends), and per joint measured_NAME
    (null without measurement) and predicted_NAME, in N m or N.
    """
    import polars as pl

    parts = []
    for log, measured in found:
        motion = log.motion
        name = log.name.encode("utf-8", "backslashreplace").decode()  # a file's may be no text
        columns: dict[str, object] = {"log": [name] * len(motion), "t": motion.t, "used": motion.mask}
        for j, name in enumerate(motion.joints):
            seen = motion.tau[:, j] if measured else np.full(len(motion), np.nan)
            columns[f"measured_{name}"] = pl.Series(seen, nan_to_null=True)
            columns[f"predicted_{name}"] = log.predicted[:, j]
        parts.append(pl.DataFrame(columns))
    return pl.concat(parts)
