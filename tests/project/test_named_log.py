"""Recordings named on a command line."""

from __future__ import annotations

from pathlib import Path

import pytest

from dynident.project.logs import recording_argument
from dynident.project.settings import LogSpec


def test_a_recording_is_named_as_it_is_typed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    here, there = tmp_path / "logs" / "q.csv", tmp_path.parent / "tau.csv"
    assert recording_argument(LogSpec.model_validate({"file": str(here)})) == str(Path("logs") / "q.csv")
    both = LogSpec.model_validate({"file": {"q": str(here), "tau": str(there)}})
    assert recording_argument(both) == f"q={Path('logs') / 'q.csv'},tau={there}"
