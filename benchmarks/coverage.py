"""How often the 95 % intervals of an identification with its defaults hold the truth: python3 benchmarks/coverage.py.

An arm follows a Fourier trajectory exactly; positions and torques are recorded with the noise of a cell, and identified
as ``dynident identify`` does where a configuration names only the logs and the estimator: smoother by the torque, time
offset estimated. Judged are the intervals that report and terminal show first, of the base parameters. Every run is a
line of a JSON lines file, where a study goes on that was interrupted. Printed for each cell: coverage on average over
the parameters and of the worst one, both in percent, the mean error of the worst parameter in its standard deviations,
the share of the runs with each warning, and the time offset found.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from pathlib import Path
from typing import Any

os.environ.update(dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1"))

import numpy as np
from closed_loop import arm, fourier
from scipy.signal import lfilter

from dynident.errors import Severity
from dynident.estimators import Estimator, LeastSquares, MaximumLikelihood, PhysicallyConsistent
from dynident.identification import Identification, Recipe, identify
from dynident.log import Log
from dynident.models import Model
from dynident.regression import structural_base_parameters
from dynident.smoothers import Spline, unshifted
from dynident.smoothers.spline import FACTORS

Array = np.ndarray
Rng = np.random.Generator
ESTIMATORS: dict[str, Estimator] = {
    "least squares": LeastSquares(),
    "consistent": PhysicallyConsistent(),
    "maximum likelihood": MaximumLikelihood(),
}
TORQUE = 0.1  # N m, standard deviation of the torque's noise in every cell
QUIET = 1e-5  # rad, of the position's where the torque's is coloured


def coloured(shape: tuple[int, int], correlation: float, rng: Rng) -> Array:
    """Return stationary noise of first order, of unit variance."""
    white = rng.standard_normal((shape[0] + 2000, shape[1])) * np.sqrt(1 - correlation**2)
    return np.asarray(lfilter([1.0], [1.0, -correlation], white, axis=0))[2000:]


def white(sigma: float) -> Callable[[Array, Rng], Array]:
    return lambda q, rng: q + sigma * rng.standard_normal(q.shape)


def encoder(bits: int) -> Callable[[Array, Rng], Array]:
    """Positions in counts; where these begin differs from run to run."""

    def seen(q: Array, rng: Rng) -> Array:
        count = 2 * np.pi / 2**bits
        begin = rng.uniform(0, count, q.shape[1])
        return count * np.round((q + begin) / count) - begin

    return seen


# by cell: what is seen of the positions, and the correlation of neighbouring torque errors
CELLS: dict[str, tuple[Callable[[Array, Rng], Array], float]] = {
    "white 1e-5": (white(1e-5), 0.0),
    "white 1e-4": (white(1e-4), 0.0),
    "white 1e-3": (white(1e-3), 0.0),
    "16 bit": (encoder(16), 0.0),
    "12 bit": (encoder(12), 0.0),
    "position AR .9": (lambda q, rng: q + 1e-4 * coloured(q.shape, 0.9, rng), 0.0),
    "torque AR .95": (white(QUIET), 0.95),
    "torque AR .995": (white(QUIET), 0.995),
}


@cache
def robot(joints: int) -> tuple[Model, Array, tuple[Array, Array, Array]]:
    """Return an arm, its parameters, and times, positions and torques of its motion."""
    model = arm(joints)
    truth = np.asarray(model.values)
    t, q, dq, ddq = (x[::2] for x in fourier(joints))  # 250 Hz
    return model, truth, (t, q, model.torque(q, dq, ddq, truth))


def recording(joints: int, cell: str, seed: int, run: int) -> Log:
    """Return the log of a run; it depends on nothing but these."""
    rng = np.random.default_rng([seed, joints, list(CELLS).index(cell), run])
    model, _, (t, q, tau) = robot(joints)
    seen, correlation = CELLS[cell]
    noise = TORQUE * coloured(tau.shape, correlation, rng)
    return Log(t, seen(q, rng), tau + noise, tuple(joint.name for joint in model.joints))


def one_run(joints: int, cell: str, seed: int, run: int, names: tuple[str, ...]) -> list[dict[str, Any]]:
    """Return a row for each estimator."""
    log, rows = recording(joints, cell, seed, run), []
    for name in names:
        recipe = Recipe(tuple(Spline(factor=one) for one in FACTORS), ESTIMATORS[name], time_offset="estimate")
        began = time.process_time()
        found = identify(robot(joints)[0], [log], recipe=recipe)
        took = time.process_time() - began
        rows.append(
            {"joints": joints, "cell": cell, "run": run, "estimator": name, "seconds": round(took, 3)}
            | row(found, robot(joints)[1])
        )
    return rows


def row(found: Identification, truth: Array) -> dict[str, Any]:
    basis, std = found.base.on_data, found.errors.best_base
    assert basis is not None and std is not None
    offset = found.calibration.time_offset
    return {
        "names": [basis.names[k] for k in basis.independent],
        "error": [float(f"{x:.6g}") for x in basis.to_base(found.estimate.value - truth)],
        "std": [float(f"{x:.6g}") for x in std],
        "plain": None if found.errors.base_std is None else [float(f"{x:.6g}") for x in found.errors.base_std],
        "warnings": sorted({type(one).__name__ for one in found.warnings if one.severity >= Severity.WARNING})
        if False
        else sorted({type(one).__name__ for one in found.warnings}),
        "notes": [
            (type(n).__name__, n.parameter, round(n.size, 2))
            for n in found.warnings
            if type(n).__name__.startswith("Motion")
        ],
        "offset": None if offset is None else offset.seconds,
        "factor": getattr(unshifted(found.recipe.smoothers[0]), "factor", None),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=Path)
    parser.add_argument("--joints", type=int, action="append")
    parser.add_argument("--cell", action="append", choices=CELLS)
    parser.add_argument("--estimator", action="append", choices=ESTIMATORS)
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--seed", type=int, default=11)
    given = parser.parse_args()
    done = {(r["joints"], r["cell"], r["run"], r["estimator"]) for r in read(given.file)}
    jobs = []
    for run in range(given.runs):
        for joints in given.joints or (3, 6):
            for cell in given.cell or CELLS:
                names = tuple(n for n in given.estimator or ESTIMATORS if (joints, cell, run, n) not in done)
                if names:
                    jobs.append((joints, cell, given.seed, run, names))
    with ProcessPoolExecutor(given.workers) as pool, given.file.open("a") as out:
        for rows in pool.map(one_run, *zip(*jobs)) if jobs else ():
            out.writelines(json.dumps(one) + "\n" for one in rows)
            out.flush()
    tell(read(given.file))


def read(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def tell(rows: list[dict[str, Any]]) -> None:
    groups = defaultdict(list)
    for r in rows:
        groups[r["joints"], r["cell"], r["estimator"]].append(r)
    order = list(CELLS)
    for (joints, cell, name), some in sorted(groups.items(), key=lambda x: (x[0][0], order.index(x[0][1]), x[0][2])):
        by = defaultdict(list)
        for r in some:
            for k, e, s in zip(r["names"], r["error"], r["std"]):
                by[k].append((e, s))
        hold = {k: np.mean([abs(e) < 1.96 * s for e, s in v]) for k, v in by.items()}
        worst = min(hold, key=hold.get)
        bias = {k: np.mean([e for e, _ in v]) / np.std([e for e, _ in v]) for k, v in by.items()}
        biased = max(bias, key=lambda k: abs(bias[k]))
        ratio = np.median([np.std([e for e, _ in v]) / np.median([s for _, s in v]) for v in by.values()])
        notes = Counter(n for r in some for n in r["warnings"])
        offs = np.array([r["offset"] or 0 for r in some]) * 1e3
        print(
            f"{joints} {cell:15s} {name:19s} {len(some):4d} mean {100 * np.mean(list(hold.values())):5.1f} worst {100 * hold[worst]:5.1f} {worst:14s} "
            f"bias {bias[biased]:+.2f} {biased:12s} sd/se {ratio:.2f} {np.median([r['seconds'] for r in some]):.1f}s off {offs.mean():+.3f}+-{offs.std():.3f} ms fac {np.median([r['factor'] for r in some]):.1f}"
            f" {dict(notes)}"
        )


if __name__ == "__main__":
    main()
