"""The residual of plain least squares, and how much of it one more unknown would explain: score tests.

The parameters of the model are eliminated (variable projection; Golub and Pereyra 1973): of the derivative of
the torque with respect to an unknown only the part orthogonal to the regressor counts, and its regression on
the residual is one Gauss-Newton step towards the unknown. An unknown whose derivative lies within the
regressor cannot be seen.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import cached_property
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from dynident.models import Model, Parameter
from dynident.motion.filters import frequency_response
from dynident.motion.log import Motion, stack_states, subsample
from dynident.regression import EntryBlock, ParallelFilter, Rank, TriangularFactors, factorise, fitted_mask, rank_of
from dynident.regression.whitening import long_run
from dynident.runtime import Noun
from dynident.runtime.arrays import Array

CASE_SAMPLES = 1000  # of all motions, up to twice as many
MAX_CUTOFF = 20.0  # Hz: largest cut-off; rigid bodies move more slowly
REVERSAL_MARGIN = 1.5  # over the cut-off: time (s) from a jump of friction within which the low-passed torque differs
BATCH_COLUMNS = 64  # columns that are tested together
MIN_EXPLAINED_SHARE = 0.1  # share of the squared residual that an unknown must explain: 5 % of the error
# or this part of what is not white noise, counted as at least that share
COLOURED_NOISE_SHARE, MIN_COLOURED_SHARE = 0.3, 0.1
FOLDS = 5  # consecutive parts of the data; the value from the others must explain each of them
MIN_FOLD_NORM_SHARE = 0.02  # share of an unknown's effect below which a part says nothing of its sign
WEIGHT_ROUNDS = 3  # of the weights of the joints
MIN_VISIBLE_SHARE = 1e-5  # share of a derivative, beside the regressor, below which it is rounding error
MIN_RESIDUAL_SHARE = 1e-7  # share of a joint's torque below which its residual is rounding error


class FitCase(Noun):
    """A model with the samples that it has to explain.

    q, dq, ddq, dddq, tau and ``keep`` are (M, n); the last tells which samples count. ``lengths`` are the numbers
    of samples of the logs. ``noise`` (n) is the variance of the white noise in each torque; ``extra`` are columns
    (M, n) beside those of the model, ``beyond`` the same at twice the speed; ``gain`` (n) multiplies the
    torques of the model; ``memory`` (M, m) is the internal state of terms that have one.
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

    @property
    def states(self) -> dict[str, Array]:
        """The states of the samples by name, as ``Motion.states``."""
        arrays = {"q": self.q, "dq": self.dq, "ddq": self.ddq}
        return arrays if self.memory is None else arrays | {"memory": self.memory}

    def torque(self, theta: Array) -> Array:
        """Return the torque (M, n) of the model with parameters theta (p)."""
        return self.model.torque(**self.states, theta=theta) * self.gain

    def column_of_joint(self, j: int, x: Array) -> Array:
        """Return columns (M, n) that are x (M) at joint j and zero elsewhere."""
        return np.where(np.arange(self.q.shape[1]) == j, x[:, None], 0.0)


def fit_case(
    model: Model,
    motions: Sequence[Motion],
    parallel_filter: ParallelFilter | None = None,
    min_speed: tuple[float, ...] | None = None,
    samples: int = CASE_SAMPLES,
) -> FitCase:
    """Return the case of a model and motions, low-passed as the recipe says and thinned to ``samples``."""
    return fit_cases(model, motions, parallel_filter, min_speed, (samples,))[0]


def fit_cases(
    model: Model,
    motions: Sequence[Motion],
    parallel_filter: ParallelFilter | None,
    min_speed: tuple[float, ...] | None,
    samples: Sequence[int],
) -> list[FitCase]:
    """Return the cases of ``fit_case`` for several numbers of samples."""
    cutoffs = [] if parallel_filter is None else [parallel_filter.cutoff_at(motion) for motion in motions]
    cutoff = min([MAX_CUTOFF, *cutoffs])
    # low-pass all motions once, then thin them for each number of samples
    filtered_motions = [_low_pass(motion, cutoff) for motion in motions]
    steady_masks = [steady_mask(motion, REVERSAL_MARGIN / cutoff) for motion in filtered_motions]
    noise = _noise_variance(motions, filtered_motions, steady_masks, cutoff)
    # a torque that is the same throughout one log, and not in another, was not recorded there
    varies = np.array([np.ptp(motion.tau, axis=0) > 0 for motion in motions])
    live = varies | ~varies.any(axis=0)
    masks = [steady & live_in_log for steady, live_in_log in zip(steady_masks, live, strict=True)]
    jerks = [np.gradient(motion.ddq, motion.t, axis=0) for motion in filtered_motions]  # for differences in time
    # thin all signals by the same rows, so that they stay aligned
    thinned = [subsample(filtered_motions, count) for count in samples]
    return [_stacked_case(model, filtered_motions, rows, min_speed, noise, masks, jerks) for rows in thinned]


def measured_case(model: Model, motions: Sequence[Motion], min_speed: tuple[float, ...] | None = None) -> FitCase:
    """Return the case of a model and motions with all samples as measured: not low-passed, and reversals included."""
    rows, zeros = [np.arange(len(motion)) for motion in motions], [np.zeros_like(motion.q) for motion in motions]
    return _stacked_case(model, motions, rows, min_speed, zeros[0][0], [x == 0 for x in zeros], zeros)


def _stacked_case(
    model: Model, motions: Sequence[Motion], rows: Sequence[NDArray[np.intp]], min_speed: tuple[float, ...] | None,
    noise: Array, masks: Sequence[NDArray[np.bool_]], jerks: Sequence[Array],
) -> FitCase:  # fmt: skip
    """Return the case of the ``rows`` of motions where ``masks`` (N, n) are True, with their ``jerks`` (N, n)."""
    pairs, states = list(zip(motions, rows, strict=True)), stack_states(motions, rows)
    tau = np.concatenate([motion.tau[indices] for motion, indices in pairs])
    dddq, keep = (
        np.concatenate([x[indices] for x, indices in zip(arrays, rows, strict=True)]) for arrays in (jerks, masks)
    )
    keep &= np.concatenate([fitted_mask(motion, min_speed, indices) for motion, indices in pairs])
    q, dq, ddq, lengths = states["q"], states["dq"], states["ddq"], tuple(map(len, rows))
    return FitCase(model, q, dq, ddq, dddq, tau, keep, lengths, noise, memory=states.get("memory"))


def _noise_variance(
    motions: Sequence[Motion],
    filtered_motions: Sequence[Motion],
    steady_masks: Sequence[NDArray[np.bool_]],
    cutoff: float,
) -> Array:
    """Return the variance (n) of the white noise in the low-passed torques, from the octave above the cut-off.

    Only samples away from reversals count, where ``steady_masks`` (N, n) are True.
    """
    # pool the noise over all motions, which share their sensors
    total, count = np.zeros(motions[0].q.shape[1]), 0
    for motion, filtered_motion, steady in zip(motions, filtered_motions, steady_masks, strict=True):
        # above the cut-off rigid bodies hardly move: what is left in that octave is taken as white noise
        octave = np.where(steady, _low_pass(motion, 2.0 * cutoff, ("tau",)).tau - filtered_motion.tau, 0.0)
        total += _white_noise_ratio(motion, cutoff) * np.square(octave).sum(axis=0)
        count = count + steady.sum(axis=0)
    return np.asarray(total / np.maximum(count, 1))


def steady_mask(motion: Motion, margin: float) -> NDArray[np.bool_]:
    """Return where each joint (N, n) does not reverse within ``margin`` (s)."""
    mask = np.ones(motion.q.shape, dtype=bool)
    for j, dq in enumerate(motion.dq.T):
        turns = motion.t[np.flatnonzero(np.diff(np.signbit(dq)))]
        # no reversal lies in the window where as many come before its start as before its end
        turns_before, turns_until = (np.searchsorted(turns, motion.t + side * margin) for side in (-1, 1))
        mask[:, j] = turns_before == turns_until
    return mask


def _white_noise_ratio(motion: Motion, cutoff: float) -> float:
    """Return the energy of white noise that passes the low-pass, relative to that in the octave above it."""

    def response(cutoff: float) -> Array:
        """Return that of the low-pass, which has no phase, from zero to half the sampling rate."""
        low = _low_pass_filter(motion, cutoff)
        return np.ones(512) if low is None else np.asarray(np.abs(frequency_response(low.sections(motion), 512)) ** 2)

    low, high = response(cutoff), response(2.0 * cutoff)
    octave = float(np.square(high - low).sum())
    return float(np.square(low).sum()) / octave if octave > 0 else 0.0


def _low_pass(motion: Motion, cutoff: float, channels: Sequence[str] = ("q", "dq", "ddq", "tau")) -> Motion:
    low = _low_pass_filter(motion, cutoff)
    return motion if low is None else low.filter_motion(motion, channels)


def _low_pass_filter(motion: Motion, cutoff: float) -> ParallelFilter | None:
    """Return the low-pass filter, None where the motion is sampled too slowly to contain higher frequencies."""
    return ParallelFilter(cutoff=cutoff) if cutoff <= 0.4 / float(np.diff(motion.t).mean()) else None


class ScoreTest(Noun):
    """The score test of one unknown, on a weighted ``residual`` (M, n) of consecutive logs of the given ``lengths``.

    ``z`` (M, n) is the part of the torque's derivative with respect to it that nothing else explains.
    """

    residual: Array
    z: Array
    lengths: tuple[int, ...]

    @cached_property
    def value(self) -> float:
        """Least squares estimate of the unknown."""
        return float(np.vdot(self.z, self.residual)) / self._norm

    @cached_property
    def share(self) -> float:
        """Share of the squared residual that the unknown explains."""
        return self.value**2 * self._norm / float(np.vdot(self.residual, self.residual))

    @cached_property
    def by_joint(self) -> Array:
        """Share of each joint's squared residual (n) that the unknown explains."""
        before, after = (np.square(x).sum(axis=0) for x in (self.residual, self._remaining_residual))
        return np.asarray(1.0 - after / np.where(before > 0, before, 1.0))

    @cached_property
    def std(self) -> float:
        """Standard error of the value, robust to correlated residuals."""
        scores = np.split((self.z * self._remaining_residual).sum(axis=1)[:, None], np.cumsum(self.lengths)[:-1])
        return float(np.sqrt(long_run(scores)[0, 0])) / self._norm

    @cached_property
    def held_out(self) -> float:
        """Share explained in each part of the data with the value from the other parts, over all parts."""
        # leave-one-part-out: the value of the other parts, applied to each part
        inner, norm = self._fold_sums
        other_norms = norm.sum() - norm
        value = (inner.sum() - inner) / np.where(other_norms > 0, other_norms, 1.0)
        return float((2 * value * inner - value**2 * norm).sum()) / float(np.vdot(self.residual, self.residual))

    @property
    def has_constant_sign(self) -> bool:
        """Whether the value has the same sign in all parts."""
        inner, norm = self._fold_sums
        return bool(np.ptp(np.sign(inner[norm > MIN_FOLD_NORM_SHARE * norm.sum()])) == 0)

    @cached_property
    def _norm(self) -> float:
        return float(np.vdot(self.z, self.z))

    @cached_property
    def _remaining_residual(self) -> Array:
        return self.residual - self.value * self.z

    @cached_property
    def _fold_sums(self) -> tuple[Array, Array]:
        """Inner products with the residual, and squared norms, of consecutive parts of the data."""
        inner, norm = (np.array_split(x.sum(axis=1), FOLDS) for x in (self.z * self.residual, np.square(self.z)))
        return np.array([x.sum() for x in inner]), np.array([x.sum() for x in norm])


class Misfit(Noun):
    """The fit of a case: parameters ``theta`` (p), and the ``residual`` (M, n) multiplied by the ``weight`` (M, n).

    The weight is zero for samples that do not count; ``basis`` (M n, r) spans the weighted regressor. ``theta``
    has the file's values in the directions that the data leave free; ``extra`` are the values of the columns
    beside the model's; ``predicted`` (M, n) is the torque of the fit.
    """

    case: FitCase
    theta: Array
    extra: Array
    weight: Array
    basis: Array
    residual: Array
    predicted: Array

    @cached_property
    def torque(self) -> Array:
        """Torque (M, n) of the model alone, with the file's values where the data leave them free."""
        return self.case.torque(self.theta)

    @property
    def size(self) -> float:
        """Sum of squared weighted residuals."""
        return float(np.square(self.residual).sum())

    @property
    def min_share(self) -> float:
        """Share of the squared residual that an unknown must explain: smaller where most of it is white noise."""
        white_noise = (np.square(self.weight) * self.case.noise).sum(axis=0)
        noise = float(np.minimum(white_noise, np.square(self.residual).sum(axis=0)).sum())
        coloured = max(1.0 - noise / self.size, MIN_COLOURED_SHARE) if self.size > 0 else np.inf
        return min(MIN_EXPLAINED_SHARE, COLOURED_NOISE_SHARE * coloured)

    @property
    def unweighted(self) -> Array:
        """Residual (M, n) in N m or N, zero for samples that do not count."""
        return np.where(self.case.keep, self.case.tau - self.predicted, 0.0)

    @property
    def error(self) -> Array:
        """Relative error (n) of each joint's torque."""
        torque = np.linalg.norm(np.where(self.case.keep, self.case.tau, 0.0), axis=0)
        return np.asarray(np.linalg.norm(self.unweighted, axis=0) / np.where(torque > 0, torque, 1.0))

    def orthogonal_part(self, columns: Array) -> Array:
        """Return the weighted part (K, M, n) of columns (K, M, n) that is orthogonal to the regressor."""
        z = (columns * self.weight).reshape(len(columns), -1)
        for _ in range(2):  # once more for the digits
            z = z - (z @ self.basis) @ self.basis.T
        return z.reshape(columns.shape)

    def score_tests(self, columns: Iterable[Array]) -> Iterator[ScoreTest | None]:
        """Yield the score test of each column (M, n), the derivative of the torque with respect to an unknown.

        Yields None for a column that lies within the regressor, and so cannot be seen.
        """
        remaining = iter(columns)
        # together they are projected much faster than one by one
        while batch := list(islice(remaining, BATCH_COLUMNS)):
            for column, z in zip(batch, self.orthogonal_part(np.array(batch)), strict=True):
                threshold = MIN_VISIBLE_SHARE * float(np.linalg.norm(column * self.weight))
                is_visible = float(np.linalg.norm(z)) > threshold and self.size > 0
                yield ScoreTest(self.residual, z, self.case.lengths) if is_visible else None


def misfit(case: FitCase, weight: Array | None = None) -> Misfit:
    """Return the fit of a case by least squares on the directions that the data determine.

    Each joint counts by one over the standard deviation of its residual, or by ``weight`` (n).
    """
    (rows, n), n_parameters = case.q.shape, len(case.model.parameters)
    block = _entry_block(case)
    factors = factorise([block], block.structure)
    size = np.sqrt(np.square(case.tau).mean(axis=0))
    # the floor keeps rounding errors of a perfect fit from dominating the weights
    floor = MIN_RESIDUAL_SHARE * np.where(size > 0, size, size.max(initial=0.0) or 1.0)
    # weight each joint by its residual, iterated from the size of its torque unless weights are given
    has_fixed_weight, weight = weight is not None, 1.0 / np.maximum(size, floor) if weight is None else weight
    theta, rank = _solve_weighted(factors, weight, case)
    for _ in range(0 if has_fixed_weight else WEIGHT_ROUNDS - 1):
        weight = 1.0 / np.maximum(np.sqrt(factors.residual(theta) / np.maximum(factors.rows, 1)), floor)
        theta, rank = _solve_weighted(factors, weight, case, rank.unweighted or rank)
    # the rank gives an orthonormal basis of the weighted regressor, by which it is projected out of the torque
    W = np.where(case.keep, weight, 0.0)
    directions = rank.determined_directions / rank.values[: rank.rank]
    basis = block.scale_rows(W.T).regressor(directions).reshape(rows * n, -1)
    residual = (case.tau * W).ravel()
    for _ in range(2):  # once more for the digits
        residual = residual - basis @ (basis.T @ residual)
    full_theta = _complete_parameters(theta, case.model, rank)
    return Misfit(case, full_theta, theta[n_parameters:], W, basis, residual.reshape(rows, n), block.torque(theta).T)


def _entry_block(case: FitCase) -> EntryBlock:
    """Return the regressor rows of a case, with the columns beside those of the model."""
    structure, n = case.model.structure, case.q.shape[1]
    # the gain multiplies the torque of the model, and so the rows of its regressor
    entries = case.model.entries(**case.states, joint=structure.joint, parameter=structure.parameter)
    entries *= np.broadcast_to(case.gain, n)[structure.joint, None]
    rows = [
        row
        for j, part in enumerate(structure.parts)
        for row in (entries[part], *(column[None, :, j] for column in case.extra))
    ]
    return EntryBlock(structure.append_columns(len(case.extra)), np.concatenate(rows), case.tau.T, case.keep.T)


def _solve_weighted(
    factors: TriangularFactors, weight: Array, case: FitCase, unweighted_rank: Rank | None = None
) -> tuple[Array, Rank]:
    """Return the parameters with those of the extra columns, and the rank, from that without weights where given."""
    extra = (Parameter(f"extra {k}", "") for k in range(len(case.extra)))
    R = factors.stack(weight)
    rank = rank_of(R, (*case.model.parameters, *extra), None, unweighted_rank)
    p = R.shape[1] - 1
    theta = rank.determined_directions @ (rank.left_vectors[:, : rank.rank].T @ R[:p, p] / rank.values[: rank.rank])
    return np.asarray(theta), rank


def _complete_parameters(theta: Array, model: Model, rank: Rank) -> Array:
    """Return the parameters of the model, with the file's values in the directions that the data leave free."""
    nominal = np.zeros_like(theta)
    nominal[: len(model.parameters)] = [parameter.value or 0.0 for parameter in model.parameters]
    # directions without singular values are free: there the scaled parameters keep the file's values
    free = rank.vectors[:, rank.rank :]
    full_theta = theta + free @ (free.T @ (nominal * rank.scale)) / rank.scale
    return np.asarray(full_theta[: len(model.parameters)])
