"""The words of the verdict: which sentences it has, and the figures in its reasons."""

from __future__ import annotations

from dynident.identification import HeldOut, LargestResidual, Verdict, WorstRun
from dynident.identification import verdict as why
from dynident.identification.verdict import CommonGain, MotionRatios, Zeros
from dynident.runtime import Finding, Remark, Use
from dynident.validation import ResidualRipple, Reversals

RUN = WorstRun("fast", "elbow", 2.54)


def second(use: Use, *reasons: why.Reason, run: WorstRun | None = RUN) -> str:
    return Verdict(use, reasons, (), HeldOut(4.0, 3.0, None), run, None).sentences()[1]


def test_the_second_sentence_praises_only_what_nothing_stands_against() -> None:
    assert second(Use.SIMULATION).startswith("Its mass matrix is positive definite in all poses tested")
    assert "at most 2.5 % of the motion (elbow, fast)" in second(Use.SIMULATION)
    one, two, three = why.NoFreeRun(), why.InertiasFree(), why.NoHoldOut()
    assert second(Use.CONTROL, one) == "Not for simulation: no free simulation was run."
    assert second(Use.CONTROL, one, run=None) == second(Use.CONTROL, one)
    assert second(Use.DO_NOT_USE, three) == f"Against its use: {three}."
    assert second(Use.CONTROL, one, two) == f"Not for simulation: {one}; {two}."
    assert second(Use.DO_NOT_USE, three, one, two) == f"Against its use: {three}; {one}; and 1 more."


def test_a_reason_that_asks_ends_with_its_question_mark() -> None:
    asking = why.ForbiddingFindings((Finding(Remark("is it in degrees?"), "a"),))
    plain, said = why.TorqueErrorTooLarge("fast", 12.0, 10.0), "Against its use: a: is it in degrees?"
    assert second(Use.DO_NOT_USE, asking) == said
    assert second(Use.DO_NOT_USE, asking, plain) == f"{said} And {plain}."
    assert second(Use.DO_NOT_USE, plain, asking, plain) == (
        f"Against its use: {plain}; a: is it in degrees? And 1 more."
    )


def test_what_no_data_show_is_a_sentence_only_where_there_is_something() -> None:
    plain = Verdict(Use.SIMULATION, (), (), HeldOut(4.0, 3.0, None), RUN, LargestResidual("elbow", "fast", ()))
    assert len(plain.sentences()) == 3
    assert plain.sentences()[2] == "The torque residual is largest in elbow (fast) and has no clear cause."
    unknown = Verdict(**{**vars(plain), "unknown": (CommonGain(), Zeros(("turn", "wrist")), MotionRatios(("rail",)))})
    assert unknown.sentences()[3] == (
        "No data can show a factor that all torques share (wrong gains), which masses and friction take up, or a wrong "
        "zero of turn, wrist, or a wrong gear ratio, lead or unit of the position of rail: make sure of that by other "
        "means."
    )


def verdict(use: Use = Use.SIMULATION, *reasons: why.Reason, unfiltered: tuple[float, float] | None = None) -> Verdict:
    residual = LargestResidual("a", "fast", (Reversals(), ResidualRipple(26.0)))
    return Verdict(use, reasons, (), HeldOut(4.0, 3.0, unfiltered), WorstRun("fast", "a", 2.5), residual)


def test_a_good_model_in_three_sentences() -> None:
    first, second, third = verdict().sentences()
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
    first, second, _ = verdict(Use.CONTROL, *given, unfiltered=(20.0, 5.0)).sentences()
    assert first.endswith("after the low-pass of the fit (training 3 %), and 20 % of it as measured (5 %).")
    assert second == (
        "Not for simulation: no free simulation was run; the bodies' inertias were not constrained to be physically "
        "consistent; and 1 more."
    )


def test_what_is_not_known_is_said() -> None:
    nothing = Verdict(Use.DO_NOT_USE, (why.NoHoldOut(),), (), None, None, None)
    assert nothing.sentences() == (
        "Do not use this model yet: no log was held out.",
        "Against its use: no log was held out, so the error on unseen motion is not known.",
        "The torque residual could not be tested.",
    )
