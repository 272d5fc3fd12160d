"""What is chosen before a fit, the reasons of a verdict and the next steps say their figures."""

from __future__ import annotations

import numpy as np
import pytest

from dynident.checks import robot_notes
from dynident.identification import BaseTilt, Gain, Measure, Origin, Remedy, Rests, SmootherChoice, TimeOffset
from dynident.identification import verdict as why
from dynident.identification import verdict_steps as steps
from dynident.identification.long import InPieces
from dynident.models.simulation import Singular
from dynident.motion.smoothers import Difference, Spline
from dynident.runtime import Finding, Severity
from dynident.validation import Driver

CHOICES = [
    (
        InPieces(100_000_000, 100_000.0, 1000, 6, "elbow", 7.321),
        (
            "all 100,000,000 samples (27.8 h) are fitted, in 1000 pieces; what was chosen before the fit, and "
            "errors and figures of the training, are of 6 excerpts. Over all samples the largest error is that "
            "of elbow, 7.32 %"
        ),
    ),
    (
        TimeOffset(0.005, 4.0, 2.0),
        "positions are stamped 5 ms later than torques; with it, the training error is 2 % instead of 4 %",
    ),
    (
        TimeOffset(-0.005, 4.0, 2.0),
        "torques are stamped 5 ms later than positions; with it, the training error is 2 % instead of 4 %",
    ),
    (TimeOffset(0.0, 4.0, 4.0), "no time offset, as none lowers the training error (4 %)"),
    (
        TimeOffset(0.0, 4.0, 4.0, 1e-4),
        "no time offset, as none lowers the training error (4 %) significantly; its standard error would be 0.1 ms",
    ),
    (
        TimeOffset(0.0021, 4.0, 2.0, 2e-4),
        "positions are stamped 2.1 +- 0.2 ms later than torques; with it, the training error is 2 % instead of 4 %",
    ),
    (
        BaseTilt(0.02, -0.035, (1e-3, 2e-3), 4.0, 2.0),
        (
            "the base is tilted by 1.15 deg about x and -2.01 deg about y (+- 0.06 and 0.11); with it, the "
            "training error is 2 % instead of 4 %"
        ),
    ),
    (
        BaseTilt(0.0, 0.0, (1e-3, 2e-3), 4.0, 4.0, Gain(31.2, 4.1), (1.57, 0.0)),
        (
            "the base is taken as level (+- 0.06 and 0.11 deg about x and y): the best tilt would gain 31 +- 4.1 % "
            "of the squared cross-validated error, but is 90.0 deg about x and 0.0 deg about y, more than a "
            "mounting error"
        ),
    ),
    (
        TimeOffset(0.0, 2.0, 2.0, 1e-3, Gain(-9.94, 12.2)),
        (
            "no time offset, as the best one does not predict left-out stretches better: -9.9 +- 12 % of the squared "
            "cross-validated error"
        ),
    ),
    (
        Rests("a", 4.7, 0.52, 0.0),
        "a: 4.7 s at its start and 0.52 s at its end, where the arm is at rest, are left out of fit and errors",
    ),
    (
        Rests("a", 0.0, 1.2, 2.5, Gain(12.3, 1.2)),
        (
            "a: 1.2 s at its end, where the arm is at rest, are left out of fit and errors; rests of 2.5 s within "
            "are left out of the fit, which gains 12 +- 1.2 % of the squared cross-validated error in motion"
        ),
    ),
    (
        Rests("a", 0.0, 0.0, 2.5, Gain(1.0, 2.0)),
        (
            "a: rests of 2.5 s within are fitted: without them 1 +- 2 % of the squared cross-validated error in "
            "motion would be gained"
        ),
    ),
    (Rests("a", 0.0, 0.0, 2.5), "a: rests of 2.5 s within are counted in its errors"),
    (
        SmootherChoice(Difference(), (Difference(), Spline()), (1.5, np.inf)),
        (
            "forward differences, by the cross-validated torque error on the training logs (forward differences: "
            "1.5 %; smoothing spline, S = n: cannot smooth these logs)"
        ),
    ),
    (Origin(Measure.RESIDUAL), "residual of the fit"),
    (Origin(Measure.SCATTER), "scatter between neighbouring samples"),
    (Origin(None, ("a",)), "as given"),
    (Origin(Measure.SCATTER, ("a",)), "as given for a; else scatter between neighbouring samples"),
]
REASONS = [
    (why.NoHoldOut(), "no log was held out, so the error on unseen motion is not known"),
    (why.NoFreeRun(), "no free simulation was run"),
    (why.InertiasFree(), "the bodies' inertias were not constrained to be physically consistent"),
    (why.NegativeValues(tuple("abcde")), "negative values, which are not physical: a, b, c, d, e"),
    (why.SlowHoldOut(0.25), "the held-out motion has only 25 % of the speed of the training"),
    (
        why.TrainedWorse("a", 55.4, 6.32),
        (
            "the error on a, which was fitted, is 55.4 %, 6.3 times the held-out error: outliers or a fault are "
            "in the fit"
        ),
    ),
    (
        why.HeldBack(25.0, 12.3),
        (
            "physical constraints hold the parameters far from what the data say (without them the residual "
            "would be 20 % smaller, and the torque at twice the speed would differ by 12 %): the model lacks an "
            "effect, or a gain, a unit or a direction is wrong"
        ),
    ),
    (
        why.DrawnBack(25.0, 12.3),
        (
            "the prior holds the parameters far from what the data say (without it the residual would be 20 % "
            "smaller, and the torque at twice the speed would differ by 12 %): the prior is wrong or too strong, "
            "or the model lacks an effect"
        ),
    ),
    (why.NegativeValues(tuple("abcdefg")), "negative values, which are not physical: a, b, c, d, e and 2 more"),
    (
        why.JointErrorsTooLarge("fast", (("a", 40.0), ("b", 26.4)), 25.0),
        "on fast some joints have a torque error above 25 %: a 40 %, b 26.4 %",
    ),
    (
        why.UnfilteredErrorTooLarge("fast", 26.0, 25.0),
        "unfiltered, the torque error on fast is 26 %, above 25 %",
    ),
    (why.TorqueErrorTooLarge("fast", 11.0, 10.0), "the torque error on fast is 11 %, above 10 %"),
    (
        why.NotCarriedOver("fast", 2.51),
        "the error on fast is 2.5 times the training error: the model does not generalise",
    ),
    (
        why.Repeats((("b", "a"),)),
        "b repeats the motion of a: the error on another motion is not known",
    ),
    (
        why.SilentTorque(("a", "b")),
        "the torque of a, b does not change in any training log",
    ),
    (why.MassMatrixNotPositive(-0.1), "the mass matrix is not positive definite (eigenvalue -0.1)"),
    (why.MostlyUnexcited(3, 7), "the data do not excite 3 of 7 base parameters"),
    (
        why.PartlyUnexcited(1, 7),
        "the data do not excite 1 of 7 base parameters: motions that do are not predicted",
    ),
    (why.FreeRunFails(("a", "b"), Singular()), "the free simulation of a, b fails: the mass matrix is singular"),
    (
        why.FreeRunAstray("fast", "a", 30.0, Driver.TORQUE, 0.5),
        "the free simulation of fast has an error of 30 % of the motion of a within 0.5 s of the measured torque",
    ),
    (
        why.FreeRunAstray("fast", "a", 2.0, Driver.CONTROLLER, None),
        "the free simulation of fast has an error of 2 % of the motion of a in the controller's loop",
    ),
]
STEPS = [
    (
        steps.Sharpen("M", 5.0, 4.0, 43.2, steps.ExcitingMotion.ACCELERATE, "a"),
        ("M is 5 +- 4 (one standard error, 43 % of the torque): accelerate a harder, in several poses of the others."),
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
        steps.SetRight(Finding(Severity.WARNING, None, robot_notes.TiltedBase(0.01, -0.02, (1e-3, 1e-3), 6.0, 5.0))),
        "set `base_tilt: estimate`: the base seems to be tilted by 0.57 deg about x and -1.15 deg about y.",
    ),
    (
        steps.CheckRipple(("a",)),
        "a: record constant speeds to see whether the ripple follows the position.",
    ),
]


@pytest.mark.parametrize(("fact", "sentence"), CHOICES + REASONS + STEPS, ids=lambda x: type(x).__name__)
def test_a_fact_says_its_figures(fact: object, sentence: str) -> None:
    assert str(fact) == sentence


@pytest.mark.parametrize("remedy", [*Remedy, *(step for step, _ in STEPS)])
def test_what_to_do_is_a_sentence(remedy: object) -> None:
    assert str(remedy).endswith((".", "?"))
