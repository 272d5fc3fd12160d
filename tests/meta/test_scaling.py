"""What many runs cost on many cores follows from what one costs."""

from __future__ import annotations

import importlib
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture
def scaling(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    return importlib.import_module("scaling_page")


def test_more_cores_help_until_who_asks_has_no_time_left(scaling: ModuleType) -> None:
    work = scaling.Work("fits", jobs=1000, worker=0.95, own=0.01)
    assert work.seconds(1) == pytest.approx(960)
    assert work.seconds(50) == pytest.approx(20)
    assert work.most == pytest.approx(100)
    assert work.seconds(100) == work.seconds(1000) == pytest.approx(10)
