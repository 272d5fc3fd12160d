"""Defaults on many pairs of training and held-out recording: python3 benchmarks/pairs.py [ROBOT ...] --out pairs.jsonl.

The measured robots of defaults_robots.py, in both directions, in halves and from one log to another. Each pair is
identified with nothing set, and by an oracle: the same terms, smoothing and offset fitted to the held-out log itself.
One number decides: the geometric mean over all pairs of error / oracle. Beside it stands plain viscous and Coulomb
friction. A line of JSON per pair is appended to --out, where pairs that are there already are left out; --against
another such file compares pair by pair. A third of the pairs is kept for the end: only --all runs them.
"""

from __future__ import annotations

import argparse
import json
import os
import time
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

os.environ.update(dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1"))

import numpy as np
import yaml
from defaults import configured, errors, found_at
from defaults_robots import PENDULUM, ROBOTS

from dynident.estimators import LeastSquares
from dynident.identification import Identification, identify
from dynident.identification.calibration import with_plain_terms
from dynident.motion.log import Log
from dynident.project.project import Project, read_project
from dynident.runtime import DynidentError

Row = dict[str, Any]
Part = tuple[int, float, float | None]  # a recording of the robot by its number, from and to (s)
Pair = tuple[Part, Part]
ALL = (0.0, None)
PAIRS: dict[str, tuple[Pair, ...]] = {
    "emps": (
        ((0, *ALL), (1, *ALL)),
        ((1, *ALL), (0, *ALL)),
        ((0, 0.0, 12.4), (0, 12.4, None)),
        ((0, 12.4, None), (0, 0.0, 12.4)),
    ),
    "lwr4": (
        ((0, *ALL), (1, *ALL)),
        ((1, *ALL), (0, *ALL)),
        ((0, 0.0, 12.5), (0, 12.5, None)),
        ((1, 12.5, None), (0, 0.0, 12.5)),
    ),
    "panda": (
        ((0, 0.0, 14.7), (0, 14.7, None)),
        ((0, 6.3, None), (0, 0.0, 6.3)),
        ((0, 0.0, 10.5), (0, 10.5, None)),
        ((0, 10.5, None), (0, 0.0, 10.5)),
    ),
    "tx40": (((0, 0.0, 5.0), (0, 5.0, 7.4)), ((0, 2.4, 7.4), (0, 0.0, 2.4)), ((0, 0.0, 3.7), (0, 3.7, 7.4))),
    "double_pendulum": (
        ((0, 0.0, 50.0), (0, 50.0, None)),
        ((0, 25.0, None), (0, 0.0, 25.0)),
        *(((k, *ALL), (j, *ALL)) for k in range(len(PENDULUM) + 1) for j in range(len(PENDULUM) + 1) if k != j),
    ),
}
KEPT = 3  # of each robot, every third pair is for the end


def recordings(project: Project) -> list[Log]:
    """Return the recordings of a robot, each whole, in the order of its list."""
    logs, _ = project.logs()
    return [*logs["train"].values(), *logs["validation"].values()]


def cut(log: Log, start: float, stop: float | None) -> Log:
    """Return a part of a log, from ``start`` to ``stop`` (s)."""
    t = log.t - log.t[0]
    rows = slice(*np.searchsorted(t, [start, t[-1] + 1.0 if stop is None else stop]).tolist())
    return log.rows(rows, f"{log.source} {start:g} s")


def measure(project: Project, train: Log, held: Log) -> Row:
    """Return errors (%) on the held-out log with nothing set, by the oracle and by plain friction, and CPU (s)."""
    began = time.process_time()
    result = identify(project.model, {"train": train}, {"held": held}, project.recipe)
    seconds = time.process_time() - began
    # least squares leaves the least error that the same terms and smoothing can leave; the model is on its tilted base
    oracle_recipe = replace(result.recipe, min_speed=None, base_tilt=None, estimator=LeastSquares())
    oracle = identify(result.model, {"held": held}, {"train": train}, oracle_recipe)
    plain_recipe = replace(project.recipe, terms=None)
    plain = identify(with_plain_terms(project.model), {"train": train}, {"held": held}, plain_recipe)
    row = {name: error_on(fit) for name, fit in (("error", result), ("oracle", oracle), ("plain", plain))}
    recipe = result.recipe
    chosen = {name: repr(getattr(recipe, name)) for name in ("smoother", "time_offset", "base_tilt", "min_speed")}
    chosen |= {"prior": str(result.calibration.prior_strength)}
    return {**row, "joints": joints_on(result), "seconds": round(seconds, 1), "chosen": chosen, "terms": terms(result)}


def error_on(result: Identification) -> float:
    return float(next(errors(log)["error"] for log in result.validations if log.name == "held"))


def joints_on(result: Identification) -> Row:
    return dict(next(errors(log)["joints"] for log in result.validations if log.name == "held"))


def terms(result: Identification) -> dict[str, list[str]]:
    joints = result.model.joints
    supports = [(type(term).__name__, np.asarray(getattr(term, "support", ()))) for term in result.model.terms]
    return {
        name: [joints[j].name for j in np.flatnonzero(support.any(axis=1))]
        for name, support in supports
        if support.size
    }


def projects(name: str, folder: Path) -> Project:
    """Return the project of a robot as ``init`` drafts it, with its recordings whole."""
    robot = ROBOTS[name]
    data = found_at(robot)
    if data is None:
        raise SystemExit(f"the recordings of {name} are not here.")
    path = configured(robot, data, folder / f"{name}.yaml")
    config = yaml.safe_load(path.read_text(encoding="utf-8"))
    if len(robot.logs) == 1:  # ``init`` has cut it in two
        config["train"][0].pop("window")
        config["validation"] = config["validation"][1:]
    path.write_text(yaml.safe_dump(config, sort_keys=False), encoding="utf-8")
    return read_project(path)


def rows(names: Sequence[str], done: Sequence[Row], everything: bool) -> Iterator[Row]:
    seen = {(row["robot"], row["pair"]) for row in done}
    for name in names:
        with TemporaryDirectory() as folder, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            project = projects(name, Path(folder))
            logs = recordings(project)
            for k, (train, held) in enumerate(PAIRS[name]):
                if (name, k) in seen or (k % KEPT == KEPT - 1 and not everything):
                    continue
                try:
                    figures = measure(project, cut(logs[train[0]], *train[1:]), cut(logs[held[0]], *held[1:]))
                except DynidentError as error:
                    figures = {"refused": str(error)}
                yield {"robot": name, "pair": k, **figures}


def summary(done: Sequence[Row], against: Sequence[Row]) -> Iterator[str]:
    before = {(row["robot"], row["pair"]): row for row in against if "error" in row}
    done = [row for row in done if "error" in row]
    for row in done:
        other = before.get((row["robot"], row["pair"]))
        change = (
            ""
            if other is None
            else f"  before {other['error']:6.2f} {100 * (row['error'] / other['error'] - 1):+5.1f} %"
        )
        head = f"{row['robot']:16} {row['pair']:2}  {row['error']:6.2f} oracle {row['oracle']:6.2f}"
        yield f"{head} plain {row['plain']:6.2f}  {row['seconds']:5.1f} s{change}"
    ratios = {name: [np.log(row["error"] / row["oracle"]) for row in done if row["robot"] == name] for name in ROBOTS}
    for name, values in {**ratios, "all": [x for some in ratios.values() for x in some]}.items():
        if values:
            yield f"{name}: error / oracle {np.exp(np.mean(values)):.3f} over {len(values)} pairs"
    if means := [float(np.mean(values)) for values in ratios.values() if values]:
        yield f"mean of the robots: {np.exp(np.mean(means)):.3f}"


def read(file: Path | None) -> list[Row]:
    return [json.loads(line) for line in file.read_text().splitlines()] if file is not None and file.exists() else []


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("robots", nargs="*", metavar="ROBOT", help=", ".join(PAIRS))
    parser.add_argument("--out", type=Path, help="file of the rows")
    parser.add_argument("--against", type=Path, help="file of other rows, to compare with")
    parser.add_argument("--all", action="store_true", help="also the third that is kept for the end")
    parser.add_argument("--table", action="store_true", help="only print")
    given = parser.parse_args()
    done = read(given.out)
    for row in () if given.table else rows(given.robots or tuple(PAIRS), done, given.all):
        done.append(row)
        print(json.dumps({key: value for key, value in row.items() if key != "terms"}), flush=True)
        if given.out is not None:
            with given.out.open("a", encoding="utf-8") as file:
                file.write(json.dumps(row) + "\n")
    print("\n".join(summary(done, read(given.against))))


if __name__ == "__main__":
    main()
