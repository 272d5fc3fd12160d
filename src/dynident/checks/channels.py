"""Checks of the channels of a log: joints at rest, wrong units, quantised or repeated values."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Set
from dataclasses import dataclass, replace
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from dynident.checks import notes, time, units
from dynident.checks.finding import Finding, Topic
from dynident.checks.outliers import jumps, position_outliers
from dynident.checks.time import MINIMUM_SAMPLES
from dynident.errors import InputError, Severity
from dynident.identification import resting, whole_rests
from dynident.log import Log
from dynident.smoothers import repaired
from dynident.splines import bridged, noise_sigma, stretches

__all__ = ["ChannelFacts", "channels", "check_log", "check_log_fully"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_RANGE = 4 * np.pi  # rad: joints of arms seldom turn further from stop to stop
_SPEED = 40.0  # rad/s: no arm moves its joints so fast
_SPEED_LAG = 0.02  # s: over this time position noise is small beside 40 rad/s
_COARSE = 10.0  # median step in units of the resolution below which quantisation shapes the noise
_GRID, _LARGEST = 0.95, 1000  # share of the steps below so many counts that must be whole, for values on a grid
_STALE = 0.05  # share of repeated positions in motion to warn of
_PIECE = 6  # samples between outliers, at least, to estimate the noise from
_KNOWN: WeakKeyDictionary[Log, dict[object, tuple[Finding, ...]]] = WeakKeyDictionary()  # logs are checked when read


@dataclass(frozen=True)
class ChannelFacts:
    """Statistics of one joint of a log, in SI units: ``span`` of the position and ``rms`` of the torque.

    ``resolution`` and ``torque_resolution`` are the smallest steps, nan where the values lie on no grid; ``noise`` and
    ``torque_noise`` the estimates of ``noise_sigma``; ``repeats`` the share of positions, in motion, that are exactly
    the previous one; ``still`` the share of the time without motion. All but the steps are without the samples that the
    fit leaves out: ``left_out`` positions and ``torque_left_out`` torques.
    """

    joint: str
    span: float
    noise: float
    resolution: float
    repeats: float
    still: float
    rms: float
    torque_noise: float
    torque_resolution: float
    left_out: int = 0
    torque_left_out: int = 0


def channels(log: Log, positions: Mask | None = None, torques: Mask | None = None) -> tuple[ChannelFacts, ...]:
    """Return statistics of each joint of a log, which must have at least 6 samples.

    ``positions`` and ``torques`` (N, n) are those that the fit leaves out, None for none.
    """
    none = np.zeros(log.q.shape, dtype=bool)
    q_out, tau_out = none if positions is None else positions, none if torques is None else torques
    q = np.stack([bridged(log.t, *one) for one in zip(log.q.T, q_out.T, strict=True)], axis=1)
    still = resting(replace(log, q=q)).mean(axis=0)
    return tuple(
        ChannelFacts(
            joint=name,
            span=float(np.ptp(q[:, j])),
            noise=_noise(log.t, log.q[:, j], ~q_out[:, j]),
            resolution=_resolution(log.q[:, j]),
            repeats=_repeats(q[:, j]),
            still=float(still[j]),
            rms=float(np.sqrt(np.mean(log.tau[~tau_out[:, j], j] ** 2))),
            torque_noise=_noise(log.t, log.tau[:, j], ~tau_out[:, j]),
            torque_resolution=_resolution(log.tau[:, j]),
            left_out=int(q_out[:, j].sum()),
            torque_left_out=int(tau_out[:, j].sum()),
        )
        for j, name in enumerate(log.joints)
    )


def _noise(t: Array, x: Array, kept: Mask) -> float:
    """Return the noise of x (N) in the stretches that are kept, nan where none is long enough."""
    parts = [part for part in stretches(kept) if part.stop - part.start >= _PIECE]
    squares = [noise_sigma(t[part], x[part])[0] ** 2 for part in parts]
    sizes = [part.stop - part.start for part in parts]
    return float(np.sqrt(np.average(squares, weights=sizes))) if parts else np.nan


def check_log(
    log: Log, kinds: Mapping[str, str], multi_turn: Set[str] = frozenset(), *, torque: bool = True
) -> tuple[Finding, ...]:
    """Return all findings on a log, those on time first, then joint by joint.

    ``kinds`` maps each joint of the log to "revolute" or "prismatic"; joints named in ``multi_turn`` may make any
    number of turns. With ``torque`` False the torques are not checked. Raises InputError where a joint of the log has
    no kind.
    """
    asked, known = (frozenset(kinds.items()), frozenset(multi_turn), torque), _KNOWN.setdefault(log, {})
    if asked not in known:
        known[asked] = _quickly(log, kinds, multi_turn, torque)
    return known[asked]


def _jumped(log: Log) -> tuple[Finding, ...]:
    known = _KNOWN.setdefault(log, {})
    if Topic.JUMP not in known:
        known[Topic.JUMP] = tuple(jumps(log))
    return known[Topic.JUMP]


def _quickly(log: Log, kinds: Mapping[str, str], multi_turn: Set[str], torque: bool) -> tuple[Finding, ...]:
    missing = [name for name in log.joints if name not in kinds]
    if missing:
        raise InputError(f"{log.source}: joint {missing[0]!r} has no kind; give 'revolute' or 'prismatic'.")
    clock = list(units.time_unit(log))
    findings = [*time.samples(log), *time.gaps(log), *time.jitter(log), *clock]
    findings += [found for found in _jumped(log) if found.topic is Topic.WRAPPED]
    wrapped = [found.joint for found in findings if found.topic is Topic.WRAPPED]
    for j, name in enumerate(log.joints):
        q, tau = log.q[:, j], log.tau[:, j]
        turns = kinds[name] == "revolute" and name not in multi_turn and not clock and name not in wrapped
        found = [*_still(q), *(_degrees(log, j) if turns else ()), *_quantised(q), *(_torque(tau) if torque else ())]
        findings += [replace(finding, joint=name) for finding in found]
    return tuple(findings)


def check_log_fully(
    log: Log,
    kinds: Mapping[str, str],
    multi_turn: Set[str] = frozenset(),
    *,
    replaced: bool = True,
    kept: bool = False,
) -> tuple[Finding, ...]:
    """Return the findings of ``check_log`` and of the slower checks: stamps, lost samples, stale positions, rests,
    which are ``kept`` in the fit or not, outliers of the positions, which are ``replaced`` or not.

    Each finding names the log's source. Raises the errors of ``check_log``.
    """
    found = [finding for finding in check_log(log, kinds, multi_turn) if finding.topic is not Topic.JITTER]
    if len(log) >= MINIMUM_SAMPLES:
        facts = time.timing(log)
        found += [
            *time.stamps(facts),
            *time.lost(facts),
            *rest(log, kept=kept),
            *position_outliers(log, replaced=replaced),
        ]
        found += [one for one in _jumped(log) if one.topic is Topic.JUMP]
        clean = repaired(log, torque=False)
        found += [one for j, name in enumerate(log.joints) if kinds[name] == "prismatic" and name not in multi_turn
                  for one in units.length_unit(name, log.t, clean.q[:, j])]  # fmt: skip
        found += [replace(finding, joint=name) for j, name in enumerate(log.joints) for finding in _stale(log.q[:, j])]
    return tuple(replace(finding, source=log.source) for finding in found)


def _still(q: Array) -> Iterator[Finding]:
    levels = len(np.unique(q))
    if levels <= 3:
        yield Finding(Severity.WARNING, None, notes.NeverMoves(levels, float(q[0])), Topic.STILL)


def _degrees(log: Log, j: int) -> Iterator[Finding]:
    if not _far_or_fast(log.t, log.q[:, j]):
        return
    clean = repaired(log, torque=False)  # spikes are no motion
    q = clean.q[:, j]
    if _far_or_fast(clean.t, q):
        note = notes.PerhapsDegrees(float(np.ptp(q)), _peak_speed(clean.t, q))
        yield Finding(Severity.ERROR, None, note, Topic.DEGREES)


def _far_or_fast(t: Array, q: Array) -> bool:
    return float(np.ptp(q)) > _RANGE or _peak_speed(t, q) > _SPEED


def _peak_speed(t: Array, q: Array) -> float:
    """Return the 99th percentile of the speed over 20 ms: from sample to sample it is too noisy."""
    lag = int(np.clip(round(_SPEED_LAG / float(np.median(np.diff(t)))), 1, len(t) - 1))
    return float(np.percentile(np.abs(q[lag:] - q[:-lag]) / (t[lag:] - t[:-lag]), 99))


def _quantised(q: Array) -> Iterator[Finding]:
    resolution = _resolution(q)
    counts = np.abs(np.diff(q)) / resolution
    if not np.isnan(resolution) and np.median(counts[counts > 0.5]) < _COARSE:
        yield Finding(Severity.WARNING, None, notes.QuantisedPosition(resolution, _COARSE), Topic.QUANTISED)


def _torque(tau: Array) -> Iterator[Finding]:
    low, high = float(tau.min()), float(tau.max())
    if low == high:
        yield Finding(Severity.WARNING, None, notes.ConstantTorque(low), Topic.DEAD)


def _resolution(x: Array) -> float:
    """Return the step of the grid on which the values lie, nan where they lie on none."""
    steps = np.abs(np.diff(x))
    steps = steps[steps > 1e-9 * np.ptp(x)]  # shorter ones are rounding of the arithmetic
    if len(steps) < MINIMUM_SAMPLES:
        return float("nan")
    counts = steps / steps.min()
    counts = counts[counts < _LARGEST]  # in larger ones the rounding of the smallest step adds up
    on_grid = len(counts) >= MINIMUM_SAMPLES and np.mean(np.abs(counts - np.round(counts)) < 0.05) >= _GRID
    return float(steps.min()) if on_grid else float("nan")


def _repeats(q: Array, reach: int = 5) -> float:
    """Return the share of positions equal to the previous one, while the joint moves by many smallest steps."""
    steps = np.abs(np.diff(q))
    moved = steps[steps > 1e-9 * np.ptp(q)]
    if len(moved) < MINIMUM_SAMPLES or len(q) <= 2 * reach:
        return 0.0
    pace = np.abs(q[2 * reach :] - q[: -2 * reach]) / (2 * reach)
    moving = pace > 10 * moved.min()
    same = steps[reach - 1 : reach - 1 + len(pace)] == 0
    return float(same[moving].mean()) if moving.sum() >= MINIMUM_SAMPLES else 0.0


def _stale(q: Array) -> Iterator[Finding]:
    share = _repeats(q)
    if share > _STALE:
        every = round(1 / (1 - share)) if share < 1 else 0
        yield Finding(Severity.WARNING, None, notes.RepeatedPositions(share, every), Topic.STALE)


def rest(log: Log, *, kept: bool = False) -> Iterator[Finding]:
    """Yield where the whole arm is at rest for longest; a warning where such rests are ``kept`` in the fit."""
    rests = whole_rests(log)
    if rests:
        longest = max(rests, key=lambda part: part.stop - part.start)
        start, stop = log.t[longest.start], log.t[longest.stop - 1]
        note = notes.ArmAtRest(float(start), float(stop), kept)
        yield Finding(Severity.WARNING if kept else Severity.INFO, None, note, Topic.REST)
