"""Sign and scale of the measured torque against the torque of the robot file's inertias, reported as questions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.checks import notes
from dynident.checks.finding import Finding, Topic
from dynident.errors import Severity
from dynident.log import Motion, subsample
from dynident.models import INERTIAL, Model

__all__ = ["Agreement", "agreement", "agreement_findings", "nominal", "nuisance", "thinned"]

Array = NDArray[np.float64]

SAMPLES = 2000  # of all motions: enough to see a sign
NONE, ASKED = (
    0.3,
    2.0,
)  # |correlation| below NONE counts as none, where the nominal torque is over ASKED times the measured one
CLEAR = 0.6  # partial correlation from which a sign is trusted
SCALE = 3.0  # factor from which a scale is questioned, where the correlation is beyond STRONG
STRONG = 0.85
ALONE = 1e-3  # share of the nominal torque that rotor and friction cannot explain, below which nothing is compared
DRIVES = 0.2  # share of rms torque times rms speed by which friction must drive the joint, to count


@dataclass(frozen=True)
class Agreement:
    """The measured torque of one joint against the nominal one; ``scale`` times the nominal torque fits best.

    ``scale`` and ``correlation`` (partial) are taken with friction, rotor inertia and offset projected out; both are
    nan where the file has no inertias. ``rotor`` (kg m^2 or kg) and ``friction``, the share of the power dissipated by
    friction, are those of a fit of this joint alone. ``asked`` is the rms of the nominal over the measured torque.
    """

    joint: str
    scale: float
    correlation: float
    rotor: float
    friction: float
    asked: float = float("nan")


def agreement(model: Model, motions: Sequence[Motion]) -> tuple[Agreement, ...]:
    """Return for each joint of the model how its measured torque agrees with the nominal one."""
    q, dq, ddq, tau = thinned(motions)
    asked_for = nominal(model, q, dq, ddq)
    asked_for = np.zeros_like(q) if asked_for is None else asked_for
    found = []
    for j, joint in enumerate(model.joints):
        around = (np.sin(q[:, j]), np.cos(q[:, j])) if joint.kind == "revolute" else ()
        columns = nuisance(q, dq, ddq, j)
        known = np.ptp(asked_for[:, j]) > 0
        own = np.linalg.lstsq(np.column_stack([columns, *around]), tau[:, j])[0]
        lost = own[1] * np.mean(dq[:, j] ** 2) + own[2] * np.mean(columns[:, 2] * dq[:, j])
        power = _speed(dq, j) * max(float(np.sqrt(np.mean(tau[:, j] ** 2))), 1e-300)
        compared = _partial(asked_for[:, j], tau[:, j], columns) if known else (np.nan,) * 3
        scale, correlation, asked = map(float, compared)
        found.append(Agreement(joint.name, scale, correlation, float(own[0]), float(lost / power), asked))
    return tuple(found)


def _speed(dq: Array, joint: int) -> float:
    """Return the rms speed of a joint."""
    return max(float(np.sqrt(np.mean(dq[:, joint] ** 2))), 1e-12)


def nuisance(q: Array, dq: Array, ddq: Array, joint: int) -> Array:
    """Return the regressor columns (M, 4) of rotor inertia, viscous and Coulomb friction, and offset of a joint."""
    sign = np.tanh(dq[:, joint] / (0.05 * _speed(dq, joint)))
    return np.column_stack([ddq[:, joint], dq[:, joint], sign, np.ones(len(q))])


def thinned(motions: Sequence[Motion]) -> tuple[Array, ...]:
    """Return q, dq, ddq, tau (M, n) of a few thousand usable samples of all motions."""
    pairs = list(zip(motions, subsample(motions, SAMPLES), strict=True))
    return tuple(
        np.concatenate([getattr(motion, name)[rows] for motion, rows in pairs]) for name in ("q", "dq", "ddq", "tau")
    )


def nominal(model: Model, q: Array, dq: Array, ddq: Array) -> Array | None:
    """Return the torque (M, n) of the inertias that the robot file gives, None where it does not give all of them."""
    values = [parameter.value if parameter.role in INERTIAL else 0.0 for parameter in model.parameters]
    if any(value is None for value in values):
        return None
    return model.torque(q, dq, ddq, np.array(values, dtype=float), np.zeros((len(q), model.memory)))


def _partial(x: Array, y: Array, others: Array) -> tuple[float, float, float]:
    """Return slope, correlation and relative size of x against y, with the other columns projected out of both."""
    left, rest = (series - others @ np.linalg.lstsq(others, series)[0] for series in (x, y))
    a, b = float(np.linalg.norm(left)), float(np.linalg.norm(rest))
    if a < ALONE * float(np.linalg.norm(x)) or b == 0:
        return (float("nan"),) * 3
    inner = float(left @ rest)
    return inner / a**2, inner / (a * b), a / b


def agreement_findings(found: Agreement, unit: str) -> Iterator[Finding]:
    """Yield a question where the sign or scale of a torque looks wrong; ``unit`` is that of the torque."""
    against = not found.correlation > 0 and found.rotor < 0 and found.friction < -DRIVES
    if found.correlation < -CLEAR or against:
        sign = notes.ReversedSign(None if against else found.correlation)
        yield Finding(Severity.WARNING, found.joint, sign, Topic.SIGN)
    elif found.correlation > STRONG and not 1 / SCALE < found.scale < SCALE:
        yield Finding(Severity.WARNING, found.joint, notes.OddScale(found.scale, unit), Topic.SCALE)
    elif abs(found.correlation) < NONE and found.asked > ASKED:
        foreign = notes.UnrelatedTorque(found.asked, found.correlation)
        yield Finding(Severity.WARNING, found.joint, foreign, Topic.FOREIGN)
