"""The examples in Python run as they are, without a warning, and print a few lines."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_examples_run_and_print(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(path), run_name="__main__")  # pytest makes errors of warnings
    assert 2 <= len(capsys.readouterr().out.splitlines()) < 60
    assert not list(tmp_path.iterdir())


def test_there_are_five_and_a_walk_through_them() -> None:
    assert {path.stem for path in EXAMPLES} >= {
        "accuracy", "article_arm", "spline", "stribeck", "urdf_arm", "walkthrough",
    }  # fmt: skip
    text = (ROOT / "examples" / "walkthrough.py").read_text(encoding="utf-8")
    assert text.count("# %%") > 10
