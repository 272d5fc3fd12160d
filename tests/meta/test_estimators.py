"""The study of every estimator and smoother: its harness takes every kind."""

import importlib
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from dynident.runtime.families import ESTIMATORS, SMOOTHERS

ROOT = Path(__file__).parents[2]
Load = Callable[[str], ModuleType]


@pytest.fixture
def load(monkeypatch: pytest.MonkeyPatch) -> Load:
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    return lambda name: importlib.import_module(f"estimators_{name}")


def test_a_few_runs_give_figures_for_every_cell(load: Load, tmp_path: Path) -> None:
    """Least squares misses the bound at a noise of 1e-4, and a controller changes nothing for it."""
    frame, arms = load("study"), load("article")
    study = arms.study(["spline", "raw"], [1e-4], ["tabulated"])
    said: list[str] = []
    outcome = frame.run(study, frame.Runner(tmp_path, None, say=said.append), 3)
    cells = {x["method"]: x for x in outcome["cells"]}
    assert {x["scenario"] for x in outcome["cells"]} == {"tabulated"}
    assert list(cells) == ["spline", "raw"]
    assert all(cell["runs"] == 3 and cell["failed"] == 0 and len(cell["coverage"]) == 7 for cell in cells.values())
    assert 2 < np.mean(cells["spline"]["rms"]) < np.mean(cells["raw"]["rms"])
    for name, case in cells.items():  # rms^2 is bias^2 and the variance of n of the n - 1
        parts = np.square(case["bias"]) + np.square(case["spread"]) * 2 / 3
        np.testing.assert_allclose(np.square(case["rms"]), parts, rtol=5e-3, err_msg=name)
    assert "3 runs of spline, raw in tabulated" in said
    outcome |= {"known": {"tabulated": {"0.0001": 0.7}}, "minutes": 0.0, "workers": 1, "load": 0.0}
    drawn = load("page").tables({"article": outcome})
    assert "| least_squares | " in drawn["estimators"]
    assert "| difference | " in drawn["smoothers"]


def test_every_kind_takes_part(load: Load) -> None:
    for study, sizes in ((load("article"), {"time_shifted"}), (load("arm"), {"time_shifted"})):
        named = study.methods()[0] if study.__name__.endswith("arm") else study.methods()
        for kind in {*SMOOTHERS.table, *ESTIMATORS.table} - sizes - {"difference", "least_squares"}:
            assert any(kind in name.replace(",", "").split() for name in named), kind
