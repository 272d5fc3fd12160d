"""Measured robots with defaults only: python3 benchmarks/defaults.py [ROBOT ...] --out defaults.json.

Each configuration is drafted by ``dynident init`` anew, and only what a user must say is filled in: columns and gains
that were not found, gear ratios and couplings, zeros, and which part is held out. The recordings are looked for in
examples/data and beside the checkout; examples/*.yaml say where they come from.

Errors are relative, unfiltered, over all samples of a log but those within 0.1 s of its ends: a smoother that reaches
further must not gain by leaving samples out. --as names the figures; --page keeps them in out/defaults.json and
writes the table of docs/defaults.md; --draw does without measuring. Another version is measured by PYTHONPATH.
"""

from __future__ import annotations

import argparse
import os
import time
import warnings
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

os.environ.update(dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1"))

import numpy as np
import yaml
from click.testing import CliRunner
from defaults_page import FIGURES, draw, worded
from defaults_robots import RAIL, ROBOTS, Robot
from page_tables import read_figures, write_figures

from dynident.cli import main as dynident
from dynident.identification import Identification, identify, judge
from dynident.project.project import read_project
from dynident.runtime import DynidentError
from dynident.validation import LogValidation

ROOT = Path(__file__).resolve().parents[1]
PLACES = (ROOT / "examples" / "data", ROOT.parent / "shared" / "data")
MARGIN = 0.1  # s at the ends of a log that no error counts
Row = dict[str, Any]


def found_at(robot: Robot) -> Path | None:
    every = [file for log in (*robot.logs, *robot.more) for file in log.split("+")]
    return next((place for place in PLACES if all((place / x).exists() for x in every)), None)


def configured(robot: Robot, data: Path, path: Path) -> Path:
    """Draft a configuration by ``dynident init`` and fill in what is declared."""
    model = str(data / robot.model) if robot.model != RAIL else str(path.with_suffix(".urdf"))
    if robot.model == RAIL:
        Path(model).write_text(RAIL, encoding="utf-8")
    logs = ["+".join(str(data / part) for part in log.split("+")) for log in robot.logs]
    done = CliRunner().invoke(dynident, ["init", model, *logs, "--out", str(path), "--force", "--quiet"])
    if done.exit_code:
        raise SystemExit(f"{robot.title}: {done.output}")
    config = merged(yaml.safe_load(path.read_text(encoding="utf-8")), robot.declared)
    if robot.windows is not None:
        for role, (start, stop) in zip(("train", "validation"), robot.windows, strict=True):
            config[role][0]["window"] = [start, stop]
    config["validation"] += [{"file": str(data / x)} for x in robot.more]
    path.write_text(yaml.safe_dump(config, sort_keys=False), encoding="utf-8")
    return path


def by_hand(robot: Robot, data: Path, path: Path) -> Path:
    """Write the example of a robot, whose settings were chosen by hand, with the paths of its recordings."""
    text = (ROOT / "examples" / f"{robot.example}.yaml").read_text(encoding="utf-8")
    path.write_text(text.replace(": data/", f": {data.as_posix()}/"), encoding="utf-8")
    return path


def merged(case: Any, other: Mapping[str, Any]) -> dict[str, Any]:
    """Return a mapping with what another says beside or instead."""
    out = dict(case or {})
    for key, value in other.items():
        out[key] = merged(out.get(key), value) if isinstance(value, Mapping) else value
    return out


def measure(path: Path) -> Row:
    """Identify as configured, and return the errors by log, what was chosen, and what it took."""
    project = read_project(path)
    logs, remarks = project.logs()
    began = time.process_time()
    try:
        result = identify(project.model, logs["train"], logs["validation"], project.recipe)
    except DynidentError as error:
        return {"refused": str(error)}
    seconds = time.process_time() - began
    return {
        "logs": [errors(validation) for validation in result.validations],
        "seconds": round(seconds, 2),
        "chosen": chosen(result),
        "verdict": judge(result).use.value,
        "warnings": dict(
            Counter([*("of reading" for _ in remarks), *(type(warning).__name__ for warning in result.warnings)])
        ),
    }


def errors(log: LogValidation) -> Row:
    """Relative errors (%) on a log, over all its samples but the ends, and as the validation has them; rms (N m, N)."""
    motion = log.motion
    keep = (motion.t >= motion.t[0] + MARGIN) & (motion.t <= motion.t[-1] - MARGIN)
    tau, left = motion.tau[keep], (motion.tau - log.predicted_torque)[keep]
    size = np.linalg.norm(tau, axis=0)
    return {
        "name": log.name,
        "role": log.role,
        "samples": int(keep.sum()),
        "error": digits(100 * np.linalg.norm(left) / np.linalg.norm(size)),
        "joints": dict(zip(motion.joints, map(digits, 100 * np.linalg.norm(left, axis=0) / size), strict=True)),
        "rms": dict(zip(motion.joints, map(digits, np.sqrt(np.mean(left**2, axis=0))), strict=True)),
        "as_validated": digits(log.errors.relative_error),
        "validated_samples": log.errors.samples,
    }


def digits(value: Any) -> float:
    return float(f"{value:.4g}")


def chosen(identification: Identification) -> Row:
    """What was chosen on the training logs: the terms and their joints, and how the motion was made of the logs."""
    groups: dict[str, list[str]] = {}
    for term in identification.model.terms:
        support = getattr(term, "support", np.ones((len(identification.model.joints), 1)))
        on = [identification.model.joints[j].name for j in np.flatnonzero(np.asarray(support).any(axis=1))]
        groups.setdefault(type(term).__name__, []).extend(on)
    recipe = identification.recipe
    names = ("smoother", "filter", "min_speed", "time_offset", "base_tilt", "estimator")
    return {"terms": groups} | {name: repr(getattr(recipe, name)) for name in names}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("robots", nargs="*", metavar="ROBOT", help=", ".join(ROBOTS))
    parser.add_argument("--as", dest="label", default="after", help="name of the figures (before, after)")
    parser.add_argument("--out", type=Path, help="keep the figures in a file, with those of other names")
    parser.add_argument("--examples", action="store_true", help="measure the examples, which were set by hand")
    parser.add_argument("--keep", type=Path, help="folder for the configurations")
    parser.add_argument("--page", action="store_true", help="keep them for docs/defaults.md, and write it")
    parser.add_argument("--draw", action="store_true", help="write docs/defaults.md from the figures that it has")
    given = parser.parse_args()
    if wrong := [name for name in given.robots if name not in ROBOTS]:
        parser.error(f"unknown robot {wrong[0]!r}; known: {', '.join(ROBOTS)}")
    if not given.draw:
        names = [name for name in given.robots or ROBOTS if not given.examples or ROBOTS[name].example]
        run(names, "by hand" if given.examples else given.label, FIGURES if given.page else given.out, given.keep)
    if given.page or given.draw:
        draw()


def run(names: list[str], label: str, file: Path | None, folder: Path | None) -> None:
    """Measure some robots, print a line for each, and keep the figures under a name."""
    for name in names:
        robot = ROBOTS[name]
        if (data := found_at(robot)) is None:
            print(f"{robot.title}: no recordings in {' or '.join(map(str, PLACES))}")
            continue
        with TemporaryDirectory() as own, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            draft = by_hand if label == "by hand" else configured
            row = measure(draft(robot, data, (folder or Path(own)) / f"{name}.yaml"))
        for case in row.get("logs", []):
            print(f"{name} {case['role']} {case['name']}: {case['error']} % {case['joints']}", flush=True)
        print(f"{name}: {row.get('refused') or told(row)}", flush=True)
        if file:
            kept = read_figures(file)
            kept.setdefault("robots", {}).setdefault(label, {})[name] = row
            write_figures(kept, file)


def told(row: Row) -> str:
    """What was chosen, in words."""
    joints = len(row["logs"][0]["joints"])
    terms = worded(row["chosen"]["terms"], joints)
    return f"{row['seconds']} s; {row['verdict']}; {terms}; time offset {row['chosen']['time_offset']}"


if __name__ == "__main__":
    main()
