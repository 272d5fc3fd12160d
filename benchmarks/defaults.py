"""Measured robots with defaults only: python3 benchmarks/defaults.py [ROBOT ...] --out defaults.json.

Each configuration is drafted by ``dynident init`` anew, and only what a user must say is filled in: columns and gains
that were not found, gear ratios and couplings, zeros, and which part is held out. The recordings are looked for in
examples/data and beside the checkout; examples/*.yaml say where they come from.

Errors are relative, unfiltered, over all samples of a log but those within 0.1 s of its ends: a smoother that reaches
further must not gain by leaving samples out. --as names the figures; --page keeps them in docs/defaults.json and
writes the table of docs/defaults.md; --draw does without measuring. Another version is measured by PYTHONPATH.
"""

from __future__ import annotations

import argparse
import json
import os
import time
import warnings
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

os.environ.update(dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1"))

import numpy as np
import yaml
from click.testing import CliRunner

from dynident.cli import main as dynident
from dynident.errors import DynidentError
from dynident.identification import Identification, identify, judge
from dynident.io.project import read_project
from dynident.validation import LogValidation

ROOT = Path(__file__).resolve().parents[1]
PLACES = (ROOT / "examples" / "data", ROOT.parent / "shared" / "data")
PAGE, FIGURES = ROOT / "docs" / "defaults.md", ROOT / "docs" / "defaults.json"
MARGIN = 0.1  # s at the ends of a log that no error counts
QUARTER = 1.5707963267948966
PENDULUM = ("060143", "060245", "060329", "060440", "061705")
Row = dict[str, Any]


@dataclass(frozen=True)
class Robot:
    """A measured robot: its robot file or the text of one, and its recordings, as ``init`` is given them; what the user
    says beside; the marks.

    Windows (s) are those to fit and to judge by. ``mark`` is the error (%) that is aimed at on the first held-out log,
    ``floor`` what the noise of its torque leaves, ``oracle`` what a fit to the held-out log itself leaves.
    """

    title: str
    model: str
    logs: tuple[str, ...]
    mark: float | None
    declared: Mapping[str, Any] = field(default_factory=dict)
    windows: tuple[tuple[float, float | None], tuple[float, float | None]] | None = None
    more: tuple[str, ...] = ()  # further recordings held out
    example: str = ""  # the configuration set by hand
    floor: str = ""
    oracle: str = ""


_RAIL = """<robot name="emps"><link name="rail"/><link name="carriage"/><joint name="slider" type="prismatic">
<parent link="rail"/><child link="carriage"/><axis xyz="1 0 0"/></joint></robot>"""  # what a user writes of a drive
_PANDA = "+".join(f"panda/exciting_traj_{name}.txt" for name in ("positions", "time", "torques"))
_PENDULUM = "double_pendulum/20220812-{}-PM_measured.csv"
_TX40 = {
    "time": {"rate": 5000},
    "position": {f"joint_{k}": {"column": f"pos_read.Joint_{k}", "unit": "rad"} for k in range(1, 7)},
    "torque": {f"joint_{k}": {"column": f"curr.Joint_{k}", "unit": "N m"} for k in range(1, 7)},
    "transmission": {
        "joint_1": {"joint_1": 32}, "joint_2": {"joint_2": 32}, "joint_3": {"joint_3": 45},
        "joint_4": {"joint_4": -48}, "joint_5": {"joint_5": 45}, "joint_6": {"joint_5": 32, "joint_6": 32},
    },
    "zero": {"joint_2": -QUARTER, "joint_3": QUARTER},
    "model": {"couplings": {"m6": {"joints": {"joint_5": 1, "joint_6": 1}}}},
}  # fmt: skip
_ELBOW = {"joints": {"Joint1": 1, "Joint2": -6}, "terms": ["rotor"]}
ROBOTS: Mapping[str, Robot] = {
    "emps": Robot(
        "EMPS, on its pulses",
        _RAIL,
        ("emps/DATA_EMPS.mat", "emps/DATA_EMPS_PULSES.mat"),
        7.3,
        {"torque": {"slider": {"column": "vir", "gain": "gtau", "unit": "N"}}},
        example="emps",
        floor="0.2",
        oracle="6.0",
    ),
    "lwr4": Robot(
        "LWR4, on a repeat",
        "lwr4/kuka_lwr4.urdf",
        ("lwr4/measurements_1.npz", "lwr4/measurements_2.npz"),
        2.1,
        example="lwr4",
        floor="about 0",
        oracle="0.6",
    ),
    "panda": Robot(
        "Panda, 70 % to 30 %",
        "panda/panda.urdf",
        (_PANDA,),
        2.7,
        windows=((0.0, 14.7), (14.7, None)),
        floor="0.5",
        oracle="2.0",
    ),
    "panda_period": Robot(
        "Panda, within one period",
        "panda/panda.urdf",
        (_PANDA,),
        None,
        windows=((0.0, 9.33), (9.33, 13.33)),
        example="panda",
        floor="0.5",
    ),
    "tx40": Robot(
        "TX40, 5 s to 2.4 s",
        "tx40/tx40_mdh_modified.urdf",
        ("tx40/pos_read_data.csv+tx40/curr_data.csv",),
        15.5,
        _TX40,
        ((0.0, 5.0), (5.0, 7.4)),
        example="tx40",
        floor="13.9",
        oracle="15.6",
    ),
    "double_pendulum": Robot(
        "Double pendulum, 50 s to 25 s",
        "double_pendulum/double_pendulum.urdf",
        (_PENDULUM.format("061157"),),
        9.5,
        {"model": {"couplings": {"elbow_motor": _ELBOW}}},
        ((0.0, 50.0), (50.0, None)),
        tuple(_PENDULUM.format(name) for name in PENDULUM),
        example="double_pendulum",
        floor="6.4",
        oracle="8.2",
    ),
}


def found_at(robot: Robot) -> Path | None:
    every = [file for log in (*robot.logs, *robot.more) for file in log.split("+")]
    return next((place for place in PLACES if all((place / one).exists() for one in every)), None)


def configured(robot: Robot, data: Path, path: Path) -> Path:
    """Draft a configuration by ``dynident init`` and fill in what is declared."""
    model = str(data / robot.model) if robot.model != _RAIL else str(path.with_suffix(".urdf"))
    if robot.model == _RAIL:
        Path(model).write_text(_RAIL, encoding="utf-8")
    logs = ["+".join(str(data / one) for one in log.split("+")) for log in robot.logs]
    done = CliRunner().invoke(dynident, ["init", model, *logs, "--out", str(path), "--force", "--quiet"])
    if done.exit_code:
        raise SystemExit(f"{robot.title}: {done.output}")
    config = merged(yaml.safe_load(path.read_text(encoding="utf-8")), robot.declared)
    if robot.windows is not None:
        for role, (start, stop) in zip(("train", "validation"), robot.windows, strict=True):
            config[role][0]["window"] = [start, stop]
    config["validation"] += [{"file": str(data / one)} for one in robot.more]
    path.write_text(yaml.safe_dump(config, sort_keys=False), encoding="utf-8")
    return path


def by_hand(robot: Robot, data: Path, path: Path) -> Path:
    """Write the example of a robot, whose settings were chosen by hand, with the paths of its recordings."""
    text = (ROOT / "examples" / f"{robot.example}.yaml").read_text(encoding="utf-8")
    path.write_text(text.replace(": data/", f": {data.as_posix()}/"), encoding="utf-8")
    return path


def merged(one: Any, other: Mapping[str, Any]) -> dict[str, Any]:
    """Return a mapping with what another says beside or instead."""
    out = dict(one or {})
    for key, value in other.items():
        out[key] = merged(out.get(key), value) if isinstance(value, Mapping) else value
    return out


def measure(path: Path) -> Row:
    """Identify as configured, and return the errors by log, what was chosen, and what it took."""
    project = read_project(path)
    logs, remarks = project.logs()
    began = time.process_time()
    try:
        found = identify(project.model, logs["train"], logs["validation"], project.recipe)
    except DynidentError as error:
        return {"refused": str(error)}
    seconds = time.process_time() - began
    return {
        "logs": [errors(one) for one in found.validations],
        "seconds": round(seconds, 2),
        "chosen": chosen(found),
        "verdict": judge(found).use.value,
        "warnings": dict(Counter([*("of reading" for _ in remarks), *(type(one).__name__ for one in found.warnings)])),
    }


def errors(log: LogValidation) -> Row:
    """Relative errors (%) on a log, over all its samples but the ends, and as the validation has them; rms (N m, N)."""
    motion = log.motion
    keep = (motion.t >= motion.t[0] + MARGIN) & (motion.t <= motion.t[-1] - MARGIN)
    tau, left = motion.tau[keep], (motion.tau - log.predicted)[keep]
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


def chosen(found: Identification) -> Row:
    """What was chosen on the training logs: the terms and their joints, and how the motion was made of the logs."""
    groups: dict[str, list[str]] = {}
    for term in found.model.terms:
        support = getattr(term, "support", np.ones((len(found.model.joints), 1)))
        on = [found.model.joints[j].name for j in np.flatnonzero(np.asarray(support).any(axis=1))]
        groups.setdefault(type(term).__name__, []).extend(on)
    recipe = found.recipe
    names = ("smoother", "filter", "min_speed", "time_offset", "base_tilt", "estimator")
    return {"terms": groups} | {name: repr(getattr(recipe, name)) for name in names}


def held_out(row: Row) -> Row | None:
    return next((one for one in row.get("logs", []) if one["role"] == "validation"), None)


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
        for one in row.get("logs", []):
            print(f"{name} {one['role']} {one['name']}: {one['error']} % {one['joints']}", flush=True)
        print(f"{name}: {row.get('refused') or told(row)}", flush=True)
        if file:
            kept = read(file)
            kept.setdefault("robots", {}).setdefault(label, {})[name] = row
            write(kept, file)


def read(file: Path) -> Row:
    return dict(json.loads(file.read_text(encoding="utf-8"))) if file.exists() else {}


def write(kept: Row, file: Path) -> None:
    file.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")


def draw() -> None:
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8"), read(FIGURES)), encoding="utf-8")


def page(text: str, kept: Row) -> str:
    """Return the page with its tables anew."""
    for name, body in (("robots", table(kept.get("robots", {}))), ("laws", laws(kept.get("laws", {})))):
        before, _, rest = text.partition(f"<!-- {name} -->")
        text = f"{before}<!-- {name} -->\n\n{body}\n\n<!-- /{name} -->{rest.partition(f'<!-- /{name} -->')[2]}"
    return text


def table(rows: Mapping[str, Mapping[str, Row]]) -> str:
    """Return the rows, those of a robot together, as Markdown."""
    head = "| | held out, % | reported, % | by joint, % | train, % | terms | s of CPU | mark | noise | oracle |"
    lines = [head, "|" + "---|" * 10]
    for name, robot in ROBOTS.items():
        for label, own in rows.items():
            if (row := own.get(name)) is not None:
                lines.append("| " + " | ".join([f"{robot.title}, {label}", *cells(robot, row)]) + " |")
                others = [f"{one['error']:.3g}" for one in row.get("logs", []) if one["role"] == "validation"][1:]
                if others:
                    lines.append(f"| the same on {len(others)} other recordings | {', '.join(others)} |" + " |" * 8)
    return "\n".join(lines)


def laws(rows: Mapping[str, Row]) -> str:
    """Return the scores of the laws of friction as Markdown."""
    lines = ["| | found | wrong | same speed | twice as fast | missed | entered |", "|" + "---|" * 7]
    for law, one in rows.items():
        found = f"{one['found']} of {one['needed']}" if one["needed"] else ""
        figures = [law, found, f"{one['wrong']} of {one['joints']}", f"{one['same']:.3f}", f"{one['fast']:.3f}"]
        named = [", ".join(f"{kind} {count}" for kind, count in one[key].items()) for key in ("missed", "entered")]
        lines.append("| " + " | ".join([*figures, *named]) + " |")
    return "\n".join(lines)


def cells(robot: Robot, row: Row) -> list[str]:
    one = held_out(row)
    if one is None:
        return [f"refused: {row['refused']}", *[""] * 8]
    train = next(log for log in row["logs"] if log["role"] == "train")
    mark = "" if robot.mark is None else f"{robot.mark:g}: {'met' if one['error'] <= robot.mark else '**not met**'}"
    joints = ", ".join(f"{value:.3g}" for value in one["joints"].values())
    terms = worded(row["chosen"]["terms"], len(one["joints"]))
    figures = one["error"], one["as_validated"], train["error"], row["seconds"]
    held, reported, trained, seconds = (f"{value:.3g}" for value in figures)
    return [held, reported, joints, trained, terms, seconds, mark, robot.floor, robot.oracle]


def told(row: Row) -> str:
    """What was chosen, in words."""
    joints = len(row["logs"][0]["joints"])
    terms = worded(row["chosen"]["terms"], joints)
    return f"{row['seconds']} s; {row['verdict']}; {terms}; time offset {row['chosen']['time_offset']}"


def worded(groups: Mapping[str, list[str]], joints: int) -> str:
    """The terms beside the bodies, with the number of joints where these are not all."""
    counts = {kind: len(set(on)) for kind, on in groups.items() if kind != "RigidBodies"}
    return ", ".join(kind if count == joints else f"{kind} {count}" for kind, count in counts.items())


if __name__ == "__main__":
    main()
