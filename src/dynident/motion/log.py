"""The two nouns of measured motion: ``Log`` as recorded, ``Motion`` with its derivatives.

Time is axis 0, SI units, float64. Both are immutable: their arrays are read-only.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from reprlib import repr as short
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynident.runtime import InputError, KeepsFacts, join_names
from dynident.runtime.arrays import Array, as_numbers

if TYPE_CHECKING:
    import polars as pl

Mask = NDArray[np.bool_]


def freeze_array(value: ArrayLike, dtype: Any = np.float64) -> NDArray[Any]:
    """Return a read-only contiguous array; copied only where the caller could still write to it."""
    array = np.ascontiguousarray(as_numbers(value, dtype))
    # a view, or the caller's own array, could still change: only an owned read-only one is shared
    if array is value or array.base is not None:
        if array.flags.owndata and not array.flags.writeable:
            return array
        array = array.copy()
    array.flags.writeable = False
    return array


def freeze_matrix(value: ArrayLike, rows: int, columns: int, name: str, source: str) -> Array:
    """Return a channel as a read-only array (rows, columns) of finite numbers; InputError where it is not one."""
    array = freeze_array(value)
    if array.shape != (rows, columns):
        raise InputError(
            f"{source}: {name} has shape {array.shape}, expected ({rows}, {columns}): "
            "one row per time stamp and one column per joint."
        )
    if not np.isfinite(array).all():
        bad = np.argwhere(~np.isfinite(array))
        i, j = bad[0]
        raise InputError(
            f"{source}: {name}[{i}, {j}] is {array[i, j]} ({len(bad)} non-finite values in all). "
            "Remove or interpolate these samples in the file, or leave them out with a window."
        )
    return array


def mark_read_only(array: Array) -> Array:
    """Mark a new array that nobody else holds as read-only, so that it need not be copied, and return it."""
    array.flags.writeable = False
    return array


def freeze_mask(value: Mask | None, shape: tuple[int, ...], source: str, name: str = "keep") -> Mask | None:
    """Return a mask as a read-only array of a shape; InputError where it has another."""
    if value is None:
        return None
    keep = freeze_array(value, np.bool_)
    if keep.shape != shape:
        raise InputError(f"{source}: {name} has shape {keep.shape}, expected {shape}.")
    return keep


def freeze_times(value: ArrayLike, source: str) -> Array:
    """Return time stamps as a read-only array (N), increasing and finite; InputError where they are not."""
    t = freeze_array(value)
    if t.ndim != 1 or len(t) < 2:
        raise InputError(f"{source}: needs at least 2 time stamps in one column, got shape {t.shape}.")
    if not np.isfinite(t).all():
        i = int(np.flatnonzero(~np.isfinite(t))[0])
        raise InputError(f"{source}: time stamp {i} is {t[i]}; remove the rows without a valid time.")
    steps = np.diff(t)
    if (steps <= 0).any():
        i = int(np.flatnonzero(steps <= 0)[0])
        problem = "repeats" if steps[i] == 0 else "runs backwards after"
        raise InputError(
            f"{source}: time stamp {i + 1} ({t[i + 1]} s) {problem} stamp {i} ({t[i]} s); "
            "sort the rows by time and drop repeated stamps (the first of each is usually right)."
        )
    return t


class Controller(Protocol):
    """The controller that drove the joints while a log was recorded: its gains and the recorded references."""

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the n joints, in the order of q."""

    def __call__(self, t: float, q: Array, dq: Array) -> Array:
        """Return the torque (n), N m or N, held from time t (s) on, for position q (n) and velocity dq (n)."""


@runtime_checkable
class HasState(Controller, Protocol):
    """A controller that remembers something from one sample to the next, such as an integral."""

    def begin(self, t: float, h: float, q: Array, dq: Array, tau: Array) -> Array:
        """Return the state (m) before the first sample, at which the torque tau (n) was measured."""

    def advance(self, t: float, h: float, q: Array, dq: Array, state: Array) -> tuple[Array, Array]:
        """Return the torque (n) that is held from time t on, h s after the last sample, and the next state (m)."""


def _recording_text(recording: Log | Motion, suffix: str = "") -> str:
    """Return the text that stands for a recording where it is displayed."""
    kind, t = type(recording).__name__, recording.t
    span = f"{t[0]:.6g} to {t[-1]:.6g} s, {1.0 / float(np.median(np.diff(t))):.4g} Hz"
    return f"<{kind} {recording.source!r}: {len(t)} samples of {join_names(recording.joints, 6)}; {span}{suffix}>"


def _channel_table(recording: Log | Motion, channels: Sequence[str]) -> pl.DataFrame:
    """Return a table of the time and of each channel by joint, such as ``q.elbow``."""
    import polars as pl

    columns: dict[str, NDArray[Any]] = {"t": recording.t}
    for name in channels:
        value = getattr(recording, name)
        if value is not None:
            columns |= {f"{name}.{joint}": value[:, j] for j, joint in enumerate(recording.joints)}
    return pl.DataFrame(columns)


@dataclass(frozen=True, eq=False)
class Log(KeepsFacts):
    """One uninterrupted recording of n joints at N instants.

    ``t`` (N) s, strictly increasing; ``q`` (N, n) rad or m; ``tau`` (N, n) N m or N; ``joints`` n names; ``source``
    names the data in messages. Optional are ``dq`` and ``command`` (N, n), the ``controller`` that produced the
    torque, ``keep`` (N, n), False where the torque equation of a joint must not be fitted, and ``excluded`` (N), True
    where a sample is smoothed through, but neither fitted nor judged.

    Raises InputError where a value is not finite, a shape does not fit, or time does not increase.

    >>> import numpy as np
    >>> import dynident as dy
    >>> t = np.arange(401) * 0.0025
    >>> log = dy.Log(t, q=np.sin(3 * t)[:, None], tau=np.cos(3 * t)[:, None], joints=("hinge",), source="monday")
    >>> log.window(0.5)
    <Log 'monday': 201 samples of hinge; 0.5 to 1 s, 400 Hz>
    >>> log.frame().columns
    ['t', 'q.hinge', 'tau.hinge']
    """

    t: Array
    q: Array
    tau: Array
    joints: tuple[str, ...]
    source: str = "log"
    dq: Array | None = None
    command: Array | None = None
    controller: Controller | None = None
    keep: Mask | None = None
    excluded: Mask | None = None

    def __post_init__(self) -> None:
        joint_names: Any = self.joints
        if (
            isinstance(joint_names, str)
            or not isinstance(joint_names, Sequence)
            or not all(isinstance(name, str) for name in joint_names)
        ):
            raise InputError(f"{self.source}: joints is {short(self.joints)}; give the names of the joints.")
        joints = tuple(self.joints)
        object.__setattr__(self, "joints", joints)
        if not joints or len(set(joints)) != len(joints):
            raise InputError(f"{self.source}: joint names must be given and distinct, got {joints}.")
        t = freeze_times(self.t, self.source)
        object.__setattr__(self, "t", t)
        for name in ("q", "tau", "dq", "command"):
            value = getattr(self, name)
            if value is not None or name in ("q", "tau"):
                object.__setattr__(self, name, freeze_matrix(value, len(t), len(joints), name, self.source))
        object.__setattr__(self, "keep", freeze_mask(self.keep, self.q.shape, self.source))
        object.__setattr__(self, "excluded", freeze_mask(self.excluded, self.t.shape, self.source, "excluded"))

    def __len__(self) -> int:
        return len(self.t)

    def __repr__(self) -> str:
        return _recording_text(self)

    def frame(self) -> pl.DataFrame:
        """Return a table: t (s), then q, tau and, where known, dq and command by joint, such as ``q.elbow``."""
        return _channel_table(self, ("q", "tau", "dq", "command"))

    def window(self, start: float = -np.inf, stop: float = np.inf) -> Log:
        """Return the part with ``start <= t <= stop`` (s); InputError where fewer than two samples remain."""
        keep = (self.t >= start) & (self.t <= stop)
        if keep.sum() < 2:
            raise InputError(
                f"{self.source}: the window {start} to {stop} s holds {keep.sum()} samples; "
                f"the log runs from {self.t[0]} to {self.t[-1]} s."
            )
        return self.rows(keep, self.source)

    def exclude(self, windows: Iterable[tuple[float, float]]) -> Log:
        """Return the log with the samples of ``windows`` (start, stop; s, both included) excluded as well.

        The log itself is returned where no further sample lies in them.
        """
        excluded = np.zeros(len(self), dtype=bool) if self.excluded is None else self.excluded.copy()
        for start, stop in windows:
            excluded |= (self.t >= start) & (self.t <= stop)
        excluded_before = 0 if self.excluded is None else np.count_nonzero(self.excluded)
        return replace(self, excluded=excluded) if np.count_nonzero(excluded) > excluded_before else self

    def include_all(self) -> Log:
        """Return the log with nothing excluded; the log itself where nothing is."""
        return self if self.excluded is None else replace(self, excluded=None)

    def rows(self, keep: slice | NDArray[np.bool_], source: str) -> Log:
        """Return the samples selected by ``keep``, a slice or a mask (N), as a log called ``source``.

        Raises InputError where fewer than two samples remain.
        """
        return replace(self, t=self.t[keep], source=source, **self._index_channels((keep,)))

    def _index_channels(self, index: tuple[Any, ...]) -> dict[str, Any]:
        """Return every channel at the index."""
        channels = {name: getattr(self, name) for name in ("q", "tau", "dq", "command", "keep", "excluded")}
        return {name: None if value is None else value[index[: value.ndim]] for name, value in channels.items()}

    def select(self, joints: tuple[str, ...]) -> Log:
        """Return the log with its joints in the given order, matched by name; InputError where one is missing."""
        missing = [name for name in joints if name not in self.joints]
        if missing:
            raise InputError(
                f"{self.source}: no joint {missing[0]!r}; the log has {', '.join(self.joints)}. Give its position and "
                "torque too, or lock it in the model."
            )
        if joints == self.joints:
            return self
        order = [self.joints.index(name) for name in joints]
        return replace(self, joints=joints, **self._index_channels((slice(None), order)))


@dataclass(frozen=True, eq=False)
class Motion(KeepsFacts):
    """A log's motion with its derivatives: the result of a smoother, or the exact motion of a simulation.

    ``t`` (N) s; ``q``, ``dq``, ``ddq``, ``tau`` (N, n) in SI units; ``mask`` (N) is True where the samples may be
    used; ``smoothing`` describes, for the report, how the derivatives were computed; ``time_offset`` (s) is how much
    later than its torque the motion was stamped; ``keep`` (N, n) is False where the torque equation of a joint must not
    be fitted, None where all may. ``memory`` (N, m) is what the terms of a model remember at each sample of the motion
    before it, from ``Model.remembering``. Raises InputError as ``Log`` does.
    """

    t: Array
    q: Array
    dq: Array
    ddq: Array
    tau: Array
    joints: tuple[str, ...]
    mask: NDArray[np.bool_]
    source: str = "log"
    smoothing: Mapping[str, Any] = field(default_factory=dict)
    time_offset: float = 0.0
    keep: Mask | None = None
    memory: Array | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "t", freeze_times(self.t, self.source))
        object.__setattr__(self, "joints", tuple(self.joints))
        for name in ("q", "dq", "ddq", "tau"):
            value = freeze_matrix(getattr(self, name), len(self.t), len(self.joints), name, self.source)
            object.__setattr__(self, name, value)
        object.__setattr__(self, "mask", freeze_mask(self.mask, self.t.shape, self.source, "the mask"))
        object.__setattr__(self, "keep", freeze_mask(self.keep, self.q.shape, self.source))
        if self.memory is not None:
            width = np.shape(self.memory)[-1] if np.ndim(self.memory) == 2 else 1
            object.__setattr__(self, "memory", freeze_matrix(self.memory, len(self.t), width, "memory", self.source))

    def __len__(self) -> int:
        return len(self.t)

    def __repr__(self) -> str:
        method = self.smoothing.get("method")
        return _recording_text(self, f"; {self.mask.sum()} usable" + (f"; {method}" if method else ""))

    def frame(self) -> pl.DataFrame:
        """Return a table: t (s), then q, dq, ddq, tau by joint, such as ``dq.elbow``, and whether it is ``usable``."""
        import polars as pl

        return _channel_table(self, ("q", "dq", "ddq", "tau")).with_columns(pl.Series("usable", self.mask))

    def states(self, rows: slice | NDArray[Any] = slice(None)) -> dict[str, Array]:
        """Return what a model needs of these samples by name: q, dq, ddq and, where it is known, the memory.

        >>> Y = model.regressor(**motion.states())  # doctest: +SKIP
        """
        names = ("q", "dq", "ddq") if self.memory is None else ("q", "dq", "ddq", "memory")
        return {name: getattr(self, name)[rows] for name in names}

    def select_between(self, start: float = -np.inf, stop: float = np.inf) -> Motion:
        """Return the motion with only the samples in ``start <= t <= stop`` (s) left in its mask."""
        return replace(self, mask=self.mask & (self.t >= start) & (self.t <= stop))

    def shift(self, time_offset: float, rows: NDArray[np.intp] | None = None) -> Motion:
        """Return the motion at t + ``time_offset`` (s), paired with the torque at t.

        ddq is interpolated linearly between samples, as in a cubic spline, and integrated for dq and q. Samples whose
        motion lies outside the recording are masked out. ``rows`` (increasing indices, at least two) selects samples.
        ``keep`` stays with the torque, whose equations it leaves out; ``memory`` is interpolated linearly.
        """
        if time_offset == 0.0 and rows is None:
            return self
        rows = np.arange(len(self)) if rows is None else rows
        at = self.t[rows] + time_offset
        # the interval that holds the shifted time; beyond the ends the outermost, whose samples are masked out below
        k = np.clip(np.searchsorted(self.t, at, side="right") - 1, 0, len(self) - 2)
        h, s = (self.t[k + 1] - self.t[k])[:, None], (at - self.t[k])[:, None]
        start, slope = self.ddq[k], (self.ddq[k + 1] - self.ddq[k]) / h
        # ddq is linear between samples: integrate it exactly from the start of the interval
        ddq = start + slope * s
        dq = self.dq[k] + (start + slope * s / 2) * s
        q = self.q[k] + (self.dq[k] + (start / 2 + slope * s / 6) * s) * s
        q, dq, ddq, tau = map(mark_read_only, (q, dq, ddq, self.tau[rows]))
        memory = self.memory
        if memory is not None:
            share = np.clip(s / h, 0.0, 1.0)
            memory = mark_read_only(
                memory[rows] if time_offset == 0.0 else (1 - share) * memory[k] + share * memory[k + 1]
            )
        channels: dict[str, Any] = {"t": self.t[rows], "q": q, "dq": dq, "ddq": ddq, "tau": tau, "memory": memory}
        mask = self.mask[rows] & (at >= self.t[0]) & (at <= self.t[-1])
        keep = None if self.keep is None else self.keep[rows]
        return replace(self, **channels, mask=mask, keep=keep, time_offset=self.time_offset + time_offset)


def subsample(motions: Sequence[Motion], max_samples: int, margin: float = 0.0) -> list[NDArray[np.intp]]:
    """Return the indices of usable samples of each motion, evenly spread: every k-th, about ``max_samples`` in all.

    Where more are usable, the number is between ``max_samples`` and twice that. No sample lies within ``margin``
    (s) of an end of its motion.
    """
    stride = max(1, sum(int(motion.mask.sum()) for motion in motions) // max_samples)
    inside = [
        recording.mask & (recording.t >= recording.t[0] + margin) & (recording.t <= recording.t[-1] - margin)
        for recording in motions
    ]
    return [np.flatnonzero(mask)[::stride] for mask in inside]


def thin_motions(motions: Sequence[Motion], max_samples: int) -> tuple[Motion, ...]:
    """Return the motions with only the samples of ``subsample``, without those that have fewer than two of them."""
    rows = subsample(motions, max_samples)
    return tuple(motion.shift(0.0, indices) for motion, indices in zip(motions, rows, strict=True) if len(indices) > 1)


def stack_states(motions: Sequence[Motion], rows: Sequence[NDArray[np.intp]] | None = None) -> dict[str, Array]:
    """Return the states of motions at these rows, by default all, concatenated by name."""
    pairs = ((part, slice(None)) for part in motions) if rows is None else zip(motions, rows, strict=True)
    states = [part.states(selection) for part, selection in pairs]
    return {name: np.concatenate([part[name] for part in states]) for name in states[0]}


def spread_pieces(part: slice, count: int, share: float) -> list[slice]:
    """Return ``count`` evenly spread pieces of consecutive samples that hold the given share of a stretch."""
    length = part.stop - part.start
    size, step = int(share * length / count), length // count
    return [slice(part.start + k * step, part.start + k * step + size) for k in range(count)]
