"""A result followed on a stream of samples: motion with a fixed lag, torque equations, recursive least squares.

The same steps as of an identification, with all that it has chosen: smoothing, time offset, base tilt, terms, parallel
filter, least speeds, weights of the joints. Where a step needs samples around, these are waited for or kept.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynident.errors import ConfigError, brief
from dynident.estimators import Estimate, Estimator
from dynident.identification import Identification
from dynident.log import Log, Motion
from dynident.online.context import Context, cut, joined
from dynident.online.fixed_lag import FixedLag, Smoothed
from dynident.online.recursive import RecursiveLeastSquares
from dynident.regression import EntryBlock, GroupKind, Regression, RegressorBlock
from dynident.smoothers import Spline, TimeShifted, motion_of, unshifted

__all__ = ["Block", "Tracker", "smoothing_of"]

Array = NDArray[np.float64]
SPARE = 2  # samples beyond a time offset, for the interpolation


@dataclass(frozen=True, eq=False)
class Block:
    """Consecutive samples whose motion is final, in the order of time, none twice.

    ``motion`` has their derivatives, its mask False where these are not reliable; ``entries`` are the torque equations
    of the usable samples as a fit has them: filtered, decimated, without joints that are too slow.
    """

    motion: Motion
    entries: tuple[EntryBlock, ...]

    __repr__ = brief


def smoothing_of(result: Identification, log: Log) -> tuple[float, Array]:
    """Return the mean step (s) of a log, and the bandwidth (n) s with which the result's spline smooths it.

    A joint that rests, or is as straight as a line, has that of the others. Raises ConfigError where the result has
    another smoother, or no joint moves; InputError as the smoother.
    """
    spline, _ = _smoother_of(result)
    names = tuple(joint.name for joint in result.model.joints)
    motion = motion_of(spline, result.recipe.repaired(log.select(names)))
    found = np.array(motion.smoothing["bandwidth"], dtype=float)
    moves = np.isfinite(found) & (motion.dq != 0).any(axis=0)
    if not moves.any():
        raise ConfigError(
            f"{log.source}: no joint moves, so that the smoothing cannot be found; take a log of a motion."
        )
    return float(log.t[-1] - log.t[0]) / (len(log) - 1), np.where(moves, found, np.median(found[moves]))


class Tracker:
    """Follows the parameters of a robot by a result and a stream of positions and torques.

    ``step`` (s) and ``bandwidth`` (n) s are those of ``smoothing_of`` a log of this robot, such as the first seconds of
    the stream; ``lag`` (s) and ``every`` are those of ``FixedLag``, and ``memory`` that of ``RecursiveLeastSquares``,
    which starts without any knowledge of the parameters: what no sample has shown keeps the value of the result.
    Without forgetting, the estimate at the end is that of the least-squares fit to the whole recording, smoothed with
    these bandwidths, up to rounding and what the lag leaves.

    Raises ConfigError where the result has another smoother than a spline, and as those two.
    """

    def __init__(
        self,
        result: Identification,
        step: float,
        bandwidth: ArrayLike,
        lag: float | None = None,
        memory: float | Mapping[GroupKind, float] = math.inf,
        every: int | None = None,
    ) -> None:
        spline, self._late = _smoother_of(result)
        self.model, self._filter = result.model, result.recipe.filter
        joints = tuple(joint.name for joint in self.model.joints)
        self._speeds = result.recipe.min_speeds(joints)
        self.smoother = FixedLag(joints, step, bandwidth, lag, every, ends=spline.ends)
        found = result.estimate
        self.fit = RecursiveLeastSquares(self.model, found.residual.joint_weights, memory, found.value)
        away = math.ceil(abs(self._late) / self.smoother.step) + SPARE if self._late else 0
        self._shifted = Context(away, away)
        pad = 0 if self._filter is None else self._filter.pad(self._filter.sections(self._rest(1000)))
        self._filtered = Context(pad, pad, 1 if self._filter is None else self._filter.decimate)
        self._memory = Context(SPARE)  # the last samples, with what the terms remember there

    def __repr__(self) -> str:
        return f"<Tracker of {self.model.name!r}: {self.smoother!r}, {self.fit!r}>"

    @property
    def latest(self) -> float:
        """The time (s) after a sample by which its block is returned."""
        return self.smoother.latest + (self._shifted.after + self._filtered.after) * self.smoother.step

    def push(self, t: ArrayLike, q: ArrayLike, tau: ArrayLike) -> tuple[Block, ...]:
        """Take samples, t (B) s, q and tau (B, n), as many as there are, and return the blocks that they complete.

        Columns are in the order of the model's joints. The blocks and the estimate do not depend on how many samples
        are given at a time. Raises InputError as ``FixedLag``.
        """
        return self._blocks(self.smoother.push(t, q, tau))

    def finish(self) -> tuple[Block, ...]:
        """Return what is left at the end of the data, or before a pause; what follows begins anew."""
        return self._blocks(self.smoother.finish())

    def estimate(self, estimator: Estimator | None = None) -> Estimate:
        """Return the estimate as it is now, as ``RecursiveLeastSquares`` does."""
        return self.fit.estimate(estimator)

    @property
    def state(self) -> dict[str, Array]:
        """All that it knows, as plain arrays by name, to be saved; ``restore`` takes them again."""
        return {f"{part}.{name}": x for part, one in self._parts().items() for name, x in one.state.items()}

    def restore(self, state: Mapping[str, Array]) -> None:
        """Continue from a saved state of a tracker of the same result and settings; InputError where it is not."""
        for part, one in self._parts().items():
            own = {name.removeprefix(f"{part}."): x for name, x in state.items() if name.startswith(f"{part}.")}
            if isinstance(one, Context):
                one.restore(own, self._rest(2))
            else:
                one.restore(own)

    def _parts(self) -> dict[str, FixedLag | RecursiveLeastSquares | Context]:
        return {
            "smoother": self.smoother,
            "fit": self.fit,
            "shifted": self._shifted,
            "filtered": self._filtered,
            "memory": self._memory,
        }

    def _rest(self, samples: int) -> Motion:
        """Return a motion at rest, with the joints and the rate of the stream."""
        t = self.smoother.step * np.arange(samples, dtype=np.float64)
        none, usable = np.zeros((samples, len(self.model.joints))), np.ones(samples, dtype=bool)
        return Motion(t, none, none, none, none, self.smoother.joints, usable, self.smoother.source)

    def _blocks(self, motions: Iterable[Smoothed]) -> tuple[Block, ...]:
        """Return the blocks that these motions complete, after the fit has taken them."""
        found = list[Block]()
        for one in motions:
            moved = self._moved(one)
            known = None if moved is None else self._remembered(moved)
            if (part := self._filtered.push(known, ended=one.ends)) is not None:
                found.append(self._block(*part))
            if one.ends:
                self._memory.clear()
        return tuple(found)

    def _moved(self, one: Smoothed) -> Motion | None:
        """Return the motion at the times of the torques for which it is known by now."""
        if not self._late:
            return one.motion
        if (part := self._shifted.push(one.motion, ended=one.ends)) is None:
            return None
        held, new = part
        return held.shifted(self._late, np.arange(new.start, new.stop))

    def _remembered(self, motion: Motion) -> Motion:
        """Return the motion with what the terms remember of all before it, since the last gap."""
        if not self.model.memory:
            return motion
        last = self._memory.held
        if last is None or last.memory is None:
            found = self.model.remembering(motion)
        else:
            found = cut(self.model.remembering(joined(last, motion), last.memory[0]), slice(len(last), None))
        self._memory.push(found)
        return found

    def _block(self, held: Motion, new: slice) -> Block:
        """Return the block of these samples, after the fit has taken it."""
        regression = Regression(self.model, (held,), self._filter, self._speeds)
        entries = tuple(regression.entries(within=(0, new)))
        self.fit.forget((new.stop - new.start) * self.smoother.step)
        for one in entries:
            self.fit.add(RegressorBlock(one.regressor(), one.tau.T, None if one.keep is None else one.keep.T))
        return Block(cut(held, new), entries)


def _smoother_of(result: Identification) -> tuple[Spline, float]:
    """Return the spline of a result, and its time offset (s)."""
    (given,) = result.recipe.smoothers
    spline = unshifted(given)
    if not isinstance(spline, Spline):
        raise ConfigError(
            f"smoother: a stream is smoothed by a cubic spline, and the result by {type(spline).__name__}; identify "
            "again with `smoother: { kind: spline }` (in Python, Spline())."
        )
    return spline, given.time_offset if isinstance(given, TimeShifted) else 0.0
