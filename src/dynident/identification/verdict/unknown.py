"""What no data of one robot can show, so that no check and no held-out error tells that it is wrong."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.identification.result import Identification
from dynident.models import HasRobotFile

__all__ = ["CommonGain", "Ratios", "Unknown", "Zeros", "unknowns"]

STATES, TURN = 50, 0.3  # random states; rad or m by which a zero is moved
RATIO = 1.3  # times a motion
SAME = 1e-6  # relative difference of torques below which other parameters give the same ones


@dataclass(frozen=True)
class Unknown:
    """Base of what no data can show."""


@dataclass(frozen=True)
class CommonGain(Unknown):
    """A factor that all torques share: masses, inertias and friction take it up.

    A known total mass does not show it: the bodies that the torque shows grow, those at the base shrink.
    """


@dataclass(frozen=True)
class Zeros(Unknown):
    """The zeros of these ``joints``, which no torque depends on, or which the parameters take up."""

    joints: tuple[str, ...]


@dataclass(frozen=True)
class Ratios(Unknown):
    """The gear ratios, leads or units of the positions of these ``joints``, which the parameters take up."""

    joints: tuple[str, ...]


def unknowns(found: Identification) -> Iterator[Unknown]:
    """Yield what no data of this robot can show."""
    yield CommonGain()
    if not any(isinstance(term, HasRobotFile) for term in found.model.terms):
        return
    zeros, ratios = _taken_up(found)
    if zeros:
        yield Zeros(zeros)
    if ratios:
        yield Ratios(ratios)


def _taken_up(found: Identification) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the joints for which other parameters give the torques where a zero is moved, or a motion is larger.

    The shapes of friction take up the size of a motion: of it the bodies' torque is looked at.
    """
    model, rng = found.model, np.random.default_rng(0)
    n, p = len(model.joints), len(model.parameters)
    states = max(STATES, 2 * p // n)
    q, dq, ddq = rng.uniform(-1.0, 1.0, (3, states, n))
    none = np.zeros((states, model.memory))
    Y = model.regressor(q, dq, ddq, none).reshape(-1, p)
    scale = np.linalg.norm(Y, axis=0)
    basis, singular, _ = np.linalg.svd(Y / np.where(scale > 0, scale, 1.0), full_matrices=False)
    basis = basis[:, singular > SAME * singular[0]]

    def taken_up(tau: NDArray[np.float64]) -> bool:
        return bool(np.linalg.norm(tau - basis @ (basis.T @ tau)) < SAME * np.linalg.norm(tau))

    value, bodies = found.estimate.value, np.zeros(p)
    own = np.isin(model.names, model.bodies.names)
    bodies[own] = value[own]
    zeros, ratios = list[str](), list[str]()
    for joint, unit in zip(model.joints, np.eye(n), strict=True):
        size = 1.0 + (RATIO - 1.0) * unit
        if taken_up(model.torque(q + TURN * unit, dq, ddq, value, none).ravel()):
            zeros.append(joint.name)
        if taken_up(model.torque(size * q, size * dq, size * ddq, bodies, none).ravel()):
            ratios.append(joint.name)
    return tuple(zeros), tuple(ratios)
