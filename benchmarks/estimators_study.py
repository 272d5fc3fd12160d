"""A Monte Carlo study of every estimator and smoother: what is run how often, and what its rows say beside the bound.

The parts are those of the tables of ``dynident.runtime.families``: a new kind takes part by itself.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from dynident.apps.article import FitOutcome, Method, Scenario, run_study, statistics
from dynident.project.parts import build
from dynident.runtime import ConfigError, MissingInputError
from dynident.runtime.families import PartFamily
from dynident.runtime.jobs import Limits

PILOT = 2  # runs of every method in every cell, by which the others are planned
SLOW = 15.0  # s of a fit, from which on what is run seldom is not run
TOGETHER, LONGEST = 8, 900.0  # methods that see a recording in one job, and how long (s) that may take
LACKS = MissingInputError.__name__
# kinds that are methods of their own by a setting
VARIANTS: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "robust": ("loss", ("huber", "tukey")),
    "instrumental_variables": ("instruments", ("simulated", "lagged")),
}
Row = dict[str, Any]
Say = Callable[[str], None]


def parts(family: PartFamily) -> Iterator[tuple[str, Any]]:
    """Name and part of every kind of a family that needs no settings, and of its variants."""
    for kind in family.table:
        setting, values = VARIANTS.get(kind, ("", ("",)))
        for value in values:
            try:
                part = build(family, {"kind": kind} | ({setting: value} if setting else {}), kind)
            except ConfigError:
                continue  # a part around another one
            yield f"{kind}, {value}" if setting else kind, part


@dataclass(frozen=True)
class Study:
    """Scenarios x levels x methods, with the true values, and the least standard deviations (p) in each cell.

    ``paired`` maps a scenario to the same with more in its logs: it is run only with the methods to which that matters.
    ``seldom`` maps methods that are run a few times only to those whose time tells whether they are. ``more`` says more
    of the estimates (runs, p) of a cell. Where not ``each`` parameter is told, figures are root mean squares over them.
    """

    name: str
    scenarios: Sequence[Scenario]
    levels: Sequence[float]
    methods: Mapping[str, Method]
    truth: np.ndarray
    bound: Callable[[str, float], np.ndarray]
    paired: Mapping[str, Scenario]
    seldom: Mapping[str, str] = field(default_factory=dict)
    more: Callable[[np.ndarray], Row] | None = None
    each: bool = True


@dataclass(frozen=True)
class Runner:
    """Where a study runs, and how long it may take: ``minutes`` on ``workers``, none for as long as it takes."""

    folder: Path
    executor: Executor | None
    workers: int = 1
    minutes: float | None = None
    seed: int = 0
    say: Say = print

    def rows(self, study: Study, scenarios: Sequence[Scenario], names: Sequence[str], runs: int) -> pl.DataFrame:
        """The rows of some methods, a few at a time; those that are in the folder are not computed again."""
        given = [study.methods[name] for name in names]
        how: dict[str, Any] = {"path": self.folder / f"{study.name}.parquet", "executor": self.executor}
        if self.executor is not None:
            how["limits"] = Limits(LONGEST)
        some = [given[k : k + TOGETHER] for k in range(0, len(given), TOGETHER)]
        return pl.concat(run_study(scenarios, few, study.levels, runs, self.seed, **how) for few in some)


def run(study: Study, runner: Runner, runs: int) -> Row:
    """Run a study, each method as often as the time allows, and return what its page shows."""
    runner.folder.mkdir(parents=True, exist_ok=True)
    few = min(PILOT, runs)
    first = pilot(study, runner, few)
    todo = dict(applicable(study, first))
    each = {name: seconds(first, name) * len(study.levels) * len(where) for name, where in todo.items()}
    most = {name: few if name in study.seldom else runs for name in todo}
    budget = None if runner.minutes is None else 60 * runner.minutes * runner.workers
    plan = planned(each, most, budget, few)
    took = sum(each[name] * count for name, count in plan.items()) / runner.workers / 60
    runner.say(f"{study.name}: about {took:.0f} min on {runner.workers} workers")
    cells = list[Row]()
    groups: dict[tuple[int, tuple[str, ...]], list[str]] = {}
    for name, count in plan.items():
        groups.setdefault((count, tuple(x.name for x in todo[name])), []).append(name)
    for (count, _), names in groups.items():
        where = todo[names[0]]
        runner.say(f"{count} runs of {', '.join(names)} in {', '.join(x.name for x in where)}")
        table = runner.rows(study, where, names, count)
        cells += [judged(study, table, *cell) for cell in product([x.name for x in where], study.levels, names)]
    return {"runs": runs, "seed": runner.seed, "cells": cells, "lacking": lacking(study, first, todo)}


def pilot(study: Study, runner: Runner, few: int) -> pl.DataFrame:
    """The first rows of every method; of those that are run seldom, where the method that tells of them is fast."""
    where = [*study.scenarios, *study.paired.values()]
    first = runner.rows(study, where, [name for name in study.methods if name not in study.seldom], few)
    reference = set(first["method"])
    fast = [name for name, other in study.seldom.items() if other in reference and seconds(first, other) <= SLOW]
    return pl.concat((first, runner.rows(study, where, fast, few))) if fast else first


def applicable(study: Study, first: pl.DataFrame) -> Iterator[tuple[str, list[Scenario]]]:
    """The scenarios of each method: where the log has what it needs, and of two that give the same, the first."""
    for name in first["method"].unique(maintain_order=True):
        rows = {key: group for (key,), group in first.filter(pl.col("method") == name).group_by("scenario")}
        usable = [scenario for scenario in study.scenarios if needs(rows[scenario.name]) is None]
        for scenario in study.scenarios:
            more = study.paired.get(scenario.name)
            if more is None or needs(rows[more.name]) is not None:
                continue
            same = [rows[key].sort("level", "run")["value"].to_list() for key in (scenario.name, more.name)]
            if scenario not in usable or same[0] != same[1]:
                usable.append(more)
        if usable:
            yield name, usable


def needs(rows: pl.DataFrame) -> str | None:
    """What the logs lack for a method that gives nothing, None where it does or fails for another reason."""
    lacking = [reason for reason in rows["reason"] if kind(reason) == LACKS]
    if not lacking or rows["value"].list.len().sum():
        return None
    return str(lacking[0]).partition(": ")[2]


def kind(reason: str) -> str:
    """The type of the error of a fit."""
    return reason.partition(":")[0]


def lacking(study: Study, first: pl.DataFrame, todo: Mapping[str, Sequence[Scenario]]) -> dict[str, str]:
    """What the logs lack, by the method that needs it."""
    left = [name for name in study.methods if name not in todo and name not in study.seldom]
    result = {name: needs(first.filter(pl.col("method") == name)) for name in left}
    return {name: what for name, what in result.items() if what}


def seconds(rows: pl.DataFrame, method: str) -> float:
    """Seconds of a fit."""
    return float(np.median(rows.filter(pl.col("method") == method)["seconds"].to_numpy()))


def planned(each: Mapping[str, float], most: Mapping[str, int], budget: float | None, few: int) -> dict[str, int]:
    """How often each method runs, for the seconds of one run of all its cells: those that take longest are cut to the
    same time, so that all fit into the budget (s); none runs less than ``few`` times."""
    full = {name: each[name] * most[name] for name in each}
    share, left = math.inf, math.inf if budget is None else budget
    for place, (_, need) in enumerate(ordered := sorted(full.items(), key=lambda x: x[1])):
        if need > (share := left / (len(ordered) - place)):
            break
        share, left = math.inf, left - need
    return {name: most[name] if full[name] <= share else max(few, int(share / each[name])) for name in each}


def judged(study: Study, table: pl.DataFrame, scenario: str, level: float, method: str) -> Row:
    """Errors of one cell in standard deviations of the bound, by parameter; coverage; what became of the fits."""
    rows = table.filter((pl.col("scenario") == scenario) & (pl.col("level") == level) & (pl.col("method") == method))
    summary = statistics(rows, len(study.truth))
    error = (summary.estimates - study.truth) / study.bound(scenario, level)
    shares = summary.covered_share(study.truth)
    told = listed if study.each else lambda values: listed(np.sqrt([np.mean(np.square(values))]))
    return {
        "scenario": scenario,
        "level": level,
        "method": method,
        "runs": len(rows),
        "failed": summary.failed,
        "unsettled": summary.unsettled,
        "reasons": dict(Counter(kind(x) for x in rows.filter(pl.col("status") == FitOutcome.FAILED)["reason"])),
        "seconds": digits(seconds(rows, method)),
        "rms": told(np.sqrt(np.mean(error**2, axis=0))) if len(error) else [],
        "bias": told(error.mean(axis=0)) if len(error) else [],
        "spread": told(error.std(axis=0, ddof=1)) if len(error) > 1 else [],
        "coverage": listed(shares if study.each else [np.mean(shares)]) if len(error) else [],
        **(study.more(summary.estimates) if study.more and len(error) else {}),
    }


def listed(values: Any) -> list[float]:
    return [digits(value) for value in values]


def digits(value: float) -> float:
    return float(f"{value:.4g}")
