"""The page of many runs shows the figures that are kept, and what they cost on many cores follows from them."""

from __future__ import annotations

import importlib
import json
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture
def scaling(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    return importlib.import_module("scaling_page")


def test_the_tables_are_those_of_the_kept_figures(scaling: ModuleType) -> None:
    text = scaling.PAGE.read_text(encoding="utf-8")
    kept = json.loads(scaling.FIGURES.read_text(encoding="utf-8"))
    assert scaling.page(text, kept) == text
    assert all(f"<!-- {name} -->\n\n|" in text for name in scaling.TABLES)


def test_more_cores_help_until_who_asks_has_no_time_left(scaling: ModuleType) -> None:
    work = scaling.Work("fits", jobs=1000, worker=0.95, own=0.01)
    assert work.seconds(1) == pytest.approx(960)
    assert work.seconds(50) == pytest.approx(20)
    assert work.most == pytest.approx(100)
    assert work.seconds(100) == work.seconds(1000) == pytest.approx(10)
