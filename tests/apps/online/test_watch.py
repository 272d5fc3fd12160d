"""One sentence for each event."""

from __future__ import annotations

import numpy as np
import pytest

from dynident.apps import online
from dynident.apps.online import (
    Alarm,
    Back,
    BadLines,
    BaselineKnown,
    Changed,
    ClockReset,
    Event,
    Fault,
    FaultKind,
    Gap,
    NewMotion,
    Passed,
    Resting,
    Resumed,
    Signal,
    Unreadable,
    Unsteady,
    WatchSettings,
)
from dynident.apps.online.report import event_line, watch_words
from dynident.regression import GroupKind
from dynident.runtime import Severity

FRICTION, PAYLOAD, RESIDUAL = GroupKind.FRICTION, GroupKind.PAYLOAD, GroupKind.RESIDUAL
CHANGED = Changed(
    60.0, PAYLOAD, "wrist", 30.0, (29.0, 31.0), ("m", "mx", "my"), ("kg", "kg m", "kg m"),
    (0.5, 0.001, 0.3), (0.01, 0.01, np.inf), (0.7, 0.001, 0.3), 50.0,
)  # fmt: skip
SAID: list[tuple[Event, str]] = [
    (BaselineKnown(600.0, 0.0, (1.0, 0.5), (0.4, 0.4)),
     "elbow 1.0, wrist 0.50; more than twice that of the identification at elbow."),
    (BaselineKnown(600.0, 0.0, (5.0, 0.5), (0.4, 0.4)), "at elbow; at one, more than ten times: check"),
    (Unsteady(600.0, FRICTION, "elbow", 0.0), "friction of elbow changed within the baseline since 0.0 s"),
    (NewMotion(700.0, 640.0), "moves as it did not in the baseline since 640.0 s"),
    (Alarm(45.0, PAYLOAD, "wrist", 30.0, (29.0, 31.0), 20.0),
     "a change since about 30.0 s, most likely payload at wrist"),
    (CHANGED,
     "payload at wrist changed between 29.0 s and 31.0 s: m by +0.500 +- 0.010 kg (+0.700 since the baseline)."),
    (Changed(60.0, RESIDUAL, "elbow", 30.0, (30.0, 30.0), ("e",), ("",), (float(np.log(2)),), (0.1,), (1.0,), 50.0),
     "torque that the model leaves at elbow changed at about 30.0 s: +100 %."),
    (Passed(60.0, FRICTION, "elbow", 30.0), "the change since 30.0 s (friction of elbow) has passed"),
    (Fault(9.1, FaultKind.FROZEN, Signal.POSITION, "elbow", 9.0),
     "the position of elbow does not change any more, since 9.0 s"),
    (Fault(9.1, FaultKind.MISSING, Signal.TORQUE, "elbow", 9.0), "the torque of elbow gives no number, since 9.0 s"),
    (Fault(9.1, FaultKind.STILL, Signal.POSITION, "elbow", 9.0), "the torques are not those of a rest"),
    (Fault(9.1, FaultKind.JUMP, Signal.POSITION, "elbow", 9.0, -0.5), "jumps at 9.0 s, by -0.500 rad or m"),
    (Back(20.0, Signal.POSITION, "elbow", 9.0), "the position of elbow works again, after a fault since 9.0 s"),
    (Resting(310.0, 10.0), "the robot has hardly moved since 10.0 s"),
    (Gap(20.0, 4.0), "no sample came for 4.00 s"),
    (ClockReset(0.0, 20.0), "the time was set back, from 20.0 s"),
    (BadLines(20.0, 2, 17, "x\x1b[31m"),
     "2 lines could not be read and are left out, the first is line 17: 'x\\x1b[31m'"),
    (Unreadable(20.0, 100, "no joint moves."), "100 samples cannot be used: no joint moves."),
    (Resumed(20.0, 20.0), "goes on from its saved state, after the sample at 20.0 s"),
]  # fmt: skip


@pytest.mark.parametrize(("event", "said"), SAID, ids=lambda one: type(one).__name__ if isinstance(one, Event) else "")
def test_each_event_has_its_sentence(event: Event, said: str) -> None:
    line = event_line(event, ("elbow", "wrist"))
    assert said in line.text
    assert line.text.startswith(f"{event.time:.1f} s: ")
    assert line.text.endswith(".")
    assert (line.severity is Severity.WARNING) == isinstance(event, Alarm | Changed | Fault | Unsteady | Unreadable)


def test_no_event_is_without_a_sentence() -> None:
    events = {one for one in vars(online).values() if isinstance(one, type) and issubclass(one, Event)} - {Event}
    assert {type(event) for event, _ in SAID} == events


def test_dates_are_shown_where_the_stream_has_them() -> None:
    assert event_line(Gap(3600.0, 4.0), (), 86_400.0 * 20_000).text.startswith("2024-10-04 01:00:00: ")


def test_lines_before_the_first_sample_have_no_time() -> None:
    line = event_line(BadLines(float("nan"), 1, 2, "x"), ())
    assert line.text == "at the start: line 2 could not be read and is left out: 'x'."


def test_the_rate_of_false_alarms_is_said() -> None:
    assert "at most one in 33 days by chance" in watch_words(WatchSettings())
    assert "at most 2.0 a day by chance" in watch_words(WatchSettings(false_alarms=2.0))
