"""A fit in pieces, of recordings too long for the memory, in a report."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from dynident.identification import InPieces
from dynident.report import figures
from dynident.report.page import UNIT, Column, Figure, PageSection, PageTable, number
from dynident.report.wording import words
from dynident.report.words import percent

if TYPE_CHECKING:
    from dynident.identification import Identification

__all__ = ["pieces_section"]

_PIECES = (
    "The recordings are longer than the memory: their pieces were smoothed and fitted one after the other, and the "
    "parameters are those of all samples. Smoother, time offset, terms and whatever else was chosen come from "
    "excerpts; so do errors and figures of the training elsewhere on this page. Here is what is left of the torque in "
    "each piece: a residual that rises or falls shows friction, load or a sensor that changes, which one set of "
    "parameters cannot follow. Standard errors allow for any correlation within a piece."
)


@words.register
def _(note: InPieces) -> str:
    return (
        f"all {note.samples:,} samples ({_time(note.seconds)}) are fitted, in {note.pieces} pieces; what was chosen "
        f"before the fit, and errors and figures of the training, are of {note.excerpts} excerpts. Over all samples "
        f"the largest error is that of {note.joint}, {percent(note.error)}"
    )


def pieces_section(identification: Identification) -> Iterator[PageSection]:
    """Yield the section of the pieces, where there are any."""
    pieces = identification.estimate.residual.pieces
    if pieces is None:
        return
    joints = identification.model.joints
    figure = Figure(
        figures.pieces_figure(pieces, [joint.name for joint in joints]),
        "Residual of each joint in each piece, relative to its torque over all of them.",
    )
    heads = ("torque equations", "error, %", "rmse", "least rmse of a piece", "largest rmse of a piece")
    columns = (Column("joint", numeric=False), *map(Column, heads), UNIT)
    rows = []
    for j, (joint, error) in enumerate(zip(joints, pieces.relative_error, strict=True)):
        count, left = pieces.rows[:, j], pieces.residual[:, j]
        used = left[count > 0]
        whole = float(np.sqrt((count * left**2).sum() / max(int(count.sum()), 1)))
        ends = (float(used.min()), float(used.max())) if len(used) else (np.nan, np.nan)
        cells = (str(int(count.sum())), number(float(error), 3), *(number(x, 3) for x in (whole, *ends)))
        rows.append((joint.name, *cells, joint.effort))
    table = PageTable(columns, tuple(rows), "Torque error over all samples, unfiltered where the fit has no low-pass")
    yield PageSection("The whole recording", (_PIECES, table, figure))


def _time(seconds: float) -> str:
    return f"{seconds / 3600:.3g} h" if seconds >= 3600 else f"{seconds:.3g} s"
