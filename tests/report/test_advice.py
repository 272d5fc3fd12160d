"""The words of the verdict: which sentences it has, and the figures in its reasons."""

from __future__ import annotations

import pytest
from dynident.report.verdict_words import verdict_sentences

from dynident.identification import HeldOut, LargestResidual, Verdict, WorstRun
from dynident.identification import verdict as why
from dynident.identification.verdict import CommonGain, MotionRatios, Zeros
from dynident.report.terminal import words
from dynident.runtime import Finding, Severity, Use
from dynident.validation import Driver, ResidualRipple, Reversals

RUN = WorstRun("fast", "elbow", 2.54)


def second(use: Use, *reasons: why.Reason, run: WorstRun | None = RUN) -> str:
    return verdict_sentences(Verdict(use, reasons, (), HeldOut(4.0, 3.0, None), run, None))[1]


def test_the_second_sentence_praises_only_what_nothing_stands_against() -> None:
    assert second(Use.SIMULATION).startswith("Its mass matrix is positive definite in all poses tested")
    assert "at most 2.5 % of the motion (elbow, fast)" in second(Use.SIMULATION)
    one, two, three = why.NoFreeRun(), why.InertiasFree(), why.NoHoldOut()
    assert second(Use.CONTROL, one) == "Not for simulation: no free simulation was run."
    assert second(Use.CONTROL, one, run=None) == second(Use.CONTROL, one)
    assert second(Use.DO_NOT_USE, three) == f"Against its use: {words(three)}."
    assert second(Use.CONTROL, one, two) == f"Not for simulation: {words(one)}; {words(two)}."
    assert second(Use.DO_NOT_USE, three, one, two) == f"Against its use: {words(three)}; {words(one)}; and 1 more."


def test_a_reason_that_asks_ends_with_its_question_mark() -> None:
    asking = why.ForbiddingFindings((Finding(Severity.WARNING, "a", "is it in degrees?"),))
    plain, said = why.TorqueErrorTooLarge("fast", 12.0, 10.0), "Against its use: a: is it in degrees?"
    assert second(Use.DO_NOT_USE, asking) == said
    assert second(Use.DO_NOT_USE, asking, plain) == f"{said} And {words(plain)}."
    assert second(Use.DO_NOT_USE, plain, asking, plain) == (
        f"Against its use: {words(plain)}; a: is it in degrees? And 1 more."
    )


def test_what_no_data_show_is_a_sentence_only_where_there_is_something() -> None:
    plain = Verdict(Use.SIMULATION, (), (), HeldOut(4.0, 3.0, None), RUN, LargestResidual("elbow", "fast", ()))
    assert len(verdict_sentences(plain)) == 3
    assert verdict_sentences(plain)[2] == "The torque residual is largest in elbow (fast) and has no clear cause."
    unknown = Verdict(**{**vars(plain), "unknown": (CommonGain(), Zeros(("turn", "wrist")), MotionRatios(("rail",)))})
    assert verdict_sentences(unknown)[3] == (
        "No data can show a factor that all torques share (wrong gains), which masses and friction take up, or a wrong "
        "zero of turn, wrist, or a wrong gear ratio, lead or unit of the position of rail: make sure of that by other "
        "means."
    )


@pytest.mark.parametrize(
    ("reason", "figures"),
    [
        (why.HeldBack(25.0, 12.3), ("physical constraints", "20 % smaller", "differ by 12 %")),
        (why.DrawnBack(25.0, 12.3), ("the prior holds", "20 % smaller", "differ by 12 %")),
        (why.SlowHoldOut(0.25), ("only 25 % of the speed",)),
        (why.TorqueErrorTooLarge("a", 12.34, 10.0), ("on a is 12.3 %, above 10 %",)),
        (why.NotCarriedOver("a", 2.54), ("2.5 times the training error",)),
        (why.TrainedWorse("a", 55.4, 6.32), ("on a, which was fitted, is 55.4 %, 6.3 times",)),
        (why.MassMatrixNotPositive(-0.1234), ("eigenvalue -0.123",)),
        (why.MostlyUnexcited(3, 8), ("3 of 8 base parameters",)),
        (why.PartlyUnexcited(1, 8), ("1 of 8 base parameters",)),
        (why.NegativeValues(tuple("abcde")), ("not physical: a, b, c, d, e",)),
        (why.NegativeValues(tuple("abcdefg")), ("a, b, c, d, e and 2 more",)),
        (why.JointErrorsTooLarge("a", (("x", 30.0), ("y", 41.26)), 25.0), ("above 25 %: x 30 %, y 41.3 %",)),
        (why.FreeRunAstray("a", "x", 9.94, Driver.CONTROLLER, 0.5), ("9.9 % of the motion of x in the controller",)),
        (why.FreeRunAstray("a", "x", 31.4, Driver.TORQUE, 0.5), ("31 % of the motion of x within 0.5 s",)),
        (why.Repeats((("a", "b"), ("c", "d"))), ("a repeats the motion of b, c repeats the motion of d:",)),
    ],
)
def test_reasons_hold_their_figures(reason: why.Reason, figures: tuple[str, ...]) -> None:
    for one in figures:
        assert one in words(reason)
    if "more" not in figures[0]:
        assert "more" not in words(reason)


def verdict(use: Use = Use.SIMULATION, *reasons: why.Reason, unfiltered: tuple[float, float] | None = None) -> Verdict:
    residual = LargestResidual("a", "fast", (Reversals(), ResidualRipple(26.0)))
    return Verdict(use, reasons, (), HeldOut(4.0, 3.0, unfiltered), WorstRun("fast", "a", 2.5), residual)


def test_a_good_model_in_three_sentences() -> None:
    first, second, third = verdict_sentences(verdict())
    assert first == (
        "Good for simulation and control on motions like these: on held-out motion it leaves 4 % of the torque "
        "unexplained, in training 3 %."
    )
    assert second == (
        "Its mass matrix is positive definite in all poses tested, and the error of its free simulation is at most "
        "2.5 % "
        "of the motion (a, fast)."
    )
    assert third == (
        "The torque residual is largest in a (fast) and points to friction around reversals and a ripple at 26 Hz."
    )


def test_reasons_stand_in_the_second_sentence_two_of_them_in_full() -> None:
    given = (why.NoFreeRun(), why.InertiasFree(), why.NegativeValues(("Fv",)))
    first, second, _ = verdict_sentences(verdict(Use.CONTROL, *given, unfiltered=(20.0, 5.0)))
    assert first.endswith("after the low-pass of the fit (training 3 %), and 20 % of it as measured (5 %).")
    assert second == (
        "Not for simulation: no free simulation was run; the bodies' inertias were not constrained to be physically "
        "consistent; and 1 more."
    )


def test_what_is_not_known_is_said() -> None:
    nothing = Verdict(Use.DO_NOT_USE, (why.NoHoldOut(),), (), None, None, None)
    assert verdict_sentences(nothing) == (
        "Do not use this model yet: no log was held out.",
        "Against its use: no log was held out, so the error on unseen motion is not known.",
        "The torque residual could not be tested.",
    )
