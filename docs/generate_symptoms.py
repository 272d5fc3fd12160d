"""Write what is printed into docs/symptoms.md and docs/payload.md: .venv/bin/python docs/generate_symptoms.py.

Behind a mark such as <!--OddScale--> stands what that note says, "…" for its figures; a choice is named by its enum,
such as <!--TermKind.SPRING-->. What is printed is written by the notes alone; causes and advice are the pages' own.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import fields
from difflib import SequenceMatcher
from enum import Enum
from importlib import import_module
from pathlib import Path
from types import UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

from dynident.checks.robot_notes import TermKind
from dynident.files.results import write_text
from dynident.identification import NextStep, Reason
from dynident.identification.verdict_reasons import ForbiddingFindings
from dynident.identification.verdict_steps import SetRight
from dynident.models.simulation import Broken, Failure
from dynident.runtime import Note, Remark, WordedEnum
from dynident.validation import Cause

for application in ("dynident.apps.excitation.robot", "dynident.apps.excitation.design", "dynident.apps.payload.body"):
    import_module(application)  # whose notes are in the tables, too

PAGES = tuple(Path(__file__).with_name(name) for name in ("symptoms.md", "payload.md"))
VALUES: tuple[dict[Any, Any], ...] = (
    {int: 2, float: 12.5, str: "one", bool: False},
    {int: 3, float: 47.5, str: "two", bool: False},
)
FIXED = {"MissingTerm": {"partner": "", "period": 0.0}, "WrongTimeUnit": {"factor": 1e3}}
SAID_ELSEWHERE = (Remark, ForbiddingFindings, SetRight, Broken)  # pass on what another says
MIN_LETTERS, MAX_WORDS = 24, 11  # of a quote
MARK = re.compile(r'<!--([\w.]+)-->(?:"[^"\n]*")?')


def kinds(base: type = object) -> Iterator[type]:
    """Yield all classes of dynident below ``base``, or below the bases of all that is printed, that say themselves."""
    for parent in (Note, Reason, NextStep, Cause, Failure) if base is object else (base,):
        for kind in parent.__subclasses__():
            if kind.__module__.startswith("dynident."):
                yield from kinds(kind)
                if kind.__str__ is not object.__str__ and not issubclass(kind, SAID_ELSEWHERE):
                    yield kind


def example(kind: type, values: dict[Any, Any], **changes: Any) -> Any:
    """Return a note with any figures; ``changes`` are those that are given."""
    if kind is Failure:
        return Broken("stopped")
    hints = get_type_hints(kind)
    figures = {field.name: _value(hints[field.name], values) for field in fields(kind)}
    return kind(**(figures | FIXED.get(kind.__name__, {}) | changes))


def _value(hint: Any, values: dict[Any, Any]) -> Any:
    origin, inside = get_origin(hint), get_args(hint)
    if origin is tuple:
        return (_value(inside[0], values),) * 2 if Ellipsis in inside else tuple(_value(x, values) for x in inside)
    if origin is Mapping:
        return {_value(inside[0], values): _value(inside[1], values)}
    if origin in (Union, UnionType):
        return _value(next(x for x in inside if x is not type(None)), values)
    if issubclass(hint, Enum):
        return next(iter(hint))
    return values[hint] if hint in values else example(hint, values)


def quote(kind: type) -> str:
    """Return the first clauses of what a note says, "…" for its figures."""
    first, second = (re.findall(r"\s+|[\w'-]+(?:\.\d+)?|.", str(example(kind, values))) for values in VALUES)
    text, end = "", 0
    for block in SequenceMatcher(None, first, second, autojunk=False).get_matching_blocks():
        text += "…" * (block.a > end) + "".join(first[block.a : block.a + block.size])
        end = block.a + block.size
    # of a list of the same words, one
    return _first_clauses(re.sub(r"(… [^…]{8,})\1+", r"\1", re.sub(r"…(?:[^A-Za-z]*…)+", "…", text)))


def _first_clauses(text: str) -> str:
    """Return as many clauses of a text as have enough letters to be recognised, and of these the first words."""
    clauses = re.split(r"(?<=[,.:;?]) ", text)
    starts = [" ".join(clauses[: k + 1]) for k in range(len(clauses))]
    start = next((start for start in starts if len(re.findall("[A-Za-z]", start)) >= MIN_LETTERS), text)
    start = " ".join(start.split(" ")[:MAX_WORDS])
    if start.count("(") > start.count(")"):
        start = start[: start.rindex("(")]
    return re.sub(r"^…[.:] ", "", start).rstrip(" ,.:;").replace("|", "/")


def printed(mark: str) -> str:
    """Return what a mark stands for, in quotes; KeyError where there is no such note or choice."""
    name, _, member = mark.partition(".")
    if member:
        choices = {kind.__name__: kind for kind in (TermKind, *WordedEnum.__subclasses__())}
        choice = choices[name][member]
        words = choice.effect.format("…", "…", "…") if isinstance(choice, TermKind) else choice.words
        return f'"{_first_clauses(words)}"'
    return f'"{quote({kind.__name__: kind for kind in kinds()}[name])}"'


def regenerate(page: str) -> str:
    """Return a page with what is printed at its marks."""
    return MARK.sub(lambda match: match[0][: match[0].index(">") + 1] + printed(match[1]), page)


if __name__ == "__main__":
    for path in PAGES:
        write_text(path, regenerate(path.read_text(encoding="utf-8")))
