"""Every estimator and smoother where the truth is known: python3 benchmarks/estimators.py [STUDY ...] --page.

Studies: article (the article's arm at three noise levels: every estimator on its spline, every smoother with least
squares), arm (a simulated arm of six joints in closed loop, every smoother with every estimator). Errors are in
standard deviations of the bound. The parts are those of the families' tables.

The rows are kept in a folder outside the repository: run the same command again to go on where it stopped. First each
method runs twice in every cell; by that, how long all takes is said, and the slowest get fewer runs where --minutes,
for each study, would not do. --page keeps the figures in out/estimators.json and writes the tables of
benchmarks/estimators_measured.md; --draw does without measuring.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import gettempdir
from typing import Any

os.environ.update(dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1"))

import estimators_arm
import estimators_article
from estimators_page import FIGURES, draw, tables
from estimators_study import Row, Runner, Study, run
from page_tables import read_figures, write_figures

from dynident.apps.article import LEVELS, SCENARIOS
from dynident.runtime.jobs import local_workers

STUDIES: dict[str, Callable[[Sequence[str]], Study]] = {
    "article": estimators_article.study,
    "arm": estimators_arm.study,
}
RUNS, MINUTES = {"article": 200, "arm": 20}, {"article": 20.0, "arm": 18.0}
PRELOADED = ("dynident.apps.article.article", "estimators_article", "estimators_arm")


def measured(name: str, runner: Runner, runs: int, methods: Sequence[str] = ()) -> Row:
    """Run a study and return the figures of its page."""
    began, load = time.perf_counter(), os.getloadavg()[0]
    outcome = run(STUDIES[name](methods), runner, runs)
    if name == "article":
        outcome["known"] = {
            x: {f"{level:g}": round(estimators_article.known_bound(x, level), 4) for level in LEVELS} for x in SCENARIOS
        }
    minutes = round((time.perf_counter() - began) / 60, 1)
    return outcome | {"minutes": minutes, "workers": runner.workers, "load": round(load, 1)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("studies", nargs="*", metavar="STUDY", help=", ".join(STUDIES))
    parser.add_argument("--runs", type=int, help=f"of each cell, by default {RUNS}")
    parser.add_argument("--minutes", type=float, help=f"that a study may take, by default {MINUTES}; 0: as it takes")
    parser.add_argument("--folder", type=Path, default=Path(gettempdir()) / "dynident-estimators", help="for the rows")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--method", action="append", default=[], help="by default all")
    parser.add_argument(
        "--page", action="store_true", help="keep the figures for benchmarks/estimators_measured.md, and write it"
    )
    parser.add_argument(
        "--draw", action="store_true", help="write benchmarks/estimators_measured.md from the figures that it has"
    )
    given = parser.parse_args()
    if wrong := [name for name in given.studies if name not in STUDIES]:
        parser.error(f"unknown study {wrong[0]!r}; known: {', '.join(STUDIES)}")
    kept: dict[str, Any] = read_figures(FIGURES)
    with local_workers(given.workers, PRELOADED) as executor:
        for name in () if given.draw else given.studies or STUDIES:
            minutes = MINUTES[name] if given.minutes is None else given.minutes or None
            runner = Runner(given.folder, executor, given.workers, minutes, given.seed)
            kept[name] = measured(name, runner, given.runs or RUNS[name], given.method)
            print("\n\n".join(tables({name: kept[name]}).values()))
            if given.page:
                write_figures(kept, FIGURES)
    if given.page or given.draw:
        draw(kept)


if __name__ == "__main__":
    main()
