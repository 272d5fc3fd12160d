"""The page of the defaults shows the figures that are kept: no table of it is edited by hand."""

from __future__ import annotations

import importlib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def test_the_page_shows_the_figures_that_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    shown = importlib.import_module("defaults_page")
    text = shown.PAGE.read_text(encoding="utf-8")
    assert shown.page(text, shown.read(shown.FIGURES)) == text
    assert text.count(", before |") == len(shown.ROBOTS)
