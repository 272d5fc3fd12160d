"""Sentences at all their thresholds: each field of a note is changed by itself, to what its class compares it with."""

from collections import Counter
from itertools import islice
from typing import Any

import pytest

from dynident.apps.excitation import Interrupted, LeftOut
from dynident.apps.excitation.gripper import GripperLeftOut
from dynident.apps.online import events
from dynident.apps.online.report import event_line
from dynident.apps.payload import Component
from dynident.apps.payload import body as payload
from dynident.identification import Gain, base_tilt, dataset
from dynident.identification.outliers import HeldOutOutliers
from dynident.identification.prior_strength import PriorStrength
from dynident.identification.terms import candidates
from dynident.models.simulation import RunsAway
from dynident.regression import GroupKind, UnexcitedParameters
from dynident.validation import ResidualRipple
from dynident.validation.residuals import SmoothedAway
from tests.checks.test_sentences import NOTES as CHECK_NOTES
from tests.estimators.test_settings import NOTES as ESTIMATOR_NOTES
from tests.identification.test_sentences import CHOICES, REASONS, STEPS
from tests.kept import check_kept
from tests.sweeps import sweep

# what a note may say beside its sentence
SAID = ("remedy", "figures", "forbidden", "severity", "removed", "topic", "advises")
OTHERS = (
    payload.NotShown((Component.Z, Component.IXX), (0.05, 0.01), "j5", 1.5, "rad/s", (0.002, 0.003)),
    payload.NotShown((Component.IZZ,), (0.05,)),
    payload.PayloadOrDrift(Component.MASS, 0.9, unloaded=False),
    payload.GainsUnknown(0.09, 0.01, 3.0),
    payload.NoPayload(0.1, 0.2),
    payload.OtherArm(3.14),
    payload.SameRecording("a.csv"),
    dataset.NotFitted(("a", "b")),
    dataset.NotLogged(("a", "b"), (0.5, -1.23456)),
    dataset.NotJudged("fast", 12.3456),
    dataset.SubstituteUsed("fast", "FourierSeries", "smoothing spline"),
    base_tilt.SteepBase(0.5, -0.123456),
    candidates.PlainTerms(),
    candidates.NotChosen(("a", "b")),
    PriorStrength(0.01, Gain(12.3456, 1.23456)),
    PriorStrength(0.0, Gain(0.5, 1.2)),
    HeldOutOutliers("fast", ("a", "b"), 3, 12.3456, 1.23456),
    SmoothedAway("fast", ("a", "b"), 12.3456, 3.45678),
    UnexcitedParameters(("x", "y"), ("a", "b"), still=("b",)),
    Interrupted(),
    GripperLeftOut({"left": 0.01, "right": 0.02}),
    LeftOut(("Dahl", "LoadCoulomb")),
    UnexcitedParameters(("Fv_b", "Fc_b"), ("b",), still=("b",)),
    UnexcitedParameters(("x",), ("a", "b")),
    UnexcitedParameters(("x",), ("a", "b"), together=True),
    ResidualRipple(26.04),
    RunsAway(0.1234),
)
PART = (GroupKind.FRICTION, "a", 80.0)
EVENTS = (
    events.BaselineKnown(90.0, 30.0, (0.1, 2.0), (0.1, 0.5)),
    events.Unsteady(90.0, *PART),
    events.NewMotion(90.0, 80.0),
    events.Alarm(90.0, *PART, (70.0, 85.0), 12.0),
    events.Changed(
        90.0, *PART, (70.0, 85.0), ("Fv", "Fc"), ("N m s/rad", "N m"), (0.123456, 1.5), (0.01, 1.0), (0.2, 1.5), 9.0
    ),
    events.Changed(90.0, GroupKind.RESIDUAL, "a", 80.0, (80.0, 80.0), ("r",), ("",), (0.4,), (0.1,), (0.4,), 9.0),
    events.Passed(90.0, *PART),
    events.Resting(90.0, 80.0),
    *(events.Fault(90.0, kind, signal, "a", 80.0, 0.12345) for kind in events.FaultKind for signal in events.Signal),
    events.Back(90.0, events.Signal.TORQUE, "a", 80.0),
    events.Gap(90.0, 1.23456),
    events.ClockReset(90.0, 80.0),
    events.BadLines(90.0, 3, 7, "1,2", 12),
    events.Unreadable(90.0, 5, "too short."),
    events.Resumed(90.0, 1.7e9),
)
MAX_SWEPT = 2  # notes of a class whose fields are changed; of others only the sentence is compared
GROUPS = {
    "checks": CHECK_NOTES,
    "estimators": ESTIMATOR_NOTES,
    "identification": (*CHOICES, *REASONS, *STEPS),
    "others": OTHERS,
    "events": EVENTS,
}


@pytest.mark.parametrize("room", GROUPS)
def test_sentences_at_all_thresholds(room: str) -> None:
    lines, tried = list[str](), Counter[type]()
    for note in GROUPS[room]:
        tried[type(note)] += 1
        swept = sweep(note, say)
        lines += swept if tried[type(note)] <= MAX_SWEPT else islice(swept, 1)
    check_kept(f"sentences_{room}", "\n".join(lines))


def say(note: Any) -> list[str]:
    """Return the sentence, and what else a note says of itself."""
    if isinstance(note, events.Event):
        return [f"{event_line(note, ('a', 'b'))}"]  # its severity is in the line
    sentence = str(note)
    facts = (str(getattr(note, name)) for name in SAID if hasattr(note, name))
    return [sentence, *(fact for fact in facts if fact not in ("", "()", "None", sentence))]
