"""Designed motions beside random ones and recorded ones: python3 benchmarks/excitation.py [ROBOT ...] [--workers 2].

Robots are the demo arm and those of the examples whose files are in examples/data or beside the checkout. Each motion
is designed within the limits of the robot file less 10 %, clear of itself and of the floor. It is compared with the
best of 100 random series of the same periods, harmonics and limits, each made as large as these allow, and with the
recording of the example, as if it were as long, sampled alike. Samples of a joint that are too slow for a fit do not
count. Printed are seconds, log det of the information, the condition number of the weighted regressor with columns of
length one, and the worst base parameter: the largest torque error at random states, in % of the noise of the torque,
that the expected error of one base parameter makes. The
random motions have their best by each of the figures, not one motion by all.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import time
from collections.abc import Callable, Mapping
from contextlib import nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

os.environ.update(dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1"))

import numpy as np
import polars as pl

from dynident.apps.demo import demo_files
from dynident.apps.excitation import (
    Criterion,
    ExpectedAccuracy,
    MotionLimits,
    MotionRequest,
    Purpose,
    build_space,
    design,
    exact_space,
    expected_accuracy,
    min_fit_speeds,
    motion_limits,
)
from dynident.apps.excitation.design import torque_information
from dynident.apps.excitation.family import LinearCourse
from dynident.apps.excitation.limits import Feasibility
from dynident.apps.excitation.motion import build_interior
from dynident.apps.excitation.search import random_motion
from dynident.files.meshes import read_geometry
from dynident.models import Floor, Model, RigidBodies, RotorInertia, Space
from dynident.models.friction import Coulomb, Offset, Viscous
from dynident.motion.log import Log, Motion
from dynident.motion.smoothers import Butterworth
from dynident.project.project import read_project
from dynident.regression import BaseParameters, structural_base_parameters
from dynident.runtime import progress_to
from dynident.runtime.jobs import local_workers

ROOT = Path(__file__).resolve().parents[1]
PLACES = (ROOT / "examples" / "data", ROOT.parent / "shared" / "data")
NOISE = 0.01  # of the torque limit
RANDOM, STATES = 100, 400
RATE, LOW_PASS = 250.0, Butterworth(cutoffs=(8.0, 8.0, 8.0))  # Hz
Array = np.ndarray[Any, np.dtype[np.float64]]
Row = dict[str, Any]


@dataclass(frozen=True)
class Robot:
    """A model with its robot file and the motion that was recorded of it."""

    model: Model
    file: Path
    recorded: Motion

    @property
    def theta(self) -> Array:
        """The nominal parameters; friction that the file does not say is zero."""
        return np.array([one.value or 0.0 for one in self.model.parameters])


def smoothed(log: Log) -> Motion:
    """Return the motion of a recording below 8 Hz: noise of the acceleration would count as motion."""
    t = np.arange(log.t[0], log.t[-1], 1 / RATE)
    q, tau = (np.stack([np.interp(t, log.t, one) for one in x.T], axis=1) for x in (log.q, log.tau))
    return LOW_PASS(Log(t, q, tau, log.joints))


def demo(folder: Path) -> Robot:
    """Return the demo arm with its recording of Monday."""
    files = demo_files(folder)
    bodies = RigidBodies((files / "arm.urdf").read_text(), source="arm.urdf")
    joints = bodies.joints
    table = pl.read_parquet(files / "monday.parquet")
    names = tuple(joint.name for joint in joints)
    q, tau = (table.select(f"{name}.{what}" for name in names).to_numpy() for what in ("position_rad", "torque_Nm"))
    log = Log(table["time_s"].to_numpy(), q.astype(float), tau.astype(float), names)
    model = Model((bodies, RotorInertia(joints), Viscous(joints), Coulomb(joints), Offset(joints)), name="demo arm")
    return Robot(model, files / "arm.urdf", smoothed(log))


def example(name: str, folder: Path) -> Robot:
    """Return the robot of an example with its training recording."""
    data = next((place for place in PLACES if (place / name).exists()), None)
    if data is None:
        raise SystemExit(f"{name}: its files are neither in {PLACES[0]} nor in {PLACES[1]}.")
    config = folder / f"{name}.yaml"
    config.write_text((ROOT / "examples" / config.name).read_text().replace(": data/", f": {data}/"))
    project = read_project(config)
    logs, _ = project.logs()
    (log,) = logs["train"].values()
    file = next((data / name).glob("*.urdf"))
    return Robot(project.model, file, smoothed(log))


ROBOTS: Mapping[str, Callable[[Path], Robot]] = {
    "demo": demo,
    "lwr4": partial(example, "lwr4"),
    "panda": partial(example, "panda"),
    "tx40": partial(example, "tx40"),
}


def worst(model: Model, basis: BaseParameters, sigma: Array, found: ExpectedAccuracy) -> float:
    """Return the largest torque error (%, of the noise) at random states that one base parameter's error makes."""
    states = model.random_states(np.random.default_rng(0), STATES)
    Y = model.regressor(**states)[:, :, list(basis.independent)] / sigma[:, None]
    size = np.sqrt(np.square(Y).mean(axis=(0, 1)))
    return float(100 * (size * found.std).max())


def measured(robot: Robot, workers: int, seed: int, floor: float, random: int, criterion: Criterion) -> Row:
    """Return what a design takes and reaches, and what others reach."""
    model, theta = robot.model, robot.theta
    limits = motion_limits(model)
    bodies = next(term for term in model.terms if isinstance(term, RigidBodies))
    geometry = read_geometry(bodies, robot.file)
    space = build_space(geometry, (Floor(floor),), limits.lower, limits.upper)
    sigma = NOISE * limits.torque
    request = MotionRequest(sigma, criterion=criterion, duration=30.0)
    began, cpu = time.perf_counter(), _cpu()
    workers_or_none = local_workers(workers) if workers > 1 else nullcontext()
    with workers_or_none as executor, progress_to(lambda step: print(f"   {step}", end="   \r", flush=True)):
        made = design(
            model, theta, limits, space, request, np.random.default_rng(seed), executor=executor,
            shapes=exact_space(geometry, space),
        )  # fmt: skip
    row: Row = {"seconds": time.perf_counter() - began, "cpu": _cpu() - cpu, "pairs": len(space.pairs)}
    row["duration"] = made.trajectory.duration
    basis = structural_base_parameters(model)
    slow = min_fit_speeds(model, limits)
    figures = partial(_figures, model, theta, basis, sigma)
    periods = [piece for piece in made.trajectory.pieces if piece.purpose is Purpose.MOTION]
    t = np.arange(0.0, request.period, 1 / request.rate)
    samples = len(t) * len(periods)
    states = periods[0].course.states(t)
    row["design"] = figures(torque_information(model, states, len(periods) / sigma**2, slow))
    row |= _of_random(robot, limits, space, request, basis, len(periods), random, seed, figures)
    used = robot.recorded
    recorded = np.stack([used.q, used.dq, used.ddq])[:, used.mask]
    row["recorded"] = figures(torque_information(model, recorded, samples / recorded.shape[1] / sigma**2, slow))
    row["reached"] = made.checks[0].reached.max(axis=1).tolist()
    row["nearest"] = None if made.checks[0].nearest is None else made.checks[0].nearest.distance
    return row


def _of_random(
    robot: Robot,
    limits: MotionLimits,
    space: Space,
    request: MotionRequest,
    basis: BaseParameters,
    periods: int,
    count: int,
    seed: int,
    figures: Callable[[Array], Row],
) -> Row:
    """Return the best figures of random motions, the median of the worst parameter, and that of the best log det."""
    feasible = Feasibility(robot.model, robot.theta, limits, space, request.clearance)
    interior = build_interior(feasible, space, request, basis)
    rng, found, slow = np.random.default_rng([seed, 1]), [], min_fit_speeds(robot.model, limits)
    t = np.arange(0.0, request.period, 1 / request.rate)
    for _ in range(count):
        states = LinearCourse(interior.family, random_motion(interior, rng)).states(t)
        found.append(figures(torque_information(robot.model, states, periods / request.sigma**2, slow)))
    best = {"log_det": max(one["log_det"] for one in found)}
    best |= {key: min(one[key] for one in found) for key in ("condition", "worst")}
    by_log_det = max(found, key=lambda one: one["log_det"])["worst"]
    return {"random": best, "median": float(np.median([one["worst"] for one in found])), "by_log_det": by_log_det}


def _figures(model: Model, theta: Array, basis: BaseParameters, sigma: Array, information: Array) -> Row:
    found = expected_accuracy(model, theta, information, basis)
    return {
        "log_det": found.log_det,
        "condition": found.condition,
        "worst": worst(model, basis, sigma, found),
    }


def _cpu() -> float:
    return sum(one.ru_utime + one.ru_stime for one in map(resource.getrusage, (resource.RUSAGE_SELF, -1)))


def shown(name: str, row: Row) -> str:
    """Return the lines of a robot."""
    made, others, log = row["design"], row["random"], row["recorded"]
    took = f"{row['seconds']:.1f} s ({row['cpu']:.1f} s of CPU), {row['duration']:.1f} s of motion"
    lines = [
        f"{name}: {took}, {row['pairs']} pairs of shapes",
        f"{'':11}{'log det':>10}{'condition':>11}{'worst, %':>10}",
    ]
    for label, one in (("designed", made), ("random", others), ("recorded", log)):
        lines.append(f"  {label:9}{one['log_det']:10.1f}{one['condition']:11.1f}{one['worst']:10.2f}")
    ratios = (others["worst"], row["by_log_det"], row["median"], log["worst"])
    words = ("the best random one", "the random one of best log det", "the median random one", "the recorded one")
    lines.append(
        "  worst parameter better than "
        + ", ".join(f"{word} {ratio / made['worst']:.2f}x" for word, ratio in zip(words, ratios, strict=True))
    )
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("robots", nargs="*", metavar="ROBOT", help=", ".join(ROBOTS))
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--floor", type=float, default=0.0, help="m along z of the root link")
    parser.add_argument("--criterion", default="d", choices=[one.value for one in Criterion], help="of the design")
    parser.add_argument("--random", type=int, default=RANDOM, help="motions")
    parser.add_argument("--out", type=Path, help="a JSON file of all figures")
    given = parser.parse_args()
    rows = {}
    with TemporaryDirectory() as folder:
        for name in given.robots or ROBOTS:
            settings = given.workers, given.seed, given.floor, given.random, Criterion(given.criterion)
            rows[name] = measured(ROBOTS[name](Path(folder)), *settings)
            print(shown(name, rows[name]), flush=True)
    if given.out:
        given.out.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
