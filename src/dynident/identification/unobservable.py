"""The errors of a model that no data of one robot can show."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from dynident.identification.result import Identification
from dynident.runtime import Statement, TaggedUnion

MIN_STATES, ZERO_SHIFT = 50, 0.3  # random states; rad or m by which a zero is moved
MOTION_SCALE = 1.3  # times a motion
MAX_TORQUE_DIFFERENCE = 1e-6  # relative difference of torques below which other parameters give the same ones


class Unobservable(Statement, TaggedUnion):
    """Base of the errors that no data of one robot can show."""


class CommonGain(Unobservable):
    """A factor that all torques share: masses, inertias and friction take it up.

    A known total mass does not show it: the bodies that the torque shows grow, those at the base shrink.
    """

    def __str__(self) -> str:
        return "a wrong gain that is common to all torques (masses and friction absorb it)"


class Zeros(Unobservable):
    """The zeros of these ``joints``, which no torque depends on, or which the parameters take up."""

    joints: tuple[str, ...]

    def __str__(self) -> str:
        return f"a wrong zero of {', '.join(self.joints)}"


class MotionRatios(Unobservable):
    """The gear ratios, leads or units of the positions of these ``joints``, which the parameters take up."""

    joints: tuple[str, ...]

    def __str__(self) -> str:
        return f"a wrong gear ratio, lead or unit of the position of {', '.join(self.joints)}"


class DriveFriction(Unobservable):
    """Friction of the drives, of which the torques show almost none."""

    def __str__(self) -> str:
        return "friction of the drives, which torques that are computed or measured behind the gears do not have"


FRICTION_TOPIC = "friction"  # of a finding that the torques show none


def unknowns(identification: Identification) -> Iterator[Unobservable]:
    """Yield the errors that no data of this robot can show."""
    yield CommonGain()
    if any(finding.message.topic == FRICTION_TOPIC for finding in identification.findings):
        yield DriveFriction()
    if not any(term.file is not None for term in identification.model.terms):
        return
    zeros, ratios = _absorbed_changes(identification)
    if zeros:
        yield Zeros(zeros)
    if ratios:
        yield MotionRatios(ratios)


def _absorbed_changes(identification: Identification) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the joints in which parameters absorb a shifted zero, and those with a scaled motion.

    Shapes of friction absorb the scale of a motion themselves, so that only the torque of the bodies is compared.
    """
    model, rng = identification.model, np.random.default_rng(0)
    n, p = len(model.joints), len(model.parameters)
    states = max(MIN_STATES, 2 * p // n)
    q, dq, ddq = rng.uniform(-1.0, 1.0, (3, states, n))
    no_memory = np.zeros((states, model.memory))
    Y = model.regressor(q, dq, ddq, no_memory).reshape(-1, p)
    scale = np.linalg.norm(Y, axis=0)
    # An orthonormal basis of all torques that any parameters can make in these states.
    basis, singular, _ = np.linalg.svd(Y / np.where(scale > 0, scale, 1.0), full_matrices=False)
    basis = basis[:, singular > MAX_TORQUE_DIFFERENCE * singular[0]]

    def is_absorbed(tau: NDArray[np.float64]) -> bool:
        return bool(np.linalg.norm(tau - basis @ (basis.T @ tau)) < MAX_TORQUE_DIFFERENCE * np.linalg.norm(tau))

    value, bodies = identification.estimate.value, np.zeros(p)
    is_body = np.isin(model.names, model.bodies.names)
    bodies[is_body] = value[is_body]
    zeros, ratios = list[str](), list[str]()
    for joint, unit in zip(model.joints, np.eye(n), strict=True):
        # One joint at a time; a change is invisible where its torque stays in the span of the regressor.
        scale_by_joint = 1.0 + (MOTION_SCALE - 1.0) * unit
        if is_absorbed(model.torque(q + ZERO_SHIFT * unit, dq, ddq, value, no_memory).ravel()):
            zeros.append(joint.name)
        if is_absorbed(
            model.torque(scale_by_joint * q, scale_by_joint * dq, scale_by_joint * ddq, bodies, no_memory).ravel()
        ):
            ratios.append(joint.name)
    return tuple(zeros), tuple(ratios)
