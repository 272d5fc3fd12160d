"""Parts, numbers, notes and findings as users read them."""

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynident.runtime import Finding, Messages, Note, Remark, Severity, settings_repr, shorten_names
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


def test_messages_are_printed_one_to_a_line_with_their_severity() -> None:
    messages = Messages([Remark("stale."), Finding(Remark("torn"), "a", severity=Severity.ERROR)])
    assert str(messages) == repr(messages) == "Warning: stale.\nError: joint 'a': torn."
    assert messages == tuple(messages)


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
