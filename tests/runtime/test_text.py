"""Parts, numbers, notes and findings as users read them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynident.checks import channel_notes, file_notes
from dynident.runtime import (
    Finding,
    InputError,
    Messages,
    Note,
    Remark,
    Severity,
    count,
    percent,
    require,
    settings_repr,
    shorten_names,
)
from dynident.runtime.text import capitalise, number_within


@dataclass(frozen=True)
class Part:
    value: object = None


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, ""),
        (np.array([1.0, 2.5]), "value=[1, 2.5]"),
        (np.zeros(4), "value=array(4,)"),
        (np.zeros((1, 2)), "value=array(1, 2)"),
        ({"a": np.ones(3)}, "value={a: [1, 1, 1]}"),
    ],
)
def test_settings_are_shown_where_they_are_changed(value: object, text: str) -> None:
    assert settings_repr(Part(value)) == f"Part({text})"


def test_names_are_cut_in_the_middle() -> None:
    assert shorten_names(["robot_cell_left_joint1_x", "short"], 13) == ["robot_…int1_x", "short"]


def test_the_cut_moves_where_names_differ_in_the_middle() -> None:
    names = ["arm_shoulder_of_the_left_robot", "arm_elbow_of_the_left_robot", "arm_wrist_of_the_left_robot"]
    result = shorten_names(names, 12)
    assert len(set(result)) == 3
    assert all(len(name) <= 12 for name in result)


@given(st.lists(st.text(max_size=40), max_size=5), st.integers(-1, 50))
def test_no_name_is_longer(names: list[str], width: int) -> None:
    result = shorten_names(names, width)
    assert all(len(name) <= max(width, 2) for name in result)
    assert len(result) == len(names)


def test_only_the_first_letter_becomes_upper_case() -> None:
    assert capitalise("iSAM of q_1") == "ISAM of q_1"
    assert capitalise("x") == "X"
    assert capitalise("") == ""


def test_a_number_has_the_digits_that_its_standard_error_leaves() -> None:
    pairs = ((0.00185, 0.0067), (0.004308, 0.026), (2.99876, 0.012), (-41.26, 31.0), (12.0, 310.0), (4.2e-7, 3e-8))
    assert [number_within(*pair) for pair in pairs] == ["0.0019", "0.004", "2.999", "-41", "12", "4.20e-7"]
    assert [number_within(1e-4, 0.5), number_within(0.0, 0.5), number_within(2.0, float("nan"))] == ["0", "0", "2.000"]


STILL = channel_notes.NeverMoves(1, 0.3)


def test_a_finding_says_its_place_and_ends_its_sentence() -> None:
    assert str(Finding(STILL, "b")).startswith("joint 'b': the position never moves (one value")
    assert str(Finding(STILL, source="x.csv")).startswith("x.csv: the position never moves")
    assert str(Finding(Remark("odd"), "b", link="a\x1b")) == "link 'a\\x1b': odd."
    assert Finding(Remark("is it odd?"), severity=Severity.ERROR).text == "is it odd?"


def test_messages_are_printed_one_to_a_line_with_their_severity() -> None:
    messages = Messages([Remark("stale."), Finding(Remark("torn"), "a", severity=Severity.ERROR)])
    assert str(messages) == repr(messages) == "Warning: stale.\nError: joint 'a': torn."
    assert messages == tuple(messages)


def test_require_lists_every_error_and_lets_warnings_pass() -> None:
    warning = Finding(file_notes.OddTotalMass(6e3))
    require([warning], "x.csv")
    gap, short = channel_notes.LongGap(0.5, 1.0, 50.0, 1), channel_notes.TooFewSamples(4, 30)
    errors = [Finding(gap, "a", severity=Severity.ERROR), warning, Finding(short, severity=Severity.ERROR)]
    with pytest.raises(InputError) as caught:
        require(errors, "x.csv")
    first, second = str(caught.value).split("\n")
    assert first.startswith("x.csv: joint 'a': a gap of 0.5 s after t = 1 s")
    assert second.startswith("  only 4 samples; at least 30 are needed")


def kinds(base: type) -> list[type]:
    """All classes of dynident below ``base`` that have no class below them."""
    below = [kind for kind in base.__subclasses__() if kind.__module__.startswith("dynident.")]
    return [leaf for kind in below for leaf in kinds(kind)] or [base]


@pytest.mark.parametrize("base", ["Note", "Cause", "Failure", "Reason", "NextStep", "Unobservable"])
def test_every_fact_says_itself(base: str) -> None:
    from dynident.identification import NextStep, Reason, verdict
    from dynident.models.simulation import Failure
    from dynident.validation import Cause

    bases = {kind.__name__: kind for kind in (Note, Cause, Failure, Reason, NextStep, verdict.Unobservable)}
    assert len(kinds(bases[base])) > 1
    assert [kind for kind in kinds(bases[base]) if kind.__str__ is object.__str__] == []


def test_shares_are_no_powers_of_ten() -> None:
    assert [percent(value, 2) for value in (0.0, 0.0004, 0.126, 5.0, 99.7, 100.0, 1234.0)] == [
        "0 %", "0.0004 %", "0.13 %", "5 %", "100 %", "100 %", "1234 %",
    ]  # fmt: skip
    assert percent(1e-7) == "1.00e-7 %"
    assert (count(1, "log"), count(2, "log")) == ("1 log", "2 logs")
