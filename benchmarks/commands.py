"""Commands as a user types them, measured from outside, each in a process of its own."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from itertools import count
from pathlib import Path

from measure import GIB

ROOT = Path(__file__).resolve().parents[1]
DYNIDENT = (sys.executable, "-P", "-m", "dynident")
SCRATCH = tempfile.TemporaryDirectory()  # removed at the end of this process
Call = Callable[[], object]


def cost(*command: object) -> dict[str, float]:
    """Run a command to its end; return the fields of its Figure."""
    began = time.perf_counter()
    process = subprocess.Popen([str(word) for word in command], stdout=subprocess.DEVNULL)
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise subprocess.CalledProcessError(process.returncode, process.args)
    return {
        "cpu": used.ru_utime + used.ru_stime, "wall": time.perf_counter() - began, "peak": used.ru_maxrss / GIB
    }  # fmt: skip


def recordings(robot: str) -> Path:
    """Return the folder of a robot's recordings: in examples/data, or in a folder beside the checkout."""
    for data in (ROOT / "examples" / "data", ROOT.parent / "shared" / "data"):
        if (data / robot).is_dir():
            return data / robot
    raise FileNotFoundError(f"the recordings are not here; the first lines of examples/{robot}.yaml say where they are")


def example(robot: str, estimator: str = "") -> Path:
    """Return the configuration of an example with the paths of its recordings, and another estimator where one is
    named."""
    data, path = recordings(robot), Path(SCRATCH.name, f"{robot}.yaml")
    text = (ROOT / "examples" / path.name).read_text(encoding="utf-8").replace(f": data/{robot}/", f": {data}/")
    if estimator:
        text = re.sub(r"(?m)^estimator:.*$", "", text) + f"\nestimator: {{ kind: {estimator} }}\n"
    path.write_text(text, encoding="utf-8")
    return path


def identify(_: str, robot: str) -> Call:
    """An example from command to report."""
    path = example(robot)
    return lambda: cost(*DYNIDENT, "identify", path, "--out", Path(SCRATCH.name, "out"))


def default(_: str, robot: str) -> Call:
    """A robot with nothing set but what only a user knows, as benchmarks/defaults.py drafts it, or the demo's arm."""
    from defaults import configured, found_at
    from defaults_robots import ROBOTS

    folder = Path(SCRATCH.name)
    if robot == "demo":
        subprocess.run([*DYNIDENT, "demo", "--out", folder / "demo", "--quiet"], check=True, stdout=subprocess.DEVNULL)
        path = folder / "demo" / "robot.yaml"
    else:
        data = found_at(ROBOTS[robot])
        if data is None:
            raise FileNotFoundError(
                f"the recordings of {robot} are not here; examples/{robot}.yaml says where they are"
            )
        path = configured(ROBOTS[robot], data, folder / f"{robot}.yaml")
    return lambda: cost(*DYNIDENT, "identify", path, "--out", folder / "out")


def excite(_: str, robot: str) -> Call:
    """The design of a motion, and of another for validation, with nothing set but the robot file."""
    from defaults_robots import ROBOTS

    path = recordings(robot) / Path(ROBOTS[robot].model).name
    return lambda: cost(*DYNIDENT, "excite", path, "--out", Path(SCRATCH.name, "excited"))


def compare(_: str) -> Call:
    """All estimators with all smoothers, on the demo's arm."""
    folder = Path(SCRATCH.name)
    subprocess.run([*DYNIDENT, "demo", "--out", folder / "demo", "--quiet"], check=True, stdout=subprocess.DEVNULL)
    numbers = count()  # what an earlier run has compared would be taken from its folder
    return lambda: cost(*DYNIDENT, "compare", folder / "demo" / "robot.yaml", "--out", folder / f"c{next(numbers)}")


def parquet(_: str, samples: int) -> Call:
    """A recording of seven joints, made here, from Parquet to the report."""
    subprocess.run([sys.executable, ROOT / "benchmarks" / "size.py", SCRATCH.name, str(samples)], check=True)
    path = Path(SCRATCH.name, "arm.yaml")
    return lambda: cost(*DYNIDENT, "identify", path, "--out", Path(SCRATCH.name, "out"))


def study(_: str, runs: int, workers: int) -> Call:
    """The article's study: nine fits a run."""
    return lambda: cost(*DYNIDENT, "reproduce", "--runs", runs, "--workers", workers)


def start(way: str, what: str) -> Call:
    """What is waited for before anything is done: a module to be imported, or an option of the command."""
    if way == "Python alone":
        return lambda: cost(sys.executable, "-c", "pass")
    return lambda: cost(*DYNIDENT, what) if what.startswith("-") else cost(sys.executable, "-c", f"import {what}")
