"""Every noun that a report may receive has words, and these hold its figures."""

from __future__ import annotations

import numpy as np
import pytest
from dynident.report.finding_words import finding_words

import dynident.apps.excitation.expected_report
import dynident.apps.payload.report  # noqa: F401  # their words are registered with them
from dynident.checks import notes as findings
from dynident.checks import robot_notes
from dynident.estimators import notes
from dynident.identification import Measure, NextStep, Origin, Reason, Remedy
from dynident.identification import verdict_steps as steps
from dynident.models.lagrangian import two_link_arm
from dynident.models.simulation import Broken, Failure, RunsAway, Singular
from dynident.regression import UnexcitedParameters
from dynident.report.words import Line, note_lines
from dynident.runtime import Finding, Note, Remark, Severity, percent
from dynident.validation import Cause, FrictionLevel, HighFrequency, LowFrequency, ResidualRipple, Reversals
from tests.classes import classes_of


def kinds(base: type) -> list[type]:
    """All classes below ``base`` of the library that have no class below them, or fields of their own."""
    below = [one for one in base.__subclasses__() if one.__module__.startswith("dynident.")]
    return [kind for one in below for kind in (one, *kinds(one)) if not _is_base(kind)]


def _is_base(kind: type) -> bool:
    return kind in (notes.Undetermined, notes.Unsettled, robot_notes.Costly, robot_notes.WrongValue)


@pytest.mark.parametrize("base", [Note, Cause, Failure, Reason, NextStep])
def test_every_noun_has_words(base: type) -> None:
    assert len(kinds(base)) > 1
    for kind in kinds(base):
        assert words.dispatch(kind) is not words.dispatch(object), kind


def test_findings_of_the_checks_are_among_the_notes() -> None:
    assert set(classes_of(findings)) <= set(kinds(Note))
    found = Finding(Severity.WARNING, "a", findings.ConstantTorque(1.0))
    assert finding_words(found) == words(found.message)


def test_every_choice_has_words() -> None:
    assert all(words(remedy).endswith(".") for remedy in Remedy)
    for excitation in steps.ExcitingMotion:
        said = words(steps.Sharpen("Fv", 1.0, 0.5, 12.3, excitation, None))
        assert said.startswith("Fv is 1 +- 0.5 (one standard error, 12 % of the torque): ")
        assert "the joints" in said


def test_a_noun_without_words_is_an_error() -> None:
    with pytest.raises(TypeError, match="there is no text for dict"):
        words({})


@pytest.mark.parametrize(
    ("noun", "said"),
    [
        (Remark("a: stale."), "a: stale."),
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
            UnexcitedParameters(("Fv_b", "Fc_b"), ("b",), still=("b",)),
            "Fv_b; Fc_b: not excited by these data; move b (at rest in these data: b).",
        ),
        (UnexcitedParameters(("x",), ("a", "b")), "x: not excited by these data; move a, b each by itself."),
        (
            UnexcitedParameters(("x",), ("a", "b"), together=True),
            "x: not excited by these data; move a, b at the same time.",
        ),
        (Reversals(), "friction around reversals"),
        (FrictionLevel(), "a wrong level of friction (it follows the sign of the velocity)"),
        (ResidualRipple(26.04), "a ripple at 26 Hz"),
        (LowFrequency(), "an error of the model or its parameters (mostly below 5 Hz)"),
        (HighFrequency(), "noise, ripple, elasticity or a time offset (mostly above 5 Hz)"),
        (RunsAway(0.1234), "the simulated position diverges after 0.123 s"),
        (Singular(), "the mass matrix is singular"),
        (Broken("no torque"), "no torque"),
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
        (Origin(Measure.RESIDUAL), "residual of the fit"),
        (Origin(Measure.SCATTER), "scatter between neighbouring samples"),
        (Origin(None, ("a",)), "as given"),
        (Origin(Measure.SCATTER, ("a",)), "as given for a; else scatter between neighbouring samples"),
        (
            steps.Sharpen("M", 5.0, 4.0, 43.2, steps.ExcitingMotion.ACCELERATE, "a"),
            (
                "M is 5 +- 4 (one standard error, 43 % of the torque): accelerate a harder, in several poses of the "
                "others."
            ),
        ),
        (
            steps.SlowReversals(("a", "b")),
            "a, b: record slow motion through zero speed, or try `coulomb_width` or `min_speed`.",
        ),
        (steps.SlowReversals(("a",), terms_chosen=True), "a: record slow motion through zero speed."),
        (
            steps.SlowReversals(("a",), (0.0312,), gain=0.456),
            (
                "a: record slow motion through zero speed, or try `coulomb_width` or `min_speed` (below 0.031 rad/s or "
                "m/s). May gain at most 0.46 points of the torque error."
            ),
        ),
        (
            steps.Sharpen("M", 5.0, 4.0, 43.2, steps.ExcitingMotion.ACCELERATE, "a", 1.83, gain=1e-3),
            (
                "M is 5 +- 4 (one standard error, 43 % of the torque): accelerate a harder, in several poses of the "
                "others, up to 1.8 times the speed. May gain less than 0.01 points of the torque error."
            ),
        ),
        (
            steps.LeaveOut("tuesday", 8.0, 9.96, 12.3, gain=1.24),
            (
                "tuesday: leave 8.00 to 9.96 s out of the training (`window`): predicted from the rest, their squared "
                "residual is 12 times that of the rest. Did the robot touch something there? May gain about 1.2 points "
                "of the torque error."
            ),
        ),
        (
            steps.Cover("fast", 1.0, 2.5, "a", 1.52, 3.14, gain=0.4),
            (
                "a: record a training motion 1.5 times as fast, up to 3.1 rad/s or m/s: fast is beyond what was "
                "trained, above all at 1.00 to 2.50 s. May gain about 0.4 points of the torque error."
            ),
        ),
        (
            steps.HoldOutFaster(2.52),
            "Record a held-out motion 2.5 times as fast, on other paths: little is seen of the inertias in a slow one.",
        ),
        (
            steps.SetRight(
                Finding(Severity.INFO, "a", robot_notes.MissingTerm(robot_notes.TermKind.VISCOUS, 1.0, 0.1, 0.3)),
                gain=0.5,
            ),
            (
                "a: the model lacks viscous friction. Add `viscous` to `terms` of the model. May gain about 0.5 points "
                "of the torque error."
            ),
        ),
        (
            steps.SetRight(
                Finding(Severity.WARNING, None, robot_notes.TiltedBase(0.01, -0.02, (1e-3, 1e-3), 6.0, 5.0))
            ),
            "set `base_tilt: estimate`: the base seems to be tilted by 0.57 deg about x and -1.15 deg about y.",
        ),
        (
            steps.CheckRipple(("a",)),
            "a: record constant speeds to see whether the ripple follows the position.",
        ),
    ],
)
def test_words_hold_the_figures(noun: object, said: str) -> None:
    assert words(noun) == said


def test_the_mass_matrix_says_where_it_is_weakest() -> None:
    arm, q = two_link_arm(), np.stack([np.zeros(5), np.linspace(0.0, np.pi, 5)], axis=1)
    assert arm.values is not None
    good = words(arm.check_mass_matrix(q, arm.values))
    assert good.startswith("The mass matrix is positive definite: smallest eigenvalue 0.00")
    wrong = arm.values.copy()
    wrong[2] = 0.02
    bad = words(arm.check_mass_matrix(q, wrong))
    assert "not positive definite: eigenvalue -0.0" in bad
    assert "at q = (0, 3.142)" in bad


def test_lines_say_how_serious_a_note_is() -> None:
    assert note_lines([Remark("stale."), notes.Averaged(3)]) == [
        Line("Warning: stale.", Severity.WARNING),
        Line("Note: each 3 neighbouring samples were averaged", Severity.INFO),
    ]


def test_shares_are_no_powers_of_ten() -> None:
    assert [percent(value, 2) for value in (0.0, 0.0004, 0.126, 5.0, 99.7, 100.0, 1234.0)] == [
        "0 %", "0.0004 %", "0.13 %", "5 %", "100 %", "100 %", "1234 %",
    ]  # fmt: skip
    assert percent(1e-7) == "1.00e-7 %"
