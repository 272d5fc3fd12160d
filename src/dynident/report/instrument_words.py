"""Text for what instrumental variables have to say of their instruments."""

from __future__ import annotations

from dynident.estimators.instrumental_variables import notes
from dynident.estimators.instrumental_variables.notes import InstrumentKind
from dynident.report.wording import words
from dynident.report.words import short

KINDS = {
    InstrumentKind.SIMULATED: "the motion that the model makes in the loop of the controller",
    InstrumentKind.REPEATED: "another pass of the same motion",
    InstrumentKind.LAGGED: "the motion before and after each sample",
}


@words.register
def _(note: notes.InstrumentsUsed) -> str:
    kinds = ", and ".join(KINDS[one] for one in note.kinds)
    moved = ""
    if note.parameter is not None:
        moved = f"; least squares differs most in {note.parameter}, by {short(note.moved, 2)} standard errors"
    white = ""
    if note.lag is not None:
        white = f". That holds where noise of the positions is not correlated over {short(note.lag, 2)} s"
    return f"instruments are {kinds} (least correlation with the regressor {short(note.correlation, 3)}){moved}{white}"


@words.register
def _(note: notes.WeakInstruments) -> str:
    return (
        f"weak instruments: they hardly show {note.parameter} (correlation {short(note.correlation, 2)}, F = "
        f"{short(note.statistic, 2)}, 10 would do); values and standard errors are not reliable there"
    )


@words.register
def _(note: notes.NotSimulated) -> str:
    return (
        "instruments were not simulated, as neither least squares nor the physically consistent model can be simulated "
        f"in the loop of the controller: {note.reason}"
    )


@words.register
def _(note: notes.MotionMovesOn) -> str:
    why = f": {note.reason}" if note.reason else ""
    return (
        f"instruments have not settled after {note.iterations} simulations (the last one moved the value by "
        f"{short(note.moved, 2)} standard errors){why}"
    )
