"""Text for what estimators that simulate have to say."""

from __future__ import annotations

from dynident.estimators.notes import Start, StartedElsewhere
from dynident.estimators.output_error import notes
from dynident.report.wording import words
from dynident.report.words import short

STARTS = {
    Start.SMOOTHED: "least squares of a smoothing spline",
    Start.KALMAN: "least squares of a Kalman smoother",
    Start.CONSISTENT: "the physically consistent fit",
    Start.INSTRUMENTS: "instrumental variables",
    Start.NOMINAL: "the values of the robot file",
    Start.MASS: "least squares with a positive definite mass matrix",
}


@words.register
def _(note: StartedElsewhere) -> str:
    return f"simulated, least squares fails or is farther off: the iteration began with {STARTS[note.start]}"


@words.register
def _(note: notes.StillSimulating) -> str:
    return (
        f"not converged: after {note.iterations} simulations the parameters still move, by "
        f"{short(note.moved, 2)} standard errors"
    )
