"""Notes and findings say themselves, and text of numbers is short."""

from __future__ import annotations

import pytest

from dynident.checks import channel_notes, file_notes
from dynident.runtime import Finding, InputError, Messages, Note, Remark, Severity, count, percent, require

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
