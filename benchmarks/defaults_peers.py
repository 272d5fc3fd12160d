"""Measured robots beside others: python3 benchmarks/defaults_peers.py [ROBOT ...] [--peers PYTHON] [--page].

On the recordings and windows of benchmarks/defaults.py, each fits the training log and predicts the torque of the first
held-out log, on the same samples: all but those within 0.1 s of its ends, as measured, and both after a low-pass of
10 Hz. "Least squares" is how most papers do it: positions and torque after a zero-phase low-pass of 10 Hz, differences,
viscous and Coulomb friction, offset and rotor inertia. FIGAROH 1.0.2 has its own pipeline, at the same cut-off, with 40
samples a second; ``mujoco.sysid`` fits the inertia of each link, armature, damping, friction loss and a constant to the
torque of ``mj_inverse``. Both run in a Python of their own, --peers; each predicts on its own low-passed motion. Of
dynident the figures are those of defaults.py. Published parameters: of the EMPS (Janot, 2019).
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import time
import warnings
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

os.environ.update(dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1"))

import numpy as np
from defaults import MARGIN, configured, digits, errors, found_at
from defaults_page import FIGURES, draw
from defaults_robots import ROBOTS
from page_tables import read_figures, write_figures
from scipy.signal import butter, sosfiltfilt

from dynident.identification import identify
from dynident.models import Model, RotorInertia
from dynident.models.friction import Coulomb, Offset, Viscous
from dynident.motion.log import Log
from dynident.project.export.tree_text import mjcf_of, urdf_of
from dynident.project.project import Project, read_project

HERE = Path(__file__).parent
CUTOFF, ORDER, SAMPLES_A_SECOND = 10.0, 4, 40.0  # Hz; of the low-pass; that FIGAROH keeps
PUBLISHED = {"emps": ("Janot 2019", [95.1089, 203.5034, 20.3935, -3.1648])}  # mass, viscous, Coulomb, offset
PEERS = {"FIGAROH": "figaroh_fit.py", "mujoco.sysid": "mujoco_torque_fit.py"}
Array = np.ndarray
Row = dict[str, Any]


def low_pass(x: Array, rate: float) -> Array:
    return np.asarray(sosfiltfilt(butter(ORDER, CUTOFF, fs=rate, output="sos"), x, axis=0))


class Motion:
    """A log after the low-pass, on even times, with differences as velocity and acceleration."""

    def __init__(self, log: Log) -> None:
        self.rate = (len(log.t) - 1) / float(log.t[-1] - log.t[0])
        self.t = np.linspace(log.t[0], log.t[-1], len(log.t))
        even = [np.stack([np.interp(self.t, log.t, x) for x in y.T], axis=1) for y in (log.q, log.tau)]
        self.raw = even
        self.q, self.tau = (low_pass(y, self.rate) for y in even)
        self.measured = even[1]
        self.dq = np.gradient(self.q, self.t, axis=0)
        self.ddq = np.gradient(self.dq, self.t, axis=0)
        self.judged = (self.t >= self.t[0] + MARGIN) & (self.t <= self.t[-1] - MARGIN)


def plain_model(model: Model) -> Model:
    """The bodies (and coupled motors) of a model with what papers add to them."""
    joints = model.joints
    terms = (RotorInertia(joints), Viscous(joints), Coulomb(joints), Offset(joints))
    return Model((model.terms[0], *terms))


def error(tau: Array, predicted: Array) -> float:
    return digits(100 * np.linalg.norm(tau - predicted) / np.linalg.norm(tau))


def row(who: str, motion: Motion, predicted: Array, seconds: float | None) -> Row:
    """Errors of a prediction, of the torque as measured and of both after the low-pass."""
    use = motion.judged
    smooth = low_pass(predicted, motion.rate)
    return {
        "who": who, "error": error(motion.measured[use], predicted[use]), "seconds": seconds,
        "low_passed": error(motion.tau[use], smooth[use]),
    }  # fmt: skip


def least_squares(model: Model, train: Motion, held_out: Motion) -> Row:
    began = time.process_time()
    step = max(1, round(train.rate / 200.0))
    Y = model.regressor(*(x[::step] for x in (train.q, train.dq, train.ddq)))
    theta = np.linalg.lstsq(Y.reshape(-1, Y.shape[2]), train.tau[::step].ravel(), rcond=1e-8)[0]
    seconds = time.process_time() - began
    return row("least squares, 10 Hz", held_out, model.torque(held_out.q, held_out.dq, held_out.ddq, theta), seconds)


def peer(who: str, python: str, urdf: str, gravity: Any, model: Model, train: Motion, held_out: Motion) -> list[Row]:
    """What another finds, in its own process; why, where it finds nothing."""
    with TemporaryDirectory() as folder:
        given, answer = Path(folder) / "in.npz", Path(folder) / "out.json"
        q, tau = train.raw if who == "FIGAROH" else (train.q, train.tau)
        rows = {"dq": train.dq, "ddq": train.ddq, "decimate": round(train.rate / SAMPLES_A_SECOND)}
        np.savez(given, urdf=urdf, gravity=np.array(gravity), t=train.t - train.t[0], q=q, tau=tau, **rows)
        command = [python, "-W", "ignore", HERE / PEERS[who], given, answer]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            lines = done.stderr.strip().splitlines()
            return [{"who": who, "reason": lines[-1] if lines else f"exit code {done.returncode}"}]
        fits = json.loads(answer.read_text(encoding="utf-8"))
    rows = []
    for fit in fits:
        predicted = model.torque(held_out.q, held_out.dq, held_out.ddq, np.array(fit["value"]))
        rows.append(row(f"{who}, {fit['name']}", held_out, predicted, round(fit["seconds"], 2)))
    return rows


def dynident_row(project: Project, logs: Any, held_out: Motion) -> Row:
    """The default of dynident, on all samples of its own motion, which is none but the measured one smoothed."""
    began = time.process_time()
    result = identify(project.model, logs["train"], logs["validation"], project.recipe)
    seconds = time.process_time() - began
    log = next(one for one in result.validations if one.role == "validation")
    motion = log.motion
    predicted = np.stack([np.interp(held_out.t, motion.t, x) for x in log.predicted_torque.T], axis=1)
    return row("dynident", held_out, predicted, round(seconds, 1)) | {"error": errors(log)["error"]}


def measure(name: str, python: str | None) -> list[Row]:
    """All rows of a robot."""
    robot = ROBOTS[name]
    data = found_at(robot)
    if data is None:
        return []
    with TemporaryDirectory() as folder:
        project = read_project(configured(robot, data, Path(folder) / f"{name}.yaml"))
        logs, _ = project.logs()
        train, held_out = (Motion(next(iter(logs[role].values()))) for role in ("train", "validation"))
        model = plain_model(project.model)
        rows = [dynident_row(project, logs, held_out), least_squares(model, train, held_out)]
        print(*rows, sep="\n", flush=True)
        if name in PUBLISHED:
            who, (mass, viscous, coulomb, offset) = PUBLISHED[name]
            predicted = mass * held_out.ddq + viscous * held_out.dq + coulomb * np.sign(held_out.dq) + offset
            rows.append(row(f"published ({who})", held_out, predicted, None))
        bodies = project.model.terms[0]
        for who, write in {"FIGAROH": urdf_of, "mujoco.sysid": mjcf_of}.items() if python else ():
            rows += peer(who, str(python), write(bodies), bodies.gravity, model, train, held_out)
            print(rows[-1], flush=True)
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("robots", nargs="*", metavar="ROBOT", help=", ".join(ROBOTS))
    parser.add_argument("--peers", metavar="PYTHON", help="a Python with figaroh==1.0.2 and mujoco[sysid]==4.0.0")
    parser.add_argument("--page", action="store_true", help="keep the figures for docs/defaults.md, and write it")
    options = parser.parse_args()
    kept = read_figures(FIGURES)
    for name in options.robots or [one for one in ROBOTS if one != "panda_period"]:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            rows = measure(name, options.peers)
        print(name, *rows, sep="\n", flush=True)
        kept.setdefault("peers", {})[name] = rows
        if options.page:
            write_figures(kept, FIGURES)
    if options.page:
        draw()


if __name__ == "__main__":
    main()
