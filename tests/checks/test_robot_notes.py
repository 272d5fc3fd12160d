"""Every note on the robot has words, with its figures and what to do."""

from __future__ import annotations

import dataclasses
import json

import pytest
from pydantic import TypeAdapter

from dynident.checks import channel_notes, file_notes, log_notes, motion_notes, robot_notes
from dynident.checks.file_notes import AffectedColumns
from dynident.checks.robot_notes import MissingTerm, TermKind
from dynident.runtime import Note, Remark
from tests.checks.test_sentences import SAID
from tests.classes import classes_of

OTHERS = tuple(robot_notes.Rival(f"j{k}", one, 0.1) for k, one in enumerate(robot_notes.SuspectQuantity))
NOTES = [
    *(file_notes.JointsSwapped(("a", "b"), channel, 30.0, 2.0) for channel in AffectedColumns),
    *(file_notes.ColumnReversed(channel, 30.0, 2.0) for channel in AffectedColumns),
    file_notes.OtherAxis((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), 30.0, 2.0),
    robot_notes.TorqueGain(1.25, 0.01, 0.2, OTHERS),
    robot_notes.ZeroOff(0.1, 0.01, 0.2),
    robot_notes.LengthWrong("x", 0.4, 0.5, 0.01, 0.2),
    robot_notes.AxisTilted((1.0, 0.0, 0.0), 0.05, True, 0.01, 0.2),
    *(MissingTerm(kind, 0.5, 0.01, 0.6, "j1" if kind is TermKind.COUPLED else "") for kind in TermKind),
    robot_notes.TermLeftOut(TermKind.ROTOR, 0.5, 0.01, 0.6),
    MissingTerm(TermKind.RIPPLE, 0.5, 0.01, 0.6, period=0.524),
    robot_notes.LeftAtReversals(3.52, 0.71),
    robot_notes.Unexplained(8.1, 42.3),
    robot_notes.ClockWrong(1.2, 0.01, 0.2),
    motion_notes.OddLog(12.0, 2.0),
    robot_notes.TiltedBase(0.02, -0.035, (1e-3, 2e-3), 4.0, 2.0, cost=3.0),
    motion_notes.OtherPayload(2.0, 0.1, 0.9),
    motion_notes.OtherPayload(-2.0, 0.1, 0.9),
]


@pytest.mark.parametrize("note", NOTES, ids=lambda note: type(note).__name__)
def test_a_note_is_said_in_sentences(note: Note) -> None:
    text = str(note)
    assert text.endswith(".")
    assert text.count(".") >= 1
    assert "{" not in text.replace("`{ kind", "")


def test_all_kinds_of_notes_are_tried() -> None:
    modules = (channel_notes, file_notes, log_notes, motion_notes, robot_notes)
    kinds = {kind for module in modules for kind in classes_of(module) if issubclass(kind, Note)}
    bases = {robot_notes.Costly, robot_notes.WrongValue}
    assert {type(note) for note in (*NOTES, *(note for note, _ in SAID))} == {
        kind for kind in kinds - bases if not issubclass(kind, Remark)
    }


def test_what_a_cause_costs_is_said() -> None:
    costly = [one for one in NOTES if isinstance(one, robot_notes.Costly)]
    for note in costly:
        assert "at twice the speed it changes the torque by 3.2 %" in str(dataclasses.replace(note, cost=3.21))
    assert "tilted by 1.15 deg about x and -2.01 deg about y" in str(NOTES[-3])


def test_what_cannot_be_told_apart_is_listed() -> None:
    text = str(NOTES[7])
    assert "1.25 +- 0.01 times" in text
    for words in ("cannot tell this from", "joint j1: a zero", "origin moved by 0.1 m", "frame turned by 0.1 rad"):
        assert words in text
    assert "+0.1 +- 0.01" in str(NOTES[8])
    assert "lighter" in str(NOTES[-1])
    assert "together with j1" in str(MissingTerm(TermKind.COUPLED, 0.2, 0.01, 0.5, "j1"))


def test_what_is_left_is_said_with_its_figures() -> None:
    assert "that repeats every 0.524 rad or m" in str(MissingTerm(TermKind.RIPPLE, 0.5, 0.01, 0.6, period=0.524))
    assert "repeats" not in str(MissingTerm(TermKind.SPRING, 0.5, 0.01, 0.6))
    at = str(robot_notes.LeftAtReversals(3.52, 0.71))
    assert "3.5 % of its torque" in at
    assert "71 % of the joint's squared residual" in at
    left = str(robot_notes.Unexplained(8.1, 42.3))
    assert "8.1 % of all torque" in left
    assert "42 % of its own" in left


@pytest.mark.parametrize("note", NOTES, ids=lambda note: type(note).__name__)
def test_a_note_is_saved_and_read_as_it_was(note: Note) -> None:
    saved = json.loads(json.dumps(dataclasses.asdict(note)))
    assert TypeAdapter(type(note)).validate_python(saved) == note


@pytest.mark.parametrize("note", NOTES, ids=lambda note: type(note).__name__)
def test_what_to_do_is_said_in_short(note: Note) -> None:
    text = note.remedy
    assert text.endswith(("?", "."))
    assert len(text) <= len(str(note))
    if isinstance(note, robot_notes.WrongValue):
        assert len(text) < 0.5 * len(str(note))


def test_what_setting_right_removes_survives_a_file() -> None:
    note = robot_notes.ZeroOff(0.1, 0.01, 0.2, removed=(("a", 0.5), ("b", 0.25)))
    again = TypeAdapter(robot_notes.ZeroOff).validate_python(json.loads(json.dumps(dataclasses.asdict(note))))
    assert again == note
    assert again.removed == (("a", 0.5), ("b", 0.25))
