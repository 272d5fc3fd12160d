"""docs/symptoms.md and docs/payload.md have what is printed: of each type of message, and in its words."""

import re
import runpy
from pathlib import Path

import pytest

from dynident.checks.robot_notes import TermKind

DOCS = Path(__file__).parents[2] / "docs"
GENERATOR = runpy.run_path(str(DOCS / "generate_symptoms.py"))
PAGES = {path.name: path.read_text(encoding="utf-8") for path in GENERATOR["PAGES"]}
MARKED = {match[1] for page in PAGES.values() for match in GENERATOR["MARK"].finditer(page)}
# what a reader needs no help with: how data were changed, a missing term at a higher price, and what to do next
LEFT_OUT = {"Averaged", "GripperLeftOut", "SmoothSigns", "TermLeftOut"}
KINDS = {kind.__name__: kind for kind in GENERATOR["kinds"]() if kind not in GENERATOR["kinds"](GENERATOR["NextStep"])}


@pytest.mark.parametrize("name", PAGES)
def test_the_pages_have_what_is_printed(name: str) -> None:
    """Where one is stale: .venv/bin/python docs/generate_symptoms.py."""
    assert PAGES[name] == GENERATOR["regenerate"](PAGES[name])


def test_each_type_of_message_has_its_entry() -> None:
    assert len(KINDS) > 100
    assert set(KINDS) - MARKED == LEFT_OUT
    assert not any(getattr(KINDS[name], "forbids", None) for name in LEFT_OUT - {"TermLeftOut"})
    assert {f"TermKind.{kind.name}" for kind in TermKind} <= MARKED


def test_no_words_are_quoted_that_nobody_prints() -> None:
    prose = re.sub(r"```.*?```|`[^`]*`", "``", PAGES["symptoms.md"], flags=re.DOTALL)
    free = re.findall(r'(?<!-->)"([^"\n]+)"', GENERATOR["MARK"].sub("", prose))
    texts = [str(GENERATOR["example"](kind, GENERATOR["VALUES"][0])) for kind in GENERATOR["kinds"]()]
    assert [phrase for phrase in free if phrase != "…" and not any(phrase in text for text in texts)] == []
