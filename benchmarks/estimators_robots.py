"""Every estimator and smoother on real robots: python3 benchmarks/estimators_robots.py [PART ...] --page.

Parts: emps (the drive of EMPS by several estimators, beside what was published), robots (dynident compare on all five,
all that applies), peers (FIGAROH and MuJoCo beside dynident on a simulated arm; --peers names the Python that has
them). A robot whose recordings are not here is skipped; examples/*.yaml say where they are had.

What is done is kept in a folder outside the repository: run the same command again to go on where it stopped. --page
keeps the figures in out/estimators_robots.json and writes the tables of benchmarks/estimators_measured.md; --draw does
without measuring.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from tempfile import gettempdir
from typing import Any

os.environ.update(dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1"))

import estimators_peers
import numpy as np
from commands import DYNIDENT, ROOT, recordings
from estimators_robots_page import FIGURES, draw, tables
from page_tables import read_figures, write_figures

from dynident.identification import Identification
from dynident.project.project import parse_project
from dynident.runtime import DynidentError
from dynident.validation import LogValidation

Row = dict[str, Any]
ROBOTS = ("emps", "double_pendulum", "lwr4", "panda", "tx40")
FITS = {  # of EMPS: name in the table -> estimator of the configuration
    "least squares": "{ kind: least_squares }",
    "instrumental variables": "{ kind: instrumental_variables, instruments: simulated }",
    "instrumental variables, lagged": "{ kind: instrumental_variables, instruments: lagged }",
    "didim": "{ kind: didim }",
    "output error": "{ kind: output_error }",
    "maximum likelihood": "{ kind: maximum_likelihood }",
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", metavar="PART", help=", ".join(PARTS))
    parser.add_argument("--robot", action="append", choices=ROBOTS, help="of part robots, by default all")
    parser.add_argument("--smoothers", metavar="KIND,...", help="of part robots, by default all")
    parser.add_argument("--estimators", metavar="KIND,...", help="of part robots, by default all")
    parser.add_argument("--time-limit", default="120", help="s that a fit of part robots may take, by default 120")
    parser.add_argument("--peers", metavar="PYTHON", help="a Python that has figaroh 1.0.2 and mujoco[sysid] 4.0.0")
    parser.add_argument("--folder", type=Path, default=Path(gettempdir()) / "dynident-robots", help="for what is done")
    parser.add_argument("--workers", default="1")
    parser.add_argument(
        "--page", action="store_true", help="keep the figures for benchmarks/estimators_measured.md, and write it"
    )
    parser.add_argument(
        "--draw", action="store_true", help="write benchmarks/estimators_measured.md from the figures that it has"
    )
    given = parser.parse_args()
    if wrong := [name for name in given.parts if name not in PARTS]:
        parser.error(f"unknown part {wrong[0]!r}; known: {', '.join(PARTS)}")
    for name in () if given.draw else given.parts or PARTS:
        if result := PARTS[name](given):
            kept = known()
            kept[name] = kept.get(name, {}) | result
            print(tables(kept)[name])
            if given.page:
                write_figures(kept, FIGURES)
    if given.page or given.draw:
        draw(known())


def known() -> Row:
    """The figures that are kept."""
    return read_figures(FIGURES)


def text_of(robot: str) -> str:
    """The configuration of an example with the paths of its recordings."""
    text = (ROOT / "examples" / f"{robot}.yaml").read_text(encoding="utf-8")
    return text.replace(f": data/{robot}/", f": {recordings(robot)}/")


def here(robot: str) -> bool:
    """Whether its recordings are here; says so where not."""
    try:
        recordings(robot)
    except FileNotFoundError as missing:
        print(f"{robot} is skipped: {missing}")
        return False
    return True


def emps(_: argparse.Namespace) -> Row:
    """The four parameters with their errors, by estimator."""
    if not here("emps"):
        return {}
    before = load()
    return {"fits": {name: emps_fit(name, fit) for name, fit in FITS.items()}, "load": before}


def emps_fit(name: str, estimator: str) -> Row:
    """One fit; where it fails, why."""
    text = f"{text_of('emps')}\nestimator: {estimator}\n"
    began = time.process_time()
    try:
        result = parse_project(text, ROOT / "examples" / "emps.yaml").identify()
    except DynidentError as error:
        return {"reason": f"{type(error).__name__}: {error}"}
    row = {"seconds": rounded(time.process_time() - began), **figures(result)}
    print(f"{name}: {row}", flush=True)
    return row


def figures(identification: Identification) -> Row:
    """Values and standard errors; errors by log."""
    return {
        "value": [rounded(x) for x in identification.estimate.value],
        "std": [rounded(x) for x in identification.errors.std],
        "notes": [type(note).__name__ for note in identification.notes],
        "errors": {log.role: errors(log) for log in identification.validations},
    }


def errors(log: LogValidation) -> Row:
    """Relative errors (%): of the torque, filtered as for the fit and as measured, and of the simulated position."""
    simulated = np.nan if log.free_run is None else max(log.free_run.relative_error.values())
    of = {"filtered": log.errors.relative_error_filtered, "measured": log.errors.relative_error, "simulated": simulated}
    return {name: rounded(value) for name, value in of.items()}


def robots(given: argparse.Namespace) -> Row:
    """What dynident compare says of each robot."""
    return {robot: compared(given, robot) for robot in given.robot or ROBOTS if here(robot)}


def compared(given: argparse.Namespace, robot: str) -> Row:
    """Run the comparison, which goes on where it stopped, and keep its rows."""
    folder = given.folder / robot
    folder.mkdir(parents=True, exist_ok=True)
    file = given.folder / f"{robot}.yaml"
    file.write_text(text_of(robot), encoding="utf-8")
    chosen = [
        word for name in ("smoothers", "estimators", "time_limit", "workers") if (value := getattr(given, name))
        for word in (f"--{name.replace('_', '-')}", value)
    ]  # fmt: skip
    before = load()
    subprocess.run([*DYNIDENT, "compare", file, "--folds", "0", "--out", folder, *chosen], check=True)
    content = json.loads((folder / "compare.json").read_text(encoding="utf-8"))
    return {"rows": [kept_of(row) for row in content["rows"]], "absent": absent(content), "load": before} | {
        name: content[name] for name in ("ranked_by", "told_from_chance", "within_chance")
    }


def kept_of(row: Mapping[str, Any]) -> Row:
    """What is kept of a row."""
    lower, upper = row["interval"]
    named = {name: row[name] for name in ("smoother", "estimator", "own", "status", "worse")}
    numbers = {"error": row["error"], "overall": row["overall"], "least": lower, "most": upper, "seconds": seconds(row)}
    return named | {name: rounded(value) for name, value in numbers.items()}


def seconds(row: Mapping[str, Any]) -> float:
    """Of smoothing and estimate; nan of a failed fit."""
    return float(np.sum([np.nan if x is None else x for x in row["seconds"][:2]]))


def absent(result: Mapping[str, Any]) -> list[str]:
    """What does not apply, in a word or two each."""
    return list(dict.fromkeys(x["estimator"] or x["smoother"] for x in result["does_not_apply"]))


def rounded(value: Any) -> float | None:
    return None if value is None or not np.isfinite(value) else float(f"{value:.6g}")


def load() -> float:
    return round(os.getloadavg()[0], 1)


def peers(given: argparse.Namespace) -> Row:
    """FIGAROH and MuJoCo beside dynident."""
    return estimators_peers.measured(given.peers or sys.executable, given.folder) | {"load": load()}


PARTS: dict[str, Callable[[argparse.Namespace], Row]] = {"emps": emps, "robots": robots, "peers": peers}

if __name__ == "__main__":
    main()
