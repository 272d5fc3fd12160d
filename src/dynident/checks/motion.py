"""Excitation: how far, fast and often each joint moves, its limits, and which base parameters the motion excites."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.checks import motion_notes
from dynident.checks.finding import Finding, Topic
from dynident.errors import Severity
from dynident.identification import hardly_moving
from dynident.log import Motion
from dynident.models import Model
from dynident.models.robot_file import Limits
from dynident.regression import Regression, UnexcitedParameters, base_parameters, compare, structural_base_parameters

__all__ = [
    "Excitation",
    "ExcitedRank",
    "excitation",
    "excited_rank",
    "held_findings",
    "limit_findings",
    "rank_findings",
]

Array = NDArray[np.float64]

SLOW = 0.02  # of the peak speed: below, a joint hardly moves
OVER = 1.02  # x the limit
BEYOND = 0.02  # share of the range (or rad, m) past a limit of position
FAR = 3.0  # times the range that the file allows
MOVING = 1e-3  # rad/s or m/s: peak speed of a joint that moves at all
FEW = 2  # reversals below which friction and offset are strongly correlated
ILL = 1e4  # condition number of the base parameters above which they are strongly correlated


@dataclass(frozen=True)
class Excitation:
    """How a joint moves over all training motions, in rad or m and s.

    ``peak`` and ``rms`` of velocity and acceleration (the peak is the 99.9th percentile), ``reversals`` of direction,
    and the share of samples that are ``slow``, below 2 % of the peak velocity; ``torque`` is the peak effort.
    """

    joint: str
    lower: float
    upper: float
    peak_speed: float
    rms_speed: float
    peak_acceleration: float
    rms_acceleration: float
    reversals: int
    slow: float
    torque: float


def excitation(motions: Sequence[Motion], joint: str) -> Excitation:
    """Return how a joint moves in the usable samples of all motions."""
    rows = [(motion, motion.joints.index(joint)) for motion in motions]
    q, dq, ddq, tau = (
        np.concatenate([getattr(motion, name)[:, j][motion.mask] for motion, j in rows])
        for name in ("q", "dq", "ddq", "tau")
    )
    peak = _peak(dq)
    return Excitation(
        joint=joint,
        lower=float(q.min()),
        upper=float(q.max()),
        peak_speed=peak,
        rms_speed=_rms(dq),
        peak_acceleration=_peak(ddq),
        rms_acceleration=_rms(ddq),
        reversals=sum(_reversals(motion.dq[:, j][motion.mask], SLOW * peak) for motion, j in rows),
        slow=float(np.mean(np.abs(dq) < SLOW * peak)) if peak > 0 else 1.0,
        torque=_peak(tau),
    )


def _peak(x: Array) -> float:
    """Return the 99.9th percentile of the absolute value, which ignores single outliers."""
    return float(np.percentile(np.abs(x), 99.9))


def _rms(x: Array) -> float:
    return float(np.sqrt(np.mean(x**2)))


def _reversals(dq: Array, floor: float) -> int:
    """Return how often the velocity changes sign, speeds below ``floor`` ignored."""
    signs = np.sign(dq[np.abs(dq) > floor])
    return int(np.count_nonzero(np.diff(signs)))


def held_findings(moved: Sequence[Excitation], model: Model) -> Iterator[Finding]:
    """Yield the joints that only give way a little where controllers hold them: what is fitted is no friction."""
    reach, kinds = np.array([one.upper - one.lower for one in moved]), [joint.kind for joint in model.joints]
    for one, joint, held in zip(moved, model.joints, hardly_moving(reach, kinds), strict=True):
        if held and one.upper > one.lower:  # of one that never moves, its log says so
            largest = max(x for x, kind in zip(reach.tolist(), kinds, strict=True) if kind == joint.kind)
            middle = (one.lower + one.upper) / 2
            note = motion_notes.HardlyMoves(one.upper - one.lower, largest, middle, joint.unit)
            yield Finding(Severity.WARNING, one.joint, note, Topic.STILL)


def limit_findings(found: Excitation, limits: Limits | None, effort: str) -> Iterator[Finding]:
    """Yield warnings: few reversals, limits of the robot file exceeded; ``effort`` is the unit of the torque."""
    joint = found.joint
    if found.reversals < FEW and found.peak_speed > MOVING:
        yield Finding(Severity.WARNING, joint, motion_notes.FewReversals(found.reversals), Topic.REVERSALS)
    if limits is not None:
        yield from _position(found, limits)
        yield from _speed(found, limits)
        yield from _effort(found, limits, effort)


def _position(found: Excitation, limits: Limits) -> Iterator[Finding]:
    if limits.lower is None or limits.upper is None or limits.lower >= limits.upper:
        return
    slack = BEYOND * max(limits.upper - limits.lower, 1.0)
    if found.lower < limits.lower - slack or found.upper > limits.upper + slack:
        far = found.upper - found.lower > FAR * (limits.upper - limits.lower)
        note = motion_notes.PositionBeyondLimits(found.lower, found.upper, limits.lower, limits.upper, far)
        yield Finding(Severity.WARNING, found.joint, note, Topic.POSITION_LIMIT)


def _speed(found: Excitation, limits: Limits) -> Iterator[Finding]:
    if limits.velocity is not None and 0 < OVER * limits.velocity < found.peak_speed:
        note = motion_notes.VelocityAboveLimit(found.peak_speed, limits.velocity)
        yield Finding(Severity.WARNING, found.joint, note, Topic.VELOCITY_LIMIT)


def _effort(found: Excitation, limits: Limits, unit: str) -> Iterator[Finding]:
    limit = limits.effort
    if limit is None or limit <= 0:
        return
    if found.torque > OVER * limit:
        above = motion_notes.EffortAboveLimit(found.torque, limit, unit, far=found.torque > 3 * limit)
        yield Finding(Severity.WARNING, found.joint, above, Topic.EFFORT_LIMIT)
    elif 0 < found.torque < 1e-3 * limit:  # a torque of zero is a dead channel
        below = motion_notes.EffortFarBelowLimit(found.torque, limit, unit)
        yield Finding(Severity.WARNING, found.joint, below, Topic.EFFORT_LIMIT)


@dataclass(frozen=True)
class ExcitedRank:
    """Rank and condition of a model's ``count`` parameters in the training motions, and what is ``missing``.

    ``on_data`` is the rank in these motions, ``structural`` the largest rank of any motion; ``condition`` is the
    condition number of the base parameters, with scaled columns.
    """

    count: int
    on_data: int
    structural: int
    condition: float
    missing: tuple[UnexcitedParameters, ...]


def excited_rank(model: Model, regression: Regression, unfitted: Collection[str] = ()) -> ExcitedRank:
    """Return the rank on the data and the structural rank, where the torques of ``unfitted`` joints are not fitted."""
    on_data = base_parameters(regression.triangular_factors.stacked(), model.parameters)
    structural = structural_base_parameters(model, unfitted=unfitted)
    values = on_data.singular_values
    condition = float(values[0] / values[on_data.rank - 1]) if on_data.rank else float("inf")
    missing = compare(structural, on_data, model, regression.motions)
    return ExcitedRank(len(model.parameters), on_data.rank, structural.rank, condition, missing)


def rank_findings(found: ExcitedRank) -> Iterator[Finding]:
    """Yield the base parameters that the motions do not excite, and the joints to move."""
    for one in found.missing:
        yield Finding(Severity.WARNING, None, one, Topic.NOT_EXCITED)
    if found.condition > ILL and not found.missing:
        note = motion_notes.CorrelatedParameters(found.on_data, found.condition)
        yield Finding(Severity.WARNING, None, note, Topic.CONDITION)
