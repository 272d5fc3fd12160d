"""Parts of a robot that can change on their own, as directions of its base parameters."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dynident.models import CoupledFriction, CoupledMotor, Model, Parameter, RotorInertia, Term
from dynident.models.friction import Counterbalance, Drift, JointTerm, Offset, Ripple, Spring
from dynident.motion.filters import cross_correlation
from dynident.motion.log import Log, Motion
from dynident.regression.base_parameters import BaseParameters
from dynident.runtime import Noun, WordedEnum
from dynident.runtime.arrays import Array

Index = NDArray[np.intp]

MAX_REPEAT_DIFFERENCE = 10.0  # %, difference of positions and torques below which two recordings are of one motion
# of size and of speed: up to the second a path that is repeated is no other motion, and up to the first torques tell
MIN_PATH_FACTOR, MAX_PATH_FACTOR = 1.03, 1.25
MAX_RATE_ERROR = 0.12  # share of a rate by which it may differ in a part of a motion
RATE_SEARCH = {"xatol": 2e-3, "maxiter": 15}  # precision of that share, and steps
MAX_GRID_POINTS = 2**15  # of the common time axis of each recording
MAX_FINE_POINTS = 4000  # of a recording, to refine the lag
MIN_OVERLAP_SHARE = 0.5  # share of the recording that the other must overlap
MAX_PASS_DIFFERENCE = 5.0  # %, difference of positions below which the samples of a motion are those of another pass
# %, above which they are of another motion: before the first such lag, a log resembles itself
MIN_OTHER_DIFFERENCE = 50.0
MAX_COARSE_POINTS = 2**12  # points of the time axis on which passes are sought
MIN_SHARED_SHARE = 0.1  # share of a log that must have been passed twice
MIN_TAIL = 1e-280  # below, the tail probability of a change is given by its leading term
MIN_RANGE_SHARE = 0.05  # of the largest range of a joint: with a smaller one a joint hardly moves


@dataclass(frozen=True)
class Repeat:
    """The ``lag`` (s), counted from both starts, at which a second recording resembles the first most.

    ``torque`` and ``position`` are the relative differences (%) there of the torques and of the positions about
    their mean; infinite where the second is too short. A joint's position counts by its range, so that rad and m
    can be compared, unless it hardly moves.
    """

    lag: float
    torque: float
    position: float

    @property
    def error(self) -> float:
        """The larger difference (%)."""
        return max(self.torque, self.position)


def repeat_of(first: Log | Motion, second: Log | Motion) -> Repeat:
    """Return how far the second recording repeats the motion of the first, at the best lag.

    The squared difference at all lags is a cross-correlation and two running sums of squares; the lag is refined
    to a tenth of a sample. A motion that is repeated faster, slower or backwards is another motion.
    """
    lengths = [float(np.ptp(x.t)) for x in (first, second)]
    step = max(*(float(np.median(np.diff(x.t))) for x in (first, second)), max(lengths) / MAX_GRID_POINTS)
    span = np.ptp(first.q, axis=0)
    span = np.maximum(span, MIN_RANGE_SHARE * span.max()) if span.any() else np.ones(len(span))
    a, b = _resample_evenly(first, step, span), _resample_evenly(second, step, span)
    if min(len(a), len(b)) < 10 or len(b) < MIN_OVERLAP_SHARE * len(a):
        return Repeat(0.0, np.inf, np.inf)
    n = a.shape[1] // 2
    # positions count about their mean; so do torques, whose mean is gravity, but for the positions' absolute place
    middle = np.concatenate((a[:, :n].mean(axis=0), np.zeros(n)))
    a, b = a - middle, b - middle
    parts = [_relative_differences(a[:, part], b[:, part]) for part in (slice(0, n), slice(n, 2 * n))]
    lags = np.arange(-len(a) + 1, len(b))
    total = np.maximum(*parts)
    total[_overlap_counts(len(a), len(b)) < MIN_OVERLAP_SHARE * len(a)] = np.inf
    # refine around the best lag, first at a few samples
    best = float(lags[int(np.argmin(total))])
    lags_nearby, stride = (best + np.linspace(-1, 1, 21)) * step, max(1, len(first) // MAX_FINE_POINTS)
    finest = min(lags_nearby, key=lambda lag: _repeat_at(first, second, float(lag), span, stride).error)
    return _repeat_at(first, second, float(finest), span)


def repeats_path(first: Motion, second: Motion) -> bool:
    """Return whether the second motion repeats the path of the first, at a size and speed within a quarter.

    Both are sought about those of the whole motions: the ratios of their rms positions about the mean, and of their
    rms velocities over these.
    """
    if repeat_of(first, second).error < MAX_REPEAT_DIFFERENCE:
        return True
    middle = second.q.mean(axis=0)
    # joints of several units count by their ranges in the first motion
    span = np.ptp(first.q, axis=0)
    span = np.where(span > 0, span, np.inf)
    sizes = [float(np.sqrt(np.mean(((x.q - x.q.mean(axis=0)) / span) ** 2))) for x in (first, second)]
    speeds = [float(np.sqrt(np.mean((x.dq / span) ** 2))) for x in (first, second)]
    if not min(*sizes, *speeds) > 0:
        return False
    size = sizes[1] / sizes[0]
    rate = speeds[1] / speeds[0] / size
    if not MIN_PATH_FACTOR < max(size, rate, 1.0 / size, 1.0 / rate) < MAX_PATH_FACTOR:
        return False

    def difference(share: float) -> float:
        q = middle + (second.q - middle) / size
        return repeat_of(first, replace(second, t=second.t * rate * (1.0 + share), q=q)).position

    # a part of a path has about its speed: the rate is refined where the motions are alike at all
    at_start = difference(0.0)
    if not MAX_REPEAT_DIFFERENCE <= at_start < MIN_OTHER_DIFFERENCE:
        return at_start < MAX_REPEAT_DIFFERENCE
    from scipy.optimize import minimize_scalar

    best = minimize_scalar(difference, bounds=(-MAX_RATE_ERROR, MAX_RATE_ERROR), method="bounded", options=RATE_SEARCH)
    return bool(best.fun < MAX_REPEAT_DIFFERENCE)


def repeated_rows(first: Motion, second: Motion) -> tuple[Index, Index] | None:
    """Return samples of two motions that pass the same positions, to half a sample.

    They are usable samples of the first motion and those of the second. Both may be the same motion, which then passes
    them again later. None where there are fewer than a tenth.
    """
    lag = _best_lag(first, second)
    if lag is None:
        return None
    times = first.t - first.t[0] + lag
    at = np.interp(times, second.t - second.t[0], np.arange(len(second.t)), left=-1, right=-1)
    # the nearest sample of the second motion, -1 outside of it
    nearest = np.rint(at).astype(np.intp)
    use = (at >= 0) & first.mask & second.mask[nearest]
    rows = np.flatnonzero(use), nearest[use]
    power = float(np.square(first.q[rows[0]] - first.q[rows[0]].mean(axis=0)).sum()) if use.any() else 0.0
    misfit = float(np.square(first.q[rows[0]] - second.q[rows[1]]).sum())
    is_enough = use.sum() > MIN_SHARED_SHARE * len(first)
    return rows if is_enough and misfit < (MAX_PASS_DIFFERENCE / 100) ** 2 * power else None


def _best_lag(first: Motion, second: Motion) -> float | None:
    """Return the lag (s), counted from both starts, at which positions differ least; None where they always differ."""
    lengths = [float(np.ptp(x.t)) for x in (first, second)]
    step = max(*(float(np.median(np.diff(x.t))) for x in (first, second)), max(lengths) / MAX_COARSE_POINTS)
    a, b = (
        np.column_stack([np.interp(np.arange(x.t[0], x.t[-1], step), x.t, q) for q in x.q.T]) for x in (first, second)
    )
    if min(len(a), len(b)) < 10 or not np.ptp(a, axis=0).any():
        return None
    lags, differences = np.arange(-len(a) + 1, len(b)), _relative_differences(a - a.mean(axis=0), b - a.mean(axis=0))
    differences[_overlap_counts(len(a), len(b)) < MIN_SHARED_SHARE * len(a)] = np.inf
    # a motion is like itself at lag zero: look only beyond the first lag at which it is another motion
    if first is second:
        is_other = (lags > 0) & (differences > (MIN_OTHER_DIFFERENCE / 100) ** 2) & np.isfinite(differences)
        differences[: np.argmax(is_other)] = np.inf
    best = int(np.argmin(differences))
    if not differences[best] < (2 * MAX_PASS_DIFFERENCE / 100) ** 2:
        return None
    stride = max(1, len(first) // MAX_FINE_POINTS)
    lags_nearby = (lags[best] + np.linspace(-1, 1, 41)) * step

    def misfit(lag: float) -> float:
        """Return the mean squared difference of positions at a lag (s)."""
        t, u = first.t[::stride] - first.t[0] + lag, second.t - second.t[0]
        use = (t >= 0) & (t <= u[-1])
        twin = np.column_stack([np.interp(t[use], u, q) for q in second.q.T])
        return float(np.mean(np.square(first.q[::stride][use] - twin))) if use.any() else np.inf

    return float(min(lags_nearby, key=misfit))


def _resample_evenly(recording: Log | Motion, step: float, span: Array) -> Array:
    """Return positions over their ranges ``span`` (n), and torques (N, 2 n), at equal steps (s) from the start."""
    t = np.arange(recording.t[0], recording.t[-1] + step / 2, step)
    channels = np.column_stack((recording.q / span, recording.tau))
    return np.column_stack([np.interp(t, recording.t, x) for x in channels.T])


def _overlap_counts(a: int, b: int) -> Array:
    """Return the number of common samples at the lags -a + 1 to b - 1."""
    lags = np.arange(-a + 1, b)
    return np.asarray(np.minimum(a, b - lags) - np.maximum(0, -lags), dtype=float)


def _relative_differences(a: Array, b: Array) -> Array:
    """Return sum |a(k) - b(k + lag)|^2 over sum |a(k)|^2 at the lags -a + 1 to b - 1, over the common samples."""
    # |a - b|^2 = |a|^2 + |b|^2 - 2 a b: running sums and a cross-correlation over the common samples
    crossed = np.sum([cross_correlation(x, y) for x, y in zip(a.T, b.T, strict=True)], axis=0)
    sums_first, sums_second = (np.concatenate(([0.0], np.cumsum(np.square(x).sum(axis=1)))) for x in (a, b))
    lags = np.arange(-len(a) + 1, len(b))
    start, stop = np.maximum(0, -lags), np.minimum(len(a), len(b) - lags)
    size = sums_first[stop] - sums_first[start]
    misfit = size + sums_second[stop + lags] - sums_second[start + lags] - 2 * crossed
    return np.where(size > 1e-12 * sums_first[-1], np.maximum(misfit, 0.0) / np.maximum(size, 1e-300), np.inf)


def _repeat_at(first: Log | Motion, second: Log | Motion, lag: float, span: Array, stride: int = 1) -> Repeat:
    """Return the differences at a lag (s), at every ``stride``-th stamp of the first recording."""
    t, u = first.t[::stride] - first.t[0] + lag, second.t - second.t[0]
    use = (t >= 0) & (t <= u[-1])
    if use.sum() < MIN_OVERLAP_SHARE * len(t):
        return Repeat(lag, np.inf, np.inf)
    errors = []
    ones = np.ones(len(span))
    # one search for all columns, as np.interp does for each
    k = np.clip(np.searchsorted(u, t[use], side="right") - 1, 0, len(u) - 2)
    share = ((t[use] - u[k]) / (u[k + 1] - u[k]))[:, None]
    for mine, its, about, unit in ((first.tau, second.tau, 0.0, ones), (first.q, second.q, first.q.mean(axis=0), span)):
        twin, recorded = its[k] + share * (its[k + 1] - its[k]), mine[::stride][use]
        size, misfit = (float(np.sqrt(np.square(x / unit).sum())) for x in (recorded - about, recorded - twin))
        errors.append(100.0 * misfit / size if size > 0 else np.inf)
    return Repeat(lag, *errors)


NO_FRICTION_TERMS = (RotorInertia, Spring, Counterbalance, Drift)  # terms of joints that are no friction
MIN_INDEPENDENT_NORM = 1e-6  # of a direction of unit length: what is left of it beside those before


class GroupKind(WordedEnum):
    """What of a robot can change on its own; its words have a place for the joint.

    Friction of a joint, what the last body carries, the offset of a sensor, a ripple of a gear, or the residual
    of a joint: torque that the model leaves, whatever its cause.
    """

    FRICTION = "friction", "friction of {}"
    PAYLOAD = "payload", "payload at {}"
    OFFSET = "offset", "offset of {}"
    RIPPLE = "ripple", "ripple of {}"
    RESIDUAL = "residual", "torque that the model leaves at {}"


class ParameterGroup(Noun):
    """One part that can change on its own: the ``directions`` (b, k) in which it moves the base parameters.

    ``joint`` is the joint whose friction, offset or ripple it is, of a payload the joint that moves its body;
    ``names`` (k) say what the directions are, with ``units`` (k). Of a residual the directions (n, 1) are of the
    logarithms of the residuals of n joints, so that a size is the logarithm of a factor.
    """

    kind: GroupKind
    joint: str
    directions: Array
    names: tuple[str, ...]
    units: tuple[str, ...]


def groups_of(model: Model, basis: BaseParameters) -> tuple[ParameterGroup, ...]:
    """Return friction, offset and ripple of each joint or coupled motor, and the payload of each last body.

    ``basis`` are base parameters of the model. The directions of a group are independent columns of their map, those of
    its parameters: what has no effect, or the same as those before, is left out. A group without any is left out.
    """
    columns_by_group: dict[tuple[GroupKind, str], list[int]] = {}
    for k, (kind, joint) in enumerate(_kinds_and_joints(model)):
        if kind is not None:
            columns_by_group.setdefault((kind, joint), []).append(k)
    for joint, columns in _payload_columns(model):
        columns_by_group.setdefault((GroupKind.PAYLOAD, joint), []).extend(columns)
    order = list(GroupKind)
    ordered = sorted(columns_by_group.items(), key=lambda item: order.index(item[0][0]))
    groups = []
    for (kind, joint), columns in ordered:
        sizes = basis.scale[list(basis.independent), None] * basis.combination[:, columns]  # free of units
        if independent := [columns[k] for k in independent_columns(sizes)]:
            parameters = [model.parameters[k] for k in independent]
            names, units = tuple(x.name for x in parameters), tuple(x.unit for x in parameters)
            groups.append(ParameterGroup(kind, joint, basis.combination[:, independent], names, units))
    return tuple(groups)


def kinds_of(model: Model) -> tuple[GroupKind | None, ...]:
    """Return the kind of each of the p parameters, as in ``groups_of``; None for inner bodies and rotors."""
    kinds = [kind for kind, _ in _kinds_and_joints(model)]
    for _, columns in _payload_columns(model):
        for k in columns:
            kinds[k] = GroupKind.PAYLOAD
    return tuple(kinds)


def _kinds_and_joints(model: Model) -> Iterator[tuple[GroupKind | None, str]]:
    """Yield the kind of each parameter, None for those of bodies, and the name of its joint or motor."""
    for term in model.terms:
        for k, parameter in enumerate(term.parameters):
            yield _kind_of_parameter(term, parameter), _joint_of_parameter(term, k)


def _kind_of_parameter(term: Term, parameter: Parameter) -> GroupKind | None:
    if isinstance(term, Offset):
        return GroupKind.OFFSET
    if isinstance(term, Ripple):
        return GroupKind.RIPPLE
    if isinstance(term, CoupledMotor):
        return {"rotor": None, "": GroupKind.OFFSET}.get(parameter.role, GroupKind.FRICTION)
    is_friction = isinstance(term, JointTerm | CoupledFriction) and not isinstance(term, NO_FRICTION_TERMS)
    return GroupKind.FRICTION if is_friction or parameter.role in ("viscous", "coulomb") else None


def _joint_of_parameter(term: Term, parameter: int) -> str:
    """Return the name of the motor, or of the joint, that a parameter of single joints acts on."""
    if isinstance(term, CoupledMotor | CoupledFriction):
        return term.name
    return term.joints[int(np.argmax(Model((term,)).support[:, parameter]))].name


def _payload_columns(model: Model) -> Iterator[tuple[str, list[int]]]:
    """Yield, for each body that carries no other, the joint that moves it and the columns of its parameters.

    Such a body acts on more joints than any body that carries it.
    """
    bodies: dict[str, list[int]] = {}
    for k, parameter in enumerate(model.parameters):
        if parameter.body:
            bodies.setdefault(parameter.body, []).append(k)
    # the joints whose torque a body acts on: a body is a last one where no other acts on these and more
    felt = {body: frozenset(np.flatnonzero(model.support[:, columns].any(axis=1))) for body, columns in bodies.items()}
    for body, columns in bodies.items():
        if felt[body] and not any(felt[body] < others for others in felt.values()):
            # of the joints that feel the body, the one that feels the fewest bodies is its own
            carriers = {joint: sum(joint in others for others in felt.values()) for joint in felt[body]}
            last = min(carriers, key=lambda joint: (carriers[joint], -joint))
            yield model.joints[last].name, columns


def independent_columns(columns: Array) -> list[int]:
    """Return the indices of the columns that are independent of those before them."""
    columns_kept, basis = list[int](), np.zeros((len(columns), 0))
    for k, column in enumerate(columns.T):
        if not (length := np.linalg.norm(column)):
            continue
        remainder = column / length
        for _ in range(2):  # the second pass removes what rounding left
            remainder = remainder - basis @ (basis.T @ remainder)
        if (size := np.linalg.norm(remainder)) > MIN_INDEPENDENT_NORM:
            columns_kept.append(k)
            basis = np.column_stack([basis, remainder / size])
    return columns_kept


def evidence(gain: Array, rank: NDArray[np.intp] | int, dof: float) -> Array:
    """Return the evidence -log P(F > gain / rank) (N) of gains (N) by the F distribution; zero for rank 0.

    It has ``rank`` and ``dof`` degrees of freedom (Hotelling, 1931).
    """
    from scipy.special import betainc, betaln

    k = np.broadcast_to(np.asarray(rank, dtype=float), np.shape(gain))
    a, b = dof / 2, np.maximum(k, 1.0) / 2
    z = dof / (dof + np.maximum(gain, 0.0))
    tail = betainc(a, b, z)
    # in the far tail, where the incomplete beta function underflows
    leading_term = -a * np.log(z) + np.log(a) + betaln(a, b)  # betainc(a, b, z) = z^a / (a B(a, b)) of small z
    log_tail = np.where(tail > MIN_TAIL, -np.log(np.maximum(tail, MIN_TAIL)), leading_term)
    return np.asarray(np.where(k > 0, np.maximum(log_tail, 0.0), 0.0))
