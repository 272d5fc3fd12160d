"""What no data of one robot can show, so that no check and no held-out error tells that it is wrong."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from dynident.identification.result import Identification
from dynident.models import HasRobotFile

__all__ = ["CommonGain", "Unknown", "Zeros", "unknowns"]

STATES, TURN = 50, 0.3  # random states; rad or m by which a zero is moved
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


def unknowns(found: Identification) -> Iterator[Unknown]:
    """Yield what no data of this robot can show."""
    yield CommonGain()
    if joints := _zeros(found):
        yield Zeros(joints)


def _zeros(found: Identification) -> tuple[str, ...]:
    """Return the joints of a robot file for which other parameters give the torques with a zero that is moved."""
    model, rng = found.model, np.random.default_rng(0)
    if not any(isinstance(term, HasRobotFile) for term in model.terms):
        return ()
    n, p = len(model.joints), len(model.parameters)
    states = max(STATES, 2 * p // n)
    q, dq, ddq = rng.uniform(-1.0, 1.0, (3, states, n))
    none = np.zeros((states, model.memory))
    Y = model.regressor(q, dq, ddq, none).reshape(-1, p)
    scale = np.linalg.norm(Y, axis=0)
    basis, singular, _ = np.linalg.svd(Y / np.where(scale > 0, scale, 1.0), full_matrices=False)
    basis = basis[:, singular > SAME * singular[0]]
    moved = []
    for j, joint in enumerate(model.joints):
        tau = model.torque(q + TURN * np.eye(n)[j], dq, ddq, found.estimate.value, none).ravel()
        if np.linalg.norm(tau - basis @ (basis.T @ tau)) < SAME * np.linalg.norm(tau):
            moved.append(joint.name)
    return tuple(moved)
