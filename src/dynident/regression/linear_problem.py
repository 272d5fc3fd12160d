"""The linear problem y = X theta + e, eqs. (9)-(10): streamed block by block to one triangular factor per joint."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ConfigError, InputError, brief
from dynident.log import Motion
from dynident.models import Model
from dynident.smoothers import cutoff_complaint
from dynident.splines import stretches

__all__ = [
    "BLOCK",
    "HIGHEST_ORDER",
    "ParallelFilter",
    "Regression",
    "RegressorBlock",
    "TriangularFactors",
    "fast_enough",
    "fitted_rows",
    "one_thread",
    "stretches",
    "triangularise",
]

Array = NDArray[np.float64]
BLOCK = 4096
HIGHEST_ORDER = 12  # order of a digital filter: poles of higher ones are lost in rounding


@dataclass(frozen=True)
class ParallelFilter:
    """Parallel filtering: the same zero-phase low-pass and decimation for the torque and every regressor column.

    The relation tau = Y theta holds exactly after a linear filter. ``decimate`` keeps every k-th sample; ``cutoff``
    (Hz) is that of the Butterworth filter of ``order``, applied forward and backward; None takes 0.8 of the Nyquist
    frequency after decimation. Reference: Gautier and Poignet (2000), cited by the article.

    >>> import dynident as dy
    >>> dy.ParallelFilter(decimate=10, cutoff=20.0)
    ParallelFilter(decimate=10, cutoff=20.0, order=4)
    """

    decimate: int = 1
    cutoff: float | None = None
    order: int = 4

    def __post_init__(self) -> None:
        whole = all(isinstance(number, (int, np.integer)) and number >= 1 for number in (self.decimate, self.order))
        if not whole or self.order > HIGHEST_ORDER or not (self.cutoff is None or self.cutoff > 0):
            raise ConfigError(
                f"parallel filter: decimate = {self.decimate} must be a whole number from 1, order = {self.order} one "
                f"from 1 to {HIGHEST_ORDER}, and cutoff = {self.cutoff} positive (Hz)."
            )
        if self.decimate == 1 and self.cutoff is None:
            raise ConfigError("parallel filter: give decimate > 1, a cutoff in Hz, or both.")

    def sections(self, motion: Motion) -> Array:
        """Return the filter's second-order sections for the mean rate of a motion."""
        from scipy.signal import butter

        cutoff, of = self.cutoff_at(motion), "" if self.cutoff else f" for decimate = {self.decimate},"
        if wrong := cutoff_complaint(f"the parallel filter's cut-off{of}", cutoff, motion.t):
            raise ConfigError(f"{motion.source}: {wrong}")
        return np.asarray(butter(self.order, cutoff, fs=_rate(motion), output="sos"))

    def cutoff_at(self, motion: Motion) -> float:
        """Return the cut-off (Hz) for a motion."""
        return self.cutoff or 0.4 * _rate(motion) / self.decimate

    def filtered(self, motion: Motion) -> Motion:
        """Return a motion with q, dq, ddq and tau filtered in each stretch of usable samples, and not decimated."""
        sections = self.sections(motion)
        series = {name: getattr(motion, name).copy() for name in ("q", "dq", "ddq", "tau")}
        for part in stretches(motion.mask):
            for x in series.values() if part.stop - part.start > 1 else ():
                x[part] = self.apply(sections, x[part])
        return replace(motion, **series)

    def pad(self, sections: Array) -> int:
        """Return the number of samples in which the filter's response decays to about 1e-12."""
        poles = np.concatenate([np.roots(row[3:]) for row in sections])
        slowest = np.abs(poles).max(initial=0.1)  # a pole at zero has no logarithm
        return int(np.ceil(np.log(1e-12) / np.log(slowest)))

    def apply(self, sections: Array, x: Array) -> Array:
        """Return x (N, ...) filtered at all N samples, not yet decimated."""
        from scipy.signal import sosfiltfilt

        return np.asarray(sosfiltfilt(sections, x, axis=0, padlen=min(3 * self.order, len(x) - 1)))


def _rate(motion: Motion) -> float:
    return 1.0 / float(np.diff(motion.t).mean())


@dataclass(frozen=True, eq=False)
class RegressorBlock:
    """Some rows of the problem: ``Y`` (B, n, p), ``tau`` (B, n), and which of them to use, ``keep`` (B, n) or all."""

    Y: Array
    tau: Array
    keep: NDArray[np.bool_] | None = None

    __repr__ = brief

    def times(self, weight: Array) -> RegressorBlock:
        """Return the block with each row multiplied by its weight (B, n)."""
        return RegressorBlock(self.Y * weight[:, :, None], self.tau * weight, self.keep)


@dataclass(frozen=True, eq=False)
class TriangularFactors:
    """The sufficient statistics of least squares for any number of rows: per joint the R factor of [Y_j | tau_j].

    ``factors`` (n, p + 1, p + 1), upper triangular; ``rows`` (n) is the number of rows behind each of them.
    """

    factors: Array
    rows: NDArray[np.int_]

    __repr__ = brief

    @property
    def samples(self) -> int:
        """The largest number of rows of a joint."""
        return int(self.rows.max())

    @property
    def total(self) -> int:
        """The number of rows of all joints."""
        return int(self.rows.sum())

    def stacked(self, weights: Array | None = None) -> Array:
        """Return one factor (p + 1, p + 1) of all joints, each multiplied by its weight (n) (one over its noise)."""
        factors = self.factors if weights is None else self.factors * np.asarray(weights)[:, None, None]
        if len(factors) == 1:
            return np.asarray(factors[0])
        with one_thread():
            return _triangle(np.concatenate(factors))

    def residual(self, theta: Array) -> Array:
        """Return the sum of squared residuals of each joint (n) at theta (p)."""
        return np.asarray(np.square(self.factors @ np.append(-theta, 1.0)).sum(axis=1))

    def less(self, theta: Array) -> TriangularFactors:
        """Return the factors of the torque less that of theta (p)."""
        factors = self.factors.copy()
        factors[:, :, -1] -= self.factors[:, :, :-1] @ theta
        return TriangularFactors(factors, self.rows)


@dataclass(frozen=True, eq=False)
class Regression:
    """The torque equation of a model over any number of motions; only samples inside the masks are used.

    The matrix is never formed whole: ``blocks`` computes it a few thousand samples at a time, on every call;
    ``triangular_factors`` caches its triangular factors. ``min_speed`` (n), in rad/s or m/s, leaves out of each joint's
    equation the samples at which that joint is slower, where the friction model is poor; None leaves none out.
    ``weights`` multiply the rows of each motion, one (N, n) for each, after any filter; empty: all rows count the same.
    ``bias`` (p) is taken off the solution: the torque is that of the motions less Y bias.
    """

    model: Model
    motions: tuple[Motion, ...]
    filter: ParallelFilter | None = None
    min_speed: tuple[float, ...] | None = None
    weights: tuple[Array, ...] = ()
    bias: Array | None = None

    __repr__ = brief

    def __post_init__(self) -> None:
        names = tuple(joint.name for joint in self.model.joints)
        for motion in self.motions:
            if motion.joints != names:
                raise InputError(f"{motion.source}: has the joints {motion.joints}, the model {names}.")
        self._check_min_speed(names)
        shapes = [motion.q.shape for motion in self.motions]
        if self.weights and [weight.shape for weight in self.weights] != shapes:
            raise ConfigError(f"weights have shapes {[w.shape for w in self.weights]}, the motions {shapes}.")

    def _check_min_speed(self, names: tuple[str, ...]) -> None:
        if self.min_speed is not None and (
            len(self.min_speed) != len(names) or not all(v >= 0 for v in self.min_speed)
        ):
            raise ConfigError(
                f"min_speed = {self.min_speed}: give a speed >= 0 for each of the joints {', '.join(names)}."
            )

    def blocks(self) -> Iterator[RegressorBlock]:
        """Yield the rows block by block, filtered and decimated where ``filter`` says so, and weighted."""
        for _, _, block in self._placed():
            yield block if self.bias is None else replace(block, tau=block.tau - block.Y @ self.bias)

    def unbiased(self, bias: Array) -> Regression:
        """Return the regression whose solution is less by ``bias`` (p), with the factors that follow from these."""
        found = replace(self, bias=bias if self.bias is None else self.bias + bias)
        found.__dict__["triangular_factors"] = self.triangular_factors.less(bias)
        return found

    def pulls(self, torques: Sequence[Array], weights: Array | None = None) -> Array:
        """Return sum w_j^2 Y_j' c_j (p, k) of other torques c, for each motion (N, n, k), with ``weights`` w (n)."""
        w2 = np.ones(len(self.model.joints)) if weights is None else np.square(weights)
        total = np.zeros((len(self.model.parameters), torques[0].shape[2]))
        for k, kept, block in self._placed():
            c = torques[k]
            if self.filter is not None:  # as far as it matters: the ends of a stretch are not treated apart
                c = self.filter.apply(self.filter.sections(self.motions[k]), c)
            Y = block.Y * (w2 if block.keep is None else block.keep * w2)[..., None]
            rows = c[kept] * self.weights[k][kept][:, :, None] if self.weights else c[kept]
            total += np.einsum("bjp,bjk->pk", Y, rows, optimize=True)
        return total

    def _placed(self) -> Iterator[tuple[int, slice, RegressorBlock]]:
        """Yield each block with the place of its motion, and of its rows in this motion."""
        for k, motion in enumerate(self.motions):
            for part in stretches(motion.mask):
                rows = self._plain if self.filter is None else partial(self._filtered, parallel_filter=self.filter)
                for kept, block in rows(motion, part):
                    yield k, kept, block.times(self.weights[k][kept]) if self.weights else block

    @cached_property
    def triangular_factors(self) -> TriangularFactors:
        """The triangular factors; InputError where there are not more rows than parameters."""
        found = triangularise(self.blocks(), len(self.model.joints), len(self.model.parameters))
        unknowns = len(self.model.parameters)
        if not unknowns:
            raise ConfigError(f"{self.model.name}: the model has no parameters to estimate.")
        if found.total <= unknowns:
            raise InputError(
                f"{', '.join(motion.source for motion in self.motions)}: {found.samples} usable samples of "
                f"{len(self.model.joints)} joints are too few for {unknowns} parameters; record longer."
            )
        return found

    def _plain(self, motion: Motion, part: slice) -> Iterator[tuple[slice, RegressorBlock]]:
        for start in range(part.start, part.stop, BLOCK):
            rows = slice(start, min(start + BLOCK, part.stop))
            yield rows, self._rows(motion, rows)

    def _filtered(
        self, motion: Motion, part: slice, parallel_filter: ParallelFilter
    ) -> Iterator[tuple[slice, RegressorBlock]]:
        """Filter pieces that overlap by the filter's response time, so that the pieces join exactly."""
        sections, step = parallel_filter.sections(motion), parallel_filter.decimate
        pad = parallel_filter.pad(sections)
        size = -(-max(BLOCK, 4 * pad) // step) * step
        for start in range(part.start, part.stop, size):
            stop = min(start + size, part.stop)
            first, last = max(part.start, start - pad), min(part.stop, stop + pad)
            if last - first < 2:
                continue
            rows = self._rows(motion, slice(first, last))
            kept = slice(start - first, stop - first, step)
            Y, tau = (parallel_filter.apply(sections, x)[kept] for x in (rows.Y, rows.tau))
            yield slice(start, stop, step), RegressorBlock(Y, tau, None if rows.keep is None else rows.keep[kept])

    def _rows(self, motion: Motion, rows: slice) -> RegressorBlock:
        q, dq, ddq = motion.q[rows], motion.dq[rows], motion.ddq[rows]
        return RegressorBlock(
            self.model.regressor(q, dq, ddq), motion.tau[rows], fitted_rows(motion, self.min_speed, rows)
        )


def fast_enough(dq: Array, min_speed: tuple[float, ...] | None) -> NDArray[np.bool_] | None:
    """Return where each joint (N, n) is at least as fast as ``min_speed`` (n); None for everywhere."""
    return None if min_speed is None else np.abs(dq) >= np.array(min_speed)


def fitted_rows(
    motion: Motion, min_speed: tuple[float, ...] | None, rows: slice = slice(None)
) -> NDArray[np.bool_] | None:
    """Return which torque equations (B, n) of these samples are fitted: of joints that are fast enough, where the
    motion keeps them; None for all."""
    fast = fast_enough(motion.dq[rows], min_speed)
    if motion.keep is None:
        return fast
    return motion.keep[rows] if fast is None else fast & motion.keep[rows]


def triangularise(blocks: Iterator[RegressorBlock], joints: int, parameters: int) -> TriangularFactors:
    """Reduce blocks to triangular factors, merging as they come (TSQR): memory does not grow with the rows."""
    factors = np.zeros((joints, parameters + 1, parameters + 1))
    count = np.zeros(joints, dtype=int)

    def merge(block: RegressorBlock) -> None:
        """Reduce the factors so far and a block to new factors."""
        # all joints in one call, so that the next block is computed meanwhile; rows of zeros do not change a factor
        rows = np.concatenate((block.Y, block.tau[:, :, None]), axis=2).swapaxes(0, 1)
        rows = rows if block.keep is None else rows * block.keep.T[:, :, None]
        factors[:] = _triangle(np.concatenate((factors, rows), axis=1))
        count[:] += len(block.tau) if block.keep is None else block.keep.sum(axis=0)

    with one_thread(), ThreadPoolExecutor(1) as worker:
        merging: Future[None] | None = None
        for block in blocks:  # the next block is made while this one is factorised
            if merging is not None:
                merging.result()
            merging = worker.submit(merge, block)
        if merging is not None:
            merging.result()
    return TriangularFactors(factors, count)


def _triangle(rows: Array) -> Array:
    return np.asarray(np.linalg.qr(rows, mode="r"))


@cache
def _controller() -> Any:
    import scipy.linalg  # noqa: F401  # SciPy's own BLAS must be loaded to be found
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


def one_thread() -> Any:
    """Limit BLAS to one thread: with several, the many small factorisations run several times slower."""
    return _controller().limit(limits=1, user_api="blas")
