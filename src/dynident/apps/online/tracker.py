"""Tracking of a result on a stream of samples: motion with a fixed lag, torque equations, recursive least
squares.

The steps are those of an identification, with all that it has chosen: smoothing, time offset, base tilt,
terms, parallel filter, minimum speeds, weights of the joints. Where a step needs neighbouring samples,
these are waited for or kept.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from dynident.apps.online.fixed_lag import Context, FinalMotion, FixedLag, StreamSmoothing, cut_motion, join_motions
from dynident.apps.online.recursive import RecursiveLeastSquares
from dynident.estimators import Estimate, Estimator
from dynident.identification import Identification
from dynident.motion.log import Log, Motion
from dynident.motion.smoothers import Spline, TimeShifted, smooth_log, strip_time_offset
from dynident.motion.splines import Rule
from dynident.motion.splines.search import SplineSearch
from dynident.motion.splines.series import ScaledSeries
from dynident.regression import EntryBlock, GroupKind, Regression, RegressorBlock, Selection, one_thread
from dynident.runtime import ConfigError, Noun
from dynident.runtime.arrays import Array

OFFSET_MARGIN = 2  # samples beyond a time offset, for the interpolation


class MotionBlock(Noun):
    """Consecutive samples whose motion is final, in the order of time, none twice.

    ``motion`` has their derivatives, its mask is False where these are not reliable; ``entries`` are the
    torque equations of the usable samples as a fit has them: filtered, decimated, without joints that are
    too slow.
    """

    motion: Motion
    entries: tuple[EntryBlock, ...]


def estimate_smoothing(result: Identification, log: Log) -> StreamSmoothing:
    """Return the mean step of a log, and the bandwidth with which the result's spline smooths it.

    A joint that rests, or moves in a straight line, has the bandwidth of the others. Raises ConfigError
    where the result has another smoother, or no joint moves, and the InputError of the smoother.
    """
    steps = smoothing_steps(result, log)
    while True:
        try:
            next(steps)
        except StopIteration as end:
            smoothing: StreamSmoothing = end.value
            return smoothing


def smoothing_steps(result: Identification, log: Log) -> Generator[None, None, StreamSmoothing]:
    """Estimate the smoothing in steps, two a joint, so that a stream need not wait for all of them."""
    spline, _ = _result_smoother(result)
    bandwidth = np.full(len(result.model.joints), np.nan)
    for j, joint in enumerate(result.model.joints):
        position = log.select((joint.name,))
        # torques say nothing about the smoothing, and would be searched for spikes
        repaired = result.recipe.repair(replace(position, tau=np.zeros_like(position.tau)))
        yield
        motion = smooth_log(_spline_of_joint(spline, j, joint.name), repaired)
        (width,) = np.array(motion.smoothing["bandwidth"], dtype=float)
        if np.isfinite(width) and motion.dq.any():
            bandwidth[j] = width
        yield
    moves = np.isfinite(bandwidth)
    if not moves.any():
        raise ConfigError(
            f"{log.source}: no joint moves, so that the smoothing cannot be found; take a log of a motion."
        )
    step = float(log.t[-1] - log.t[0]) / (len(log) - 1)
    return StreamSmoothing(step, np.where(moves, bandwidth, np.median(bandwidth[moves])))


@dataclass(frozen=True)
class ColumnRule(Rule):
    """A ``rule`` as it smooths one ``column`` of several."""

    rule: Rule
    column: int
    needs_sigma: bool  # type: ignore[misc]  # a constant of other rules

    def choose(self, series: ScaledSeries, column: int) -> SplineSearch:  # noqa: ARG002
        """Search as the rule does for this column."""
        return self.rule.choose(series, self.column)


def _spline_of_joint(spline: Spline, column: int, joint: str) -> Spline:
    """Return the spline of all joints as it smooths the one in a ``column``."""
    sigma, factor = spline.sigma, spline.factor
    if isinstance(sigma, Mapping):
        sigma = {name: value for name, value in sigma.items() if name == joint}
    if isinstance(factor, Mapping):
        factor = {name: value for name, value in factor.items() if name == joint}
    rule = ColumnRule(spline.rule, column, spline.rule.needs_sigma)
    return replace(spline, rule=rule, sigma=sigma, factor=factor)


class Tracker:
    """Tracks the parameters of a robot, from a result and a stream of positions and torques.

    ``smoothing`` is that of ``estimate_smoothing`` for a log of this robot, such as
    the first seconds of the stream; ``lag`` (s) and ``window`` (samples) are those of ``FixedLag``, and
    ``memory`` that of ``RecursiveLeastSquares``, which starts without any knowledge of the parameters: what
    no sample has shown keeps the value of the result. Without forgetting, the estimate at the end is that of
    the least-squares fit to the whole recording, smoothed with these bandwidths, up to rounding and what the
    lag leaves. Without ``fits``, only the blocks are computed, in half the time, and the estimate stays as it is.

    Raises ConfigError where the result has another smoother than a spline, and the errors of those two.
    """

    def __init__(
        self,
        result: Identification,
        smoothing: StreamSmoothing,
        lag: float | None = None,
        memory: float | Mapping[GroupKind, float] = math.inf,
        window: int | None = None,
        *,
        fits: bool = True,
    ) -> None:
        spline, self._late = _result_smoother(result)
        self._fits = fits
        self.model, self._filter = result.model, result.recipe.filter
        joints = tuple(joint.name for joint in self.model.joints)
        self._speeds = result.recipe.min_speeds(joints)
        self.smoother = FixedLag(joints, smoothing, lag, window, spline.ends)
        estimate = result.estimate
        self.fit = RecursiveLeastSquares(self.model, estimate.residual.joint_weights, memory, estimate.value)
        # interpolation at shifted times needs some samples more on either side
        offset_samples = math.ceil(abs(self._late) / self.smoother.step) + OFFSET_MARGIN if self._late else 0
        self._shifted = Context(offset_samples, offset_samples)
        # the filter needs its transient before and after the samples that are delivered
        motion_at_rest = self.smoother.motion_at_rest(1000)
        pad = 0 if self._filter is None else self._filter.pad_samples(self._filter.sections(motion_at_rest))
        self._filtered = Context(pad, pad, 1 if self._filter is None else self._filter.decimate)
        self._memory = Context(OFFSET_MARGIN)  # the last samples, with what the terms remember there

    def __repr__(self) -> str:
        return f"<Tracker of {self.model.name!r}: {self.smoother!r}, {self.fit!r}>"

    @property
    def latest(self) -> float:
        """Time (s) after a sample by which its block is returned."""
        return self.smoother.latest + (self._shifted.after + self._filtered.after) * self.smoother.step

    def push(self, t: ArrayLike, q: ArrayLike, tau: ArrayLike) -> tuple[MotionBlock, ...]:
        """Take samples, t (B) s, q and tau (B, n), any number of them, and return the blocks that they complete.

        Columns are in the order of the model's joints. The blocks and the estimate do not depend on how many
        samples are given at a time. Raises InputError like ``FixedLag``.
        """
        return self._complete_blocks(self.smoother.push(t, q, tau))

    def finish(self) -> tuple[MotionBlock, ...]:
        """Return the rest at the end of the data, or before a pause; the next sample begins anew."""
        return self._complete_blocks(self.smoother.finish())

    def estimate(self, estimator: Estimator | None = None) -> Estimate:
        """Return the estimate as it is now, as ``RecursiveLeastSquares`` does."""
        return self.fit.estimate(estimator)

    @property
    def state(self) -> dict[str, Array]:
        """State as plain arrays by name, to be saved; ``restore`` takes them again."""
        return {f"{part}.{name}": x for part, component in self._parts().items() for name, x in component.state.items()}

    def restore(self, state: Mapping[str, Array]) -> None:
        """Continue from a saved state of a tracker of the same result and settings; InputError where it is not."""
        for part, component in self._parts().items():
            own_names = (name for name in state if name.startswith(f"{part}."))
            component_state = {name.removeprefix(f"{part}."): state[name] for name in own_names}
            if isinstance(component, Context):
                component.restore(component_state, self.smoother.motion_at_rest(2))
            else:
                component.restore(component_state)

    def _parts(self) -> dict[str, FixedLag | RecursiveLeastSquares | Context]:
        contexts = {"shifted": self._shifted, "filtered": self._filtered, "memory": self._memory}
        return {"smoother": self.smoother, "fit": self.fit, **contexts}

    def _complete_blocks(self, motions: Iterable[FinalMotion]) -> tuple[MotionBlock, ...]:
        """Return the blocks that these motions complete, once the fit has taken them."""
        blocks = list[MotionBlock]()
        for final in motions:
            aligned = self._align_motion(final)
            complete = None if aligned is None else self._with_memory(aligned)
            if (part := self._filtered.push(complete, ended=final.ends)) is not None:
                blocks.append(self._make_block(*part))
            if final.ends:
                self._memory.clear()
        return tuple(blocks)

    def _align_motion(self, final: FinalMotion) -> Motion | None:
        """Return the motion at the times of the torques, as far as it is known by now; None for nothing."""
        if not self._late:
            return final.motion
        if (part := self._shifted.push(final.motion, ended=final.ends)) is None:
            return None
        buffered, delivered = part
        return buffered.shift(self._late, np.arange(delivered.start, delivered.stop))

    def _with_memory(self, motion: Motion) -> Motion:
        """Return the motion with the memory of the terms of all before it, since the last gap."""
        if not self.model.memory:
            return motion
        last = self._memory.held
        if last is None or last.memory is None:
            extended = self.model.remembering(motion)
        else:
            # go on from the memory of the last samples, which are then cut off again
            joined = self.model.remembering(join_motions(last, motion), last.memory[0])
            extended = cut_motion(joined, slice(len(last), None))
        self._memory.push(extended)
        return extended

    def _make_block(self, buffered: Motion, delivered: slice) -> MotionBlock:
        """Return the block of these samples, once the fit has taken it."""
        regression = Regression(self.model, (buffered,), Selection(self._filter, self._speeds))
        with one_thread():  # several would wait for each other in products this small
            entries = tuple(regression.entries(within=(0, delivered)))
            if self._fits:
                # forgetting goes by the time of the samples, usable or not
                self.fit.forget((delivered.stop - delivered.start) * self.smoother.step)
                for entry in entries:
                    keep = None if entry.keep is None else entry.keep.T
                    self.fit.add(RegressorBlock(entry.regressor(), entry.tau.T, keep))
        return MotionBlock(cut_motion(buffered, delivered), entries)


def _result_smoother(result: Identification) -> tuple[Spline, float]:
    """Return the spline of a result, and its time offset (s)."""
    (smoother,) = result.recipe.smoothers
    spline = strip_time_offset(smoother)
    if not isinstance(spline, Spline):
        raise ConfigError(
            f"smoother: a stream is smoothed by a cubic spline, and the result by {type(spline).__name__}; identify "
            "again with `smoother: { kind: spline }` (in Python, Spline())."
        )
    return spline, smoother.time_offset if isinstance(smoother, TimeShifted) else 0.0
