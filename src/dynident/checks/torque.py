"""Does the torque go with the motion? Its sign and scale against the robot file's inertias, asked as questions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.checks.finding import Finding, Topic
from dynident.errors import Severity
from dynident.log import Motion, subsample
from dynident.models import INERTIAL, Model

__all__ = ["Agreement", "agreement", "agreement_findings", "nominal", "nuisance", "thinned"]

Array = NDArray[np.float64]

SAMPLES = 2000  # of all motions: enough to see a sign
NONE, ASKED = 0.3, 2.0  # a correlation below NONE is none, where the file asks for ASKED times the torque that is there
CLEAR = 0.6  # partial correlation from which on a sign is believed
SCALE = 3.0  # factor from which on a scale is asked about, where the correlation is beyond STRONG
STRONG = 0.85
ALONE = 1e-3  # share of the nominal torque that rotor and friction cannot explain, below which nothing is compared
DRIVES = 0.2  # share of rms torque times rms speed by which friction must drive the joint, to be believed


@dataclass(frozen=True)
class Agreement:
    """The torque of one joint against the nominal one: ``scale`` times it fits best, beside friction and a rotor.

    ``correlation`` is the partial one, without what friction, rotor and offset explain; both are nan where the file
    has no inertias. ``rotor`` (kg m^2 or kg) and ``friction``, the share of the power that is lost to friction, are
    those of a fit of this joint on its own. ``asked`` is the rms of the nominal torque over that of the measured one.
    """

    joint: str
    scale: float
    correlation: float
    rotor: float
    friction: float
    asked: float = float("nan")


def agreement(model: Model, motions: Sequence[Motion]) -> tuple[Agreement, ...]:
    """Return for each joint of the model how its measured torque goes with the motion."""
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
    """Return the columns (M, 4) of what a joint has beside its bodies: rotor, viscous and Coulomb friction, offset."""
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
    return model.torque(q, dq, ddq, np.array(values, dtype=float))


def _partial(x: Array, y: Array, others: Array) -> tuple[float, float, float]:
    """Return slope, correlation and relative size of x against y, without what the other columns explain of each."""
    left, rest = (series - others @ np.linalg.lstsq(others, series)[0] for series in (x, y))
    a, b = float(np.linalg.norm(left)), float(np.linalg.norm(rest))
    if a < ALONE * float(np.linalg.norm(x)) or b == 0:
        return (float("nan"),) * 3
    inner = float(left @ rest)
    return inner / a**2, inner / (a * b), a / b


def agreement_findings(found: Agreement, unit: str) -> Iterator[Finding]:
    """Yield a question where sign or scale of a torque look wrong; ``unit`` is that of the torque."""
    against = not found.correlation > 0 and found.rotor < 0 and found.friction < -DRIVES
    if found.correlation < -CLEAR or against:
        why = f"it goes against the torque of the robot file's inertias (correlation {found.correlation:.2f})"
        if against:
            why = "friction and inertia of the joint come out negative"
        yield Finding(
            Severity.WARNING,
            found.joint,
            f"is the sign of the torque turned? By the motion, {why}. Look at the signs of `gain` and "
            "`transmission`, and whether position and torque count the same way round.",
            Topic.SIGN,
        )
    elif found.correlation > STRONG and not 1 / SCALE < found.scale < SCALE:
        yield Finding(
            Severity.WARNING,
            found.joint,
            f"the torque is {found.scale:.3g} times what the robot file's inertias ask for. A gear ratio, a torque "
            f"constant or a unit that is missing in `gain`? It should be in {unit}.",
            Topic.SCALE,
        )
    elif abs(found.correlation) < NONE and found.asked > ASKED:
        yield Finding(
            Severity.WARNING,
            found.joint,
            "does this torque belong to this joint? It hardly follows the robot file's gravity and inertia, which ask "
            f"for {found.asked:.2g} times as much change (correlation {found.correlation:.2f}). Look at the column.",
            Topic.FOREIGN,
        )
