"""Measured robots beside others: python3 dev.py bench peers [--page], or benchmarks/defaults_peers.py [ROBOT ...].

On the recordings and windows of benchmarks/defaults.py, each fits the training log and predicts the torque of the first
held-out log, on the same samples: all but those within 0.1 s of its ends, as measured, and both after a low-pass of
10 Hz. "Least squares" is how most papers do it: positions and torque after a zero-phase low-pass of 10 Hz, differences,
viscous and Coulomb friction, offset and rotor inertia. FIGAROH 1.0.2 has its own pipeline, at the same cut-off, with 40
samples a second; ``mujoco.sysid`` fits the inertia of each link, armature, damping, friction loss and a constant to the
torque of ``mj_inverse``; neither knows coupled motors. Both run in processes of their own. All predict on the motion
that dynident has chosen, so that only parameters differ. Published parameters: benchmarks/published.py.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
import warnings
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

os.environ.update(dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1"))

import numpy as np
from defaults import MARGIN, PLACES, configured, digits, found_at
from defaults_page import FIGURES, draw
from defaults_robots import ROBOTS
from page_tables import read_figures, write_figures
from published import PUBLISHED
from scipy.signal import butter, sosfiltfilt

from dynident.identification import identify
from dynident.models import Model, RigidBodies, RotorInertia
from dynident.models.friction import Coulomb, Offset, Viscous
from dynident.motion.log import Log
from dynident.project.export.tree_text import mjcf_of, urdf_of
from dynident.project.project import Project, read_project

HERE = Path(__file__).parent
CUTOFF, ORDER, SAMPLES_A_SECOND = 10.0, 4, 40.0  # Hz; of the low-pass; that FIGAROH keeps
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
        self.raw = [np.stack([np.interp(self.t, log.t, x) for x in y.T], axis=1) for y in (log.q, log.tau)]
        self.q, self.tau = (low_pass(y, self.rate) for y in self.raw)
        self.dq = np.gradient(self.q, self.t, axis=0)
        self.ddq = np.gradient(self.dq, self.t, axis=0)
        self.inside = (self.t >= self.t[0] + MARGIN) & (self.t <= self.t[-1] - MARGIN)


def plain_model(model: Model) -> Model:
    """The terms of a model, as bodies and coupled motors, with what papers add to them."""
    joints = model.joints
    return Model((*model.terms, RotorInertia(joints), Viscous(joints), Coulomb(joints), Offset(joints)))


def error(tau: Array, predicted: Array) -> float:
    return digits(100 * np.linalg.norm(tau - predicted) / np.linalg.norm(tau))


class HeldOut:
    """The held-out recording, with its motion as the default of dynident has it."""

    def __init__(self, project: Project) -> None:
        began = time.process_time()
        logs, _ = project.logs()
        result = identify(project.model, logs["train"], logs["validation"], project.recipe)
        self.seconds = round(time.process_time() - began, 1)
        self.validation = next(log for log in result.validations if log.role == "validation")
        self.motion = self.validation.motion
        t = self.motion.t
        self.rate, self.use = (len(t) - 1) / float(t[-1] - t[0]), (t >= t[0] + MARGIN) & (t <= t[-1] - MARGIN)

    def row(self, who: str, predicted: Array, seconds: float | None) -> Row:
        """Errors of a prediction, of the torque as measured and of both after the low-pass."""
        pairs = [(self.motion.tau, predicted), tuple(low_pass(x, self.rate) for x in (self.motion.tau, predicted))]
        errors = [error(x[self.use], y[self.use]) for x, y in pairs]
        return {"who": who, "error": errors[0], "low_passed": errors[1], "seconds": seconds}

    def predict(self, who: str, model: Model, theta: Array, seconds: float | None) -> Row:
        return self.row(who, model.torque(self.motion.q, self.motion.dq, self.motion.ddq, theta), seconds)


def least_squares(model: Model, train: Motion, held_out: HeldOut) -> Row:
    began = time.process_time()
    rows = np.flatnonzero(train.inside)[:: max(1, round(train.rate / 200.0))]
    Y = model.regressor(train.q[rows], train.dq[rows], train.ddq[rows])
    theta = np.linalg.lstsq(Y.reshape(-1, Y.shape[2]), train.tau[rows].ravel(), rcond=1e-8)[0]
    seconds = time.process_time() - began
    return held_out.predict("least squares, 10 Hz", model, theta, round(seconds, 2))


def peer(who: str, python: str, urdf: str, gravity: Any, model: Model, train: Motion, held_out: HeldOut) -> list[Row]:
    """What another finds, in its own process; why, where it finds nothing."""
    with TemporaryDirectory() as folder:
        recording, answer = Path(folder) / "in.npz", Path(folder) / "out.json"
        q, tau = train.raw if who == "FIGAROH" else (train.q, train.tau)
        rows = {"joints": [joint.name for joint in model.joints], "dq": train.dq, "ddq": train.ddq}
        rows |= {"decimate": round(train.rate / SAMPLES_A_SECOND)}
        np.savez(recording, urdf=urdf, gravity=np.array(gravity), t=train.t - train.t[0], q=q, tau=tau, **rows)
        command: list[str | Path] = [python, "-W", "ignore", HERE / PEERS[who], recording, answer]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            lines = done.stderr.strip().splitlines()
            return [{"who": who, "reason": lines[-1] if lines else f"exit code {done.returncode}"}]
        fits = json.loads(answer.read_text(encoding="utf-8"))
    named = [(f"{who}, {fit['name']}", np.array(fit["value"]), round(fit["seconds"], 2)) for fit in fits]
    return [held_out.predict(name, model, value, seconds) for name, value, seconds in named]


def measure(name: str, python: str) -> list[Row]:
    """All rows of a robot."""
    robot = ROBOTS[name]
    data = found_at(robot)
    if data is None:
        return []
    with TemporaryDirectory() as folder:
        project = read_project(configured(robot, data, Path(folder) / f"{name}.yaml"))
        train = Motion(next(iter(project.logs()[0]["train"].values())))
        held_out, model = HeldOut(project), plain_model(Model(project.model.terms[:1]))
        rows = [
            held_out.row("dynident", held_out.validation.predicted_torque, held_out.seconds),
            least_squares(plain_model(project.model), train, held_out),
        ]
        if name in PUBLISHED:
            who, torque = PUBLISHED[name]
            predicted = torque(Model(project.model.terms[:1]), held_out.motion)
            rows.append(held_out.row(f"published ({who})", predicted, None))
        bodies = project.model.terms[0]
        assert isinstance(bodies, RigidBodies)
        for who, write in {"FIGAROH": urdf_of, "mujoco.sysid": mjcf_of}.items():
            if who == "FIGAROH" and len(model.joints) == 1:
                rows.append({"who": who, "reason": "its functions take two joints or more"})
                continue
            rows += peer(who, python, write(bodies), bodies.gravity, model, train, held_out)
        if not any(parameter.value for parameter in bodies.parameters):
            rows[-1]["who"] += " (from 1 kg)"  # the file has no masses
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("robots", nargs="*", metavar="ROBOT", help=", ".join(ROBOTS))
    parser.add_argument("--peers", default=sys.executable, metavar="PYTHON", help="one that has both, else this one")
    parser.add_argument("--page", action="store_true", help="keep the figures for docs/defaults.md, and write it")
    options = parser.parse_args()
    figures = read_figures(FIGURES)
    for name in options.robots or [robot for robot in ROBOTS if robot != "panda_period"]:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            rows = measure(name, options.peers)
        if not rows:
            print(f"{name}: no recordings in {' or '.join(map(str, PLACES))}", flush=True)
            continue
        print(name, *rows, sep="\n", flush=True)
        figures.setdefault("peers", {})[name] = rows
        if options.page:
            write_figures(figures, FIGURES)
    if options.page:
        draw()


if __name__ == "__main__":
    main()
