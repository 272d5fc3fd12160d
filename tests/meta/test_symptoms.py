"""docs/symptoms.md has the words that checks, verdict and estimators print: of each type, and no others. Those on a
payload are in docs/payload.md."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import fields
from enum import Enum
from functools import cache
from pathlib import Path
from types import UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

import pytest
from dynident.report.finding_words import finding_words  # noqa: F401  # and those of findings
from dynident.report.verdict_words import verdict_sentences  # noqa: F401  # with it the words of reasons are there

from dynident.apps.excitation.expected_report import noise_words  # noqa: F401  # and those of designed motions
from dynident.apps.payload import body as payload_notes
from dynident.apps.payload.report import payload_words  # noqa: F401  # and those of payloads
from dynident.checks.log_notes import EffortAboveLimit, SearchKind, SearchLeftOut
from dynident.checks.notes import ReadingNote, SamplingJitter
from dynident.checks.robot_notes import MissingTerm, TermKind
from dynident.identification import Reason
from dynident.identification.verdict import ForbiddingFindings
from dynident.identification.verdict_steps import Sharpen
from dynident.models.simulation import Broken, Failure
from dynident.runtime import Note, Remark, Use
from dynident.validation import Cause

DOCS = Path(__file__).parents[2] / "docs"
PAGE = (DOCS / "symptoms.md").read_text(encoding="utf-8")
PAYLOAD_PAGE = (DOCS / "payload.md").read_text(encoding="utf-8")
PLAIN = {int: 2, float: 1e-3, str: "one", bool: False}
# what a reader needs no help with, and what passes on the words of another
LEFT_OUT = {"Averaged", "SmoothSigns"}
PASSED_ON = (Remark, ForbiddingFindings, Broken, ReadingNote)


def kinds(base: type) -> Iterator[type]:
    """All types below one that have words of their own."""
    for kind in base.__subclasses__():
        if kind.__module__.startswith("dynident."):
            yield from kinds(kind)
            if words.dispatch(kind) is not words.dispatch(object) and kind not in PASSED_ON:
                yield kind


def printed() -> list[type]:
    every = [kind for base in (Note, Reason, Cause, Failure) for kind in kinds(base)]
    return [kind for kind in every if kind not in of_payloads()]


def of_payloads() -> list[type]:
    return [kind for kind in kinds(Note) if kind.__module__ == payload_notes.__name__]


def example(hint: Any) -> Any:
    """Any value of a type: the words about it matter, not its figures."""
    origin, inside = get_origin(hint), get_args(hint)
    if origin is tuple:
        return (example(inside[0]),) * 2 if Ellipsis in inside else tuple(map(example, inside))
    if origin in (Union, UnionType):
        return example(next(one for one in inside if one is not type(None)))
    if issubclass(hint, Enum):
        return next(iter(hint))
    return PLAIN[hint] if hint in PLAIN else made(hint)


def made(kind: type, **given: Any) -> Any:
    if kind is Failure:
        return Broken("stopped")
    hints = get_type_hints(kind)
    return kind(**({field.name: example(hints[field.name]) for field in fields(kind)} | given))  # type: ignore[arg-type]


@cache
def texts(kind: type) -> tuple[str, ...]:
    """What is printed of a type, of each sort of it."""
    if issubclass(kind, MissingTerm):
        return tuple(str(made(kind, effect=effect, period=0.0)) for effect in TermKind)
    if kind is SearchLeftOut:
        return tuple(str(made(kind, search=search)) for search in SearchKind)
    if kind is EffortAboveLimit:
        return tuple(str(made(kind, far=far)) for far in (False, True))
    if kind is SamplingJitter:
        return str(made(kind)), str(made(kind, factor=None))
    said: str = str(made(kind))
    return said, said[0].upper() + said[1:]


def quoted() -> list[str]:
    prose = re.sub(r"```.*?```|`[^`]*`", "``", PAGE, flags=re.DOTALL)
    return re.findall(r'"([^"\n]+)"', prose)


@pytest.mark.parametrize("kind", sorted(printed(), key=lambda kind: kind.__name__), ids=lambda kind: kind.__name__)
def test_each_type_of_message_has_its_entry(kind: type) -> None:
    if kind.__name__ in LEFT_OUT:
        assert getattr(kind, "forbids", None) is None
        return
    found = [phrase for phrase in quoted() if any(phrase in text for text in texts(kind))]
    assert found, f"docs/symptoms.md quotes nothing of what is printed: {texts(kind)[0]}"


def test_each_type_of_note_on_a_payload_has_its_row_and_no_others() -> None:
    rows, kinds = re.findall(r'^\| "([^"]+)"', PAYLOAD_PAGE, flags=re.MULTILINE), of_payloads()
    defined = [
        kind for kind in vars(payload_notes).values() if getattr(kind, "__module__", "") == payload_notes.__name__
    ]
    assert set(kinds) == {kind for kind in defined if isinstance(kind, type) and issubclass(kind, Note)}
    assert len(kinds) > 5
    for kind in kinds:
        assert any(row in text for row in rows for text in texts(kind)), f"docs/payload.md: {texts(kind)[0]}"
    assert [row for row in rows if not any(row in text for kind in kinds for text in texts(kind))] == []


def test_every_effect_that_a_model_may_lack_has_its_entry() -> None:
    for effect in TermKind:
        name = str(made(MissingTerm, effect=effect, period=0.0)).partition(" (")[0].removesuffix(" together with one")
        assert f'"{name.removesuffix(",")}"' in PAGE, name


def test_no_words_are_quoted_that_nobody_prints() -> None:
    every = [text for kind in (*printed(), Sharpen) for text in texts(kind)]
    assert [phrase for phrase in quoted() if not any(phrase in text for text in every)] == []


def test_what_forbids_a_use_is_among_them() -> None:
    found = set(printed())
    assert len([kind for kind in found if getattr(kind, "forbids", None) in (Use.CONTROL, Use.SIMULATION)]) > 20
    assert set(Reason.__subclasses__()) - {ForbiddingFindings} <= found
