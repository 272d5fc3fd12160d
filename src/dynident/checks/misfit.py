"""What plain least squares leaves of the torque, and how much of it one more unknown would explain: score tests.

The torque and the motion are low-passed alike and thinned to a few thousand samples, which bounds the cost for long
logs. The parameters of the model are eliminated (variable projection; Golub and Pereyra 1973): of the derivative of the
torque by an unknown only the part orthogonal to the regressor counts, and its regression on the residual is one
Gauss-Newton step towards the unknown. An unknown whose derivative lies within the regressor cannot be seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief
from dynident.log import Motion, subsample
from dynident.models import Model, Parameter
from dynident.regression import ParallelFilter, Rank, fast_enough, rank_of, stretches
from dynident.validation import long_run

__all__ = ["Case", "Evidence", "Misfit", "case_of", "misfit"]

Array = NDArray[np.float64]
SAMPLES = 1000  # of all motions, up to twice as many
BAND = 20.0  # Hz: cut-off without a filter in the recipe; rigid bodies move more slowly
RESPONSE = 1.5  # over the cut-off: time (s) from a jump of friction within which the low-passed torque is another
WORTH = 0.1  # share of the squared residual that an unknown must explain: 5 % of the error
PART, LEAST = 0.3, 0.1  # or this part of what is not white noise, counted as at least that share
FOLDS = 5  # consecutive parts of the data; the value from the others must explain each of them
TELLING = 0.02  # share of an unknown's effect below which a part says nothing of its sign
ROUNDS = 3  # of the weights of the joints
UNSEEN = 1e-5  # share of a derivative, beside the regressor, below which it is rounding error
FLOOR = 1e-7  # share of a joint's torque below which its residual is rounding error


@dataclass(frozen=True, eq=False)
class Case:
    """A model with the samples to explain: q, dq, ddq, dddq, tau (M, n), which of them count, and the lengths of the
    logs.

    ``noise`` (n) is the variance of the white noise in each torque; ``extra`` are columns (M, n) beside those of the
    model, and ``beyond`` the same at twice the speed; ``gain`` (n) are what the torques of the model are multiplied
    with.
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

    __repr__ = brief

    def torque(self, theta: Array) -> Array:
        """Return the torque (M, n) of the model with parameters theta (p)."""
        return self.model.torque(self.q, self.dq, self.ddq, theta) * self.gain


@dataclass(frozen=True, eq=False)
class Evidence:
    """What one unknown explains: its ``value`` and ``std``; the ``share`` of the squared residual in all, by joint (n),
    and in parts of the data with the value from the other parts (``held_out``). ``agreed`` says that the value has the
    same sign in all parts.
    """

    value: float
    std: float
    share: float
    by_joint: Array
    held_out: float
    agreed: bool

    __repr__ = brief


@dataclass(frozen=True, eq=False)
class Misfit:
    """The fit of a case: parameters ``theta`` (p), and the ``residual`` (M, n) times the ``weight`` (M, n), which is
    zero for samples that do not count; ``basis`` (M n, r) spans the weighted regressor. ``theta`` has the file's values
    in the directions that the data leave free; ``extra`` are the values of the columns beside the model's;
    ``predicted`` (M, n) is the torque of the fit.
    """

    case: Case
    theta: Array
    extra: Array
    weight: Array
    basis: Array
    residual: Array
    predicted: Array

    __repr__ = brief

    @cached_property
    def torque(self) -> Array:
        """Torque (M, n) of the model alone, with the file's values where the data leave them free."""
        return self.case.torque(self.theta)

    @property
    def size(self) -> float:
        """Sum of squared weighted residuals."""
        return float(np.square(self.residual).sum())

    @property
    def worth(self) -> float:
        """Share of the squared residual that is worth a word: less where most of it is white noise."""
        all_of_it = (np.square(self.weight) * self.case.noise).sum(axis=0)
        noise = float(np.minimum(all_of_it, np.square(self.residual).sum(axis=0)).sum())
        return min(WORTH, PART * max(1.0 - noise / self.size, LEAST)) if self.size > 0 else WORTH

    @property
    def error(self) -> Array:
        """Relative error (n) of each joint's torque."""
        counted = np.where(self.case.keep, self.case.tau, 0.0)
        left = np.where(self.case.keep, self.case.tau - self.predicted, 0.0)
        torque = np.linalg.norm(counted, axis=0)
        return np.asarray(np.linalg.norm(left, axis=0) / np.where(torque > 0, torque, 1.0))

    def beside(self, column: Array) -> Array:
        """Return the weighted part (M, n) of a column (M, n) that the regressor does not span."""
        z = (column * self.weight).ravel()
        for _ in range(2):  # once more for the digits
            z = z - self.basis @ (self.basis.T @ z)
        return z.reshape(column.shape)

    def evidence(self, column: Array) -> Evidence | None:
        """Return what a column (M, n), the derivative of the torque by an unknown, explains; None where it cannot be
        seen."""
        z, r = self.beside(column), self.residual
        inner, norm = float((z * r).sum()), float((z * z).sum())
        if norm <= (UNSEEN * float(np.linalg.norm(column * self.weight))) ** 2 or not self.size > 0:
            return None
        value = inner / norm
        left = r - value * z
        scores = np.split((z * left).sum(axis=1)[:, None], np.cumsum(self.case.lengths)[:-1])
        std = float(np.sqrt(long_run(scores)[0, 0])) / norm
        before = np.square(r).sum(axis=0)
        by_joint = 1.0 - np.square(left).sum(axis=0) / np.where(before > 0, before, 1.0)
        return Evidence(value, std, inner**2 / norm / self.size, by_joint, *self._in_parts(z))

    def _in_parts(self, z: Array) -> tuple[float, bool]:
        """Return the share explained in each part with the value from the others, and whether all agree in sign."""
        inner, norm = (np.array([part.sum() for part in np.array_split(x, FOLDS)]) for x in (z * self.residual, z * z))
        others = norm.sum() - norm
        value = (inner.sum() - inner) / np.where(others > 0, others, 1.0)
        telling = inner[norm > TELLING * norm.sum()]
        return float((2 * value * inner - value**2 * norm).sum()) / self.size, bool(np.ptp(np.sign(telling)) == 0)


def case_of(
    model: Model,
    motions: Sequence[Motion],
    parallel_filter: ParallelFilter | None = None,
    min_speed: tuple[float, ...] | None = None,
    samples: int = SAMPLES,
) -> Case:
    """Return the case of a model and motions: low-passed as the recipe says, and thinned to ``samples``."""
    cutoff = BAND if parallel_filter is None else float(parallel_filter.cutoff or BAND)
    cutoff = min(cutoff, BAND)
    slow = [_low_passed(motion, cutoff) for motion in motions]
    rows = subsample(slow, samples)
    q, dq, ddq, tau = (
        np.concatenate([getattr(one, name)[kept] for one, kept in zip(slow, rows, strict=True)])
        for name in ("q", "dq", "ddq", "tau")
    )
    jerks = [np.gradient(one.ddq, one.t, axis=0)[kept] for one, kept in zip(slow, rows, strict=True)]
    steady = [_steady(one, RESPONSE / cutoff) for one in slow]
    keep = np.concatenate([one[kept] for one, kept in zip(steady, rows, strict=True)])
    fast = fast_enough(dq, min_speed)
    above = [_low_passed(motion, 2.0 * cutoff).tau - one.tau for motion, one in zip(motions, slow, strict=True)]
    noise = [np.where(one, np.square(x), 0.0).sum(axis=0) for x, one in zip(above, steady, strict=True)]
    count = np.maximum(np.sum([one.sum(axis=0) for one in steady], axis=0), 1)
    return Case(
        model,
        q,
        dq,
        ddq,
        np.concatenate(jerks),
        tau,
        keep if fast is None else keep & fast,
        tuple(map(len, rows)),
        _white(motions[0], cutoff) * np.sum(noise, axis=0) / count,
    )


def _steady(motion: Motion, margin: float) -> NDArray[np.bool_]:
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
    from scipy.signal import sosfreqz

    if not _lowers(motion, cutoff):
        return np.ones(512)
    return np.asarray(np.abs(sosfreqz(ParallelFilter(cutoff=cutoff).sections(motion))[1]) ** 2)


def _lowers(motion: Motion, cutoff: float) -> bool:
    return cutoff <= 0.4 / float(np.diff(motion.t).mean())


def _low_passed(motion: Motion, cutoff: float) -> Motion:
    if not _lowers(motion, cutoff):
        return motion
    low = ParallelFilter(cutoff=cutoff)
    sections = low.sections(motion)
    series = {name: getattr(motion, name).copy() for name in ("q", "dq", "ddq", "tau")}
    for part in stretches(motion.mask):
        if part.stop - part.start > 3 * low.order:
            for x in series.values():
                x[part] = low.apply(sections, x[part])
    return replace(motion, **series)


def misfit(case: Case, weight: Array | None = None) -> Misfit:
    """Return the fit of a case by least squares on the directions that the data determine.

    Each joint counts by one over the standard deviation of its residual, or by ``weight`` (n).
    """
    model, (rows, n) = case.model, case.q.shape
    Y = model.regressor(case.q, case.dq, case.ddq) * np.broadcast_to(case.gain, n)[:, None]
    Y = np.concatenate([Y, *(one[:, :, None] for one in case.extra)], axis=2)
    size = np.sqrt(np.square(case.tau).mean(axis=0))
    floor = FLOOR * np.where(size > 0, size, size.max(initial=0.0) or 1.0)
    given, shown = weight, None
    weight = 1.0 / np.maximum(size, floor) if given is None else given
    for k in range(ROUNDS if given is None else 1):
        W = np.where(case.keep, weight, 0.0)
        X, y = (Y * W[:, :, None]).reshape(rows * n, -1), (case.tau * W).ravel()
        Q, R = np.linalg.qr(X)
        rank = _rank(R, model, len(case.extra), shown)
        shown = shown or rank
        basis = Q @ rank.left[:, : rank.rank]
        inner = basis.T @ y
        residual = (y - basis @ inner).reshape(rows, n)
        if given is None and k < ROUNDS - 1:
            count = np.maximum(case.keep.sum(axis=0), 1)
            deviation = np.linalg.norm(residual, axis=0) / np.sqrt(count) / weight
            weight = 1.0 / np.maximum(deviation, floor)
    theta = rank.determined @ (inner / rank.values[: rank.rank])
    return Misfit(case, _completed(theta, model, rank), theta[len(model.parameters) :], W, basis, residual, Y @ theta)


def _rank(R: Array, model: Model, extra: int, shown: Rank | None) -> Rank:
    parameters = (*model.parameters, *(Parameter(f"extra {k}", "") for k in range(extra)))
    return rank_of(R, parameters, None, shown)


def _completed(theta: Array, model: Model, rank: Rank) -> Array:
    """Return the parameters of the model with the file's values in the directions that the data leave free."""
    nominal = np.zeros_like(theta)
    nominal[: len(model.parameters)] = [parameter.value or 0.0 for parameter in model.parameters]
    free = rank.vectors[:, rank.rank :]
    found = theta + free @ (free.T @ (nominal * rank.scale)) / rank.scale
    return np.asarray(found[: len(model.parameters)])
