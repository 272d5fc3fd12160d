"""What goes wrong: faults of logs, effects that a model lacks, conventions of a system, errors of files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from situation_arm import Convention, Course, Effect, Fault, Link, Raw, Robot, Truth

Array = NDArray[np.float64]


def rows(raw: Raw, start: float, stop: float) -> slice:
    """Return the rows between two shares of a log."""
    return slice(int(start * len(raw.t)), int(stop * len(raw.t)))


def torque(change: Callable[[Array, np.random.Generator], None], *roles: str) -> Fault:
    """Return a fault that changes a copy of the torques in place, in the logs of these roles (none: both)."""

    def fault(raw: Raw, rng: np.random.Generator, role: str) -> Raw:
        tau = raw.tau.copy()
        if not roles or role in roles:
            change(tau, rng)
        return replace(raw, tau=tau)

    return fault


def position(change: Callable[[Array, np.random.Generator], None], *roles: str) -> Fault:
    """Return the same for positions."""

    def fault(raw: Raw, rng: np.random.Generator, role: str) -> Raw:
        return replace(raw, q=torque(change, *roles)(replace(raw, tau=raw.q), rng, role).tau)

    return fault


def put(at: Any, value: Any) -> Callable[[Array, np.random.Generator], None]:
    def change(x: Array, _rng: np.random.Generator) -> None:
        x[at] = value

    return change


def add(at: Any, value: Any) -> Callable[[Array, np.random.Generator], None]:
    def change(x: Array, _rng: np.random.Generator) -> None:
        x[at] += value

    return change


def scale(at: Any, value: Any) -> Callable[[Array, np.random.Generator], None]:
    def change(x: Array, _rng: np.random.Generator) -> None:
        x[at] *= value

    return change


def torque_spikes(tau: Array, rng: np.random.Generator) -> None:
    chosen = rng.choice(tau.size, max(1, round(tau.size / 1000)), replace=False)
    tau.flat[chosen] += rng.choice([-1.0, 1.0], len(chosen)) * rng.uniform(100, 500, len(chosen))


def position_spikes(q: Array, rng: np.random.Generator) -> None:
    q[rng.choice(len(q), 5, replace=False), 1] += 5e-3


def saturated(tau: Array, _rng: np.random.Generator) -> None:
    most = 0.7 * np.abs(tau[:, 1]).max()
    np.clip(tau[:, 1], -most, most, out=tau[:, 1])


def swap(a: int, b: int) -> Callable[[Array, np.random.Generator], None]:
    def change(x: Array, _rng: np.random.Generator) -> None:
        x[:, [a, b]] = x[:, [b, a]]

    return change


def both(fault: Fault, other: Fault) -> Fault:
    return lambda raw, rng, role: other(fault(raw, rng, role), rng, role)


def gains(*factors: float) -> Convention:
    return lambda q, tau: (q, tau * np.array([*factors, *[1.0] * (tau.shape[1] - len(factors))]))


def zero(*offsets: float) -> Convention:
    return lambda q, tau: (q + np.array([*offsets, *[0.0] * (q.shape[1] - len(offsets))]), tau)


def backlash(q: Array, tau: Array) -> tuple[Array, Array]:
    """Positions of the motors, by the play of the gears ahead of the links."""
    return q + 0.005 * np.tanh(tau), tau


def elastic(q: Array, tau: Array) -> tuple[Array, Array]:
    """Positions of the motors, whose gears the torque winds up (N m/rad)."""
    return q + tau / np.array([4000.0, 4000.0, *[1000.0] * (q.shape[1] - 2)]), tau


def geared(*factors: float) -> Convention:
    """Positions by another gear ratio than that of the joint."""
    return lambda q, tau: (q * np.array([*factors, *[1.0] * (q.shape[1] - len(factors))]), tau)


def saturating(q: Array, tau: Array) -> tuple[Array, Array]:
    """A motor of joint 2 whose torque the current shows less and less."""
    return q, np.column_stack([tau[:, 0], 60.0 * np.tanh(tau[:, 1] / 60.0), tau[:, 2:]])


def absolute(q: Array, tau: Array) -> tuple[Array, Array]:
    """The position of joint 3 against the base, as a parallel linkage has it."""
    return np.column_stack([q[:, :2], q[:, 1] + q[:, 2], q[:, 3:]]), tau


def differential(q: Array, tau: Array) -> tuple[Array, Array]:
    """The torque of joint 2 with that of joint 3, as the motor behind both has it."""
    return q, np.column_stack([tau[:, 0], tau[:, 1] + tau[:, 2], tau[:, 2:]])


def reversed_position(q: Array, tau: Array) -> tuple[Array, Array]:
    return q * np.array([1.0, -1.0, *[1.0] * (q.shape[1] - 2)]), tau


def time(change: Callable[[Array, np.random.Generator], Array]) -> Fault:
    return lambda raw, rng, _role: replace(raw, t=change(raw.t, rng))


def scaled(factor: float) -> Fault:
    return lambda raw, _rng, _role: replace(raw, q=raw.q * factor)


def late(*seconds: float) -> Fault:
    """Return torques that were stamped so late, by joint."""

    def fault(raw: Raw, _rng: np.random.Generator, _role: str) -> Raw:
        shifted = [np.interp(raw.t - by, raw.t, x) for by, x in zip(seconds, raw.tau.T, strict=True)]
        return replace(raw, tau=np.column_stack(shifted))

    return fault


def low_passed(channel: str, cutoff: float) -> Fault:
    """Return a channel (q, tau) after a causal low-pass of first order (Hz), as drives have it."""

    def fault(raw: Raw, _rng: np.random.Generator, _role: str) -> Raw:
        share = 1.0 - np.exp(-2 * np.pi * cutoff * float(raw.t[1] - raw.t[0]))
        x = getattr(raw, channel).copy()
        for k in range(1, len(x)):
            x[k] = x[k - 1] + share * (x[k] - x[k - 1])
        return replace(raw, **{channel: x})

    return fault


def commanded(raw: Raw, _rng: np.random.Generator, _role: str) -> Raw:
    """Positions as commanded, which the arm follows 20 ms later and with an error by its torque."""
    ahead = [np.interp(raw.t + 0.02, raw.t, x) for x in raw.q.T]
    return replace(raw, q=np.column_stack(ahead) + raw.tau / 6000.0)


def drifting(tau: Array, _rng: np.random.Generator) -> None:
    """The gain of joint 2 rises by 15 % over the log."""
    tau[:, 1] *= np.linspace(1.0, 1.15, len(tau))


def repeated_samples(raw: Raw, rng: np.random.Generator, _role: str) -> Raw:
    """A tenth of the samples is that before again, as a bus without new data gives it."""
    rows = np.arange(len(raw.t)) - (rng.random(len(raw.t)) < 0.1)
    rows[0] = 0
    return replace(raw, q=raw.q[rows], tau=raw.tau[rows])


def role_clock(factor: float, *roles: str) -> Fault:
    """Return stamps whose seconds are wrong in the logs of these roles."""
    return lambda raw, _rng, role: replace(raw, t=raw.t * factor) if role in roles else raw


def stale(raw: Raw, _rng: np.random.Generator, _role: str) -> Raw:
    """Positions at a quarter of the rate of the torques."""
    return replace(raw, q=raw.q[np.arange(len(raw.t)) // 4 * 4])


def stale_torque(raw: Raw, _rng: np.random.Generator, _role: str) -> Raw:
    return replace(raw, tau=raw.tau[np.arange(len(raw.t)) // 4 * 4])


def joined(raw: Raw, _rng: np.random.Generator, _role: str) -> Raw:
    """Two pieces one after the other, without the time between: the arm jumps."""
    keep = np.r_[rows(raw, 0.0, 0.4), rows(raw, 0.62, 1.0)]
    return Raw(raw.t[: len(keep)], raw.q[keep], raw.tau[keep])


def wrapped(raw: Raw, _rng: np.random.Generator, _role: str) -> Raw:
    q = raw.q.copy()
    q[:, 0] = (q[:, 0] + 3.0 + np.pi) % (2 * np.pi) - np.pi
    return replace(raw, q=q)


def noisy_fast(raw: Raw, rng: np.random.Generator, _role: str) -> Raw:
    speed = np.gradient(raw.q, raw.t, axis=0)
    return replace(raw, tau=raw.tau + 0.5 * np.abs(speed) * rng.standard_normal(raw.tau.shape))


def no_gravity(truth: Truth, robot: Robot, _role: str) -> Array:
    model, theta = robot.model()
    still = np.zeros_like(truth.q)
    held, offset = model.torque(truth.q, still, still, theta), theta[-len(robot.links) :]
    return -(held - offset)


def no_friction(truth: Truth, robot: Robot, _role: str) -> Array:
    return -(truth.dq * _each(robot, "viscous") + np.sign(truth.dq) * _each(robot, "coulomb"))


def _each(robot: Robot, name: str) -> Array:
    return np.array([getattr(x, name) for x in robot.friction[: len(robot.links)]])


def spring(truth: Truth, _robot: Robot, _role: str) -> Array:
    return np.asarray(truth.q * np.array([0.0, 40.0, *[0.0] * (truth.q.shape[1] - 2)]))


def tempered(truth: Truth, robot: Robot, role: str) -> Array:
    """Friction is 40 % higher in the second log, of a cold robot."""
    return 0.4 * (role == "second") * (truth.dq * _each(robot, "viscous") + np.sign(truth.dq) * _each(robot, "coulomb"))


def load_friction(truth: Truth, robot: Robot, _role: str) -> Array:
    return np.asarray(0.12 * np.abs(truth.tau) * np.sign(truth.dq) * (np.arange(len(robot.links)) > 0))


def stribeck(truth: Truth, robot: Robot, _role: str) -> Array:
    return np.asarray(1.5 * _each(robot, "coulomb") * np.exp(-((truth.dq / 0.15) ** 2)) * np.sign(truth.dq))


def compliance(truth: Truth, _robot: Robot, _role: str) -> Array:
    """A torsional resonance behind the gear, excited by the torque: what the motor's side sees of it."""
    step, rate, damping = truth.t[1] - truth.t[0], 2 * np.pi * 6.0, 0.02
    x = np.zeros((2, truth.q.shape[1]))
    seen = np.zeros_like(truth.tau)
    driven = np.gradient(truth.tau, truth.t, axis=0)
    for k, push in enumerate(driven):
        x[1] += step * (push - 2 * damping * rate * x[1] - rate**2 * x[0])
        x[0] += step * x[1]
        seen[k] = x[1]
    return np.asarray(0.5 * seen)


def warming(truth: Truth, robot: Robot, role: str) -> Array:
    """Friction falls by 40 % over the first log, and is low in all later ones."""
    share = truth.t / truth.t[-1] if role == "train" else np.ones_like(truth.t)
    friction = truth.dq * _each(robot, "viscous") + np.sign(truth.dq) * _each(robot, "coulomb")
    return np.asarray(-0.4 * share[:, None] * friction)


def ripple(truth: Truth, _robot: Robot, _role: str) -> Array:
    """Cogging of the motors, twelve times a turn."""
    return np.asarray(2.0 * np.sin(12 * truth.q))


def remounted(truth: Truth, robot: Robot, role: str) -> Array:
    """The base is tilted in the held-out log only."""
    (level, theta), (leaning, _) = robot.model(), tilted(robot).model()
    state = truth.q, truth.dq, truth.ddq
    moved = leaning.torque(*state, theta) - level.torque(*state, theta)
    return moved if role == "validation" else 0.0 * moved


def payload(*roles: str, mass: float = 2.0) -> Effect:
    """Return the torque of a mass (kg) at the last link in the logs of these roles."""

    def effect(truth: Truth, robot: Robot, role: str) -> Array:
        model, theta = robot.model()
        extra = np.zeros_like(theta)
        last = 10 * (len(robot.links) - 1)
        extra[last : last + 2] = mass, mass * 0.3
        extra[last + 7 : last + 10 : 2] = mass * 0.09
        return np.asarray(model.torque(truth.q, truth.dq, truth.ddq, extra) if role in roles else 0.0 * truth.tau)

    return effect


def without(name: str) -> Callable[[dict[str, Any]], dict[str, Any]]:
    terms = [x for x in ("rotor", "viscous", "coulomb", "offset") if x != name]
    return lambda config: config | {"model": {"file": config["model"], "terms": terms}}


def unit(group: str, name: str) -> Callable[[dict[str, Any]], dict[str, Any]]:
    def change(config: dict[str, Any]) -> dict[str, Any]:
        given = config[group]
        if group == "time":
            return config | {group: given | {"unit": name}}
        return config | {group: {joint: channel | {"unit": name} for joint, channel in given.items()}}

    return change


def longer(factor: float) -> Callable[[tuple[Link, ...]], tuple[Link, ...]]:
    return geometry(2, lambda link: replace(link, xyz=(link.xyz[0] * factor, *link.xyz[1:])))


def geometry(k: int, change: Callable[[Link], Link]) -> Callable[[tuple[Link, ...]], tuple[Link, ...]]:
    return lambda links: (*links[:k], change(links[k]), *links[k + 1 :])


def massless(links: tuple[Link, ...]) -> tuple[Link, ...]:
    return tuple(replace(link, mass=0.0, moments=(0.0, 0.0, 0.0)) for link in links)


def turned_round(text: str) -> str:
    """The elements of a URDF in the opposite order."""
    head, *rest, tail = text.strip().split("\n")
    return "\n".join([head.replace('<link name="base"/>', ""), *rest[::-1], '<link name="base"/>', tail])


def courses(**changes: Course) -> Callable[[Any], Any]:
    return lambda x: dict(x) | changes


def repeated(start: float) -> Fault:
    """Return a held-out log that repeats the training's motion, ``start`` s later, with noise of its own."""

    def fault(raw: Raw, _rng: np.random.Generator, role: str) -> Raw:
        cut = round(start / (raw.t[1] - raw.t[0]))
        return raw if role == "train" else Raw(raw.t[: len(raw.t) - cut], raw.q[cut:], raw.tau[cut:])

    return fault


def twice(config: dict[str, Any]) -> dict[str, Any]:
    return config | {"validation": [{"file": "train.csv", "name": "again"}]}


def in_two(config: dict[str, Any]) -> dict[str, Any]:
    """Two training logs."""
    return config | {"train": [{"file": "train.csv"}, {"file": "second.csv"}]}


def kept(config: dict[str, Any]) -> dict[str, Any]:
    return config | {"outliers": "keep"}


def simulated(config: dict[str, Any]) -> dict[str, Any]:
    return config | {"simulation": {"kind": "measured_torque"}}


def hung(robot: Robot) -> Robot:
    return replace(robot, gravity=(0.0, 0.0, 9.81))


def wall(robot: Robot) -> Robot:
    return replace(robot, gravity=(9.81, 0.0, 0.0))


def tilted(robot: Robot) -> Robot:
    angle = np.deg2rad(2.0)
    return replace(robot, gravity=(9.81 * np.sin(angle), 0.0, -9.81 * np.cos(angle)))


def tipped(link: Link) -> Link:
    angle = np.deg2rad(3.0)
    return replace(link, axis=(float(np.sin(angle)), float(np.cos(angle)), 0.0))
