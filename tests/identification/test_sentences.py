"""What is chosen before a fit, the reasons of a verdict and the next steps say their figures."""

from __future__ import annotations

from pathlib import Path

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
    InPieces(100_000_000, 100_000.0, 1000, 6, "elbow", 7.321),
    TimeOffset(0.005, 4.0, 2.0),
    TimeOffset(-0.005, 4.0, 2.0),
    TimeOffset(0.0, 4.0, 4.0),
    TimeOffset(0.0, 4.0, 4.0, 1e-4),
    TimeOffset(0.0021, 4.0, 2.0, 2e-4),
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
    why.HeldBack(25.0, 12.3),
    why.DrawnBack(25.0, 12.3),
    why.NegativeValues(tuple("abcdefg")),
    why.JointErrorsTooLarge("fast", (("a", 40.0), ("b", 26.4)), 25.0),
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
    steps.Sharpen("M", 5.0, 4.0, 43.2, steps.ExcitingMotion.ACCELERATE, "a", 1.83, gain=1e-3),
    steps.LeaveOut("tuesday", 8.0, 9.96, 12.3, gain=1.24),
    steps.Cover("fast", 1.0, 2.5, "a", 1.52, 3.14, gain=0.4),
    steps.HoldOutFaster(2.52),
    steps.SetRight(
        Finding(robot_notes.MissingTerm(robot_notes.TermKind.VISCOUS, 1.0, 0.1, 0.3), "a", severity=Severity.INFO),
        gain=0.5,
    ),
    steps.SetRight(Finding(robot_notes.TiltedBase(0.01, -0.02, (1e-3, 1e-3), 6.0, 5.0))),
    steps.CheckRipple(("a",)),
]


SENTENCES = Path(__file__).with_name("sentences.txt").read_text("utf-8").splitlines()  # in the order of the facts


@pytest.mark.parametrize(
    ("fact", "sentence"),
    list(zip((*CHOICES, *REASONS, *STEPS), SENTENCES, strict=True)),
    ids=lambda x: type(x).__name__,
)
def test_a_fact_says_its_figures(fact: object, sentence: str) -> None:
    assert str(fact) == sentence


@pytest.mark.parametrize("remedy", [*Remedy, *STEPS])
def test_what_to_do_is_a_sentence(remedy: object) -> None:
    assert str(remedy).endswith((".", "?"))
