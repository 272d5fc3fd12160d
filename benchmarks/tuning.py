"""How long someone waits who tunes by hand: python3 benchmarks/tuning.py.

An arm of seven joints with friction moves along sums of sines for two recordings of 20 000 samples at 1 kHz, both to
be fitted, or (``--train 1``) one of them held out. Printed is the time of the CPU for each answer of the bench to a
setting that it has not seen before, the median of several, in milliseconds: it works on one thread.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable
from dataclasses import replace
from statistics import median
from time import process_time

os.environ.update(dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1"))

import numpy as np
from arm import LINKS, urdf

from dynident.apps.tuning import Bench, Tuning
from dynident.estimators import Estimator, LeastSquares, PhysicallyConsistent
from dynident.identification import Recipe, identify
from dynident.models import Model, RigidBodies, RotorInertia
from dynident.models.friction import Coulomb, Offset, Viscous
from dynident.motion.log import Log
from dynident.motion.smoothers import Spline

RATE, SINES = 1000.0, 4  # Hz; of each joint
ENCODER, TORQUE = 1e-5, 0.3  # rad, N m
ESTIMATORS: dict[str, Estimator] = {"least_squares": LeastSquares(), "consistent": PhysicallyConsistent()}


def arm() -> Model:
    """The arm, with the plain set of terms."""
    bodies = RigidBodies(urdf(LINKS))
    joints = bodies.joints
    terms = (part(joints, values=(0.5,) * len(joints)) for part in (RotorInertia, Viscous, Coulomb, Offset))
    return Model((bodies, *terms), name="arm")


def recording(model: Model, samples: int, seed: int) -> Log:
    """A motion that never repeats, with its torque and noise."""
    rng, n = np.random.default_rng(seed), len(model.joints)
    t = np.arange(samples) / RATE
    w, phase = 2 * np.pi * rng.uniform(0.1, 1.2, (SINES, n)), rng.uniform(0.0, 2 * np.pi, (SINES, n))
    size = rng.uniform(0.1, 0.4, (SINES, n))
    s, c = (turn(w * t[:, None, None] + phase) for turn in (np.sin, np.cos))
    q, dq, ddq = (size * s).sum(axis=1), (size * w * c).sum(axis=1), -(size * w**2 * s).sum(axis=1)
    theta = np.array([parameter.value for parameter in model.parameters], dtype=float)
    tau = model.torque(q, dq, ddq, theta) + TORQUE * rng.standard_normal(q.shape)
    names = tuple(joint.name for joint in model.joints)
    return Log(t, q + ENCODER * rng.standard_normal(q.shape), tau, names, f"log {seed}")


def bench(samples: int, train: int, estimator: Estimator) -> Bench:
    """Two recordings of the arm on the bench."""
    model = arm()
    logs = [recording(model, samples, seed) for seed in (1, 2)]
    roles = {
        "train": {log.source: log for log in logs[:train]},
        "validation": {log.source: log for log in logs[train:]},
    }
    result = identify(model, roles["train"], roles["validation"], Recipe(Spline(factor=2.0), estimator))
    return Bench.of(model, roles, result)


def times(on: Bench, runs: int) -> dict[str, float]:
    """Return the median time (ms) of each answer."""
    start, first, joint = on.start, on.log_names[0], on.joints[0]
    log = on.logs["train"][first]
    begin = float(log.t[len(log) // 2])
    on.fit(start)

    def of(answer: Callable[[Tuning], object], changed: Callable[[int], Tuning], count: int = runs) -> float:
        """Return the median time of an answer to settings of a number, which it has not seen."""
        result = []
        for k in range(1, count + 1):
            tuning, begun = changed(k), process_time()
            answer(tuning)
            result.append(1e3 * (process_time() - begun))
        return median(result)

    def seen(tuning: Tuning) -> object:
        return on.smooth(tuning, first, joint)

    kinds = [*start.terms[0], "stribeck", "spring", "power", "asymmetric_viscous", "wide_coulomb"]
    return {
        "smoothing of one joint": of(seen, lambda k: start.with_degree(0.01 * k, 0)),
        "smoothing of all joints": of(seen, lambda k: start.with_degree(0.011 * k)),
        "quick fit after smoothing": of(on.fit, lambda k: start.with_degree(0.012 * k)),
        "quick fit after terms": of(on.fit, lambda k: _with_terms(start, k % 7, kinds[: k % 5 + 4])),
        "quick fit after joints": of(on.fit, lambda k: replace(start, unfitted=(on.joints[k % 7],))),
        "quick fit after minimum speed": of(on.fit, lambda k: _speed(start, 0.01 * k)),
        "quick fit after a window": of(on.fit, lambda k: start.exclude(first, begin, begin + 0.1 * k)),
        "quick fit with hysteresis": of(on.fit, lambda k: _with_terms(start, k % 7, [*kinds[:4], "dahl"])),
        "curve of all joints": of(on.curve, lambda k: _late(start, 1e-4 * k), 3),
        "curve of one joint": of(lambda x: on.curve(x, joint), lambda k: _late(start, 2e-4 * k), 3),
        "whole": of(on.identify, lambda k: start.with_degree(0.013 * k), 3),
    }


def _with_terms(tuning: Tuning, joint: int, kinds: list[str]) -> Tuning:
    return replace(tuning, terms=tuple(tuple(kinds) if j == joint else entry for j, entry in enumerate(tuning.terms)))


def _speed(tuning: Tuning, speed: float) -> Tuning:
    return replace(tuning, min_speed=(speed,) * len(tuning.min_speed))


def _late(tuning: Tuning, seconds: float) -> Tuning:
    return replace(tuning, time_offset=seconds)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=20_000)
    parser.add_argument("--train", type=int, default=2, choices=(1, 2))
    parser.add_argument("--runs", type=int, default=7)
    given = parser.parse_args()
    result = {name: times(bench(given.samples, given.train, x), given.runs) for name, x in ESTIMATORS.items()}
    print(f"| ms | {' | '.join(result)} |")
    print("|---|" + "---:|" * len(result))
    for row in next(iter(result.values())):
        print(f"| {row} | {' | '.join(f'{value[row]:.0f}' for value in result.values())} |")


if __name__ == "__main__":
    main()
