"""What is said of instruments."""

from __future__ import annotations

import pytest

from dynident.estimators import instruments as notes
from dynident.estimators.instruments import InstrumentKind
from dynident.report.terminal import words
from dynident.runtime import Note

SETTLED = "instruments have not settled after 2 simulations (the last one moved the value by 0.5 standard errors)"


@pytest.mark.parametrize(
    ("note", "said"),
    [
        (
            notes.InstrumentsUsed((InstrumentKind.SIMULATED,), 0.9876, None, "M", 2.345),
            "(least correlation with the regressor 0.988); least squares differs most in M, by 2.3 standard errors",
        ),
        (
            notes.InstrumentsUsed((InstrumentKind.REPEATED, InstrumentKind.LAGGED), 0.5, 0.0123),
            "another pass of the same motion, and the motion before and after each sample (least correlation",
        ),
        (
            notes.InstrumentsUsed((InstrumentKind.LAGGED,), 0.5, 0.0123),
            "regressor 0.5). That holds where noise of the positions is not correlated over 0.012 s",
        ),
        (
            notes.WeakInstruments("M", 0.0123, 1.5),
            "weak instruments: they hardly show M (correlation 0.012, F = 1.5, 10 would do)",
        ),
        (notes.NotSimulated("it runs away after 0.3 s"), "in the loop of the controller: it runs away after 0.3 s"),
        (notes.MotionMovesOn(2, 0.5), SETTLED),
        (notes.MotionMovesOn(2, 0.5, "its mass matrix is singular"), f"{SETTLED}: its mass matrix is singular"),
    ],
    ids=lambda one: type(one).__name__,
)
def test_notes_in_words(note: Note, said: str) -> None:
    assert said in words(note)
    assert not words(note).endswith(".")
