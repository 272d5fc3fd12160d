"""Identification by others beside dynident: one recording of the arm in closed loop, seen by encoders of 17 bits.

Each works in a process with one BLAS thread; of every one the seconds are CPU time from the recording to the
parameters. FIGAROH and MuJoCo run in a Python of their own (figaroh_fit.py, mujoco_fit.py).
"""

from __future__ import annotations

import json
import subprocess
import time
from pathlib import Path
from typing import Any

import estimators_arm
import numpy as np
from estimators_study import listed, parts

from dynident.apps.demo.arm import JOINTS, urdf
from dynident.models import RigidBodies
from dynident.models.simulation import CascadePD
from dynident.motion.log import Log
from dynident.motion.smoothers import Spline
from dynident.runtime.families import ESTIMATORS

HERE = Path(__file__).parent
BITS, FIRST = 17.0, 50  # the row from which MuJoCo simulates: the spline knows the speed there
OWN = (
    "least_squares", "weighted_least_squares", "consistent", "instrumental_variables, lagged",
    "instrumental_variables, simulated", "didim", "output_error", "maximum_likelihood",
)  # fmt: skip
PEERS = {"FIGAROH": "figaroh_fit.py", "MuJoCo": "mujoco_fit.py"}
Row = dict[str, Any]


def measured(python: str, folder: Path, seconds: float = estimators_arm.SECONDS) -> Row:
    """Errors and seconds of each; why, where one could not be had."""
    loop = estimators_arm.ClosedLoop(seconds=seconds)
    record = loop.record(BITS, np.random.default_rng(0))
    given, answer = folder / "peers.npz", folder / "peers.json"
    folder.mkdir(parents=True, exist_ok=True)
    written(given, record.log)
    bound = loop.bound()
    rows = []
    for name, script in PEERS.items():
        answer.unlink(missing_ok=True)
        done = subprocess.run([python, "-W", "ignore", HERE / script, given, answer], capture_output=True, text=True)
        if done.returncode:
            lines = done.stderr.strip().splitlines()
            rows.append({"who": name, "name": "", "reason": lines[-1] if lines else f"exit code {done.returncode}"})
            continue
        fits = json.loads(answer.read_text(encoding="utf-8"))
        rows += [judged(name, fit["name"], np.array(fit["value"]), fit["seconds"], bound) for fit in fits]
        print(*rows, sep="\n", flush=True)
    reference = dict(parts(ESTIMATORS))
    for name in OWN:
        if name in reference:
            rows.append(own(name, reference[name], record, bound))
            print(rows[-1], flush=True)
    return {"rows": rows, "seconds": seconds}


def own(name: str, estimator: Any, record: Any, bound: Any) -> Row:
    """A fit of dynident, with the default spline."""
    method = estimators_arm.Identify(name, Spline(), estimator)
    began = time.process_time()
    try:
        value = method.estimate(record).value
    except Exception as error:  # what fails is a row, the rest goes on
        return {"who": "dynident", "name": name, "reason": f"{type(error).__name__}: {error}"}
    return judged("dynident", name, value, time.process_time() - began, bound)


def judged(who: str, name: str, value: Any, seconds: float, bound: Any) -> Row:
    """The error of the torque held out (%), and of the base parameters in standard deviations of the bound."""
    _, theta, base = estimators_arm.arm()
    result = value if len(value) == base.rank else base.to_base(value)
    true = base.to_base(theta)
    held = estimators_arm.held_out(result[None])
    rms, cost = listed([np.sqrt(np.mean(np.square((result - true) / bound))), seconds])
    return {"who": who, "name": name, "error": held["error"], "rms": rms, "seconds": cost}


def written(file: Path, log: Log) -> None:
    """Write the recording for the peers."""
    drives, motion = log.controller, Spline()(log)
    assert isinstance(drives, CascadePD)
    bodies = next(term for term in estimators_arm.arm()[0].terms if isinstance(term, RigidBodies))
    run = drives.t >= log.t[0] - 1e-9
    np.savez(
        file, urdf=urdf(), gravity=bodies.gravity, t=log.t, q=log.q, tau=log.tau, reference_t=drives.t[run],
        reference=drives.reference[run], kp=drives.kp, kv=drives.kv, limit=[x.effort for x in JOINTS], first=FIRST,
        q0=motion.q[FIRST], dq0=motion.dq[FIRST],
    )  # fmt: skip
