"""The benchmarks: works are measured in turn, marks are judged, figures of other parts are kept."""

import importlib
import json
import os
from pathlib import Path
from types import SimpleNamespace

import pytest

ROOT = Path(__file__).parents[2]
pytestmark = pytest.mark.skipif(os.name == "nt", reason="processes are measured by their resource usage")
PARTS = ("marks", "measure", "plot", "run", "tables")
TRIED = """
import os

def tried(who, *values):
    if who == "a peer that is not here":
        raise FileNotFoundError(f"{who} is not found")
    print("no answer")
    off = os.environ.get("DYNIDENT_KERNEL") == "off"
    return lambda: {"cpu": sum(values) * (1 if who != "dynident" else 0.5 if off else 0.1)}

def large(who):
    data = b"." * (100 * 2**20)
    return lambda: len(bytearray(50 * 2**20)) + len(data)

def broken(who):
    return lambda: 1 / 0
"""


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    return SimpleNamespace(**{name: importlib.import_module(name) for name in PARTS})


@pytest.fixture
def tried(bench: SimpleNamespace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """The same with a file of works that take no time."""
    (tmp_path / "tried.py").write_text(TRIED, encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    return bench


def test_a_work_is_measured_with_the_kernel_without_it_and_by_its_peers(tried: SimpleNamespace) -> None:
    work = tried.measure.Work("tried", "tried", (2, 3), ("peer", "a peer that is not here"), seconds=0)
    result = tried.measure.measured(work)
    assert list(result) == ["with", "without", "peer", "a peer that is not here"]
    assert [result[way].cpu for way in list(result)[:3]] == [0.5, 2.5, 5.0]
    assert result["peer"].peak > 0.001
    assert result["a peer that is not here"] == "a peer that is not here is not found"


def test_every_work_exists_and_has_one_key(bench: SimpleNamespace) -> None:
    every = bench.marks.works(bench.run.PARTS)
    assert len({work.key for work in every}) == len(every) > 40
    for work in every:
        source = (ROOT / "benchmarks" / f"{work.file}.py").read_text(encoding="utf-8")
        assert f"def {work.name}(" in source, work.key


def test_a_run_keeps_what_a_file_has_of_other_parts(
    tried: SimpleNamespace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    work = tried.measure.Work("tried", "tried", (1,), ("peer",), seconds=0)
    row = tried.marks.Row("a row", work, "peer", (tried.marks.Mark(ratio=5), tried.marks.Mark(ratio=5)))
    monkeypatch.setitem(tried.marks.TABLES, "start", tried.marks.Table("A table", "s", 1, (row,)))
    monkeypatch.setattr(tried.run, "facts", lambda: {"level": "avx2", "kernel": "avx2"})
    file = tmp_path / "kept.json"
    file.write_text(json.dumps({"machine": {}, "works": {"other": {"with": "kept"}}}), encoding="utf-8")
    tried.run.main(["start", "--json", str(file)])
    content = json.loads(file.read_text(encoding="utf-8"))["works"]
    assert content["other"] == {"with": "kept"}
    assert content[work.key]["without"]["cpu"] == 0.5
    shown = capsys.readouterr().out
    assert "| a row | peer 1 | 0.1 (10 x) | 5 x: met | 0.5 (2 x) | 5 x: **not met** |" in shown
    assert "Marks: 1 met, 1 not met, 0 not measured." in shown
