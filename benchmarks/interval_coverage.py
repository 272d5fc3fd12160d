"""How often 95 % intervals of an identification with its defaults hold: python3 benchmarks/interval_coverage.py FILE.

An arm follows a Fourier trajectory exactly for 10 s; its positions and torques are recorded at 250 Hz with the noise of
a cell, and identified as ``dynident identify`` does where a configuration names only the logs and the estimator: the
smoother chosen by the torque, the time offset estimated. Judged are the intervals that report and terminal show, of the
base parameters. Each run of an estimator is a line of FILE (JSON lines), from which an interrupted study goes on; what
it holds depends on seed, joints, cell and run alone, but for its seconds: what estimators share is found, and counted,
once.

Printed for each cell: runs; coverage on average over the parameters, and of the worst; scatter of the estimates over
their standard errors; the largest bias over the scatter; mean and standard deviation of the time offset; share of the
runs with each note.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any
from unittest.mock import patch

os.environ.update(dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1"))

import numpy as np
from arm import LINKS, urdf
from closed_loop import arm, fourier
from scipy.signal import lfilter

from dynident.estimators import Estimator, LeastSquares, PhysicallyConsistent
from dynident.estimators.maximum_likelihood import MaximumLikelihood
from dynident.identification import Identification, Recipe, choose_smoother, find_time_offset, identify
from dynident.models import Model, RigidBodies
from dynident.models.friction import Coulomb, Viscous
from dynident.motion.log import Log
from dynident.motion.smoothers import Spline
from dynident.motion.smoothers.spline import NOISE_FACTORS
from dynident.motion.splines import NORMAL_95

Rng = np.random.Generator
Row = dict[str, Any]
ESTIMATORS: dict[str, Estimator] = {
    "least squares": LeastSquares(),
    "consistent": PhysicallyConsistent(),
    "maximum likelihood": MaximumLikelihood(),
}
FRICTION: tuple[tuple[Any, float, dict[str, float]], ...] = ((Viscous, 0.5, {}), (Coulomb, 0.4, {"width": 0.02}))
TORQUE = 0.1  # N m, standard deviation of the torque's noise in every cell
LEAD = 2000  # samples in which coloured noise forgets its start


def coloured(shape: tuple[int, int], correlation: float, rng: Rng) -> np.ndarray:
    """Stationary noise of first order and unit variance."""
    fresh = rng.standard_normal((shape[0] + LEAD, shape[1])) * np.sqrt(1 - correlation**2)
    return np.asarray(lfilter([1.0], [1.0, -correlation], fresh, axis=0))[LEAD:]


def noisy(sigma: float, correlation: float = 0.0) -> Callable[[np.ndarray, Rng], np.ndarray]:
    return lambda q, rng: q + sigma * coloured(q.shape, correlation, rng)


def encoder(bits: int) -> Callable[[np.ndarray, Rng], np.ndarray]:
    """Positions in counts; where these begin differs from run to run."""
    count = 2 * np.pi / 2**bits

    def seen(q: np.ndarray, rng: Rng) -> np.ndarray:
        begin = rng.uniform(0, count, q.shape[1])
        return np.asarray(count * np.round((q + begin) / count) - begin)

    return seen


# by cell: what is seen of the positions, and the correlation of neighbouring torque errors
CELLS: dict[str, tuple[Callable[[np.ndarray, Rng], np.ndarray], float]] = {
    "white 1e-5": (noisy(1e-5), 0.0),
    "white 1e-4": (noisy(1e-4), 0.0),
    "white 1e-3": (noisy(1e-3), 0.0),
    "16 bit": (encoder(16), 0.0),
    "12 bit": (encoder(12), 0.0),
    "position AR .9": (noisy(1e-4, 0.9), 0.0),
    "torque AR .95": (noisy(1e-5), 0.95),
    "torque AR .995": (noisy(1e-5), 0.995),
    "17 bit": (encoder(17), 0.0),
    "17 bit, torque AR .9": (encoder(17), 0.9),
}


@cache
def robot(joints: int) -> tuple[Model, np.ndarray, np.ndarray, np.ndarray]:
    """An arm, and times, positions and torques of its motion."""
    model = arm(joints)
    t, q, dq, ddq = (x[::2] for x in fourier(joints))
    return model, t, q, model.torque(q, dq, ddq, np.asarray(model.values))


@cache
def nominal(joints: int, error: float) -> Model:
    """The arm as its file has it: masses, centres and inertias a share ``error`` too large or too small."""
    if not error:
        return robot(joints)[0]
    return wrong_file(urdf(LINKS[6 - joints : 6], turn=1), joints, error)


def wrong_file(text: str, joints: int, error: float) -> Model:
    """The model of a robot file whose bodies, and whose friction, are a share ``error`` too large or too small."""
    rng = np.random.default_rng([5, joints])
    for pattern in (r'(<mass value=")([^"]+)', r'(<inertial><origin xyz=")([^"]+)', r'(i(?:xx|yy|zz)=")([^"]+)'):
        text = re.sub(pattern, lambda match: match[1] + scaled(match[2], 1 + error * rng.choice([-1, 1])), text)
    bodies = RigidBodies(text)
    friction = [(term(bodies.joints, values=((1 + error) * size,) * joints, **width)) for term, size, width in FRICTION]
    return Model((bodies, *friction))


def scaled(numbers: str, factor: float) -> str:
    return " ".join(f"{factor * float(x):.9g}" for x in numbers.split())


def recording(joints: int, cell: str, seed: int, run: int) -> Log:
    rng = np.random.default_rng([seed, joints, list(CELLS).index(cell), run])
    model, t, q, tau = robot(joints)
    seen, correlation = CELLS[cell]
    noise = TORQUE * coloured(tau.shape, correlation, rng)
    return Log(t, seen(q, rng), tau + noise, tuple(joint.name for joint in model.joints))


def one_run(joints: int, cell: str, seed: int, run: int, names: tuple[str, ...], error: float) -> list[Row]:
    """A row for each estimator; what is found before the fit in the same way is found once."""
    log, rows = recording(joints, cell, seed, run), []
    shared: dict[str, Any] = {
        "choose_smoother": once(choose_smoother, lambda _model, _logs, candidates, **_: tuple(candidates)),
        "find_time_offset": once(find_time_offset, lambda *_, **__: "least squares"),
    }
    for name in names:
        recipe = Recipe(tuple(Spline(factor=x) for x in NOISE_FACTORS), ESTIMATORS[name], time_offset="estimate")
        began = time.process_time()
        with patch.multiple("dynident.identification.time_offset", **shared):
            result = identify(nominal(joints, error), [log], recipe=recipe)
        took = {"seconds": round(time.process_time() - began, 2)}
        key = {"joints": joints, "cell": cell, "estimator": name, "seed": seed, "run": run, "file": error}
        rows.append(key | took | judged(result, np.asarray(robot(joints)[0].values)))
    return rows


def once(function: Callable[..., Any], key: Callable[..., Any]) -> Callable[..., Any]:
    """Remember what a function returns, by a key of its arguments."""
    reference: dict[Any, Any] = {}

    def remembered(*given: Any, **named: Any) -> Any:
        which = key(*given, **named)
        if which not in reference:
            reference[which] = function(*given, **named)
        return reference[which]

    return remembered


def judged(identification: Identification, truth: np.ndarray) -> Row:
    """Errors and standard errors of the base parameters, the notes and the time offset of a run."""
    basis, std, offset = (
        identification.base.on_data,
        identification.errors.base_std,
        identification.calibration.time_offset,
    )
    assert basis is not None
    assert std is not None
    assert offset is not None
    return {
        "names": [basis.names[k] for k in basis.independent],
        "error": [float(f"{x:.5g}") for x in basis.to_base(identification.estimate.value - truth)],
        "std": [float(f"{x:.5g}") for x in std],
        "notes": sorted({f"{type(warning).__name__} ({warning.severity})" for warning in identification.warnings}),
        "offset": [offset.seconds, offset.std],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=Path)
    parser.add_argument("--joints", type=int, action="append", choices=range(2, 7), help="default: 3 and 6")
    parser.add_argument("--cell", action="append", choices=CELLS, help="default: all")
    parser.add_argument("--estimator", action="append", choices=ESTIMATORS, help="default: all")
    parser.add_argument("--runs", type=int, default=200, help="of each cell, those in FILE included; 0: only print")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--seed", type=int, default=11)
    parser.add_argument("--file-error", type=float, default=0.0, help="share by which the robot file is wrong")
    given = parser.parse_args()
    reference = {
        (r["joints"], r["cell"], r["estimator"], r["seed"], r["run"], r.get("file", 0)) for r in read(given.file)
    }
    jobs = []
    for run, joints, cell in product(range(given.runs), given.joints or (3, 6), given.cell or CELLS):
        wanted = given.estimator or ESTIMATORS
        names = tuple(x for x in wanted if (joints, cell, x, given.seed, run, given.file_error) not in reference)
        jobs += [(joints, cell, given.seed, run, names, given.file_error)] if names else []
    with ProcessPoolExecutor(given.workers) as pool, given.file.open("a") as out:
        for rows in pool.map(one_run, *zip(*jobs, strict=True)) if jobs else ():
            out.writelines(json.dumps(row) + "\n" for row in rows)
            out.flush()
    tell(read(given.file))


def read(path: Path) -> Iterator[Row]:
    """The rows of a file, without a last one that was cut."""
    for line in path.read_text().splitlines() if path.exists() else ():
        try:
            yield json.loads(line)
        except json.JSONDecodeError:
            continue


def tell(rows: Iterable[Row]) -> None:
    cells: dict[tuple[int, float, int, int], list[Row]] = defaultdict(list)
    for row in rows:
        place = list(CELLS).index(row["cell"]), list(ESTIMATORS).index(row["estimator"])
        cells[row["joints"], row.get("file", 0.0), *place].append(row)
    for (joints, error, cell, estimator), some in sorted(cells.items()):
        wrong = f", file {100 * error:.0f} % wrong" if error else ""
        told = (
            f"{joints} joints{wrong}, {list(CELLS)[cell]:14s}, {list(ESTIMATORS)[estimator]:18s}: {len(some):3d} runs, "
        )
        print(told + summary(some), flush=True)


def summary(rows: list[Row]) -> str:
    by: dict[str, list[tuple[float, float]]] = defaultdict(list)
    for row in rows:
        for name, *pair in zip(row["names"], row["error"], row["std"], strict=True):
            by[name].append(tuple(pair))
    pairs = {name: np.array(some) for name, some in by.items()}
    holds = {name: 100 * (np.abs(x[:, 0]) < NORMAL_95 * x[:, 1]).mean() for name, x in pairs.items()}
    worst = min(holds, key=lambda name: holds[name])
    scatter = {name: max(float(x[:, 0].std()), 1e-300) for name, x in pairs.items()}
    ratio = np.median([scatter[name] / np.median(x[:, 1]) for name, x in pairs.items()])
    bias = max(abs(float(x[:, 0].mean())) / scatter[name] for name, x in pairs.items())
    notes = Counter(note for row in rows for note in row["notes"])
    shares = ", ".join(f"{note} {100 * count / len(rows):.0f} %" for note, count in sorted(notes.items()))
    offset = 1e3 * np.array([row["offset"][0] for row in rows])
    return (
        f"{np.mean(list(holds.values())):.1f} %, worst {holds[worst]:.1f} ({worst}); scatter {ratio:.2f}, "
        f"bias {bias:.2f}; offset {offset.mean():.3f} +- {offset.std():.3f} ms; {shares or 'no notes'}"
    )


if __name__ == "__main__":
    main()
