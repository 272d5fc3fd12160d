"""A toy whose answer is known: bodies welded together, moved freely, with the wrench or its moment alone measured."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.estimators import Problem
from dynident.models import INERTIAL, Joint, Model, Parameter, Partials, Term, change_frame, from_pseudo
from dynident.motion.log import Motion
from dynident.regression import Regression

Array = NDArray[np.float64]
UNITS = ("kg", *["kg m"] * 3, *["kg m^2"] * 6)


def cross(v: Array) -> Array:
    """The matrices (..., 3, 3) of the cross product v x."""
    out = np.zeros((*v.shape[:-1], 3, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        out[..., i, j], out[..., j, i] = -v[..., k], v[..., k]
    return out


def tensor(v: Array) -> Array:
    """The matrices (..., 3, 6) that take (Ixx, Ixy, Iyy, Ixz, Iyz, Izz) to I v."""
    x, y, z = np.moveaxis(v, -1, 0)
    o = np.zeros_like(x)
    rows = np.array([[x, y, o, z, o, o], [o, x, y, o, z, o], [o, o, o, x, y, z]])
    return np.moveaxis(rows, (0, 1), (-2, -1))


def wrench(a: Array, w: Array, alpha: Array) -> Array:
    """Regressor (N, 6, 10) of force and moment for the acceleration a less gravity, rate w and its derivative alpha."""
    out = np.zeros((len(a), 6, 10))
    out[:, :3, 0] = a
    out[:, :3, 1:4] = cross(alpha) + cross(w) @ cross(w)
    out[:, 3:, 1:4] = -cross(a)
    out[:, 3:, 4:] = tensor(alpha) + cross(w) @ tensor(w)
    return out


def cloud(points: Array, masses: Array) -> Array:
    """Parameters (10) of point masses at points (k, 3)."""
    reach = np.column_stack((points, np.ones(len(points))))
    return from_pseudo((reach * masses[:, None]).T @ reach)


def random_body(rng: np.random.Generator, size: float = 0.1, mass: float = 2.0) -> Array:
    """Parameters (10) of eight random point masses."""
    return cloud(size * rng.normal(size=(8, 3)) + size * rng.normal(size=3), mass * rng.dirichlet(np.ones(8)))


def turned(rng: np.random.Generator, reach: float = 0.2) -> Array:
    """A random rigid displacement (4, 4)."""
    X = np.eye(4)
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    X[:3, :3], X[:3, 3] = q * np.sign(np.linalg.det(q)), reach * rng.normal(size=3)
    return X


@dataclass(frozen=True, eq=False)
class Welded(Term):
    """Rigid bodies at ``frames`` (4, 4) in the moving frame; q holds the acceleration, dq and ddq the rates."""

    frames: tuple[Array, ...]
    values: tuple[Array | None, ...]
    moments_only: bool = False

    @property
    def joints(self) -> tuple[Joint, ...]:
        force = [Joint(f"f{axis}", "prismatic") for axis in "xyz"]
        return (*([] if self.moments_only else force), *(Joint(f"n{axis}") for axis in "xyz"))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        out = []
        for b, values in enumerate(self.values, start=1):
            nominal: Sequence[float | None] = [None] * 10 if values is None else list(map(float, values))
            for role, unit, value in zip(INERTIAL, UNITS, nominal, strict=True):
                out.append(Parameter(f"b{b}.{role}", unit, "", value, role, f"b{b}"))
        return tuple(out)

    def regressor(self, q: Array, dq: Array, ddq: Array) -> Array:
        Y = wrench(q[:, -3:], dq[:, -3:], ddq[:, -3:])[:, 3 if self.moments_only else 0 :]
        return np.concatenate([Y @ change_frame(np.eye(10), X).T for X in self.frames], axis=2)

    def partials(self, q: Array, dq: Array, ddq: Array, theta: Array) -> Partials:
        raise NotImplementedError


@dataclass(frozen=True, eq=False)
class Drag(Term):
    """One effect per joint: friction in proportion to dq or to its sign, or a rotor in proportion to ddq."""

    joints: tuple[Joint, ...]
    role: str
    on: int = 0
    value: float | None = None

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (Parameter(f"{self.role}_{self.joints[self.on].name}", "SI", "", self.value, self.role),)

    def regressor(self, q: Array, dq: Array, ddq: Array) -> Array:
        out = np.zeros((*q.shape, 1))
        shape = {"viscous": dq, "coulomb": np.sign(dq), "rotor": ddq}[self.role]
        out[:, self.on, 0] = shape[:, self.on]
        return out

    def partials(self, q: Array, dq: Array, ddq: Array, theta: Array) -> Partials:
        raise NotImplementedError


def single(value: Array | None = None, *drags: tuple[str, int], moments_only: bool = False) -> Model:
    """One body, with further effects (role, joint)."""
    body = Welded((np.eye(4),), (value,), moments_only)
    extra: list[Term] = [Drag(body.joints, role, on) for role, on in drags]
    return Model((body, *extra))


def problem(
    model: Model,
    truth: Array,
    noise: float = 0.0,
    seed: int = 0,
    samples: int = 200,
    spread: Sequence[float] = (1,) * 9,
) -> Problem:
    """Random states; ``spread`` scales acceleration, rates and their derivatives along x, y, z."""
    rng, n = np.random.default_rng(seed), len(model.joints)
    q, dq, ddq = rng.normal(size=(3, samples, n)) * np.array([5.0, 2.0, 10.0])[:, None, None]
    for k, state in enumerate((q, dq, ddq)):
        state[:, -3:] *= np.asarray(spread, dtype=float)[3 * k : 3 * k + 3]
    tau = model.torque(q, dq, ddq, truth) + noise * rng.normal(size=(samples, n))
    names = tuple(joint.name for joint in model.joints)
    motion = Motion(np.linspace(0, 1, samples), q, dq, ddq, tau, names, np.ones(samples, dtype=bool), f"run {seed}")
    return Problem(model, (motion,), Regression(model, (motion,)))


def pair(*values: Array | None, seed: int = 3) -> tuple[Model, Array]:
    """Two bodies welded together, of which data determine only the sum, and the placement of the second."""
    X = turned(np.random.default_rng(seed))
    return Model((Welded((np.eye(4), X), (*values, None, None)[:2]),)), X
