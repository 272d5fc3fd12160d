"""What is chosen before a fit, the reasons of a verdict, the next steps and the verdict itself say their figures."""

import numpy as np

from dynident.checks import robot_notes
from dynident.identification import (
    BaseTilt,
    Gain,
    HeldOut,
    LargestResidual,
    Measure,
    Origin,
    Rests,
    SmootherChoice,
    TimeOffset,
    Verdict,
    WorstRun,
)
from dynident.identification import verdict_reasons as why
from dynident.identification import verdict_steps as steps
from dynident.identification.long import InPieces
from dynident.identification.unobservable import CommonGain, MotionRatios, Zeros
from dynident.models.simulation import Singular
from dynident.motion.smoothers import Difference, Spline
from dynident.runtime import Finding, Remark, Severity, Use
from dynident.validation import Driver, FloorOrigin, NoiseFloor

CHOICES = [
    InPieces(100_000_000, 100_000.0, 1000, 6, "elbow", 7.321),
    TimeOffset(0.005, 4.0, 2.0),
    TimeOffset(-0.005, 4.0, 2.0),
    TimeOffset(0.0, 4.0, 4.0),
    TimeOffset(0.0, 4.0, 4.0, 1e-4),
    TimeOffset(0.0021, 4.0, 2.0, 2e-4),
    TimeOffset(0.032, 4.0, 2.0, 2e-4),
    TimeOffset(-0.02, 4.0, 2.0, 2e-4),
    BaseTilt(0.02, -0.035, (1e-3, 2e-3), 4.0, 2.0),
    BaseTilt(0.0, 0.0, (1e-3, 2e-3), 4.0, 4.0, Gain(31.2, 4.1), (1.57, 0.0)),
    TimeOffset(0.0, 2.0, 2.0, 1e-3, Gain(-9.94, 12.2)),
    Rests("a", 4.7, 0.52, 0.0),
    Rests("a", 0.0, 1.2, 2.5, Gain(12.3, 1.2)),
    Rests("a", 0.0, 0.0, 2.5, Gain(1.0, 2.0)),
    Rests("a", 0.0, 0.0, 2.5),
    SmootherChoice(Difference(), (Difference(), Spline()), (1.5, np.inf)),
    Origin(Measure.RESIDUAL),
    Origin(Measure.SCATTER),
    Origin(None, ("a",)),
    Origin(Measure.SCATTER, ("a",)),
]
REASONS = [
    why.NoHoldOut(),
    why.NoFreeRun(),
    why.InertiasFree(),
    why.NegativeValues(tuple("abcde")),
    why.SlowHoldOut(0.25),
    why.TrainedWorse("a", 55.4, 6.32),
    why.Uncertain(4.93),
    why.AboveFloor("a", (("elbow", NoiseFloor(0.1, 2.61, 2.9, FloorOrigin.WHITE)),)),
    why.HeldBack(25.0, 12.3),
    why.DrawnBack(25.0, 12.3),
    why.NegativeValues(tuple("abcdefg")),
    why.JointErrorsTooLarge("fast", (("a", 40.0), ("b", 26.4)), 25.0),
    why.WeakJoints("fast", (("a", 38.2, 1.06),)),
    why.UnfilteredErrorTooLarge("fast", 26.0, 25.0),
    why.TorqueErrorTooLarge("fast", 11.0, 10.0),
    why.NotCarriedOver("fast", 2.51),
    why.Repeats((("b", "a"),)),
    why.SilentTorque(("a", "b")),
    why.MassMatrixNotPositive(-0.1),
    why.MostlyUnexcited(3, 7),
    why.PartlyUnexcited(1, 7),
    why.FreeRunFails(("a", "b"), Singular()),
    why.FreeRunAstray("fast", "a", 30.0, Driver.TORQUE, 0.5),
    why.FreeRunAstray("fast", "a", 2.0, Driver.CONTROLLER, None),
]
STEPS = [
    steps.Sharpen("M", 5.0, 4.0, 43.2, steps.ExcitingMotion.ACCELERATE, "a"),
    steps.SlowReversals(("a", "b")),
    steps.SlowReversals(("a",), terms_chosen=True),
    steps.SlowReversals(("a",), (0.0312,), gain=0.456),
    steps.Sharpen("M", 5.0, 4.0, 43.2, steps.ExcitingMotion.ACCELERATE, "a", 1.83, "kg", gain=1e-3),
    steps.LeaveOut("tuesday", 8.0, 9.96, 12.3, gain=1.24),
    steps.Cover("fast", 1.0, 2.5, "a", 1.52, 3.14, gain=0.4),
    steps.HoldOutFaster(2.52),
    steps.MoreRecordings(1, gain=0.31),
    steps.MoreRecordings(2),
    steps.SetRight(
        Finding(robot_notes.MissingTerm(robot_notes.TermKind.VISCOUS, 1.0, 0.1, 0.3), "a", severity=Severity.INFO),
        gain=0.5,
    ),
    steps.SetRight(Finding(robot_notes.TiltedBase(0.01, -0.02, (1e-3, 1e-3), 6.0, 5.0))),
    steps.CheckRipple(("a",), (26.04,)),
]
RUN = WorstRun("fast", "elbow", 2.54)


def second(use: Use, *reasons: why.Reason, run: WorstRun | None = RUN) -> str:
    return Verdict(use, reasons, (), HeldOut(4.0, 3.0, None), run, None).sentences()[1]


def test_the_second_sentence_praises_only_what_nothing_stands_against() -> None:
    assert second(Use.SIMULATION).startswith("Its mass matrix is positive definite in all poses tested")
    assert "at most 2.5 % of the motion (elbow, fast)" in second(Use.SIMULATION)
    case, two, three = why.NoFreeRun(), why.InertiasFree(), why.NoHoldOut()
    assert second(Use.CONTROL, case) == "Not tested for simulation: no free simulation was run."
    assert second(Use.CONTROL, case, run=None) == second(Use.CONTROL, case)
    assert second(Use.DO_NOT_USE, three) == f"Against its use: {three}."
    assert second(Use.CONTROL, case, two) == f"Not for simulation: {case}; {two}."
    assert second(Use.DO_NOT_USE, three, case, two) == f"Against its use: {three}; {case}. There is 1 more reason."


def test_a_reason_that_asks_ends_with_its_question_mark() -> None:
    asking = why.ForbiddingFindings((Finding(Remark("is it in degrees?"), "a"),))
    plain, said = why.TorqueErrorTooLarge("fast", 12.0, 10.0), "Against its use: a: is it in degrees?"
    assert second(Use.DO_NOT_USE, asking) == said
    assert second(Use.DO_NOT_USE, asking, plain) == f"{said} And {plain}."
    assert second(Use.DO_NOT_USE, plain, asking, plain) == (
        f"Against its use: {plain}; a: is it in degrees? There is 1 more reason."
    )


def test_no_reason_is_cut_and_of_each_the_first_sentence_is_said() -> None:
    advice = Finding(Remark("friction grows with the load. Add `load` to `terms`. Likewise b"), "a")
    said = second(Use.DO_NOT_USE, why.ForbiddingFindings((advice,)), *[why.NoHoldOut()] * 3)
    assert said == f"Against its use: a: friction grows with the load; {why.NoHoldOut()}. There are 2 more reasons."
    reasons = why.ForbiddingFindings((advice,)), why.NoHoldOut(), why.NoFreeRun(), why.InertiasFree()
    named = [
        Verdict(Use.CONTROL, group, (), None, None, None).names_all
        for group in (reasons[:1], reasons[1:3], reasons[1:])
    ]
    assert named == [False, True, False]


def test_what_no_data_show_is_a_sentence_only_where_there_is_something() -> None:
    plain = Verdict(Use.SIMULATION, (), (), HeldOut(4.0, 3.0, None), RUN, LargestResidual("elbow", "fast", ()))
    assert len(plain.sentences()) == 3
    assert plain.sentences()[2] == "The torque residual is largest in elbow (fast) and has no clear cause."
    unknown = Verdict(**{**vars(plain), "unknown": (CommonGain(), Zeros(("turn", "wrist")), MotionRatios(("rail",)))})
    assert unknown.sentences()[3] == (
        "No recording of this robot can reveal a wrong gain that is common to all torques (masses and friction absorb "
        "it), or a wrong zero of turn, wrist, or a wrong gear ratio, lead or unit of the position of rail. Check this "
        "by other means."
    )


def test_what_is_not_known_is_said() -> None:
    nothing = Verdict(Use.DO_NOT_USE, (why.NoHoldOut(),), (), None, None, None)
    assert nothing.sentences() == (
        "Do not use this model yet: no log was held out.",
        "Against its use: no log was held out, so the error on unseen motion is not known.",
        "The torque residual could not be tested.",
    )
