"""The figures of docs/experiment.md are those that its benchmark prints."""

import re
import runpy
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def test_the_table_of_motions_is_that_of_the_benchmark(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    runpy.run_path(str(ROOT / "benchmarks" / "recording.py"))["main"]()
    printed = re.findall(r"^(\S.*?) {2,}(\d+ of \d+) +(\S+)$", capsys.readouterr().out, re.MULTILINE)
    page = (ROOT / "docs" / "experiment.md").read_text(encoding="utf-8")
    shown = re.findall(r"^\| (.+?) \| (\d+ of \d+) \| (.+?) \|$", page, re.MULTILINE)
    assert [row[:2] for row in shown] == [row[:2] for row in printed]
    assert len(shown) > 5
    for (_, _, told), (_, _, result) in zip(shown, printed, strict=True):
        assert float(told.replace("not determined", "inf")) == pytest.approx(float(result), rel=0.02)
