"""Simulated robots, and their recordings as a user would have them: a folder with a URDF, CSV files and a YAML."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from dynident.models import Model, RigidBodies, RotorInertia
from dynident.models.friction import Coulomb, Offset, Viscous

Array = NDArray[np.float64]
DOWN = (0.0, 0.0, -9.81)
PERIOD, RATE = 10.0, 200.0  # s, Hz
NOISE_Q, NOISE_TAU = 2e-5, 0.02  # rad; share of the rms torque of the joint
HARMONICS = 5


@dataclass(frozen=True)
class Link:
    """A moving link: its body, and the joint that carries it, in the frame of the link before."""

    mass: float
    centre: tuple[float, float, float]
    moments: tuple[float, float, float]
    xyz: tuple[float, float, float]
    rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)
    axis: tuple[float, float, float] = (0.0, 1.0, 0.0)


@dataclass(frozen=True)
class Friction:
    """Friction and rotor inertia of a joint, and the constant torque."""

    rotor: float
    viscous: float
    coulomb: float
    offset: float


THREE = (
    Link(8.0, (0.02, 0.03, 0.10), (0.10, 0.10, 0.06), (0.0, 0.0, 0.3), axis=(0.0, 0.0, 1.0)),
    Link(6.0, (0.20, 0.02, 0.01), (0.02, 0.09, 0.09), (0.05, 0.08, 0.1)),
    Link(3.0, (0.15, -0.01, 0.02), (0.006, 0.03, 0.03), (0.40, -0.02, 0.0)),
)
QUARTER = np.pi / 2
SIX = (
    *THREE,
    Link(1.5, (0.0, 0.01, 0.04), (0.006, 0.006, 0.003), (0.32, 0.0, 0.05), (0.0, QUARTER, 0.0), (0.0, 0.0, 1.0)),
    Link(1.0, (0.01, 0.0, 0.03), (0.003, 0.004, 0.002), (0.0, 0.0, 0.1)),
    Link(0.6, (0.02, 0.01, 0.05), (0.0015, 0.002, 0.001), (0.0, 0.0, 0.1), axis=(0.0, 0.0, 1.0)),
)
FRICTION = (
    Friction(0.25, 3.0, 4.0, 0.3),
    Friction(0.20, 3.0, 4.0, -0.2),
    Friction(0.10, 1.5, 2.0, 0.1),
    Friction(0.03, 0.4, 0.6, 0.05),
    Friction(0.03, 0.4, 0.6, -0.05),
    Friction(0.02, 0.2, 0.4, 0.02),
)
ARMS: Mapping[str, tuple[Link, ...]] = {"three": THREE, "six": SIX}
NOMINAL = (1.1, 0.9, 1.08, 0.95, 1.1, 0.9)  # the user's masses over the true ones: a robot file is never exact


@dataclass(frozen=True)
class Truth:
    """A true motion and its true torque, (N, n) each."""

    t: Array
    q: Array
    dq: Array
    ddq: Array
    tau: Array


@dataclass(frozen=True)
class Raw:
    """What a log of one file shows, before it is written: times, positions and torques, of some joints."""

    t: Array
    q: Array
    tau: Array


Effect = Callable[[Truth, "Robot", str], Array]  # torque (N, n) added to the true one in a role's log
Fault = Callable[[Raw, np.random.Generator, str], Raw]  # what happens to a role's log
Convention = Callable[[Array, Array], tuple[Array, Array]]  # positions and torques as the user's system has them


@dataclass(frozen=True)
class Robot:
    """The true robot: its links, gravity and friction."""

    links: tuple[Link, ...]
    gravity: tuple[float, float, float] = DOWN
    friction: tuple[Friction, ...] = FRICTION

    def model(self) -> tuple[Model, Array]:
        """Return the model of the rigid bodies with friction, and its true parameters (p)."""
        bodies = RigidBodies(urdf(self.links), gravity=self.gravity)
        own = self.friction[: len(self.links)]
        kinds: list[tuple[Any, str]] = [(RotorInertia, "rotor"), (Viscous, "viscous"), (Coulomb, "coulomb")]
        terms = [kind(bodies.joints) for kind, _ in [*kinds, (Offset, "offset")]]
        model = Model((bodies, *terms))
        inertial = [parameter.value for parameter in bodies.parameters]
        values = [getattr(x, name) for _, name in [*kinds, (Offset, "offset")] for x in own]
        return model, np.array([*inertial, *values], dtype=float)


@dataclass(frozen=True)
class Course:
    """How a log moves: seed, speed over the usual, amplitude (rad) about a middle by joint, joints at rest."""

    seed: int
    speed: float = 1.0
    size: float = 0.9
    still: tuple[int, ...] = ()


def drawn(robot: Robot, nominal: tuple[float, ...], seed: int) -> tuple[Robot, tuple[float, ...]]:
    """Return another arm of that kind and other errors of its file, by a seed; seed 0 is the robot as it is."""
    if not seed:
        return robot, nominal
    rng = np.random.default_rng([11, seed])

    def like(x: Any, share: float) -> Any:
        return tuple(np.array(x) * rng.uniform(1.0 - share, 1.0 + share, np.shape(x)))

    links = []
    for link in robot.links:
        mass, size = rng.uniform(0.7, 1.4), rng.uniform(0.8, 1.25)
        moments = tuple(mass * size**2 * np.array(link.moments))
        centre, xyz = tuple(size * np.array(like(link.centre, 0.3))), like(link.xyz, 0.2)
        links.append(replace(link, mass=link.mass * mass, centre=centre, moments=moments, xyz=xyz))
    friction = tuple(Friction(*like((x.rotor, x.viscous, x.coulomb, x.offset), 0.4)) for x in robot.friction)
    errors = tuple(rng.uniform(0.88, 1.14, len(nominal)).tolist())
    return replace(robot, links=tuple(links), friction=friction), errors


PATHS: Mapping[str, Course] = {"train": Course(1), "validation": Course(2), "faster": Course(3, 2.0)}


@dataclass(frozen=True)
class Setup:
    """A user with a robot: what is true, what happens to the logs, and what the user's files say."""

    arm: str = "three"
    robot: Callable[[Robot], Robot] = lambda robot: robot
    effect: Effect | None = None
    paths: Callable[[Mapping[str, Course]], Mapping[str, Course]] = lambda paths: paths
    fault: Fault = lambda raw, _rng, _role: raw
    convention: Convention = lambda q, tau: (q, tau)
    links: Callable[[tuple[Link, ...]], tuple[Link, ...]] = lambda links: links
    text: Callable[[str], str] = lambda text: text
    config: Callable[[dict[str, Any]], dict[str, Any]] = lambda config: config


@dataclass(frozen=True)
class Built:
    """A project's configuration on disk, and the faster motion that nobody has seen, as truth and as the log has it."""

    config: Path
    q: Array
    dq: Array
    ddq: Array
    torque: Array
    seen: Array = field(repr=False)


def urdf(links: tuple[Link, ...]) -> str:
    """Write links as URDF text."""
    parts = ['<robot name="arm"><link name="base"/>']
    for k, case in enumerate(links, start=1):
        parent = "base" if k == 1 else f"link{k - 1}"
        x, y, z = case.moments
        effort, speed = (300, 8) if k <= 3 else (60, 12)
        parts.append(
            f'<link name="link{k}"><inertial><origin xyz="{_words(case.centre)}"/><mass value="{case.mass}"/>'
            f'<inertia ixx="{x}" iyy="{y}" izz="{z}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
            f'<joint name="joint{k}" type="revolute"><parent link="{parent}"/><child link="link{k}"/>'
            f'<origin xyz="{_words(case.xyz)}" rpy="{_words(case.rpy)}"/><axis xyz="{_words(case.axis)}"/>'
            f'<limit lower="-3.1" upper="3.1" effort="{effort}" velocity="{speed}"/></joint>'
        )
    return "\n".join([*parts, "</robot>\n"])


def moved(path: Course, n: int) -> tuple[Array, Array, Array, Array]:
    """Return times, and positions, velocities and accelerations (N, n) of a Fourier series."""
    rng = np.random.default_rng(path.seed)
    t = np.arange(round(PERIOD * RATE)) / RATE
    rate = 2 * np.pi / PERIOD * np.arange(1, HARMONICS + 1)[:, None, None] * path.speed
    phase, size = rng.uniform(0, 2 * np.pi, (HARMONICS, 1, n)), rng.uniform(0.3, 1.0, (HARMONICS, 1, n))
    size *= path.size / size.sum(axis=0) * 1.4
    size[:, :, list(path.still)] = 0.0
    angle = rate * t[:, None] + phase
    middle = np.array([0.2, 0.4, -0.6, 0.3, 0.5, -0.2])[:n]
    q = middle + (size * np.sin(angle)).sum(axis=0)
    return t, q, (size * rate * np.cos(angle)).sum(axis=0), -(size * rate**2 * np.sin(angle)).sum(axis=0)


def build(setup: Setup, folder: Path, estimator: str, seed: int = 0) -> Built:
    """Write a project into a folder, and return it with the motion that is kept from it.

    Another ``seed`` draws other bodies, friction, noise, paths and errors of the robot file.
    """
    arm, errors = drawn(Robot(ARMS[setup.arm]), NOMINAL, seed)
    robot = setup.robot(arm)
    model, theta = robot.model()
    n = len(robot.links)
    paths = {role: replace(path, seed=path.seed + 100 * seed) for role, path in setup.paths(PATHS).items()}
    truths = {role: _truth(setup, robot, model, theta, path, role) for role, path in paths.items()}
    for number, role in enumerate(path for path in paths if path != "faster"):
        rng = np.random.default_rng([7, number, *[seed] * bool(seed)])
        case = truths[role]
        q, tau = setup.convention(case.q, case.tau)
        size = np.sqrt(np.mean(case.tau**2, axis=0))
        noisy = tau + NOISE_TAU * size * rng.standard_normal(tau.shape)
        raw = Raw(case.t, q + NOISE_Q * rng.standard_normal(q.shape), noisy)
        _write(setup.fault(raw, rng, role), folder / f"{role}.csv")
    nominal = tuple(replace(link, mass=link.mass * by) for link, by in zip(arm.links, errors, strict=False))
    (folder / "arm.urdf").write_text(setup.text(urdf(setup.links(nominal))))
    config = setup.config(_config(n, estimator))
    (folder / "robot.yaml").write_text(yaml.safe_dump(config, sort_keys=False))
    fast = truths["faster"]
    q, seen = setup.convention(fast.q, fast.tau)
    step = 1e-4  # of the convention's positions over the true ones, which are linear
    slope = (setup.convention(fast.q + step, fast.tau)[0] - q) / step
    return Built(folder / "robot.yaml", q, fast.dq * slope, fast.ddq * slope, fast.tau, seen)


def _truth(setup: Setup, robot: Robot, model: Model, theta: Array, path: Course, role: str) -> Truth:
    t, q, dq, ddq = moved(path, len(robot.links))
    truth = Truth(t, q, dq, ddq, model.torque(q, dq, ddq, theta))
    return truth if setup.effect is None else replace(truth, tau=truth.tau + setup.effect(truth, robot, role))


def _config(n: int, estimator: str) -> dict[str, Any]:
    joints = [f"joint{k + 1}" for k in range(n)]
    return {
        "model": "arm.urdf",
        "time": {"column": "t", "unit": "s"},
        "position": {name: {"column": f"q{k + 1}", "unit": "rad"} for k, name in enumerate(joints)},
        "torque": {name: {"column": f"tau{k + 1}", "unit": "N m"} for k, name in enumerate(joints)},
        "train": [{"file": "train.csv"}],
        "validation": [{"file": "validation.csv"}],
        "estimator": {"kind": estimator},
    }


def _write(raw: Raw, file: Path) -> None:
    n = raw.q.shape[1]
    names = ["t", *(f"q{k + 1}" for k in range(n)), *(f"tau{k + 1}" for k in range(n))]
    table = np.column_stack([raw.t, raw.q, raw.tau])
    np.savetxt(file, table, delimiter=",", header=",".join(names), comments="", fmt="%.10g")


def _words(values: tuple[float, ...]) -> str:
    return " ".join(f"{x:.12g}" for x in values)
