"""Matches columns whose names say nothing by their values: blocks of one column per joint, in any order.

Positions are the block of which another is the derivative, or the smoothest one; torques are what the motion explains
best of the rest. Each is a guess, with its reason and a question.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.io.columns import ColumnFamily
from dynident.io.match import JointFacts, Match, increases
from dynident.io.tables import DataTable

__all__ = ["match_by_shape"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

SAMPLES = 20_000  # of the recording, at most
FEWEST, LARGEST = 100, 1e100
DERIVATIVE = 0.9  # least correlation, of each joint that moves, of a column's steps with the integral of its derivative
ALIKE = 0.99  # correlation from which a block is another of the same quantity, as commanded beside measured
NEAR = 0.05  # of the share explained: a block that is explained as well within it is a rival
EXPLAINED = 0.3  # least share of a torque that the motion of its joint explains
RIVAL = 0.5  # of the largest share explained, from which a block is named as a rival
STILL = 1e-3  # rad or m (degrees, N m, ...): a column that moves less says nothing
SAME_UNIT = 1.1  # factor by which velocities and accelerations may differ from the derivatives of what is before them
USUAL = (0.02, 1.5)  # of the effort limit: usual peaks of torques


@dataclass(frozen=True)
class _Block:
    """As many neighbouring columns as joints, from the place ``start`` among those that are not the time."""

    start: int
    names: tuple[str, ...]

    def __str__(self) -> str:
        return f"{self.names[0]!r} to {self.names[-1]!r}" if len(self.names) > 1 else repr(self.names[0])


def match_by_shape(table: DataTable, joints: Sequence[JointFacts]) -> tuple[Match | None, Match | None]:
    """Return the columns of positions and of torques, None where no block of so many columns looks like them.

    Columns are in the order of the joints within a block. Columns that are constant, or increase as the time does, are
    of neither kind unless a block of others holds them. The fingers of a gripper, sliding joints after turning ones,
    may be missing.
    """
    rows = max((len(column) for column in table.columns.values()), default=0)
    names = [name for name, x in table.columns.items() if len(x) == rows and not increases(x)]
    joints = _recorded(joints, len(names))
    n = len(joints)
    if rows < FEWEST or not n or len(names) < 2 * n:
        return None, None
    X = _complete(np.column_stack([table.columns[name] for name in names])[:SAMPLES])
    if len(X) < FEWEST:
        return None, None
    starts = _starts(len(names), n)
    blocks = {k: _Block(k, tuple(names[k : k + n])) for k in starts}
    chain, why = _motion(X, starts, n, joints)
    if not chain:
        return None, None
    position = blocks[chain[0]]
    others = [blocks[k] for k in _same(X, chain[0], starts, n) if _apart(k, chain, n)]
    asked = (
        f"the columns {position} are taken for the positions of {joints[0].name} to {joints[-1].name}, as {why}: are "
        "they, and is this order right?"
    )
    if others:
        asked += f" Why not {' or '.join(map(str, others))}, which are nearly the same?"
    found = _match("position", position, joints, asked)
    return found, _torque(X, chain, starts, joints, blocks)


def _recorded(joints: Sequence[JointFacts], count: int) -> Sequence[JointFacts]:
    """Return the joints that ``count`` columns are of: those without fingers where they make whole blocks of these."""
    turning = next((k for k, one in enumerate(joints) if k and one.kind == "prismatic"), len(joints))
    fingers = all(one.kind == "prismatic" for one in joints[turning:])
    arm = all(one.kind == "revolute" for one in joints[:turning])
    whole = len(joints) > 0 and count % len(joints) == 0
    return joints[:turning] if arm and fingers and turning and not whole and count % turning == 0 else joints


def _complete(X: Array) -> Array:
    """Return the rows without missing values; a column of which most are missing is zero."""
    known = np.abs(X) < LARGEST
    empty = known.mean(axis=0) < 0.5
    return np.where(empty, 0.0, X)[known[:, ~empty].all(axis=1)]


def _match(role: str, block: _Block, joints: Sequence[JointFacts], question: str) -> Match:
    columns = {joint.name: name for joint, name in zip(joints, block.names, strict=True)}
    return Match(ColumnFamily(role, 0, dict(enumerate(block.names))), columns, "matched by their values", question)


def _starts(count: int, n: int) -> list[int]:
    """Return where blocks may start: at multiples of n where the columns make whole blocks, else anywhere."""
    return list(range(0, count - n + 1, n if count % n == 0 else 1))


def _apart(start: int, taken: Sequence[int], n: int) -> bool:
    return all(abs(start - other) >= n for other in taken)


def _derivatives(X: Array) -> tuple[Array, Array]:
    """Return correlation and slope (m, m) of the steps of column i against the integral of column j over them."""
    lag = max(1, len(X) // 500)
    steps = X[lag:] - X[:-lag]
    total = np.vstack([np.zeros(X.shape[1]), np.cumsum((X[1:] + X[:-1]) / 2, axis=0)])
    integral = total[lag:] - total[:-lag]
    C = _correlation(steps, integral)
    return C, C * steps.std(axis=0)[:, None] / np.maximum(integral.std(axis=0), 1e-300)


def _correlation(x: Array, y: Array) -> Array:
    """Return the correlation (m, k) of the columns of x (N, m) with those of y (N, k); zero with a constant."""
    parts = []
    for one in (x, y):
        centred = one - one.mean(axis=0)
        size = np.linalg.norm(centred, axis=0)
        parts.append(centred / np.where(size > 1e-9 * np.abs(one).max(axis=0), size, np.inf))
    return np.asarray(parts[0].T @ parts[1])


def _along(C: Array, one: int, other: int, moving: Mask, n: int) -> Array:
    """Return the entries of a matrix, joint by joint, for two blocks; of joints that move in the first."""
    rows = one + np.flatnonzero(moving[one : one + n])
    return np.asarray(C[rows, rows - one + other])


def _least(C: Array, one: int, other: int, moving: Mask, n: int) -> float:
    return float(_along(C, one, other, moving, n).min(initial=1.0)) if moving[one : one + n].any() else 0.0


def _motion(X: Array, starts: Sequence[int], n: int, joints: Sequence[JointFacts]) -> tuple[list[int], str]:
    """Return the starts of positions and, where they are there, velocities and accelerations; and the reason."""
    moving = np.ptp(X, axis=0) > STILL
    C, slope = _derivatives(X)
    derived = ((C > DERIVATIVE) & moving[:, None] & moving).any(axis=0)
    pairs = {(a, b): size for a in starts for b in starts
             if _apart(a, [b], n) and (size := _least(C, a, b, moving, n)) > DERIVATIVE}  # fmt: skip
    first = [pair for pair in pairs if not derived[pair[0] : pair[0] + n].any()]
    if first:
        a, b = max(first, key=lambda pair: (int(moving[pair[0] : pair[0] + n].sum()), pairs[pair]))
        unit = float(np.median(_along(slope, a, b, moving, n)))
        ratios = {d: float(np.median(_along(slope, b, d, moving, n))) / unit for one, d in pairs if one == b and d != a}
        more = [d for d, ratio in ratios.items() if 1 / SAME_UNIT < ratio < SAME_UNIT]
        return [a, b, *more], f"their derivative is in the file, too (correlation {pairs[a, b]:.3f})"
    live = [k for k in starts if moving[k : k + n].any()]
    within = [k for k in live if _reachable(joints, X[:, k : k + n])]
    within = within or [k for k in live if _reachable(joints, X[:, k : k + n], degrees=True)]
    if not within:
        return [], ""
    k = min(within, key=lambda start: _roughness(X[:, start : start + n][:, moving[start : start + n]]))
    return [k], "they are the smoothest within the range of the joints"


def _reachable(joints: Sequence[JointFacts], X: Array, *, degrees: bool = False) -> bool:
    """Whether columns (N, n) span no more than joints can move, in rad and m, or in degrees and mm."""
    for joint, span in zip(joints, np.ptp(X, axis=0), strict=True):
        lower, upper = joint.limits.lower, joint.limits.upper
        reach = upper - lower if lower is not None and upper is not None and lower < upper else 4 * np.pi
        unit = 1.0 if not degrees else 180 / np.pi if joint.kind == "revolute" else 1000.0
        if span > 1.1 * reach * unit:
            return False
    return True


def _roughness(X: Array) -> float:
    """Return the largest second difference of columns (N, k), rms and relative to their deviation."""
    return float((np.sqrt(np.mean(np.diff(X, 2, axis=0) ** 2, axis=0)) / X.std(axis=0)).max())


def _same(X: Array, start: int, starts: Sequence[int], n: int) -> list[int]:
    """Return the other blocks that are nearly the same, such as commanded positions."""
    C, moving = _correlation(X, X), np.ptp(X, axis=0) > STILL
    return [k for k in starts if _apart(k, [start], n) and _least(C, start, k, moving, n) > ALIKE]


def _torque(
    X: Array, chain: Sequence[int], starts: Sequence[int], joints: Sequence[JointFacts], blocks: Mapping[int, _Block]
) -> Match | None:
    """Return the block that the motion of its joints explains best, of those that are no motion themselves."""
    n = len(joints)
    taken = {k for one in chain for k in [one, *_same(X, one, starts, n)]}
    features = _features(X[:, chain[0] : chain[0] + n])
    shares = {k: _explained(X[:, k : k + n], features) for k in starts if _apart(k, sorted(taken), n)}
    shares = {k: share for k, share in shares.items() if share > EXPLAINED}
    if not shares:
        return None
    likely = [k for k in shares if shares[k] > max(shares.values()) - NEAR]
    best = max(likely, key=lambda k: (_usual(joints, X[:, k : k + n]), shares[k]))
    asked = (
        f"the columns {blocks[best]} are taken for the torques, as the motion explains {100 * shares[best]:.0f} % of "
        "them: are they torques of the joints, not currents, and is this order right?"
    )
    rivals: list[int] = []
    for k in sorted(shares, key=lambda start: -shares[start]):
        if shares[k] > RIVAL * shares[best] and _apart(k, [best, *rivals], n):
            rivals.append(k)
    if rivals:
        asked += f" Why not {' or '.join(str(blocks[k]) for k in sorted(rivals))}?"
    return _match("torque", blocks[best], joints, asked)


def _usual(joints: Sequence[JointFacts], X: Array) -> float:
    """Return how many joints have peaks in columns (N, n) that are usual for their effort limits."""
    peaks = zip(joints, np.abs(X).max(axis=0), strict=True)
    return float(sum(USUAL[0] < peak / joint.limits.effort < USUAL[1] for joint, peak in peaks if joint.limits.effort))


def _features(q: Array) -> list[Array]:
    """Return for each joint what its torque consists of, roughly: acceleration, friction, and gravity (N, k)."""
    q = q * (np.pi / 180 if np.ptp(q, axis=0).max() > 4 * np.pi else 1.0)
    lag = max(2, len(q) // 1000)
    before, here, after = q[: -2 * lag], q[lag:-lag], q[2 * lag :]
    dq, ddq = after - before, after - 2 * here + before
    found = []
    for j in range(q.shape[1]):
        sign = np.tanh(dq[:, j] / max(0.05 * float(dq[:, j].std()), 1e-300))
        sums = [here[:, max(j - k, 0) : j + 1].sum(axis=1) for k in range(3)]
        waves = [wave(angle) for angle in sums for wave in (np.sin, np.cos)]
        found.append(np.column_stack([ddq[:, j], dq[:, j], sign, np.ones(len(dq)), *waves]))
    return found


def _explained(X: Array, features: Sequence[Array]) -> float:
    """Return the median share (R^2) of columns that the features of their joints explain; none of a velocity or an
    acceleration, which a single feature explains."""
    cut = (len(X) - len(features[0])) // 2
    shares, single = [], []
    for x, columns in zip(X[cut : cut + len(features[0])].T, features, strict=True):
        left = x - columns @ np.linalg.lstsq(columns, x)[0]
        shares.append(1.0 - float(np.var(left)) / float(np.var(x)) if np.var(x) > 0 else 0.0)
        single.append(float(np.abs(_correlation(x[:, None], columns[:, :2])).max()))
    return 0.0 if min(single) > ALIKE else float(np.median(shares))
