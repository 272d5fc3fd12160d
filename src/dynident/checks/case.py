"""The samples that a model is to explain: torque and motion low-passed alike, and thinned to a few thousand samples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief
from dynident.filters import response
from dynident.log import Motion, subsample, together
from dynident.models import Model
from dynident.regression import ParallelFilter, fast_enough, fitted_rows

__all__ = ["SAMPLES", "Case", "as_measured", "case_of", "cases_of", "steady"]

Array = NDArray[np.float64]
SAMPLES = 1000  # of all motions, up to twice as many
BAND = 20.0  # Hz: largest cut-off; rigid bodies move more slowly
RESPONSE = 1.5  # over the cut-off: time (s) from a jump of friction within which the low-passed torque is another


@dataclass(frozen=True, eq=False)
class Case:
    """A model with the samples to explain: q, dq, ddq, dddq, tau (M, n), which of them count, and the lengths of the
    logs.

    ``noise`` (n) is the variance of the white noise in each torque; ``extra`` are columns (M, n) beside those of the
    model, and ``beyond`` the same at twice the speed; ``gain`` (n) are what the torques of the model are multiplied
    with; ``memory`` (M, m) is what the model remembers.
    """

    model: Model
    q: Array
    dq: Array
    ddq: Array
    dddq: Array
    tau: Array
    keep: NDArray[np.bool_]
    lengths: tuple[int, ...]
    noise: Array
    extra: tuple[Array, ...] = ()
    beyond: tuple[Array, ...] = ()
    gain: Array | float = 1.0
    memory: Array | None = None

    __repr__ = brief

    @property
    def states(self) -> dict[str, Array]:
        """The states of the samples by name, as ``Motion.states``."""
        found = {"q": self.q, "dq": self.dq, "ddq": self.ddq}
        return found if self.memory is None else found | {"memory": self.memory}

    def torque(self, theta: Array) -> Array:
        """Return the torque (M, n) of the model with parameters theta (p)."""
        return self.model.torque(**self.states, theta=theta) * self.gain


def case_of(
    model: Model,
    motions: Sequence[Motion],
    parallel_filter: ParallelFilter | None = None,
    min_speed: tuple[float, ...] | None = None,
    samples: int = SAMPLES,
) -> Case:
    """Return the case of a model and motions: low-passed as the recipe says, and thinned to ``samples``."""
    return cases_of(model, motions, parallel_filter, min_speed, (samples,))[0]


def cases_of(
    model: Model,
    motions: Sequence[Motion],
    parallel_filter: ParallelFilter | None,
    min_speed: tuple[float, ...] | None,
    samples: Sequence[int],
) -> list[Case]:
    """Return the cases of ``case_of`` for several numbers of samples."""
    given = [] if parallel_filter is None else [parallel_filter.cutoff_at(motion) for motion in motions]
    cutoff = min([BAND, *given])
    slow = [_low_passed(motion, cutoff) for motion in motions]
    calm = [steady(one, RESPONSE / cutoff) for one in slow]
    noise = _noise(motions, slow, calm, cutoff)
    return [_thinned(model, slow, calm, min_speed, noise, count) for count in samples]


def _thinned(
    model: Model,
    slow: Sequence[Motion],
    calm: Sequence[NDArray[np.bool_]],
    min_speed: tuple[float, ...] | None,
    noise: Array,
    samples: int,
) -> Case:
    """Return the case of about so many samples of low-passed motions, with the variance (n) of the noise in them."""
    rows = subsample(slow, samples)
    pairs = list(zip(slow, rows, strict=True))
    states, tau = together(slow, rows), np.concatenate([one.tau[kept] for one, kept in pairs])
    jerks = [np.gradient(one.ddq, one.t, axis=0)[kept] for one, kept in pairs]
    keep = [away[kept] & _fitted(one, min_speed, kept) for away, (one, kept) in zip(calm, pairs, strict=True)]
    q, dq, ddq = (states[name] for name in ("q", "dq", "ddq"))
    dddq, lengths, memory = np.concatenate(jerks), tuple(map(len, rows)), states.get("memory")
    return Case(model, q, dq, ddq, dddq, tau, np.concatenate(keep), lengths, noise, memory=memory)


def as_measured(model: Model, motions: Sequence[Motion], min_speed: tuple[float, ...] | None = None) -> Case:
    """Return the case of a model and motions, all samples as they are: neither low-passed nor without reversals."""
    states, tau = together(motions), np.concatenate([one.tau for one in motions])
    used = [one.mask[:, None] & (np.ones(one.q.shape, bool) if one.keep is None else one.keep) for one in motions]
    keep, fast = np.concatenate(used), fast_enough(states["dq"], min_speed)
    lengths = tuple(len(one) for one in motions)
    keep = keep if fast is None else keep & fast
    q, dq, ddq = (states[name] for name in ("q", "dq", "ddq"))
    none, noise = np.zeros_like(q), np.zeros(q.shape[1])
    return Case(model, q, dq, ddq, none, tau, keep, lengths, noise, memory=states.get("memory"))


def _fitted(motion: Motion, min_speed: tuple[float, ...] | None, rows: NDArray[np.intp]) -> NDArray[np.bool_]:
    kept = fitted_rows(motion, min_speed)
    return np.ones((len(rows), motion.q.shape[1]), dtype=bool) if kept is None else kept[rows]


def _noise(
    motions: Sequence[Motion], slow: Sequence[Motion], calm: Sequence[NDArray[np.bool_]], cutoff: float
) -> Array:
    """Return the variance (n) of white noise in the low-passed torques, from the octave above the cut-off, where the
    joints are ``calm`` (N, n)."""
    total, count = np.zeros(motions[0].q.shape[1]), 0
    for motion, one, away in zip(motions, slow, calm, strict=True):
        above = np.where(away, _low_passed(motion, 2.0 * cutoff, ("tau",)).tau - one.tau, 0.0)
        total += _white(motion, cutoff) * np.square(above).sum(axis=0)
        count = count + away.sum(axis=0)
    return np.asarray(total / np.maximum(count, 1))


def steady(motion: Motion, margin: float) -> NDArray[np.bool_]:
    """Return where each joint (N, n) does not reverse within ``margin`` (s)."""
    found = np.ones(motion.q.shape, dtype=bool)
    for j, dq in enumerate(motion.dq.T):
        turns = motion.t[np.flatnonzero(np.diff(np.signbit(dq)))]
        first, last = (np.searchsorted(turns, motion.t + side * margin) for side in (-1, 1))
        found[:, j] = first == last
    return found


def _white(motion: Motion, cutoff: float) -> float:
    """Return the energy of white noise that the low-pass leaves, over that in the octave above it."""
    low, high = _response(motion, cutoff), _response(motion, 2.0 * cutoff)
    above = float(np.square(high - low).sum())
    return float(np.square(low).sum()) / above if above > 0 else 0.0


def _response(motion: Motion, cutoff: float) -> Array:
    """Return the frequency response of ``_low_passed``, which has no phase, from zero to half the sampling rate."""
    low = _filter(motion, cutoff)
    return np.ones(512) if low is None else np.asarray(np.abs(response(low.sections(motion), 512)) ** 2)


def _low_passed(motion: Motion, cutoff: float, channels: Sequence[str] = ("q", "dq", "ddq", "tau")) -> Motion:
    low = _filter(motion, cutoff)
    return motion if low is None else low.filtered(motion, channels)


def _filter(motion: Motion, cutoff: float) -> ParallelFilter | None:
    """Return the low-pass, None where the motion is sampled too slowly to have anything above."""
    return ParallelFilter(cutoff=cutoff) if cutoff <= 0.4 / float(np.diff(motion.t).mean()) else None
