"""Matching of columns without telling names by their values: blocks of one column per joint, or a block per joint.

Positions are the block of which another is the derivative, or else the smoothest one; torques are the
remaining block that the motion explains best. Each is a guess, with its reason and a question.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.apps.init.match import Match, MovableJoint, columns_beside
from dynident.apps.init.stamps import is_increasing
from dynident.files.tables import DataTable
from dynident.project.columns import COMMANDED, ColumnFamily, is_commanded, read_name
from dynident.runtime.arrays import Array

Mask = NDArray[np.bool_]

MAX_SAMPLES = 20_000  # of the recording, at most
MIN_SAMPLES, MAX_VALUE = 100, 1e100
# least correlation, of each joint that moves, of a column's steps with the integral of its derivative
MIN_DERIVATIVE_CORRELATION = 0.9
MIN_SURE_SHARE = 0.7  # of the joints that move: those whose velocities must tell the sampling rate
# correlation from which a block is another of the same quantity, as commanded beside measured
MIN_TWIN_CORRELATION = 0.99
# of the positions where columns are block by block: those that are joint by joint must be smoother by this factor
MAX_ROUGHNESS_RATIO = 0.5
MAX_SHARE_DIFFERENCE = 0.05  # of the share explained: a block that is explained as well within it is a rival
MIN_EXPLAINED_SHARE = 0.3  # least share of a torque that the motion of its joint explains
MIN_RIVAL_RATIO = 0.5  # of the largest share explained, from which a block is named as a rival
MIN_MOTION = 1e-3  # rad or m (degrees, N m, ...): a column that moves less says nothing
# factor by which velocities and accelerations may differ from the derivatives of what is before them
MAX_UNIT_RATIO = 1.1
EFFORT_PEAK_RANGE = (0.02, 1.5)  # of the effort limit: usual peaks of torques


@dataclass(frozen=True)
class _ColumnBlock:
    """As many columns as joints, from index ``start`` of those that are not the time, ``step`` columns apart."""

    start: int
    names: tuple[str, ...]
    step: int = 1

    def __str__(self) -> str:
        if self.step > 1:
            return ", ".join(map(repr, self.names))
        return f"{self.names[0]!r} to {self.names[-1]!r}" if len(self.names) > 1 else repr(self.names[0])

    def order_question(self, joints: Sequence[MovableJoint]) -> str:
        """Return the question of the order of the joints, which there is unless all columns name theirs."""
        order = [joint.name for joint in joints]
        is_named = [read_name(name, order).joint for name in self.names] == order
        return "" if is_named else ", and is this order right"


def match_by_shape(table: DataTable, joints: Sequence[MovableJoint]) -> tuple[Match | None, Match | None]:
    """Return the columns of positions and of torques, None where no block of columns looks like them.

    Within a block, columns are of the joints that they name, else in the order of the joints; where each joint has all
    its columns together, a block has every second or third column. Columns that are constant, or increase as the time
    does, are neither, unless they are in a block of others. The fingers of a gripper (sliding joints after turning
    ones) may be missing.
    """
    # columns that increase are clocks or counters; shorter ones belong to other logs
    rows = max((len(column) for column in table.columns.values()), default=0)
    varying = [name for name, x in table.columns.items() if len(x) == rows and not is_increasing(x)]
    # what was commanded was not measured: it is neither, whatever it looks like
    names = _in_joint_order([name for name in varying if not is_commanded(name)] or varying, joints)
    joints = _recorded_joints(_named_order(table, joints), len(names))
    n = len(joints)
    if rows < MIN_SAMPLES or not n or len(names) < n or len(varying) < 2 * n:
        return None, None
    X = _complete_rows(np.column_stack([table.columns[name] for name in names])[:MAX_SAMPLES])
    if len(X) < MIN_SAMPLES:
        return None, None
    # at multiples of n where the columns make whole blocks, else anywhere
    step, starts = 1, range(0, len(names) - n + 1, n if len(names) % n == 0 else 1)
    motion = _find_motion(X, starts, n, joints)
    if len(names) % n == 0 and n > 1:
        # the columns of each joint may be together: every second or third one is then a block
        count = len(names) // n
        order = [k for first in range(count) for k in range(first, len(names), count)]
        other_motion = _find_motion(X[:, order], starts, n, joints)
        if other_motion.roughness < MAX_ROUGHNESS_RATIO * motion.roughness:
            step, motion, X, names = count, other_motion, X[:, order], [names[k] for k in order]
    if not motion.starts:
        return None, None
    blocks = {k: _ColumnBlock(k, tuple(names[k : k + n]), step) for k in starts}
    chain, position = motion.starts, blocks[motion.starts[0]]
    twins = [blocks[k] for k in _twin_blocks(X, chain[0], starts, n) if _is_separate(k, chain, n)]
    question = (
        f"the columns {position} are taken for the positions of {joints[0].name} to {joints[-1].name}, as "
        f"{motion.reason}: are they{position.order_question(joints)}?"
    )
    if twins:
        question += f" Why not {' or '.join(map(str, twins))}, which are nearly the same?"
    position_match = _block_match("position", position, joints, question)
    return position_match, _find_torque(X, chain, starts, joints, blocks)


def match_torque_by_shape(table: DataTable, joints: Sequence[MovableJoint], position: Match) -> Match | None:
    """Return the torques beside positions of known names, of columns whose names say nothing; None where none are."""
    joints = [joint for joint in joints if joint.name in position.columns]
    groups = columns_beside(table, joints, position, lambda name: not name.role and name.rank > COMMANDED)
    names = [group[joint.name] for group in (position.columns, *groups) for joint in joints]
    columns = np.column_stack([table.columns[name] for name in names])[:MAX_SAMPLES]
    if not groups or len(columns) < MIN_SAMPLES or len(X := _complete_rows(columns)) < MIN_SAMPLES:
        return None
    starts = range(0, len(names), len(joints))
    blocks = {k: _ColumnBlock(k, tuple(names[k : k + len(joints)])) for k in starts}
    return _find_torque(X, [0], starts, joints, blocks)


def sampling_step(table: DataTable, position: Match) -> float:
    """Return the time (s) between rows by which other columns are the velocities of the positions; nan where none are.

    Those of most joints that move must agree; a gripper may have none.
    """
    named = list(position.columns.values())
    rows = len(table.columns[named[0]])
    others = [name for name, x in table.columns.items() if name not in named and len(x) == rows]
    if rows < MIN_SAMPLES or not others:
        return np.nan
    X = _complete_rows(np.column_stack([table.columns[name] for name in (*named, *others)])[:MAX_SAMPLES])
    if len(X) < MIN_SAMPLES:
        return np.nan
    moving = np.flatnonzero(np.ptp(X[:, : len(named)], axis=0) > MIN_MOTION)
    C, slopes = (matrix[moving, len(named) :] for matrix in _derivative_correlation(X))
    steps = slopes[np.arange(len(moving)), C.argmax(axis=1)][C.max(axis=1) > MIN_DERIVATIVE_CORRELATION]
    is_sure = len(steps) > MIN_SURE_SHARE * len(moving)
    return float(np.median(steps)) if is_sure and steps.max() < MAX_UNIT_RATIO * steps.min() else np.nan


def _in_joint_order(names: Sequence[str], joints: Sequence[MovableJoint]) -> list[str]:
    """Return names of columns, those of one quantity side by side in the order of the joints that they name."""
    order = {joint.name: k for k, joint in enumerate(joints)}
    parsed = [read_name(name, order) for name in names]
    groups = [name.family if name.joint else k for k, name in enumerate(parsed)]
    keys = [(groups.index(group), order.get(name.joint or "", 0)) for group, name in zip(groups, parsed, strict=True)]
    return [names[k] for k in sorted(range(len(names)), key=keys.__getitem__)]


def _named_order(table: DataTable, joints: Sequence[MovableJoint]) -> Sequence[MovableJoint]:
    """Return the joints in the order in which columns of text name them, where these name all."""
    by_name = {joint.name: joint for joint in joints}
    named = [by_name[text] for text in table.texts.values() if text in by_name]
    return named if len(named) == len(by_name) == len({joint.name for joint in named}) else joints


def _recorded_joints(joints: Sequence[MovableJoint], count: int) -> Sequence[MovableJoint]:
    """Return the joints that ``count`` columns may belong to.

    The fingers of a gripper are left out where the columns fill whole blocks only without them.
    """
    turning = next((k for k, joint in enumerate(joints) if k and joint.kind == "prismatic"), len(joints))
    fingers = all(joint.kind == "prismatic" for joint in joints[turning:])
    arm = all(joint.kind == "revolute" for joint in joints[:turning])
    fills_blocks = len(joints) > 0 and count % len(joints) == 0
    return joints[:turning] if arm and fingers and turning and not fills_blocks and count % turning == 0 else joints


def _complete_rows(X: Array) -> Array:
    """Return the rows without missing values; a column that is mostly missing becomes zero."""
    is_finite = np.abs(X) < MAX_VALUE
    empty = is_finite.mean(axis=0) < 0.5
    return np.where(empty, 0.0, X)[is_finite[:, ~empty].all(axis=1)]


def _block_match(role: str, block: _ColumnBlock, joints: Sequence[MovableJoint], question: str) -> Match:
    columns = {joint.name: name for joint, name in zip(joints, block.names, strict=True)}
    parsed = [read_name(name, ()) for name in block.names]
    units = {name.column: name.unit for name in parsed if name.unit and name.role == role}
    family = ColumnFamily(role, 0, dict(enumerate(block.names)), units)
    return Match(family, columns, "matched by their values", question)


def _is_separate(start: int, other_starts: Sequence[int], n: int) -> bool:
    return all(abs(start - other_start) >= n for other_start in other_starts)


def _derivative_correlation(X: Array) -> tuple[Array, Array]:
    """Return correlation and slope (m, m) of the steps of column i with the integral of column j over them."""
    # compared over a lag: differences of single samples would be mostly noise
    lag = max(1, len(X) // 500)
    steps = X[lag:] - X[:-lag]
    # trapezoidal rule
    cumulative = np.vstack([np.zeros(X.shape[1]), np.cumsum((X[1:] + X[:-1]) / 2, axis=0)])
    integral = cumulative[lag:] - cumulative[:-lag]
    C = _correlation(steps, integral)
    return C, C * steps.std(axis=0)[:, None] / np.maximum(integral.std(axis=0), 1e-300)


def _correlation(x: Array, y: Array) -> Array:
    """Return the correlation (m, k) of the columns of x (N, m) with those of y (N, k); zero for a constant."""
    normalised = []
    for columns in (x, y):
        centred = columns - columns.mean(axis=0)
        norm = np.linalg.norm(centred, axis=0)
        normalised.append(centred / np.where(norm > 1e-9 * np.abs(columns).max(axis=0), norm, np.inf))
    return np.asarray(normalised[0].T @ normalised[1])


def _block_diagonal(C: Array, row_start: int, column_start: int, moving: Mask, n: int) -> Array:
    """Return the entries of a matrix joint by joint for two blocks, for joints that move in the first."""
    rows = row_start + np.flatnonzero(moving[row_start : row_start + n])
    return np.asarray(C[rows, rows - row_start + column_start])


def _min_correlation(C: Array, row_start: int, column_start: int, moving: Mask, n: int) -> float:
    entries = _block_diagonal(C, row_start, column_start, moving, n)
    return float(entries.min(initial=1.0)) if len(entries) else 0.0


@dataclass(frozen=True)
class _MotionBlocks:
    """The ``starts`` of positions and, if present, velocities and accelerations, with the reason; none where there are
    no positions.

    ``roughness`` of the positions compares orders of the columns; zero where their derivatives confirm them.
    """

    starts: Sequence[int] = ()
    reason: str = ""
    roughness: float = np.inf


def _find_motion(X: Array, starts: Sequence[int], n: int, joints: Sequence[MovableJoint]) -> _MotionBlocks:
    """Return the blocks of the motion in columns (N, m)."""
    moving = np.ptp(X, axis=0) > MIN_MOTION
    C, slope = _derivative_correlation(X)
    # a block that is itself a derivative of another one is no block of positions
    derived = ((C > MIN_DERIVATIVE_CORRELATION) & moving[:, None] & moving).any(axis=0)
    separate = [(a, b) for a in starts for b in starts if _is_separate(a, [b], n)]
    correlations = {(a, b): _min_correlation(C, a, b, moving, n) for a, b in separate}
    pairs = {pair: size for pair, size in correlations.items() if size > MIN_DERIVATIVE_CORRELATION}
    # of the blocks with a derivative, the one of which most joints move, then the best correlation
    position_pairs = [pair for pair in pairs if not derived[pair[0] : pair[0] + n].any()]
    if position_pairs:
        a, b = max(position_pairs, key=lambda pair: (int(moving[pair[0] : pair[0] + n].sum()), pairs[pair]))
        unit = float(np.median(_block_diagonal(slope, a, b, moving, n)))
        # an acceleration is the derivative of the velocity in the same unit of time
        third = [d for source, d in pairs if source == b and d != a]
        ratios = {d: float(np.median(_block_diagonal(slope, b, d, moving, n))) / unit for d in third}
        accelerations = [d for d, ratio in ratios.items() if 1 / MAX_UNIT_RATIO < ratio < MAX_UNIT_RATIO]
        reason = f"their derivative is in the file, too (correlation {pairs[a, b]:.3f})"
        return _MotionBlocks([a, b, *accelerations], reason, 0.0)
    # no derivative in the file: of the blocks within reach of the joints the smoothest is the position
    moving_starts = [k for k in starts if moving[k : k + n].any()]
    roughness = {k: _roughness(X[:, k : k + n][:, moving[k : k + n]]) for k in moving_starts}
    # in rad and m, or in degrees and mm: where these are two blocks, the one that explains another better
    likely = set[int]()
    for degrees in (False, True):
        reachable = [k for k in moving_starts if _is_reachable(joints, X[:, k : k + n], degrees=degrees)]
        likely |= {min(reachable, key=lambda start: roughness[start])} if reachable else set()
    if not likely:
        return _MotionBlocks()
    k = likely.pop() if len(likely) == 1 else max(likely, key=lambda start: _explained_by(X, start, starts, n))
    return _MotionBlocks([k], "they are the smoothest within the range of the joints", roughness[k])


def _explained_by(X: Array, start: int, starts: Sequence[int], n: int) -> float:
    """Return the largest share of another block that a block explains as its motion."""
    features = _torque_features(X[:, start : start + n])
    others = (k for k in starts if _is_separate(k, [start], n))
    return max((_explained_share(X[:, k : k + n], features) for k in others), default=0.0)


def _is_reachable(joints: Sequence[MovableJoint], X: Array, *, degrees: bool = False) -> bool:
    """Return whether columns (N, n) span no more than the joints can move, in rad and m, or in degrees and mm."""
    return all(joint.can_move(span, degrees=degrees) for joint, span in zip(joints, np.ptp(X, axis=0), strict=True))


def _roughness(X: Array) -> float:
    """Return the largest rms second difference of columns (N, k), relative to their standard deviation."""
    return float((np.sqrt(np.mean(np.diff(X, 2, axis=0) ** 2, axis=0)) / X.std(axis=0)).max())


def _twin_blocks(X: Array, start: int, starts: Sequence[int], n: int) -> list[int]:
    """Return the other blocks that are nearly equal, such as commanded positions."""
    C, moving = _correlation(X, X), np.ptp(X, axis=0) > MIN_MOTION
    others = [k for k in starts if _is_separate(k, [start], n)]
    return [k for k in others if _min_correlation(C, start, k, moving, n) > MIN_TWIN_CORRELATION]


def _find_torque(
    X: Array,
    chain: Sequence[int],
    starts: Sequence[int],
    joints: Sequence[MovableJoint],
    blocks: Mapping[int, _ColumnBlock],
) -> Match | None:
    """Return the block that the motion of its joints explains best, excluding blocks of motion."""
    n = len(joints)
    # copies of the motion are explained by it, too
    excluded = {k for motion_start in chain for k in [motion_start, *_twin_blocks(X, motion_start, starts, n)]}
    features = _torque_features(X[:, chain[0] : chain[0] + n])
    shares = {k: _explained_share(X[:, k : k + n], features) for k in starts if _is_separate(k, sorted(excluded), n)}
    shares = {k: share for k, share in shares.items() if share > MIN_EXPLAINED_SHARE}
    if not shares:
        return None
    # of blocks explained about as well prefer usual peaks: currents are proportional to torques
    likely = [k for k in shares if shares[k] > max(shares.values()) - MAX_SHARE_DIFFERENCE]
    best = max(likely, key=lambda k: (_usual_peak_count(joints, X[:, k : k + n]), shares[k]))
    question = (
        f"the columns {blocks[best]} are taken for the torques, as the motion explains {100 * shares[best]:.0f} % of "
        f"them: are they torques of the joints, not currents{blocks[best].order_question(joints)}?"
    )
    rivals: list[int] = []
    for k in sorted(shares, key=lambda start: -shares[start]):
        if shares[k] > MIN_RIVAL_RATIO * shares[best] and _is_separate(k, [best, *rivals], n):
            rivals.append(k)
    if rivals:
        question += f" Why not {' or '.join(str(blocks[k]) for k in sorted(rivals))}?"
    return _block_match("torque", blocks[best], joints, question)


def _usual_peak_count(joints: Sequence[MovableJoint], X: Array) -> float:
    """Return for how many joints the peaks of columns (N, n) are usual for the effort limits."""
    peaks = zip(joints, np.abs(X).max(axis=0), strict=True)
    ratios = [peak / joint.limits.effort for joint, peak in peaks if joint.limits.effort]
    return float(sum(EFFORT_PEAK_RANGE[0] < ratio < EFFORT_PEAK_RANGE[1] for ratio in ratios))


def _torque_features(q: Array) -> list[Array]:
    """Return for each joint rough features of its torque: acceleration, friction, and gravity, (N, k)."""
    # a span beyond two turns is taken for degrees
    q = q * (np.pi / 180 if np.ptp(q, axis=0).max() > 4 * np.pi else 1.0)
    lag = max(2, len(q) // 1000)
    before, middle, after = q[: -2 * lag], q[lag:-lag], q[2 * lag :]
    dq, ddq = after - before, after - 2 * middle + before
    features = []
    for j in range(q.shape[1]):
        # a smooth sign, at 5 % of the usual speed, for Coulomb friction
        sign = np.tanh(dq[:, j] / max(0.05 * float(dq[:, j].std()), 1e-300))
        # gravity turns with sums of joint angles: this joint alone, and with one or two before it
        sums = [middle[:, max(j - k, 0) : j + 1].sum(axis=1) for k in range(3)]
        waves = [wave(angle) for angle in sums for wave in (np.sin, np.cos)]
        features.append(np.column_stack([ddq[:, j], dq[:, j], sign, np.ones(len(dq)), *waves]))
    return features


def _explained_share(X: Array, features: Sequence[Array]) -> float:
    """Return the median share (R^2) of columns that the features of their joints explain.

    The share is zero for velocities and accelerations, which a single feature explains.
    """
    cut = (len(X) - len(features[0])) // 2
    shares, single = [], []
    for x, columns in zip(X[cut : cut + len(features[0])].T, features, strict=True):
        residual = x - columns @ np.linalg.lstsq(columns, x)[0]
        shares.append(1.0 - float(np.var(residual)) / float(np.var(x)) if np.var(x) > 0 else 0.0)
        single.append(float(np.abs(_correlation(x[:, None], columns[:, :2])).max()))
    # velocities and accelerations are nearly a multiple of one feature; torques never are
    return 0.0 if min(single) > MIN_TWIN_CORRELATION else float(np.median(shares))
