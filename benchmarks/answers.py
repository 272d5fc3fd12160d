"""How often the 95 % intervals of a user's answers hold: python3 benchmarks/answers.py FILE [--joints 5] [--runs N].

An arm of 5 or 7 joints stands on a tilted base and follows a Fourier series for 10 s at 250 Hz. Its positions are
those of 17-bit encoders, stamped 4 ms late, its torques have white or coloured noise (AR .9), and its robot file is
20 % wrong. A run identifies it (base parameters, time offset, tilt), then finds the body that it carries (payload),
then compares two results, between which friction and the last link have changed. With --bound, maximum likelihood on
the level arm with exact times is held against the Cramer-Rao bound. Each run is a line of FILE, from which an
interrupted study goes on.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections import defaultdict
from collections.abc import Iterable
from itertools import product
from pathlib import Path
from typing import Any

os.environ.update(dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1"))

import numpy as np
from arm import LINKS, urdf
from closed_loop import fourier
from interval_coverage import FRICTION, TORQUE, coloured, read, wrong_file

from dynident.apps.compare_results import ComparedResult, compare_results
from dynident.apps.payload import find_payload
from dynident.estimators import LeastSquares
from dynident.estimators.maximum_likelihood import MaximumLikelihood
from dynident.identification import Identification, Recipe, accuracy_bound, identify, tilt_base
from dynident.models import Model, RigidBodies, from_physical
from dynident.motion.log import Log
from dynident.motion.smoothers import Spline
from dynident.motion.smoothers.spline import NOISE_FACTORS
from dynident.motion.splines import NORMAL_95
from dynident.regression import BaseParameters

Array = np.ndarray
Rng = np.random.Generator
Row = dict[str, Any]
TILT = (0.03, -0.02)  # rad about x and y
STEP = 2 * np.pi / 2**17  # rad, of the encoders
MASS, CENTRE = 1.5, (0.02, -0.03, 0.06)  # kg, m: of the payload
BODY = from_physical(MASS, CENTRE, np.diag([0.006, 0.007, 0.004]))
FACTOR = 1.2  # friction after the change over that before
FILE_ERROR = 0.2  # share by which masses, centres, inertias and friction of the file are too large or too small


class Arm:
    """The true arm on its tilted base, its motion, and its model as the user's file has it."""

    def __init__(self, joints: int, level: bool) -> None:
        text = urdf(LINKS[6 - joints : 6], turn=1) if joints < 7 else urdf(LINKS)
        bodies = RigidBodies(text)
        friction = [term(bodies.joints, values=(size,) * joints, **width) for term, size, width in FRICTION]
        self.model = Model((bodies, *friction))
        self.true_model = self.model if level else tilt_base(self.model, *TILT)
        self.nominal = wrong_file(text, joints, FILE_ERROR)
        self.theta = np.asarray(self.model.values, dtype=float)
        self.bodies = 10 * joints
        self.t, self.q, self.dq, self.ddq = (x[::2] for x in fourier(joints))

    def log(self, correlation: float, rng: Rng, delay: int, theta: Array | None = None) -> Log:
        tau = self.true_model.torque(self.q, self.dq, self.ddq, self.theta if theta is None else theta)
        tau = tau + TORQUE * coloured(tau.shape, correlation, rng)
        begin = rng.uniform(0, STEP, self.q.shape[1])
        q = STEP * np.round((self.q + begin) / STEP) - begin
        stop = len(q) - delay
        return Log(self.t[delay:], q[:stop], tau[delay:], tuple(joint.name for joint in self.model.joints))

    def changed(self) -> tuple[Array, Array]:
        """Return the parameters with the payload, and with other friction and that body on the last link."""
        loaded, changed = self.theta.copy(), self.theta.copy()
        for theta in (loaded, changed):
            theta[self.bodies - 10 : self.bodies] += BODY
        changed[self.bodies :] *= FACTOR
        return loaded, changed


def one_run(joints: int, correlation: float, seed: int, run: int, bound: bool) -> dict[str, list[Row]]:
    """Return errors and standard errors by answer, each a row of name, error and standard error."""
    rng = np.random.default_rng([seed, joints, round(100 * correlation), run])
    arm = Arm(joints, level=bound)
    if bound:
        return {"bound": bound_rows(arm, arm.log(correlation, rng, 0))}
    smoothers = tuple(Spline(factor=factor) for factor in NOISE_FACTORS)
    recipe = Recipe(smoothers, LeastSquares(), time_offset="estimate", base_tilt="estimate")
    before = identify(arm.nominal, [arm.log(correlation, rng, 1)], recipe=recipe)
    loaded, changed = arm.changed()
    payload = find_payload(before, {"loaded": arm.log(correlation, rng, 1, loaded)})
    after = identify(arm.nominal, [arm.log(correlation, rng, 1, changed)], recipe=recipe)
    offset, tilt = before.calibration.time_offset, before.calibration.base_tilt
    assert offset is not None
    assert tilt is not None
    return {
        "parameters": parameter_rows(before, arm.theta),
        "offset": rows(("offset",), [offset.seconds - 0.004], [offset.std or np.nan]),
        "tilt": rows(("x", "y"), np.subtract((tilt.x, tilt.y), TILT), tilt.std),
        "payload": rows(("m", "x", "y", "z"), payload.body.values[:4] - (MASS, *CENTRE), payload.body.std[:4]),
        "change": change_rows(before, after, changed - arm.theta),
    }


def rows(names: Iterable[str], errors: Iterable[float], stds: Iterable[float]) -> list[Row]:
    return [
        {"name": name, "error": float(f"{error:.5g}"), "std": float(f"{std:.5g}")}
        for name, error, std in zip(names, errors, stds, strict=True)
    ]


def parameter_rows(result: Identification, theta: Array) -> list[Row]:
    std = result.errors.base_std
    assert std is not None
    return rows(base_names(result), basis_of(result).to_base(result.estimate.value - theta), std)


def basis_of(result: Identification) -> BaseParameters:
    basis = result.base.on_data
    assert basis is not None
    return basis


def base_names(result: Identification) -> tuple[str, ...]:
    basis = basis_of(result)
    return tuple(basis.names[k] for k in basis.independent)


def bound_rows(arm: Arm, log: Log) -> list[Row]:
    """Return the errors of maximum likelihood beside the least standard deviations of the bound."""
    result = identify(arm.nominal, [log], recipe=Recipe(estimator=MaximumLikelihood()))
    least = accuracy_bound(arm.nominal, [log])
    return rows(least.names, basis_of(result).to_base(result.estimate.value - arm.theta), least.std["now"])


def change_rows(before: Identification, after: Identification, step: Array) -> list[Row]:
    """Return the errors of the differences of base parameters that ``compare`` shows."""
    comparison = compare_results(compared(before), compared(after))
    true_step = dict(zip(base_names(before), basis_of(before).to_base(step), strict=True))
    compared_rows = [row for row in comparison.base if row.name in true_step]
    errors = [row.second - row.first - true_step[row.name] for row in compared_rows]
    stds = [np.hypot(row.first_std, row.second_std) for row in compared_rows]
    return rows([row.name for row in compared_rows], errors, stds)


def compared(result: Identification) -> ComparedResult:
    basis, names, covariance = basis_of(result), base_names(result), result.errors.base_covariance
    assert covariance is not None
    return ComparedResult(
        "result", tuple(joint.name for joint in result.model.joints), result.model.names, result.estimate.value, names,
        ("",) * len(names), basis.combination, basis.scale, covariance,
    )  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=Path)
    parser.add_argument("--joints", type=int, action="append", choices=range(3, 8), help="default: 5 and 7")
    parser.add_argument("--runs", type=int, default=40, help="of each cell, those in FILE included; 0: only print")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--bound", action="store_true", help="the bound instead of the other answers")
    options = parser.parse_args()
    done = {tuple(row["key"]) for row in read(options.file)}
    with options.file.open("a") as out:
        for run, joints, correlation in product(range(options.runs), options.joints or (5, 7), (0.0, 0.9)):
            key = (joints, correlation, options.seed, run, options.bound)
            if key in done or (options.bound and correlation):
                continue
            began = time.process_time()
            answers = one_run(*key)
            row = {"key": key, "seconds": round(time.process_time() - began, 1), "answers": answers}
            out.write(json.dumps(row) + "\n")
            out.flush()
    tell(list(read(options.file)))


def tell(table: list[Row]) -> None:
    """Print coverage by arm, noise and answer: mean, worst value, errors over standard errors."""
    cells: dict[tuple[int, float, str], list[list[Row]]] = defaultdict(list)
    for row in table:
        for answer, values in row["answers"].items():
            cells[row["key"][0], row["key"][1], answer].append(values)
    for (joints, correlation, answer), runs in sorted(cells.items()):
        ratios = defaultdict(list)
        for value in (value for run in runs for value in run):
            ratios[value["name"]].append(abs(value["error"]) / value["std"] if value["std"] else np.inf)
        shares = {name: 100 * np.mean(np.array(ratio) < NORMAL_95) for name, ratio in ratios.items()}
        worst = min(shares, key=lambda name: shares[name])
        mean = np.mean(list(shares.values()))
        size = np.sqrt(np.median([np.mean(np.square(ratio)) for ratio in ratios.values()]))
        print(
            f"{joints} joints, AR {correlation:g}, {answer:10s}: {len(runs)} runs, {mean:.1f} %, worst "
            f"{shares[worst]:.1f} ({worst}); error over stated {size:.2f}"
        )


if __name__ == "__main__":
    main()
