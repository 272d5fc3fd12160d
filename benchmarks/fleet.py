"""Changes found on a fleet whose truth is known, and those not there: python3 benchmarks/fleet.py.

Ten arms of six joints, twenty logs each, one a week: the demo arm with ripple at three joints. No two robots are alike,
and no two logs: friction follows the temperature of the day, offsets wander, joints rub by their load, which the model
does not know, and the torque's noise is coloured. On five robots something changes. Printed is what was found, and of
``--quiet`` further robots without any change how many were flagged. Then the torque error of new robots on another
motion, from one short log: by their own estimate, by the fleet's mean, and by what borrows from both. Each log is
fitted by least squares on the exact motion (0.05 s), with ``--plain`` by a model without ripple terms. With
``--run FOLDER`` the logs are written there as encoders and drives would report them, and all is done by
``dynident fleet``.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import date, timedelta
from pathlib import Path

os.environ.update(dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1"))

import numpy as np
import polars as pl
from demo_files import ENCODER_STEP
from scipy.signal import lfilter

from dynident.apps.demo.arm import JOINTS, TILT, true_model, true_values, urdf
from dynident.apps.demo.files import Day, fourier_motion
from dynident.apps.fleets import Changes, History, Population, fleet, pool_robots
from dynident.apps.fleets.doubts import find_changes_and_residuals
from dynident.cli.options import WorkerOptions
from dynident.models import Model
from dynident.models.friction import Ripple
from dynident.motion.log import Motion
from dynident.regression import (
    BaseParameters,
    GroupKind,
    ParameterGroup,
    Regression,
    groups_of,
    structural_base_parameters,
)
from dynident.runtime import ModelError
from dynident.validation import robust_covariance

ROBOTS, LOGS, EVERY = 10, 20, 7.0  # days from log to log
RATE, SECONDS, PERIOD = 100.0, 12.0, 12.0  # Hz, s, s of the first harmonic
RIPPLED, CYCLES = ("shoulder_lift", "elbow", "wrist_pitch"), 20.0
NOISE, REMAINS = 0.01, 0.8  # of the torque: share of the joint's limit, and what is there of it a sample later
LOADED = 0.02  # friction by the load, as a share of it, that the model does not have
EFFORT = np.array([joint.effort for joint in JOINTS])


@dataclass(frozen=True)
class Fault:
    """A change of one robot from a log on; ``of`` adds to the parameters the share of it that is there."""

    robot: int
    kind: GroupKind
    joint: str
    start: int
    drifts: bool
    of: Callable[[dict[str, float], float], None]

    def share(self, log: int) -> float:
        """Return how much of it is there in a log."""
        delayed = log >= self.start
        return float(delayed * (log - self.start) / (LOGS - 1 - self.start) if self.drifts else delayed)


def rubs(joint: str, by: float) -> Callable[[dict[str, float], float], None]:
    def change(theta: dict[str, float], share: float) -> None:
        for name in (f"Fv_{joint}", f"Fc_{joint}"):
            theta[name] *= 1 + by * share

    return change


def carries(mass: float, height: float) -> Callable[[dict[str, float], float], None]:
    def change(theta: dict[str, float], share: float) -> None:
        for name, value in (("mass", 1.0), ("mz", height), ("Ixx", height**2), ("Iyy", height**2)):
            theta[f"hand.{name}"] += share * mass * value

    return change


def adds(**sizes: float) -> Callable[[dict[str, float], float], None]:
    def change(theta: dict[str, float], share: float) -> None:
        for name, value in sizes.items():
            theta[name] += share * value

    return change


FAULTS = (
    Fault(1, GroupKind.FRICTION, "elbow", 4, True, rubs("elbow", 0.4)),
    Fault(2, GroupKind.FRICTION, "wrist_pitch", 0, True, rubs("wrist_pitch", 0.3)),
    Fault(4, GroupKind.PAYLOAD, "wrist_roll", 12, False, carries(0.25, 0.15)),
    Fault(6, GroupKind.OFFSET, "forearm_roll", 8, False, adds(offset_forearm_roll=0.4)),
    Fault(8, GroupKind.RIPPLE, "elbow", 6, True, adds(ripple_elbow_sin20=0.8, ripple_elbow_cos20=0.5)),
)


def arm() -> Model:
    demo = true_model()
    return Model((*demo.terms, Ripple(demo.joints, on=RIPPLED, cycles=CYCLES)), name="arm")


def built(model: Model, rng: np.random.Generator) -> dict[str, float]:
    """Return the parameters of a robot as it leaves the factory."""
    theta = dict(zip(model.names, [*true_values(), *0.1 * rng.standard_normal(2 * len(RIPPLED))], strict=True))
    links = {name.split(".")[0]: 1 + 0.02 * rng.standard_normal() for name in theta if "." in name}
    for name in theta:
        spread = {"Fv": 0.15, "Fc": 0.15, "Ia": 0.01}.get(name[:2], 0.0)
        theta[name] *= links[name.split(".")[0]] if "." in name else 1 + spread * rng.standard_normal()
        if name.startswith("offset"):
            theta[name] += 0.005 * EFFORT[[joint.name for joint in JOINTS].index(name[7:])] * rng.standard_normal()
    return theta


def of_the_day(theta: dict[str, float], rng: np.random.Generator) -> dict[str, float]:
    """Return the parameters of a robot on one day: warm or cold, its sensors a little off."""
    warm = 4.0 * rng.standard_normal()
    today = dict(theta)
    for name in today:
        if name.startswith(("Fv", "Fc")):
            by_degree = 0.02 if name.startswith("Fv") else 0.006
            today[name] *= np.exp(-by_degree * warm + 0.02 * rng.standard_normal())
        if name.startswith("offset"):
            today[name] += 0.001 * EFFORT[[joint.name for joint in JOINTS].index(name[7:])] * rng.standard_normal()
    return today


def recorded(model: Model, theta: dict[str, float], rng: np.random.Generator, seconds: float = SECONDS) -> Motion:
    """Return a random motion with the torque that is measured on it."""
    t = np.arange(0, seconds, 1 / RATE)
    q, dq, ddq = fourier_motion(rng, Day("log", seconds, PERIOD, rng.uniform(0.4, 0.6)), t)
    values = np.array([theta[name] for name in model.names])
    tau = model.torque(q, dq, ddq, values)
    bodies = np.array([0.0 if name.startswith(("F", "offset", "ripple")) else theta[name] for name in model.names])
    tau = tau + LOADED * np.abs(model.torque(q, dq, ddq, bodies)) * np.tanh(dq / 0.02)
    white = rng.standard_normal(tau.shape) * np.sqrt(1 - REMAINS**2)
    tau = tau + NOISE * EFFORT * lfilter([1.0], [1.0, -REMAINS], white, axis=0)
    names = tuple(joint.name for joint in model.joints)
    return Motion(t, q, dq, ddq, tau, names, np.ones(len(t), dtype=bool), "simulated")


def fitted(model: Model, basis: BaseParameters, motion: Motion) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the base parameters of one log, by weighted least squares, their information and the residual of each
    joint, as a fleet has them."""
    kept, weights = list(basis.independent), 1 / (NOISE * EFFORT)
    X = (weights[:, None] * model.regressor(motion.q, motion.dq, motion.ddq)[:, :, kept]).reshape(-1, len(kept))
    scale = np.linalg.norm(X, axis=0)
    U, s, axes = np.linalg.svd(X / scale, full_matrices=False)
    beta = axes.T @ (U.T @ (weights * motion.tau).ravel() / s) / scale
    theta = np.zeros(len(model.names))
    theta[kept] = beta
    to_axes = s[:, None] * axes * scale
    variance = np.full(len(kept), (1 + REMAINS) / (1 - REMAINS))  # of a log too short to tell
    with contextlib.suppress(ModelError):
        covariance = robust_covariance(Regression(model, (motion,)), theta, weights, kept)
        variance = np.maximum(np.einsum("ij,jk,ik->i", to_axes, covariance, to_axes), 1.0)
    half = to_axes / np.sqrt(variance)[:, None]
    left = motion.tau - (X @ beta).reshape(motion.tau.shape) / weights
    return beta, half.T @ half, np.sqrt((left**2).sum(axis=0) / (len(left) - len(kept) / left.shape[1]))


Histories = tuple[History, History]  # of base parameters, and of what they leave


@dataclass(frozen=True)
class Bench:
    """The model, its base parameters and groups, and fleets made of robots as ``true`` says."""

    true: Model
    model: Model
    basis: BaseParameters
    groups: tuple[ParameterGroup, ...]

    def history(self, name: str, theta: dict[str, float], rng: np.random.Generator, fault: Fault | None) -> Histories:
        fits = [fitted(self.model, self.basis, motion) for motion in motions(self.true, theta, rng, fault)]
        values, information, residual = (np.array(x) for x in zip(*fits, strict=True))
        logs, days = tuple(f"log{k:02}" for k in range(len(fits))), EVERY * np.arange(float(len(fits)))
        sure = np.tile(2 * RATE * SECONDS * np.eye(len(JOINTS)), (len(fits), 1, 1))
        return History(name, logs, days, values, information), History(name, logs, days, np.log(residual), sure)

    def fleet(self, rng: np.random.Generator, faults: tuple[Fault, ...] = ()) -> list[Histories]:
        reference = {fault.robot: fault for fault in faults}
        return [self.history(f"robot{r}", built(self.true, rng), rng, reference.get(r)) for r in range(ROBOTS)]

    def changes(self, robots: list[Histories], rng: np.random.Generator) -> Changes:
        histories, residuals = zip(*robots, strict=True)
        return find_changes_and_residuals(histories, self.groups, residuals, self.model.joints, rng)


def motions(model: Model, theta: dict[str, float], rng: np.random.Generator, fault: Fault | None) -> Iterator[Motion]:
    for k in range(LOGS):
        now = dict(theta)
        if fault:
            fault.of(now, fault.share(k))
        yield recorded(model, of_the_day(now, rng), rng)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quiet", type=int, default=0, help="robots without a change, in fleets of ten")
    parser.add_argument("--new", type=int, default=20, help="new robots with one short log")
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--run", type=Path, metavar="FOLDER", help="by `dynident fleet`, in this folder")
    parser.add_argument("--workers", type=int, default=2, help="processes of --run")
    parser.add_argument("--plain", action="store_true", help="fit a model without ripple terms")
    given = parser.parse_args()
    rng, model = np.random.default_rng(given.seed), arm()
    if given.run:
        write(given.run, model, rng)
        run(given.run, given.workers)
        return
    reference = true_model() if given.plain else model
    basis = structural_base_parameters(reference)
    bench = Bench(model, reference, basis, groups_of(reference, basis))
    robots = bench.fleet(rng, FAULTS)
    changes = bench.changes(robots, rng)
    print_changes(changes)
    if not given.plain:
        shared = pool_robots([x for x, _ in robots], bench.groups, changes.scatter, changes.changes)
        print_new(bench, shared, changes, given.new, rng)
    print_quiet(bench, given.quiet, rng)


def print_changes(changes: Changes) -> None:
    for fault in FAULTS:
        shape = "drift" if fault.drifts else "step"
        print(f"robot{fault.robot}  true: {shape} of {fault.kind} {fault.joint} from log{fault.start:02}")
    for x in changes.changes:
        sizes = ", ".join(f"{n} {s:.3g} ± {e:.2g}" for n, s, e in zip(x.group.names, x.size, x.std, strict=True))
        print(f"{x.robot}  {x.shape} of {x.group.kind} {x.group.joint} since {x.since}: {sizes}; p {x.p_value:.4f}")
    print(f"standard errors are {changes.scatter.inflation**0.5:.2f} times too small")


def print_quiet(bench: Bench, robots: int, rng: np.random.Generator) -> None:
    chances, flagged = [], 0
    for _ in range(robots // ROBOTS):
        changes = bench.changes(bench.fleet(rng), rng)
        chances += list(changes.p_values.values())
        flagged += len({change.robot for change in changes.changes})
    if chances:
        shares = ", ".join(f"{np.mean(np.array(chances) <= p):.4f} at {p}" for p in (0.01, 0.05, 0.2))
        print(f"{flagged} of {len(chances)} quiet robots flagged; share of p-values: {shares}")


def print_new(bench: Bench, shared: Population, changes: Changes, robots: int, rng: np.random.Generator) -> None:
    """Print the torque error of new robots, over the torque, by the length of their only log."""
    for seconds in (3.0, 6.0, 12.0):
        errors = np.array([_errors(bench, shared, changes, seconds, rng) for _ in range(robots)])
        own, mean, both = 100 * np.median(errors, axis=0)
        better = np.mean(errors[:, 2] < errors[:, :2].min(axis=1))
        print(
            f"one log of {seconds:4} s: own {own:.2f} %, mean {mean:.2f} %, borrowed {both:.2f} %, best in {better:.0%}"
        )


def _errors(
    bench: Bench, shared: Population, changes: Changes, seconds: float, rng: np.random.Generator
) -> tuple[float, float, float]:
    theta = built(bench.model, rng)
    value, information, _ = fitted(
        bench.model, bench.basis, recorded(bench.model, of_the_day(theta, rng), rng, seconds)
    )
    both = shared.borrow("new", value, changes.scatter.with_scatter(information)).value
    other = recorded(bench.model, theta, rng)
    X = bench.model.regressor(other.q, other.dq, other.ddq)[:, :, list(bench.basis.independent)] / EFFORT[:, None]
    truth = X @ bench.basis.to_base(np.array([theta[name] for name in bench.model.names]))
    size = np.linalg.norm(truth)
    own, mean, borrowed = (float(np.linalg.norm(X @ x - truth) / size) for x in (value, shared.mean, both))
    return own, mean, borrowed


def write(folder: Path, model: Model, rng: np.random.Generator) -> None:
    """Write the logs of a fleet with faults, as encoders and drives report them, and what ``dynident fleet`` needs."""
    reference, monday = {fault.robot: fault for fault in FAULTS}, date(2026, 1, 5)
    for r in range(ROBOTS):
        place = folder / "logs" / f"robot{r}"
        place.mkdir(parents=True, exist_ok=True)
        for k, motion in enumerate(motions(model, built(model, rng), rng, reference.get(r))):
            q = ENCODER_STEP * np.round(motion.q / ENCODER_STEP)
            columns = {"time": motion.t} | {
                f"{name}.{kind}": x[:, j]
                for j, name in enumerate(motion.joints)
                for kind, x in (("position", q), ("torque", motion.tau))
            }
            pl.DataFrame(columns).write_parquet(place / f"{monday + timedelta(days=EVERY * k)}.parquet")
    (folder / "arm.urdf").write_text(urdf())
    channels = "".join(
        f"{kind}:\n" + "".join(f"  {joint.name}: {{ column: {joint.name}.{kind}, unit: {unit} }}\n" for joint in JOINTS)
        for kind, unit in (("position", "rad"), ("torque", "N m"))
    )
    ripple = f"{{ kind: ripple, on: [{', '.join(RIPPLED)}], cycles: [{CYCLES:g}] }}"
    (folder / "arm.yaml").write_text(
        f"model:\n  file: arm.urdf\n  base_tilt: [{TILT[0]}, {TILT[1]}]\n"
        f"  terms: [rotor, viscous, coulomb, offset, {ripple}]\n"
        f"time: {{ column: time, unit: s }}\n{channels}"
    )
    (folder / "fleet.yaml").write_text("recipe: arm.yaml\nlogs: logs/{robot}/{date}.parquet\nreports: false\n")


def run(folder: Path, workers: int) -> None:
    """Identify all logs by ``dynident fleet``, and print what it found."""
    start = time.perf_counter()
    with WorkerOptions(workers=workers).executor("dynident.apps.fleets.fit") as executor:
        fleet_result = fleet(folder / "fleet.yaml", folder / "out", executor=executor)
    failed = fleet_result.rows.filter(pl.col("status") != "ok")
    print(f"{len(fleet_result.rows)} logs, {len(failed)} failed, {time.perf_counter() - start:.0f} s")
    print_changes(fleet_result.changes[0])


if __name__ == "__main__":
    main()
