"""The study of every estimator and smoother: its harness takes every kind."""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import polars as pl
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
    found = frame.run(study, frame.Runner(tmp_path, None, say=said.append), 3)
    cells = {one["method"]: one for one in found["cells"]}
    assert {one["scenario"] for one in found["cells"]} == {"tabulated"}
    assert list(cells) == ["spline", "raw"]
    assert all(one["runs"] == 3 and one["failed"] == 0 and len(one["coverage"]) == 7 for one in cells.values())
    assert 2 < np.mean(cells["spline"]["rms"]) < np.mean(cells["raw"]["rms"])
    for name, one in cells.items():  # rms^2 is bias^2 and the variance of n of the n - 1
        parts = np.square(one["bias"]) + np.square(one["spread"]) * 2 / 3
        np.testing.assert_allclose(np.square(one["rms"]), parts, rtol=5e-3, err_msg=name)
    assert "3 runs of spline, raw in tabulated" in said
    found |= {"known": {"tabulated": {"0.0001": 0.7}}, "minutes": 0.0, "workers": 1, "load": 0.0}
    drawn = load("page").tables({"article": found})
    assert "| least_squares | " in drawn["estimators"]
    assert "| difference | " in drawn["smoothers"]


def test_every_kind_takes_part(load: Load) -> None:
    for study, sizes in ((load("article"), {"time_shifted"}), (load("arm"), {"time_shifted"})):
        named = study.methods()[0] if study.__name__.endswith("arm") else study.methods()
        for kind in {*SMOOTHERS.table, *ESTIMATORS.table} - sizes - {"difference", "least_squares"}:
            assert any(kind in name.replace(",", "").split() for name in named), kind


def test_the_slowest_get_fewer_runs_and_none_too_few(load: Load) -> None:
    planned = load("study").planned
    each, most = {"fast": 0.1, "slow": 10.0, "slower": 30.0}, dict.fromkeys(("fast", "slow", "slower"), 100)
    assert planned(each, most, None, 2) == most
    some = planned(each, most, 610.0, 2)
    assert some == {"fast": 100, "slow": 30, "slower": 10}
    assert planned(each, most, 1.0, 2)["slower"] == 2


def test_of_two_scenarios_that_give_the_same_one_is_run(load: Load) -> None:
    """A method that lacks its controller in the one runs in the other only; what differs is run in both."""
    frame = load("study")
    rows = [
        ("same", "a", "", [1.0]), ("same", "a, torque known", "", [1.0]),
        ("other", "a", "", [1.0]), ("other", "a, torque known", "", [2.0]),
        ("driven", "a", "MissingInputError: a: no controller", []), ("driven", "a, torque known", "", [1.0]),
        ("never", "a", "MissingInputError: no period", []), ("never", "a, torque known", "MissingInputError: no", []),
        ("mostly", "a", "MissingInputError: no loop", []), ("mostly", "a, torque known", "InputError: no mass", []),
        ("mostly", "a, torque known", "MissingInputError: no loop", []),
    ]  # fmt: skip
    columns = ("method", "scenario", "reason", "value")
    first = pl.DataFrame([dict(zip(columns, row, strict=True)) | {"level": 1.0, "run": 0} for row in rows])

    class Named:
        def __init__(self, name: str) -> None:
            self.name = name

    one, two = Named("a"), Named("a, torque known")
    names = dict.fromkeys(("same", "other", "driven", "never", "mostly"))
    study = frame.Study("s", [one], [1.0], names, np.ones(1), lambda *_: np.ones(1), {"a": two})
    todo = dict(frame.applicable(study, first))
    assert todo == {"same": [one], "other": [one, two], "driven": [two]}
    assert frame.lacking(study, first, todo) == {"never": "no period", "mostly": "no loop"}


def test_the_arm_in_closed_loop_is_identified_from_a_short_log(load: Load) -> None:
    arms = load("arm")
    loop = arms.ClosedLoop(seconds=1.0)
    truth, drives = loop.driven
    model, theta, base = arms.arm()
    record = loop.record(12, np.random.default_rng(0))
    count = 2 * np.pi / 2**12
    assert np.abs(record.log.q - truth.q).max() <= count / 2 * (1 + 1e-9)
    assert record.log.controller is drives
    left = truth.tau - model.torque(truth.q, truth.dq, truth.ddq, theta)
    assert (np.sqrt(np.mean(left**2, axis=0)) < loop.noise).all()  # the truth fulfils its equation
    assert arms.held_out(base.to_base(theta)[None])["error"] < 1e-9
    noise = arms.coloured((20000, 1), np.random.default_rng(1))[:, 0]
    assert noise.std() == pytest.approx(1, abs=0.05)
    assert np.mean(noise[1:] * noise[:-1]) == pytest.approx(0.8, abs=0.05)
    study = arms.study(["spline + least_squares"], [17.0], loop)
    found = study.methods["spline + least_squares"].estimate(record)
    assert len(found.value) == base.rank
    assert math.isfinite(arms.held_out(found.value[None])["error"])
