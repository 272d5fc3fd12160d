"""How accurate a payload is, and how often its intervals hold: python3 benchmarks/payload.py [--runs N] [--out FILE].

Arms of 6 and 7 joints move 30 s along a Fourier series, with --repeat the same in all recordings of a run: without a
payload (what is identified), with a weighed one of 5 kg, with one of 3 kg that is sought, and without any again (a day
later). Positions are those of 17-bit encoders, at 200 Hz; torques are currents with gains that are wrong by 3 % of one
standard deviation, all together and each by itself, with coloured noise of 2 % (0.1 s) and white noise of 1 % of the
torque; friction grows with the load (5 % of it, which the model does not know), and has drifted by 10 % after the
identification, the offsets by 5 % of the friction. Each run is a line of FILE (JSON lines).
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

os.environ.update(dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1"))

import numpy as np
from scipy.signal import lfilter
from situation_arm import QUARTER, SIX, Friction, Link, Robot, urdf

from dynident.apps.payload import DriveGains, Payload, PayloadRequest, find_payload
from dynident.estimators import Estimator, LeastSquares, PhysicallyConsistent
from dynident.identification import Recipe, identify
from dynident.models import Model, RigidBodies, RotorInertia, from_physical
from dynident.models.friction import Coulomb, Offset, Viscous
from dynident.motion.log import Log

Array = np.ndarray
Rng = np.random.Generator
SEVEN = (
    Link(4.0, (0.0, -0.03, 0.12), (0.03, 0.03, 0.01), (0.0, 0.0, 0.16), axis=(0.0, 0.0, 1.0)),
    Link(4.0, (0.0, 0.05, 0.04), (0.03, 0.01, 0.03), (0.0, 0.0, 0.2), (-QUARTER, 0.0, 0.0), (0.0, 0.0, 1.0)),
    Link(3.0, (0.0, 0.03, 0.13), (0.02, 0.02, 0.007), (0.0, -0.2, 0.0), (QUARTER, 0.0, 0.0), (0.0, 0.0, 1.0)),
    Link(2.7, (0.0, 0.06, 0.03), (0.02, 0.007, 0.02), (0.0, 0.0, 0.2), (QUARTER, 0.0, 0.0), (0.0, 0.0, 1.0)),
    Link(1.7, (0.0, 0.02, 0.08), (0.01, 0.01, 0.004), (0.0, 0.2, 0.0), (-QUARTER, 0.0, 0.0), (0.0, 0.0, 1.0)),
    Link(1.6, (0.0, 0.01, 0.0), (0.004, 0.003, 0.004), (0.0, 0.0, 0.2), (-QUARTER, 0.0, 0.0), (0.0, 0.0, 1.0)),
    Link(0.4, (0.005, 0.0, 0.02), (0.0006, 0.0006, 0.0006), (0.0, -0.08, 0.0), (QUARTER, 0.0, 0.0), (0.0, 0.0, 1.0)),
)
FRICTION = (
    Friction(0.25, 3.0, 4.0, 0.3),
    Friction(0.20, 3.0, 4.0, -0.2),
    Friction(0.10, 1.5, 2.0, 0.1),
    Friction(0.08, 1.2, 1.6, 0.1),
    Friction(0.03, 0.4, 0.6, 0.05),
    Friction(0.03, 0.4, 0.6, -0.05),
    Friction(0.02, 0.2, 0.4, 0.02),
)
ROBOTS = {"6 joints": Robot(SIX), "7 joints": Robot(SEVEN, friction=FRICTION)}
RATE, DURATION, PERIOD, HARMONICS = 200.0, 30.0, 10.0, 5
ENCODER = 2 * np.pi / 2**17
GAIN, LOAD = 0.03, 0.05
COLOURED, WHITE, CORRELATION = 0.02, 0.01, np.exp(-1 / (0.1 * RATE))
DRIFT, OFFSET = 0.10, 0.05  # of friction, and of friction for an offset
WEIGHED = from_physical(5.0, [0.0, 0.0, 0.05], np.diag([0.01, 0.01, 0.008]))
SOUGHT = from_physical(3.0, [0.02, -0.03, 0.08], np.diag([0.012, 0.015, 0.006]))
TRUTH = np.array([3.0, 0.02, -0.03, 0.08, 0.012, 0.0, 0.015, 0.0, 0.0, 0.006])  # of the payload that is sought
CASES = ("blind", "weighed", "weighed, unloaded", "placed, unloaded")
SMOOTH = 0.01  # rad/s: friction that grows with the load turns so fast


@dataclass(frozen=True)
class Day:
    """An arm as it is: its model with the true parameters, the gains of its drives over the true ones."""

    model: Model
    theta: Array
    gains: Array
    path: int | None = None  # seed of the motion of all logs; None: each has its own

    def log(self, rng: Rng, name: str, payload: Array | None = None, drift: Rng | None = None) -> Log:
        """Return a recording, with a payload (10) in the frame of the last link, with friction that has drifted."""
        theta = self.theta if drift is None else self._drifted(drift)
        bodies: Any = self.model.terms[0]
        load = np.array([parameter.value for parameter in bodies.parameters])
        if payload is not None:
            load[-10:] += payload
        theta = np.concatenate([load, theta[len(load) :]])
        t, q, dq, ddq = moved(rng if self.path is None else np.random.default_rng(self.path), len(self.gains))
        felt = bodies.torque(q, dq, ddq, load)
        tau = self.model.torque(q, dq, ddq, theta) + LOAD * np.abs(felt) * np.tanh(dq / SMOOTH)
        size = np.sqrt(np.mean(tau**2, axis=0))
        fresh = rng.standard_normal((len(t) + 2000, len(size))) * np.sqrt(1 - CORRELATION**2)
        slow = lfilter([1.0], [1.0, -CORRELATION], fresh, axis=0)[2000:]
        tau = tau + size * (COLOURED * slow + WHITE * rng.standard_normal(tau.shape))
        joints = tuple(joint.name for joint in self.model.joints)
        return Log(t, ENCODER * np.round(q / ENCODER), self.gains * tau, joints, name)

    def _drifted(self, rng: Rng) -> Array:
        theta, n = self.theta.copy(), len(self.gains)
        coulomb = np.abs(theta[-2 * n : -n])
        theta[-3 * n : -n] *= 1 + DRIFT * rng.standard_normal(2 * n)
        theta[-n:] += OFFSET * coulomb * rng.standard_normal(n)
        return theta


def moved(rng: Rng, n: int) -> tuple[Array, Array, Array, Array]:
    """Return times, and positions, velocities and accelerations (N, n) of a random Fourier series."""
    t = np.arange(round(DURATION * RATE)) / RATE
    rate = 2 * np.pi / PERIOD * np.arange(1, HARMONICS + 1)[:, None, None]
    phase, size = rng.uniform(0, 2 * np.pi, (HARMONICS, 1, n)), rng.uniform(0.3, 1.0, (HARMONICS, 1, n))
    size *= 1.4 / size.sum(axis=0)
    angle = rate * t[:, None] + phase
    q = rng.uniform(-0.6, 0.6, n) + (size * np.sin(angle)).sum(axis=0)
    return t, q, (size * rate * np.cos(angle)).sum(axis=0), -(size * rate**2 * np.sin(angle)).sum(axis=0)


def of_robot(robot: Robot) -> tuple[Model, Array]:
    """Return the model of an arm with friction, and its true parameters."""
    bodies, n = RigidBodies(urdf(robot.links), gravity=robot.gravity), len(robot.links)
    kinds: list[tuple[Any, str]] = [(RotorInertia, "rotor"), (Viscous, "viscous"), (Coulomb, "coulomb")]
    terms = [kind(bodies.joints) for kind, _ in [*kinds, (Offset, "offset")]]
    values = [getattr(x, name) for _, name in [*kinds, (Offset, "offset")] for x in robot.friction[:n]]
    return Model((bodies, *terms)), np.array([*(parameter.value for parameter in bodies.parameters), *values])


def one_run(robot: str, seed: int, estimator: Estimator, repeat: bool, say: Callable[[str], None]) -> dict[str, Any]:
    """Return what is found of the payload, and its errors: without and with a weighed payload, and a log of the day."""
    rng = np.random.default_rng([seed, len(robot)])
    model, theta = of_robot(ROBOTS[robot])
    n = len(model.joints)
    gains = (1 + GAIN * rng.standard_normal()) * (1 + GAIN * rng.standard_normal(n))
    day = Day(model, theta, gains, int(rng.integers(1 << 30)) if repeat else None)
    recipe = Recipe(estimator=estimator)
    result = identify(model, {"arm": day.log(rng, "arm")}, recipe=recipe)
    later = rng.integers(1 << 30)  # the day after: one drift

    def log(name: str, payload: Array | None = None) -> dict[str, Log]:
        return {name: day.log(rng, name, payload, np.random.default_rng(later))}

    weighed, sought, unloaded = log("weighed", WEIGHED), log("sought", SOUGHT), log("unloaded")
    out: dict[str, Any] = {"robot": robot, "seed": seed, "gains": gains.tolist()}
    begin = time.perf_counter()
    out["blind"] = row(find_payload(result, sought))
    out["seconds"] = time.perf_counter() - begin
    reference: DriveGains = find_payload(result, weighed, request=PayloadRequest(known_mass=5.0)).gains
    out["found gains"] = (reference.factor.tolist(), reference.std.tolist())
    out["weighed"] = row(find_payload(result, sought, request=PayloadRequest(gains=reference)))
    reference = find_payload(result, weighed, unloaded, PayloadRequest(known_mass=5.0)).gains
    out["weighed, unloaded"] = row(find_payload(result, sought, unloaded, PayloadRequest(gains=reference)))
    placed = PayloadRequest(known_mass=5.0, known_centre=(0.0, 0.0, 0.05))
    reference = find_payload(result, weighed, unloaded, placed).gains
    out["placed, unloaded"] = row(find_payload(result, sought, unloaded, PayloadRequest(gains=reference)))
    say(f"{robot} {seed}: {out['blind']['values'][0]:.4f} {out['weighed']['values'][0]:.4f}")
    return out


def row(payload: Payload) -> dict[str, Any]:
    """Return the figures of a payload."""
    return {
        "values": payload.body.values.tolist(), "std": payload.body.std.tolist(), "factor": payload.factor,
        "shares": {source.value: share[[0, 1, 2, 3]].tolist() for source, share in payload.shares.items()},
        "free": payload.free.tolist(), "spread": payload.covariance.tolist(),
        "left": [(log.without, log.with_payload, log.free) for log in payload.logs],
        "notes": [type(note).__name__ for note in payload.notes],
    }  # fmt: skip


def summary(rows: list[dict[str, Any]]) -> None:
    """Print errors and coverage by robot and case, as a table of Markdown."""
    heads = (
        "arm",
        "gains",
        "runs",
        "mass, %: rms (95 %)",
        "within 1 %",
        "centre, mm: rms (95 %)",
        "within 3 mm",
        "95 % hold",
    )
    print(f"| {' | '.join(heads)} |\n|{'---|' * len(heads)}")
    for robot in dict.fromkeys(x["robot"] for x in rows):
        for case in CASES:
            several = [x[case] for x in rows if x["robot"] == robot]
            error = np.array([x["values"] for x in several]) - TRUTH
            held = (np.abs(error) < 1.96 * np.array([x["std"] for x in several])).mean(axis=0)
            mass, centre = 100 * np.abs(error[:, 0]) / TRUTH[0], 1e3 * np.linalg.norm(error[:, 1:4], axis=1)
            cells = (
                robot, case, len(several), f"{_rms(mass):.2f} ({np.quantile(mass, 0.95):.2f})",
                f"{100 * np.mean(mass < 1):.0f} %", f"{_rms(centre):.1f} ({np.quantile(centre, 0.95):.1f})",
                f"{100 * np.mean(centre < 3):.0f} %",
                ", ".join(f"{100 * part.mean():.0f} %" for part in (held[:1], held[1:4], held[4:])),
            )  # fmt: skip
            print(f"| {' | '.join(map(str, cells))} |")


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def main() -> None:
    """Run what is asked for, and print the summary."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=50)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("payload.jsonl"))
    parser.add_argument("--estimator", choices=["least_squares", "consistent"], default="consistent")
    parser.add_argument("--repeat", action="store_true", help="all logs are of one motion")
    asked = parser.parse_args()
    estimator: Estimator = (
        LeastSquares(weights="per_joint") if asked.estimator == "least_squares" else PhysicallyConsistent()
    )
    rows = [json.loads(line) for line in asked.out.read_text().splitlines()] if asked.out.exists() else []
    done = {(x["robot"], x["seed"]) for x in rows}
    with asked.out.open("a") as file:
        for seed in range(asked.first_seed, asked.first_seed + asked.runs):
            for robot in ROBOTS:
                if (robot, seed) not in done:
                    rows.append(one_run(robot, seed, estimator, asked.repeat, lambda text: print(text, flush=True)))
                    file.write(json.dumps(rows[-1]) + "\n")
                    file.flush()
    summary(rows)


if __name__ == "__main__":
    main()
