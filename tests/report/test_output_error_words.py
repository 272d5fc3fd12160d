"""What is said of estimations by simulation."""

from __future__ import annotations

import pytest

from dynident.estimators import Didim, OutputError
from dynident.estimators.notes import FirstModel, StartedElsewhere, StillSimulating
from dynident.report.terminal import words
from dynident.runtime import Note, part_text


@pytest.mark.parametrize(
    ("note", "said"),
    [
        (
            StartedElsewhere(FirstModel.INSTRUMENTS),
            "simulated, least squares fails or is farther off: the iteration began with instrumental variables",
        ),
        (
            StillSimulating(3, 12.345),
            "not converged: after 3 simulations the parameters still move, by 12 standard errors",
        ),
    ],
)
def test_notes_in_words(note: Note, said: str) -> None:
    assert words(note) == said


def test_estimators_in_words() -> None:
    assert part_text(Didim()) == "DIDIM, the torque of the simulated loop"
    assert part_text(OutputError("open", segment=0.5)).startswith(
        "output error of simulated positions, driven by the torque"
    )
