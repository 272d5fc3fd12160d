"""Estimators on real robots and beside peers: what their figures decide."""

from __future__ import annotations

import argparse
import importlib
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
Load = Callable[[str], ModuleType]


@pytest.fixture
def load(monkeypatch: pytest.MonkeyPatch) -> Load:
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    return lambda name: importlib.import_module(f"estimators_{name}")


def test_values_are_as_far_from_the_published_ones_as_the_errors_of_both_say(load: Load) -> None:
    shown = load("robots_page")
    same = {"value": shown.VALUE, "std": shown.STD}
    assert shown.apart(same) == 0
    moved = {"value": np.add(shown.VALUE, [0, 0, 0.3, 0]), "std": np.zeros(4)}
    assert shown.apart(moved) == pytest.approx(0.3 / shown.STD[2])


def test_of_a_robot_the_best_the_configured_and_the_plain_combination_are_shown(load: Load) -> None:
    def row(name: str, error: float, own: bool = False, **more: Any) -> dict[str, Any]:
        smoother, _, estimator = name.partition(" ")
        return {"smoother": smoother, "estimator": estimator, "own": own, "status": "ok", "worse": error > 2,
                "error": error, "overall": error, "least": 0.1, "most": 0.2, "seconds": 1.0} | more  # fmt: skip

    rows = [row("a one", 1), row("a two", 1.5), row("a three", 2), row("b one", 3), row("b own", 4, True),
            row("spline least_squares", 5), row("b bad", 0, status="failed") | {"error": None}]  # fmt: skip
    found = {"rows": rows, "absent": ["didim"], "within_chance": [1, 2], "told_from_chance": True}
    lines = load("robots_page").robot_lines("lwr4", found)
    assert [line[1:4] for line in lines] == [
        ["1. best", "a", "one"], ["2.", "a", "two"], ["3.", "a", "three"], ["5. configured", "b", "own"],
        ["6. plain", "spline", "least_squares"],
    ]  # fmt: skip
    assert [line[7] for line in lines] == ["", "chance", "chance", "more than chance", "more than chance"]
    said = load("robots_page").robots({"lwr4": found})
    assert "LWR4: 7 combinations, 2 of them as good as the best within chance, 1 failed; not applicable: didim." in said
    assert "Not measured: EMPS, double pendulum, Panda, TX40." in said


def test_a_robot_without_recordings_is_skipped(
    load: Load, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    study = load("robots")
    monkeypatch.setattr(importlib.import_module("commands"), "ROOT", tmp_path / "checkout")
    nothing = argparse.Namespace(robot=None, folder=tmp_path)
    assert study.robots(nothing) == {}
    assert study.emps(nothing) == {}
    said = capsys.readouterr().out
    assert all(f"{robot} is skipped" in said for robot in study.ROBOTS)


def test_each_conclusion_of_the_survey_is_decided_by_the_figures(load: Load) -> None:
    of = load("survey")
    assert all("| not measured" in line for line in of.survey({}, {}).splitlines()[2:])
    sizes = {
        "least_squares": 4.0,
        of.WEIGHTED: 3.0,
        of.DIDIM: 1.0,
        of.INSTRUMENTS: 1.0,
        of.OUTPUT: 2.0,
        "consistent": 1.0,
        of.KALMAN: 5.0,
    }
    cost = {"least_squares": 1.0, of.DIDIM: 4.0, of.OUTPUT: 40.0, "consistent": 3.0, of.KALMAN: 90.0}
    cells = [
        {"method": f"spline + {name}", "level": level, "rms": [size], "seconds": cost.get(name, 2.0), "error": size}
        for name, size in sizes.items() for level in of.LEVELS
    ]  # fmt: skip
    raw = {"method": "difference + least_squares", "level": 12.0, "rms": [90.0], "seconds": 1.0, "error": 90.0}
    names = ("least squares", "instrumental variables", "didim", "output error")
    fits = {name: {"errors": {"validation": {"filtered": 5.0}}} for name in names}
    robots = {"lwr4": {"absent": ["didim"], "rows": []}, "emps": {"absent": [], "rows": [{"estimator": "didim"}]}}
    said = of.survey({"arm": {"cells": [*cells, raw]}}, {"emps": {"fits": fits}, "robots": robots})
    answers = [line.split(" | ")[1] for line in said.splitlines()[2:]]
    assert answers == ["yes", "yes", "no", *["yes"] * 8]
    for cell in cells:
        if cell["method"] == f"spline + {of.DIDIM}" and cell["level"] == of.LEVELS[1]:
            cell["rms"] = [3.0]
    said = of.survey({"arm": {"cells": [*cells, raw]}}, {})
    assert [line.split(" | ")[1] for line in said.splitlines()[2:]][3:5] == ["in part", "in part"]


def test_parameters_of_peers_are_judged_in_the_order_of_the_model(load: Load) -> None:
    theta, base = load("arm").arm()[1:]
    exact = load("peers").judged("peer", "fit", theta, 1.0, np.ones(base.rank))
    assert exact["rms"] == 0
    assert exact["error"] < 1e-9
