"""Ten laws of friction, each written here anew, and simulated arms that have them: whose friction is known exactly.

A law is a sum of effects: coefficient times column, the column a small function of a joint's motion and load. The
torque of an arm is that of its bodies and rotors, the law's, an offset and noise. Times in s, positions in rad.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from situation_arm import FRICTION, NOMINAL, SIX, THREE, Link, urdf

from dynident.models import Model, RigidBodies, RotorInertia
from dynident.motion.log import Log

Array = NDArray[np.float64]
RATE, DURATION, HARMONICS = 200.0, 20.0, 10  # Hz, s, of the first harmonic, whose period is the log's length
BEFORE, DENSE = 2.0, 10  # s that the arm has moved before the log begins; steps of the path between two samples
NOISE_Q, ENCODER = 1e-5, 2 * np.pi / 2**18  # rad
REACH = 0.9  # rad
SEVEN = (*SIX, Link(0.4, (0.01, 0.02, 0.03), (0.0008, 0.0009, 0.0006), (0.0, 0.0, 0.08)))
ARMS: Mapping[str, tuple[Link, ...]] = {"three": THREE, "six": SIX, "seven": SEVEN}
PLAIN = ("viscous", "coulomb")


@dataclass(frozen=True)
class Shape:
    """The constants of a joint's friction: widths (rad/s), the length of presliding (rad), cycles per rad, a time."""

    width: float = 0.02
    stribeck: float = 0.15
    length: float = 0.01
    cycles: float = 10.0
    slow: float = 8.0  # s


@dataclass(frozen=True, eq=False)
class Moved:
    """What friction depends on: time, position, velocity and the torque of the bodies at a joint, (N) each."""

    t: Array
    q: Array
    dq: Array
    load: Array


def viscous(moved: Moved, _: Shape) -> Array:
    return moved.dq


def coulomb(moved: Moved, shape: Shape) -> Array:
    return np.tanh(moved.dq / shape.width)


def stribeck(moved: Moved, shape: Shape) -> Array:
    return np.tanh(moved.dq / shape.width) * np.exp(-((moved.dq / shape.stribeck) ** 2))


def power(moved: Moved, _: Shape) -> Array:
    return np.sign(moved.dq) * np.sqrt(np.abs(moved.dq))


def load_coulomb(moved: Moved, shape: Shape) -> Array:
    return np.abs(moved.load) * np.tanh(moved.dq / shape.width)


def dahl(moved: Moved, shape: Shape) -> Array:
    """dz/dq = sign(dq) - z / length (Dahl 1968 with exponent 1), solved exactly from one sample of the path on."""
    z, path = np.zeros(len(moved.q)), np.diff(moved.q) / shape.length
    for k, step in enumerate(path):
        end = np.sign(step)
        z[k + 1] = end + (z[k] - end) * np.exp(-abs(step))
    return z


def load_dahl(moved: Moved, shape: Shape) -> Array:
    return np.abs(moved.load) * dahl(moved, shape)


def ripple(moved: Moved, shape: Shape) -> Array:
    return np.asarray(np.sin(2 * np.pi * shape.cycles * moved.q + 0.7))


def asymmetric_coulomb(moved: Moved, shape: Shape) -> Array:
    return np.asarray(np.tanh(moved.dq / shape.width) ** 2)


def asymmetric_viscous(moved: Moved, _: Shape) -> Array:
    return np.abs(moved.dq)


def drift(moved: Moved, shape: Shape) -> Array:
    return np.asarray(1.0 - np.exp(-(moved.t - moved.t[0]) / shape.slow))


COLUMNS: Mapping[str, Callable[[Moved, Shape], Array]] = {
    x.__name__: x
    for x in (
        viscous, coulomb, stribeck, power, load_coulomb, dahl, load_dahl, ripple, asymmetric_coulomb,
        asymmetric_viscous, drift,
    )
}  # fmt: skip
# the kind of each effect and its rms over the rms torque of the joint; the first apply to all joints, the rest to some
LAWS: Mapping[str, tuple[Mapping[str, float], Mapping[str, float]]] = {
    "none": ({}, {}),
    "viscous": ({"viscous": 0.15}, {}),
    "coulomb": ({"viscous": 0.15, "coulomb": 0.2}, {}),
    "stribeck": ({"viscous": 0.15, "coulomb": 0.15}, {"stribeck": 0.1}),
    "load": ({"viscous": 0.1, "coulomb": 0.1}, {"load_coulomb": 0.12}),
    "dahl": ({"viscous": 0.1}, {"dahl": 0.2}),
    "load dahl": ({"viscous": 0.1}, {"load_dahl": 0.15}),
    "ripple": ({"viscous": 0.1, "coulomb": 0.15}, {"ripple": 0.04}),
    "asymmetric": ({"viscous": 0.1, "coulomb": 0.15}, {"asymmetric_viscous": 0.06, "drift": 0.05}),
    "power": ({"coulomb": 0.1}, {"power": 0.2}),
    "all": ({"viscous": 0.1}, {"load_coulomb": 0.1, "dahl": 0.15, "ripple": 0.04, "asymmetric_viscous": 0.05}),
}
COULOMB = {"dahl": 0.2, "load dahl": 0.15}  # of joints without presliding, in laws whose other joints have it


@dataclass(frozen=True)
class Effect:
    """One effect at one joint: its kind, coefficient and constants."""

    joint: int
    kind: str
    coefficient: float
    shape: Shape

    def column(self, moved: Moved) -> Array:
        return COLUMNS[self.kind](moved, self.shape)


@dataclass(frozen=True, eq=False)
class Course:
    """A true motion on the dense path, of which every ``DENSE``-th sample from ``first`` on is logged, and its load."""

    t: Array
    q: Array
    dq: Array
    ddq: Array
    first: int

    @property
    def logged(self) -> slice:
        return slice(self.first, None, DENSE)


@dataclass(frozen=True, eq=False)
class Arm:
    """A true arm: rigid bodies and rotors with their parameters, and its friction. The user has another robot file."""

    links: tuple[Link, ...]
    effects: tuple[Effect, ...]
    seed: int

    @cached_property
    def model(self) -> Model:
        bodies = RigidBodies(urdf(self.links))
        return Model((bodies, RotorInertia(bodies.joints)))

    @cached_property
    def bodies(self) -> Array:
        return np.array([parameter.value for parameter in self.model.terms[0].parameters], dtype=float)

    @cached_property
    def theta(self) -> Array:
        rotors = [(*FRICTION, FRICTION[-1])[k].rotor for k in range(len(self.links))]
        return np.array([*self.bodies, *rotors])

    @property
    def file(self) -> str:
        """The robot file that the user has: masses are a tenth off."""
        factors = (*NOMINAL, 1.08)
        return urdf(tuple(replace(link, mass=link.mass * by) for link, by in zip(self.links, factors, strict=False)))

    def load(self, course: Course) -> Array:
        """Torque of the bodies alone (N, n)."""
        return np.asarray(self.model.terms[0].regressor(course.q, course.dq, course.ddq) @ self.bodies)

    def torque(self, course: Course) -> Array:
        """The true torque at the logged samples (M, n)."""
        at, load = course.logged, self.load(course)
        tau = self.model.torque(course.q[at], course.dq[at], course.ddq[at], self.theta)
        for effect in self.effects:
            tau[:, effect.joint] += effect.coefficient * effect.column(_of(course, load, effect.joint))[at]
        return np.asarray(tau + 0.02 * np.sqrt(np.mean(tau**2, axis=0)))  # with an offset

    def record(self, course: Course, noise: float, rng: np.random.Generator, source: str) -> Log:
        """The log of a motion: ``noise`` of the torque over its rms by joint, encoders with noise and steps."""
        at, tau = course.logged, self.torque(course)
        q = course.q[at] + NOISE_Q * rng.standard_normal(tau.shape)
        tau = tau + noise * np.sqrt(np.mean(tau**2, axis=0)) * rng.standard_normal(tau.shape)
        joints = tuple(joint.name for joint in self.model.joints)
        return Log(course.t[at], ENCODER * np.round(q / ENCODER), tau, joints, source)


def _of(course: Course, load: Array, joint: int) -> Moved:
    return Moved(course.t, course.q[:, joint], course.dq[:, joint], load[:, joint])


def course(n: int, rng: np.random.Generator, speed: float = 1.0, duration: float = DURATION) -> Course:
    """A Fourier series whose period is the duration: none of it is repeated."""
    t = np.arange(-round(BEFORE * RATE * DENSE), round(duration * RATE) * DENSE) / (RATE * DENSE)
    rate = 2 * np.pi / DURATION * speed * np.arange(1, HARMONICS + 1)[:, None, None]
    phase = rng.uniform(0, 2 * np.pi, (HARMONICS, 1, n))
    size = rng.uniform(0.2, 1.0, (HARMONICS, 1, n)) / np.arange(1, HARMONICS + 1)[:, None, None] ** 0.5
    size *= 1.4 * REACH / size.sum(axis=0)
    angle = rate * t[:, None] + phase
    q = rng.uniform(-0.6, 0.6, n) + (size * np.sin(angle)).sum(axis=0)
    dq, ddq = (size * rate * np.cos(angle)).sum(axis=0), -(size * rate**2 * np.sin(angle)).sum(axis=0)
    return Course(t - t[round(BEFORE * RATE * DENSE)], q, dq, ddq, round(BEFORE * RATE * DENSE))


def arm(name: str, law: str, motion: Course, seed: int) -> Arm:
    """An arm with a law of friction, of the usual size on a motion; special effects act on every other joint."""
    links, rng = ARMS[name], np.random.default_rng([11, seed])
    plain = Arm(links, (), seed)
    load, (everywhere, some) = plain.load(motion), LAWS[law]
    effects = []
    for joint in range(len(links)):
        moved = _of(motion, load, joint)
        rms, speed = np.sqrt(np.mean(load[:, joint] ** 2)), np.sqrt(np.mean(moved.dq**2))
        shape = Shape(
            width=float(0.03 * speed * rng.uniform(0.7, 1.4)),
            stribeck=float(0.3 * speed * rng.uniform(0.7, 1.4)),
            length=float(0.008 * rng.uniform(0.5, 2.0)),
            cycles=float(rng.integers(6, 16)),
        )
        special = some if (joint + seed) % 2 == 0 else {"coulomb": COULOMB[law]} if law in COULOMB else {}
        for kind, share in {**everywhere, **special}.items():
            size = np.sqrt(np.mean(COLUMNS[kind](moved, shape) ** 2))
            effects.append(Effect(joint, kind, float(share * rng.uniform(0.8, 1.2) * rms / size), shape))
    return replace(plain, effects=tuple(effects))


def needed(case: Arm, motion: Course, noise: float) -> dict[tuple[int, str], float]:
    """Share of a joint's squared error, least squares on the true motion with noise, that each effect takes away."""
    at, load = motion.logged, case.load(motion)
    regressor, tau = case.model.regressor(motion.q[at], motion.dq[at], motion.ddq[at]), case.torque(motion)
    result = {}
    for joint in range(len(case.links)):
        own = [effect for effect in case.effects if effect.joint == joint]
        columns = [effect.column(_of(motion, load, joint))[at] for effect in own]
        white = noise**2 * np.mean(tau[:, joint] ** 2)
        for k, effect in enumerate(own):
            others = [column for i, column in enumerate(columns) if i != k]
            every = np.column_stack([regressor[:, joint], np.ones(len(tau)), *others])
            left = columns[k] - every @ np.linalg.lstsq(every, columns[k], rcond=1e-9)[0]
            lost = effect.coefficient**2 * np.mean(left**2)
            result[joint, effect.kind] = float(lost / (lost + white))
    return result
