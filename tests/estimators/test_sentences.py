"""Each note of an estimate says its figures."""

from __future__ import annotations

import pytest

from dynident.estimators import instruments, notes
from dynident.estimators.instruments import InstrumentKind
from dynident.estimators.notes import FirstModel, StartedElsewhere, StillSimulating
from dynident.runtime import Note

SETTLED = "instruments have not settled after 2 simulations (the last one moved the value by 0.5 standard errors)"
SENTENCES = [
    (
        notes.RankDeficient(3, 5, ("Fc",), (("v1", "v2"),)),
        (
            "rank 3 of 5; no effect on the torque in these data: Fc (move the joints that excite them); only "
            "combinations are identifiable: v1, v2 (remove or fix all but one, or excite them differently)"
        ),
    ),
    (notes.RankDeficient(10, 20), "rank 10 of 20"),
    (notes.DecidedByPrior(20), "20 parameters are determined by the prior, not by the data"),
    (notes.NotIdentifiable(1), "1 parameter is determined by neither data nor prior"),
    (notes.NotByData(4), "4 parameters are not determined by the data alone"),
    (notes.NotAlone(("a", "b")), "not determined individually: a, b"),
    (
        notes.HeldByConstraints((("Ia_elbow", 8.04), ("forearm.mx", 3.5))),
        (
            "constraints hold these base parameters more than 3 standard errors (in brackets) from least squares: "
            "Ia_elbow (8.0), forearm.mx (3.5); the model lacks an effect, a sensor or a gain is off, or a limit is "
            "wrong. Their standard errors count this"
        ),
    ),
    (
        notes.PriorApproached(2e-3),
        "the prior was not reached exactly: the barrier method stopped at a duality gap of 2.0e-03",
    ),
    (
        notes.NotConverged(60, 3.21),
        "not converged after 60 steps: the likelihood may still increase by a factor of exp(3.2)",
    ),
    (notes.Failed("no luck"), "maximum likelihood failed, so this is its least-squares start: no luck"),
    (notes.MovingStart(1e-4), "the recordings do not start from rest (likelihood ratio test, p = 1.0e-04)"),
    (
        notes.StillMoving(9, 0.25),
        "not settled after 9 steps: the last one moved the parameters by 0.25 standard errors",
    ),
    (notes.Downweighted((("elbow", 0.1),)), "torques that look wrong count less than half: elbow 10 % of them"),
    (notes.DrawnToPrior(0.01), "drawn to the prior with a strength of 0.01, by cross-validation"),
    (
        notes.ErrorsInRegressor("m1", 36.0),
        (
            "along one direction, above all of m1, 36 % of what the motion shows are its own errors: the estimate "
            "there rests on their stated size"
        ),
    ),
    (notes.Averaged(3), "each 3 neighbouring samples were averaged"),
    (
        notes.SmoothSigns((0.0123, 0.4)),
        "the sign of the velocity in friction was replaced by tanh(dq / width), with widths 0.012, 0.4",
    ),
    (
        notes.NotWhite(0.456),
        (
            "the torque residuals are not white (correlation between neighbouring samples 0.46): they are more "
            "than noise, so compare with least squares on held-out motion"
        ),
    ),
    (
        notes.StillColoured("elbow", 0.456),
        (
            "after whitening, the torque residual of elbow is still correlated over time (0.46): it is more than "
            "autoregressive noise, so compare with least squares on held-out motion"
        ),
    ),
    (
        notes.WhiteningCostly("elbow", 1.239, chance=True),
        (
            "the fit to whitened rows leaves 1.24 times as much of the torque of elbow as least squares; slow "
            "noise may do that, and so may what the model lacks: compare with least squares on held-out motion"
        ),
    ),
    (
        notes.WhiteningCostly("elbow", 1.239),
        (
            "the fit to whitened rows leaves 1.24 times as much of the torque of elbow as least squares; such "
            "noise alone does not: it is what the model lacks, so that parameters may be many standard "
            "errors off, and least squares predicts better"
        ),
    ),
    (
        notes.ScatterLarger("Fc", 1.66),
        (
            "standard errors assume white residuals; from the scatter of the residuals over time, that of Fc is "
            "1.7 times as large"
        ),
    ),
    (
        notes.MotionCorrected("Izz1 + Ia1", 3.21),
        (
            "smoothing and the noise left in the motion bias least squares, Izz1 + Ia1 by 3.2 standard errors; "
            "predicted by a second smoothing with noise, this bias was subtracted"
        ),
    ),
    (
        notes.LimitedByMotion("Izz1 + Ia1", 3, 12),
        (
            "a longer recording does not help 3 of 12 base parameters, Izz1 + Ia1 above all: most of their "
            "standard errors is what errors of the smoothed motion leave; positions with less noise help"
        ),
    ),
    (
        notes.MotionTooNoisy("Izz1 + Ia1", 3.21),
        (
            "standard errors are too small: smoothing and the noise left in the motion bias Izz1 + Ia1 by about "
            "3.2 of them, too much to be corrected; use the estimator maximum_likelihood"
        ),
    ),
    (
        StartedElsewhere(FirstModel.INSTRUMENTS),
        "simulated, least squares fails or is farther off: the iteration began with instrumental variables",
    ),
    (
        StillSimulating(3, 12.345),
        "not converged: after 3 simulations the parameters still move, by 12 standard errors",
    ),
]
INSTRUMENTS = [
    (
        instruments.InstrumentsUsed((InstrumentKind.SIMULATED,), 0.9876, None, "M", 2.345),
        "(least correlation with the regressor 0.988); least squares differs most in M, by 2.3 standard errors",
    ),
    (
        instruments.InstrumentsUsed((InstrumentKind.REPEATED, InstrumentKind.LAGGED), 0.5, 0.0123),
        "another pass of the same motion, and the motion before and after each sample (least correlation",
    ),
    (
        instruments.InstrumentsUsed((InstrumentKind.LAGGED,), 0.5, 0.0123),
        "regressor 0.5). That holds where noise of the positions is not correlated over 0.012 s",
    ),
    (
        instruments.WeakInstruments("M", 0.0123, 1.5),
        "weak instruments: they hardly show M (correlation 0.012, F = 1.5, 10 would do)",
    ),
    (instruments.NotSimulated("it runs away after 0.3 s"), "in the loop of the controller: it runs away after 0.3 s"),
    (instruments.MotionMovesOn(2, 0.5), SETTLED),
    (instruments.MotionMovesOn(2, 0.5, "its mass matrix is singular"), f"{SETTLED}: its mass matrix is singular"),
]


@pytest.mark.parametrize(("note", "sentence"), SENTENCES, ids=lambda x: type(x).__name__)
def test_a_note_says_its_figures(note: Note, sentence: str) -> None:
    assert str(note) == sentence


@pytest.mark.parametrize(("note", "part"), INSTRUMENTS, ids=lambda x: type(x).__name__)
def test_a_note_on_instruments_says_its_figures(note: Note, part: str) -> None:
    assert part in str(note)
    assert not str(note).endswith(".")
