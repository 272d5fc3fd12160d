"""Errors announced beside errors found: python3 benchmarks/announced.py [ROBOT ...] [--runs 100].

A motion is designed for a 6-joint arm and for the LWR4 from its file. It is followed in closed loop (1 kHz, velocity
inside of position, velocity fed forward) by an arm with rotor inertia, viscous and Coulomb friction that can hold a
joint at rest, whose encoders count 2^17 to a turn of the joint. Loops differ by where the counts begin. Recorded are
positions as counted and torques with white noise of the size announced, 1 % of the torque limit. Each recording is
identified by least squares with weights by joint, without slow samples, or as a configuration with all defaults says
(--draft). Printed over the base parameters: the root mean square error found, its spread and its bias, each over the
standard error announced, and the standard errors that the fits report over those announced, as quantiles of 0, 5, 50,
95 and 100 %. With N runs a ratio has an error of 1 / sqrt(2 N), 7 % for 100: 99.8 % of ratios of one are then between
0.8 and 1.25. The same for the best of 100 random motions, the one whose worst parameter is announced to be best, and
for motions that other tools have found (--other NAME=FILE.npz with t, q, dq, ddq; see figaroh_motion.py). The worst
parameter is that whose error makes the largest torque at random states, in % of the noise.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

os.environ.update(dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1"))

import numpy as np
from commands import recordings
from scipy.interpolate import BPoly

from dynident.apps.demo import demo_files
from dynident.apps.demo.arm import true_values
from dynident.apps.excitation import (
    ExpectedAccuracy,
    MotionLimits,
    MotionRequest,
    Piece,
    Program,
    Purpose,
    Trajectory,
    build_space,
    design,
    expected_accuracy,
    min_fit_speeds,
    motion_limits,
)
from dynident.apps.excitation.design import torque_information
from dynident.apps.excitation.exact_space import sample_poses
from dynident.apps.excitation.family import LinearCourse
from dynident.apps.excitation.limits import Feasibility
from dynident.apps.excitation.motion import build_interior, motion_pieces
from dynident.apps.excitation.search import random_motion
from dynident.estimators import LeastSquares, PhysicallyConsistent, Problem
from dynident.files.meshes import read_geometry
from dynident.identification import Recipe, identify
from dynident.models import Floor, Model, RigidBodies, RotorInertia, Space
from dynident.models.friction import Coulomb, Offset, Viscous
from dynident.models.simulation.trace import Machine
from dynident.motion.log import Log
from dynident.motion.smoothers import Spline
from dynident.regression import Regression, Selection, structural_base_parameters

NOISE, MARGIN = 0.01, 0.1  # of the torque limit; of all limits
STEP = 1e-3  # s: the cycle of the drives
COUNT = 2 * np.pi / 2**17  # rad
KP, KV, LOW_PASS = 40.0, 100.0, 0.3  # 1/s; 1/s by inertia; of a new velocity in the filtered one, about 60 Hz
SHARES = {"rotor": 0.006, "viscous": 0.05, "coulomb": 0.02, "offset": 0.004}  # of the torque limit, the truth of LWR4
RANDOM, STATES, LOW, WHOLE = 100, 400, 0.1, 5
Array = np.ndarray[Any, np.dtype[np.float64]]
Row = dict[str, Any]


@dataclass(frozen=True)
class Arm:
    """A model with its truth, its file and what a design is asked for."""

    model: Model
    nominal: Array
    truth: Array
    limits: MotionLimits
    space: Space
    request: MotionRequest

    @property
    def feasible(self) -> Feasibility:
        return Feasibility(self.model, self.nominal, self.limits, self.space, self.request.clearance)


def arm(name: str, folder: Path, floor: float, duration: float, program: Program = Program.MOTION) -> Arm:
    """Return a robot with the default terms, whose truth is known."""
    file = demo_files(folder) / "arm.urdf" if name == "demo" else next(recordings(name).glob("*.urdf"))
    bodies = RigidBodies(file.read_text(), source=file.name)
    joints = bodies.joints
    model = Model((bodies, RotorInertia(joints), Viscous(joints), Coulomb(joints), Offset(joints)), name=name)
    limits = motion_limits(model, margin=MARGIN)
    nominal = np.array([parameter.value or 0.0 for parameter in model.parameters])
    torque, speed = limits.torque / (1 - MARGIN), limits.velocity
    truth = true_values() if name == "demo" else nominal.copy()
    if name != "demo":
        sizes = [share * torque / (speed if kind == "viscous" else 1.0) for kind, share in SHARES.items()]
        truth[-4 * len(joints) :] = np.concatenate(sizes)
    space = build_space(read_geometry(bodies, file), (Floor(floor),), sample_poses(limits.lower, limits.upper))
    return Arm(model, nominal, truth, limits, space, MotionRequest(NOISE * torque, program, duration=duration))


def best_random(
    case: Arm, periods: int, rng: np.random.Generator, worst: Callable[[ExpectedAccuracy], float]
) -> Trajectory:
    """Return the random motion, of as many periods from rest to rest, whose worst parameter is best."""
    basis = structural_base_parameters(case.model)
    interior = build_interior(case.feasible, case.request, basis)
    t = np.arange(0.0, case.request.period, 1 / case.request.rate)
    result, slow, weights = [], min_fit_speeds(case.model, case.limits), periods / case.request.sigma**2
    for _ in range(RANDOM):
        x = random_motion(interior, rng)
        information = torque_information(case.model, LinearCourse(interior.family, x).states(t), weights, slow)
        result.append((worst(expected_accuracy(case.model, case.nominal, information, basis)), x))
    for _, x in sorted(result, key=lambda pair: pair[0]):
        if interior.between(x, case.model) is None:
            return Trajectory(
                case.limits.joints,
                motion_pieces(case.feasible, interior.family, x, replace(case.request, max_periods=periods), rng),
            )
    raise SystemExit("none of the random motions keeps to the limits between the points of its grid.")


@dataclass(frozen=True)
class Sampled:
    """A course from samples of q, dq and ddq."""

    t: Array
    values: Array  # (3, N, n)

    @property
    def duration(self) -> float:
        return float(self.t[-1])

    def states(self, t: Array) -> Array:
        curve = BPoly.from_derivatives(self.t, np.moveaxis(self.values, 1, 0))
        return np.stack([curve.derivative(k)(t) if k else curve(t) for k in range(4)])


def other(case: Arm, file: str) -> Trajectory:
    """Return the motion of another tool."""
    given = np.load(file)
    values = np.stack([given[key] for key in ("q", "dq", "ddq")])
    return Trajectory(case.limits.joints, (Piece(Sampled(given["t"] - given["t"][0], values), Purpose.MOTION),))


def followed(case: Arm, path: Trajectory, rng: np.random.Generator, runs: int) -> tuple[Array, Array, Array]:
    """Return times (N), and positions as counted and mean torques (runs, N, n) of closed loops.

    The torque of a sample is the mean of the cycles about its time.
    """
    machine, every = Machine(case.model, case.truth), round(1 / case.request.rate / STEP)
    steps = int(path.duration / STEP)
    reference, speed = path.states(STEP * np.arange(steps + 1, dtype=float))[:2]
    masses = np.diagonal(case.model.mass_matrix(reference[::50], case.truth), axis1=1, axis2=2)
    kv, most = KV * np.quantile(masses, LOW, axis=0), case.limits.torque / (1 - MARGIN)
    n = len(kv)
    start = rng.uniform(0, COUNT, (runs, n))
    q, dq, ddq, slow = np.tile(reference[0], (runs, 1)), *(np.zeros((runs, n)) for _ in range(3))
    rows = (steps - every // 2) // every
    shown, torque, cycles = *(np.empty((rows, runs, n)) for _ in range(2)), np.zeros((every, runs, n))
    before = COUNT * np.round((q + start) / COUNT) - start
    for k in range(steps):
        seen = COUNT * np.round((q + start) / COUNT) - start
        slow, before = slow + LOW_PASS * ((seen - before) / STEP - slow), seen
        cycles[k % every] = np.clip(kv * (KP * (reference[k] - seen) + speed[k] - slow), -most, most)
        if k % every == 0 and k // every < rows:
            shown[k // every] = seen
        last, rest = divmod(k + 1 - every // 2, every)
        if rest == 0 and last < rows:
            torque[last] = cycles[: k + 1].mean(axis=0)
        old = dq
        q, dq = machine.step(q, dq, ddq, cycles[k % every], STEP)
        ddq = (dq - old) / STEP
    return STEP * every * np.arange(rows, dtype=float), np.moveaxis(shown, 1, 0), np.moveaxis(torque, 1, 0)


def found(
    case: Arm, path: Trajectory, told: ExpectedAccuracy, runs: int, seed: int, recipe: Recipe
) -> tuple[Array, Array]:
    """Return the errors (runs, r) of the base parameters, and what the fits say of them (runs, r), relative to what was
    announced."""
    rng = np.random.default_rng(seed)
    t, shown, torque = followed(case, path, rng, runs)
    errors, own, names = [], [], case.model.names
    alone = Model(case.model.terms[:1], name=case.model.name)
    for k, (q, tau) in enumerate(zip(shown, torque, strict=True)):
        log = Log(t, q, tau + case.request.sigma * rng.standard_normal(tau.shape), case.limits.joints)
        if recipe.terms is None and k >= WHOLE:  # the same fit, without all that a report needs
            motion = recipe.motion(log)
            regression = Regression(case.model, (motion,), Selection(min_speed=recipe.min_speeds(case.limits.joints)))
            value = dict(zip(names, recipe.estimator(Problem(case.model, (motion,), regression)).value, strict=True))
        else:
            result = identify(case.model if recipe.terms is None else alone, {"run": log}, recipe=recipe)
            if recipe.terms is None:  # the smoother of the first recording does for all
                recipe = replace(recipe, smoother=result.recipe.smoother)
            value = dict(zip(result.model.names, result.estimate.value, strict=True))
            basis, std = result.base.on_data, result.errors.base_std
            if basis is not None and std is not None and basis.leading == told.basis.leading:
                own.append(std)
        errors.append(told.basis.combination @ (np.array([value.get(name, 0.0) for name in names]) - case.truth))
    return np.array(errors) / told.std, np.array(own).reshape(-1, len(told.std)) / told.std


def measured(name: str, folder: Path, given: argparse.Namespace) -> Row:
    """Return the tables of a robot."""
    robot, began = arm(name, folder, given.floor, given.duration, Program(given.program)), time.process_time()
    made = design(
        robot.model,
        robot.nominal,
        robot.limits,
        robot.space,
        robot.request,
        np.random.default_rng(given.seed),
    )
    print(f"{name}: {time.process_time() - began:.1f} s of CPU for the design", flush=True)
    basis, sigma = made.expected.basis, robot.request.sigma
    states = robot.model.random_states(np.random.default_rng(0), STATES)
    size = np.sqrt(
        np.square(robot.model.regressor(**states)[:, :, list(basis.independent)] / sigma[:, None]).mean((0, 1))
    )

    def worst(told: ExpectedAccuracy) -> float:
        return float(100 * (size * told.std).max())

    periods = sum(piece.purpose is Purpose.MOTION for piece in made.trajectory.pieces)
    motions = {"designed": made.trajectory}
    if periods and not given.no_random:
        motions["best random"] = best_random(robot, periods, np.random.default_rng([given.seed, 1]), worst)
    motions |= {label: other(robot, file) for label, file in (text.split("=") for text in given.other)}
    slow = min_fit_speeds(robot.model, robot.limits)
    splines = Spline(factor=given.factor) if given.factor else Spline.Settings(rule="torque").build()
    recipe = Recipe(
        splines, LeastSquares(weights="per_joint"), min_speed=dict(zip(robot.limits.joints, slow, strict=True))
    )
    if given.draft:
        recipe = Recipe(splines, PhysicallyConsistent(), time_offset="estimate", base_tilt="estimate", terms="auto")
    rows: Row = {}
    for label, path in motions.items():
        planned = path.states(path.times(robot.request.rate))
        told = expected_accuracy(
            robot.model, robot.truth, torque_information(robot.model, planned, 1 / sigma**2, slow), basis
        )
        if told.open_parameters:
            raise SystemExit(
                f"{name}, {label}: {len(told.open_parameters)} base parameters stay open, the first "
                f"{told.open_parameters[0]}."
            )
        errors, own = found(robot, path, told, given.runs, given.seed, recipe)
        rows[label] = _row(told, errors, own, size, worst(told)) | {"duration": path.duration}
        print(shown(label, rows[label], basis.leading), flush=True)
    return rows


def _row(told: ExpectedAccuracy, errors: Array, array: Array, size: Array, worst: float) -> Row:
    rms, bias = np.sqrt(np.square(errors).mean(axis=0)), errors.mean(axis=0)
    spread = errors.std(axis=0, ddof=1)
    row: Row = {"rms": rms, "spread": spread, "bias": np.abs(bias)}
    if len(array):
        row["reported"] = np.sqrt(np.square(array).mean(axis=0))
    row |= {"z": bias / spread * np.sqrt(len(errors)), "announced": worst}
    return row | {"worst": float(100 * (size * told.std * rms).max()), "log_det": told.log_det}


def shown(label: str, row: Row, names: tuple[str, ...]) -> str:
    """Return the lines of a motion."""
    head = f"  {label}, {row['duration']:.1f} s: log det {row['log_det']:.1f}; worst parameter: "
    lines = [f"{head}announced {row['announced']:.2f} %, found {row['worst']:.2f} %"]
    for key in (key for key in ("rms", "spread", "bias", "reported") if key in row):
        quantiles = " ".join(f"{x:5.2f}" for x in np.quantile(row[key], (0, 0.05, 0.5, 0.95, 1)))
        inside = f"   {((row[key] > 0.8) & (row[key] < 1.25)).sum()} of {len(names)} in 0.8 to 1.25"
        lines.append(f"    {key:9} {quantiles}{'' if key == 'bias' else inside}")
    rows = zip(names, row["rms"], row["z"], strict=True)
    off = [f"{name} {x:.2f} (z of the bias {z:+.1f})" for name, x, z in rows if not 0.8 < x < 1.25]
    return "\n".join([*lines, *([f"    outside: {', '.join(off)}"] if off else [])])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("robots", nargs="*", metavar="ROBOT", help="demo, lwr4")
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--floor", type=float, default=0.0, help="m along z of the root link")
    parser.add_argument("--duration", type=float, default=30.0, help="s")
    parser.add_argument("--program", default="motion", choices=[x.value for x in Program], help="of the design")
    parser.add_argument("--draft", action="store_true", help="identify by the drafted configuration")
    parser.add_argument("--factor", type=float, help="of the noise, that the spline smooths")
    parser.add_argument("--no-random", action="store_true")
    parser.add_argument("--other", nargs="*", default=[], metavar="NAME=FILE")
    parser.add_argument("--out", type=Path, help="a JSON file of all figures")
    given = parser.parse_args()
    with TemporaryDirectory() as folder:
        rows = {name: measured(name, Path(folder), given) for name in given.robots or ("demo", "lwr4")}
    if given.out:
        given.out.write_text(json.dumps(rows, indent=1, default=list))


if __name__ == "__main__":
    main()
