"""Servo arms from commands and positions, delay unknown: PYTHON servo.py [ARM ...] [--peers] [--seeds N] [--page].

For each simulated arm (servo_arm.py): the largest error of armature, damping and frictionloss, that of the delay, the
held-out rollout against the truth (root mean square of all joints), how often the 95 % intervals hold the truth, and
seconds of CPU. With --peers also mujoco.sysid (the extra mujoco[sysid]), which is run once for each delay of a scan,
and CMA-ES as PACE uses it. Figures are kept in out/servo.json as they come, and what is there is not measured again;
--page writes them into docs/servo.md.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray
from page_tables import DOCS, OUT, filled, markdown, read_figures, write_figures
from servo_arm import NAMES, ServoArm, arms, held_means, simulate

Array = NDArray[np.float64]
KINDS = ("armature", "damping", "frictionloss")
PAGE, FIGURES = DOCS / "servo.md", OUT / "servo.json"
PEER_ARMS = ("heavy", "geared", "noisy", "30 Hz", "backlash")
METHODS = ("dynident", "mujoco.sysid", "CMA-ES")
DURATION = 15.0  # s, of the recordings
SCAN = np.arange(0.0, 0.06, 0.01)  # s, delays that a peer is given


@dataclass
class Outcome:
    """What a method found of an arm: values (3, 6), the delay (s), CPU (s), and how many intervals hold the truth."""

    values: Array
    delay: float
    cpu: float
    held: tuple[int, int] = (0, 0)
    text: str = ""  # the file that it wrote, else that of the arm with its values

    def figures(self, arm: ServoArm, seed: int) -> dict[str, Any]:
        """Return the figures by name."""
        true = np.array([arm.armature, arm.damping, arm.frictionloss])
        errors = 100 * np.abs(self.values / true - 1)
        return {
            "parameters": errors.max(axis=1).tolist(), "delay": 1e3 * abs(self.delay - arm.delay),
            "rollout": 1e3 * rollout_error(arm, arm.text(nominal=True), self, seed), "cpu": self.cpu,
            "held": [int(x) for x in self.held],
        }  # fmt: skip


def with_values(text: str, values: Array) -> Any:
    """Return the model of a file with other values (3, 6)."""
    spec = mujoco.MjSpec.from_string(text)
    for actuator in spec.actuators:  # commands come late already
        actuator.delay, actuator.nsample = 0.0, 0
    for k, name in enumerate(NAMES):
        joint = spec.joint(name)
        joint.armature, joint.damping[0], joint.frictionloss = values[:, k]
    return spec.compile()


def rollout_error(arm: ServoArm, text: str, outcome: Outcome, seed: int) -> float:
    """Return the root mean square (rad) of the rollout of a held-out recording from its true positions."""
    t, command, _, truth = arm.record(1000 + seed, DURATION)
    model = with_values(outcome.text or text, outcome.values)
    step = model.opt.timestep
    grid = np.arange(0.0, t[-1] + step, step)
    edges = np.concatenate([grid, [grid[-1] + step]]) - outcome.delay
    control = held_means(t, command, edges)
    q = simulate(model, control, command[0])
    simulated = np.column_stack([np.interp(t, grid, column) for column in q.T])
    return float(np.sqrt(((simulated - truth)[t > 1.0] ** 2).mean()))


def dynident(arm: ServoArm, seed: int) -> Outcome:
    """Return what dynident finds from `init` and `identify`, with nothing edited."""
    from dynident.apps.servo import fit_servos
    from dynident.cli.identification import draft_from_files
    from dynident.project.project import parse_project

    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        (folder / "arm.xml").write_text(arm.text(nominal=True))
        for name, run in (("monday", seed), ("tuesday", 500 + seed)):
            t, command, q, _ = arm.record(run, DURATION)
            head = ",".join(["time", *(f"cmd_{x}" for x in NAMES), *(f"pos_{x}" for x in NAMES)])
            rows = np.column_stack([t, command, q])
            np.savetxt(folder / f"{name}.csv", rows, delimiter=",", header=head, comments="")
        start = time.process_time()
        logs = [str(folder / f"{name}.csv") for name in ("monday", "tuesday")]
        draft, _ = draft_from_files(str(folder / "arm.xml"), logs, folder)
        result = fit_servos(parse_project(draft.text, folder / "robot.yaml"))
        cpu = time.process_time() - start
    fit = result.fit
    truth = {"delay": [arm.delay], **{kind: getattr(arm, kind) for kind in KINDS}}
    stds = [(e, float(s)) for e, s in zip(fit.entries, fit.std, strict=True) if e.quantity in truth]
    held = sum(abs(fit.values.entry(e) - truth[e.quantity][e.k]) <= 1.96 * s for e, s in stds)
    for line in result.warnings:
        print(f"   {line}")
    values = np.array([getattr(fit.values, kind) for kind in KINDS])
    return Outcome(values, fit.values.delay, cpu, (held, len(stds)), result.mjcf)


def measure(name: str, method: str, seed: int) -> dict[str, Any]:
    """Return the figures of a method on an arm."""
    arm = arms()[name]
    if method == "dynident":
        return dynident(arm, seed).figures(arm, seed)
    if method == "CMA-ES":
        from servo_cma import evolve

        return evolve(arm, seed, DURATION).figures(arm, seed)
    from servo_peers import sysid

    return sysid(arm, seed, DURATION).figures(arm, seed)


def two_digits(x: float) -> str:
    """Return a figure to two digits, without an exponent."""
    return f"{x:.0f}" if x >= 100 else f"{x:.2g}" if x > 1e-4 else "0"


def table(kept: dict[str, Any]) -> str:
    """Return the table of the page, of the first seed, and how often the intervals of all seeds hold."""
    rows = []
    for name, method in ((name, method) for name in PEER_ARMS for method in METHODS):
        row = kept.get(f"{name}, {method}, 1")
        if row is not None:
            values = " / ".join(map(two_digits, row["parameters"]))
            numbers = (values, two_digits(row["delay"]), two_digits(row["rollout"]), f"{row['cpu']:.0f}")
            rows.append((name if method == METHODS[0] else "", method, *numbers))
    held = np.sum([row["held"] for key, row in kept.items() if "dynident" in key and "backlash" not in key], axis=0)
    head = ("arm", "method", "parameters, %", "delay, ms", "rollout, mrad", "CPU, s")
    share = (
        f"Of {held[1]} nominal 95 % intervals of dynident, {100 * held[0] / held[1]:.0f} % contain the true value"
        if held[1]
        else ""
    )
    return f"{markdown(head, rows)}\n\n{share}, over all arms without backlash and all seeds."


def main() -> None:
    """Print the figures of the arms that are named, by default all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("arms", nargs="*")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--peers", action="store_true")
    parser.add_argument("--page", action="store_true", help="write the kept figures into docs/servo.md")
    given = parser.parse_args()
    kept = read_figures(FIGURES)
    methods = METHODS if given.peers else METHODS[:1]
    names = given.arms or (PEER_ARMS if given.peers else list(arms()))
    for method, name in ((method, name) for method in methods for name in names):
        for seed in range(1, (given.seeds if method == "dynident" else 1) + 1):
            key = f"{name}, {method}, {seed}"
            if key not in kept:
                kept[key] = measure(name, method, seed)
                write_figures(kept, FIGURES)
            print(key, {k: np.round(x, 3).tolist() for k, x in kept[key].items()}, flush=True)
    if given.page:
        PAGE.write_text(filled(PAGE.read_text(encoding="utf-8"), {"servos": table(kept)}), encoding="utf-8")


if __name__ == "__main__":
    main()
