"""Servo arms from commands and positions, delay unknown: PYTHON servo.py [ARM ...] [--peers] [--seeds N].

For each simulated arm (servo_arm.py): the largest error of armature, damping and frictionloss, that of the delay, the
held-out rollout against the truth (root mean square of all joints), how often the 95 % intervals hold the truth, and
seconds of CPU. With --peers also mujoco.sysid (the extra mujoco[sysid]), which is run once for each delay of a scan.
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
from servo_arm import NAMES, ServoArm, arms, held_means, simulate

Array = NDArray[np.float64]
KINDS = ("armature", "damping", "frictionloss")
SCAN = np.arange(0.0, 0.06, 0.01)  # s, delays that a peer is given


@dataclass
class Outcome:
    """What a method found of an arm: values (3, 6), the delay (s), CPU (s), and how many intervals hold the truth."""

    values: Array
    delay: float
    cpu: float
    held: tuple[int, int] = (0, 0)
    text: str = ""  # the file that it wrote, else that of the arm with its values

    def line(self, arm: ServoArm, text: str, seed: int) -> str:
        """Return the figures in words."""
        true = np.array([arm.armature, arm.damping, arm.frictionloss])
        errors = 100 * np.abs(self.values / true - 1)
        rollout = 1e3 * rollout_error(arm, text, self, seed)
        held = f", intervals hold {self.held[0]} of {self.held[1]}" if self.held[1] else ""
        worst = " / ".join(f"{row.max():.2f}" for row in errors)
        delay = 1e3 * abs(self.delay - arm.delay)
        return f"parameters {worst} %, delay {delay:.3f} ms, rollout {rollout:.3f} mrad, CPU {self.cpu:.1f} s{held}"


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
    t, command, _, truth = arm.record(1000 + seed)
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
    from dynident.apps.servo import identify_servo
    from dynident.cli.identification import draft_from_files
    from dynident.project.project import parse_project

    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        (folder / "arm.xml").write_text(arm.text(nominal=True))
        for name, run in (("monday", seed), ("tuesday", 500 + seed)):
            t, command, q, _ = arm.record(run)
            head = ",".join(["time", *(f"cmd_{x}" for x in NAMES), *(f"pos_{x}" for x in NAMES)])
            rows = np.column_stack([t, command, q])
            np.savetxt(folder / f"{name}.csv", rows, delimiter=",", header=head, comments="")
        start = time.process_time()
        logs = [str(folder / f"{name}.csv") for name in ("monday", "tuesday")]
        draft, _ = draft_from_files(str(folder / "arm.xml"), logs, folder)
        result = identify_servo(parse_project(draft.text, folder / "robot.yaml"))
        cpu = time.process_time() - start
    fit = result.fit
    truth = {"delay": [arm.delay], **{kind: getattr(arm, kind) for kind in KINDS}}
    stds = [(e, float(s)) for e, s in zip(fit.entries, fit.std, strict=True) if e.quantity in truth]
    held = sum(abs(fit.values.entry(e) - truth[e.quantity][e.k]) <= 1.96 * s for e, s in stds)
    if result.suspects:
        print("   suspects:", [(str(e.quantity), NAMES[e.k]) for e in result.suspects])
    values = np.array([getattr(fit.values, kind) for kind in KINDS])
    return Outcome(values, fit.values.delay, cpu, (held, len(stds)), result.mjcf)


def main() -> None:
    """Print the figures of the arms that are named, by default all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("arms", nargs="*")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--peers", action="store_true")
    given = parser.parse_args()
    table = arms()
    for name in given.arms or table:
        arm = table[name]
        text = arm.text(nominal=True)
        held = np.zeros(2, dtype=int)
        for seed in range(1, given.seeds + 1):
            outcome = dynident(arm, seed)
            held += outcome.held
            print(f"{name}, seed {seed}: dynident {outcome.line(arm, text, seed)}", flush=True)
        print(f"{name}: intervals hold {100 * held[0] / held[1]:.0f} % of {held[1]}", flush=True)
        if given.peers:
            from servo_peers import sysid

            print(f"{name}: mujoco.sysid {sysid(arm, 1).line(arm, text, 1)}", flush=True)


if __name__ == "__main__":
    main()
