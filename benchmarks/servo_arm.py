"""Simulated arms of position servos: the files, the commands, and recordings as such arms give them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
NAMES = ("pan", "lift", "elbow", "wrist", "roll", "jaw")
AXES = ("0 0 1", "0 1 0", "0 1 0", "0 1 0", "1 0 0", "0 0 1")
PLACES = ("0 0 0.05", "0 0 0.06", "0.11 0 0.03", "0.13 0 0", "0.06 0 0", "0.02 0.01 0")  # m, in the link before
CENTRES = ("0 0 0.03", "0.06 0 0.01", "0.07 0 0", "0.03 0 0", "0.01 0.005 0", "0.03 0 0")  # m
MASSES = (0.16, 0.11, 0.10, 0.09, 0.05, 0.02)  # kg
SPREAD = (60e-6, 90e-6, 80e-6, 30e-6, 15e-6, 6e-6)  # kg m^2, about the centre of mass
PERIOD = 0.01  # s, of commands and log
STEP, GAP_STEP = 0.002, 0.0005  # s, of the simulation; of arms with gaps
COUNT = 2 * np.pi / 4096  # rad, of a 12-bit encoder


@dataclass(frozen=True)
class ServoArm:
    """The true values of an arm (6 each, SI), what its file says in their place, and how it is recorded."""

    armature: Array
    damping: Array
    frictionloss: Array
    nominal: Array  # (3, 6): what the file has in place of these, as factors
    kp: float = 17.8
    limit: float = 3.35
    delay: float = 0.02
    count: float = COUNT
    noise: float = 0.0
    rate: float = 100.0
    masses: Array | None = None  # (6), factors of the true masses
    density: float = 1.0  # factor on all masses, true and in the file
    backlash: Array | None = None  # (6), rad: gaps between motors and links, which the file does not have
    encoder: str = "output"  # side of the gap on which positions are measured and controlled, or "motor"

    def text(self, *, nominal: bool, kp: float | None = None) -> str:
        """Return the MJCF of the arm, with the true or the nominal values."""
        gaps = np.zeros(6) if nominal or self.backlash is None else self.backlash
        factors = self.nominal if nominal else np.ones((3, 6))
        values = factors * np.array([self.armature, self.damping, self.frictionloss])
        masses = self.density * np.array(MASSES) * (1.0 if nominal or self.masses is None else self.masses)
        opening, closing, actuators = "", "", ""
        for k, name in enumerate(NAMES):
            armature, damping, frictionloss = values[:, k]
            inertia = " ".join([f"{self.density * SPREAD[k]:g}"] * 3)
            opening += (
                f'<body name="{name}_link" pos="{PLACES[k]}"><joint name="{name}" axis="{AXES[k]}" '
                f'armature="{armature:.9g}" damping="{damping:.9g}" frictionloss="{frictionloss:.9g}"/>'
                f"{_gap(name, AXES[k], gaps[k])}"
                f'<inertial pos="{CENTRES[k]}" mass="{masses[k]:.9g}" diaginertia="{inertia}"/>\n'
            )
            closing += "</body>"
            bounds = f"-{self.limit} {self.limit}"
            actuators += f'<position name="{name}" joint="{name}" kp="{kp or self.kp}" forcerange="{bounds}"/>\n'
        return (
            '<mujoco model="six_servos"><compiler angle="radian"/>\n'
            f'<option timestep="{GAP_STEP if gaps.any() else STEP}" integrator="implicitfast"/>\n'
            f"<worldbody>\n{opening}{closing}\n</worldbody>\n<actuator>\n{actuators}</actuator></mujoco>\n"
        )

    def record(self, seed: int, duration: float = 30.0) -> tuple[Array, Array, Array, Array]:
        """Return t (N), commands and measured positions (N, 6), and the true positions."""
        import mujoco

        rng = np.random.default_rng(seed)
        model = mujoco.MjModel.from_xml_string(self.text(nominal=False))
        step = model.opt.timestep
        t = np.arange(0.0, duration, 1 / self.rate)
        command = commands(t, rng)
        grid = np.arange(0.0, duration, step)
        # held, and late: of a command that comes within a step of the simulation, its share of the step
        edges = np.append(grid, grid[-1] + step) - self.delay
        q = simulate(model, held_means(t, command, edges), command[0], outputs=self.encoder == "output")
        truth = np.column_stack([np.interp(t, grid, column) for column in q.T])
        measured = truth + self.noise * rng.standard_normal(truth.shape)
        return t, command, np.round(measured / self.count) * self.count if self.count else measured, truth


def _gap(name: str, axis: str, size: float) -> str:
    """Return the joint of a gear's gap, which moves freely within its size (rad)."""
    bound = 0.5 * float(size)
    return (
        f'<joint name="{name}_gap" axis="{axis}" limited="true" range="{-bound:.9g} {bound:.9g}" damping="0.002" '
        'solreflimit="0.002 1" solimplimit="0.99 0.999 0.001"/>'
        if size
        else ""
    )


def simulate(model: Any, control: Array, start: Array, *, outputs: bool = True) -> Array:
    """Return the positions (N, n) before each step of a simulation by MuJoCo, from rest at ``start``.

    Behind a gap it is the ``outputs`` whose positions are measured and controlled, or the motors.
    """
    import mujoco

    data = mujoco.MjData(model)
    motors, gaps = (
        [[k, model.joint(f"{name}{ending}").qposadr[0]] for k, name in enumerate(NAMES) if _has(model, name + ending)]
        for ending in ("", "_gap")
    )
    motor, gap = np.array(motors), np.array(gaps if outputs else [], dtype=int).reshape(-1, 2)
    data.qpos[motor[:, 1]] = start
    q = np.empty(control.shape)
    for k, row in enumerate(control):
        q[k] = data.qpos[motor[:, 1]]
        data.ctrl[:] = row
        if len(gap):
            q[k, gap[:, 0]] += data.qpos[gap[:, 1]]
            data.ctrl[gap[:, 0]] -= data.qpos[gap[:, 1]]
        mujoco.mj_step(model, data)
    return q


def _has(model: Any, joint: str) -> bool:
    return any(model.joint(k).name == joint for k in range(model.njnt))


def held_means(t: Array, command: Array, edges: Array) -> Array:
    """Return the means (N, n) of held commands between the edges (N + 1)."""
    stamps = np.concatenate([[t[0] - 1.0], t, [t[-1] + 1.0]])
    levels = np.concatenate([command[:1], command])
    integral = np.vstack([np.zeros(levels.shape[1]), np.cumsum(levels * np.diff(stamps)[:, None], axis=0)])
    sums = np.column_stack([np.interp(edges, stamps, column) for column in integral.T])
    return np.asarray(np.diff(sums, axis=0) / np.diff(edges)[:, None])


def commands(t: Array, rng: np.random.Generator) -> Array:
    """Return commands (N, 6), rad: sums of sines, and steps of some joints between them."""
    reach = np.array([1.0, 0.8, 0.8, 0.8, 1.0, 0.5])
    command = np.zeros((len(t), 6))
    for k in range(6):
        frequencies = rng.uniform(0.1, 1.5, 6)
        for frequency in frequencies:
            phase = rng.uniform(0, 2 * np.pi)
            command[:, k] += reach[k] * 0.2 / (0.3 + frequency) * np.sin(2 * np.pi * frequency * t + phase)
        edges = np.sort(rng.uniform(0, t[-1], 8))
        command[:, k] += 0.15 * reach[k] * (-1.0) ** np.searchsorted(edges, t)
    return command * np.minimum(1.0, (t[:, None] + 0.5) / 1.5)


def bench_arm() -> ServoArm:
    """Return the arm of six small servos whose nominal values are off by factors of 2 to 5."""
    return ServoArm(
        armature=np.array([0.028, 0.028, 0.028, 0.014, 0.012, 0.010]),
        damping=np.array([0.60, 0.65, 0.55, 0.35, 0.30, 0.25]),
        frictionloss=np.array([0.052, 0.060, 0.050, 0.040, 0.035, 0.030]),
        nominal=np.array(
            [[0.4, 0.5, 2.0, 0.3, 2.5, 0.5], [0.5, 0.3, 0.4, 2.0, 0.5, 3.0], [2.0, 0.5, 3.0, 0.2, 0.5, 2.0]]
        ),
    )


def arms() -> dict[str, ServoArm]:
    """Return arms of unlike kinds: the bench arm, one of heavy links, a geared stiff one, a noisy one, one at 30 Hz,
    one with backlash, one with wrong masses in its file."""
    bench = bench_arm()
    return {
        "bench": bench,
        "heavy": replace(bench, masses=np.full(6, 1.0), density=4.0, limit=8.0, kp=40.0, delay=0.034),
        "geared": replace(
            bench, armature=8 * bench.armature, damping=4 * bench.damping, frictionloss=6 * bench.frictionloss,
            kp=150.0, limit=20.0, delay=0.012, count=COUNT / 16, noise=1e-4,
        ),
        "noisy": replace(bench, noise=3e-3, count=0.0, delay=0.028),
        "30 Hz": replace(bench, rate=30.0, delay=0.05),
        "backlash": replace(bench, backlash=np.array([0.0, 0.0, 0.02, 0.0, 0.01, 0.0])),
        "masses": replace(bench, masses=np.array([1.1, 1.25, 0.8, 1.3, 0.9, 1.2])),
    }  # fmt: skip
