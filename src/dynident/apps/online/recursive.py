"""Recursive least squares by square roots: one triangular factor that rows enter, and that forgets by
group.

The factor R of the weighted rows [X | y] so far is all that least squares needs of them
(``regression/triangular.py``), so that memory and time per sample do not grow. Rows enter by Householder
reflections of [R; rows], never by squares.

Forgetting multiplies rows of R. Its first row holds all that is known of the first parameter once all
others are given, the next one what is known of the second given those after it, and so on. With the
parameters that change fastest first, multiplying the rows of a group by exp(-t / (2 T)) forgets it over
T seconds, keeps what is known of those after it, and keeps the solution of R theta = y. It is the step
of a Kalman filter whose process noise is, in each direction, the share exp(t / T) - 1 of the variance
given all that is forgotten more slowly. What no motion shows is not forgotten below a share of the most
that was ever known of it, so that an estimate is not lost while the robot rests.

References: Bierman (1977), "Factorization methods for discrete sequential estimation"; Parkum, Poulsen
and Holst (1992), "Recursive forgetting algorithms".
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynident.estimators import Estimate, Estimator, LeastSquares, Problem, Residual
from dynident.models import Model
from dynident.regression import (
    GroupKind,
    Regression,
    RegressorBlock,
    TriangularFactors,
    independent_columns,
    kinds_of,
    one_thread,
    structural_base_parameters,
)
from dynident.runtime import ConfigError, InputError, call_part
from dynident.runtime.arrays import Array

PANEL_COLUMNS = 16  # columns that LAPACK eliminates together
BATCH_SAMPLES = 64  # samples that are computed together, as each call has its cost
FORGETTING_STEPS = 100  # of forgetting in the shortest memory
# of the largest pivot that a parameter ever had: it is not forgotten further, 0.1 % of the information
MIN_PIVOT_SHARE = 0.03
MIN_ROWS_PER_PARAMETER = 10  # rows for each parameter: of fewer the residual is not forgotten
PIVOT_TOLERANCE = 1e-10  # of its column: a smaller pivot is rounding
SIGNAL_NAMES = ("q", "dq", "ddq", "tau")


class RecursiveLeastSquares:
    """The least-squares fit of a model to all samples so far, or to the latest, of which none is kept.

    ``weights`` (n) multiply the rows of each joint: one over its noise, such as ``estimate.residual.weights`` of a
    result; None for ones. ``memory`` (s) is after which time samples count exp(-1): one number for all parameters, or
    by ``GroupKind``, where parameters of no group named are never forgotten; by default none is. ``near`` (p) are the
    values from which an estimate of least squares moves no further than the samples ask for; None for zero.

    Raises ConfigError for a memory or weights that are not positive, and for a shape that does not fit.

    >>> import numpy as np
    >>> import dynident as dy
    >>> from dynident.models.lagrangian import pendulum
    >>> from dynident.apps.online import RecursiveLeastSquares
    >>> arm, t = pendulum(), np.arange(1001) * 0.01
    >>> motion = dy.simulate(arm, arm.values, lambda s: [np.sin(5 * s)], t)
    >>> fit = RecursiveLeastSquares(arm)
    >>> for k in range(1001):  # or many samples at once
    ...     fit.update(t[k], motion.q[k], motion.dq[k], motion.ddq[k], motion.tau[k])
    >>> fit
    <RecursiveLeastSquares of 2 parameters: 1001 rows, nothing forgotten>
    >>> print(fit.estimate().value)
    [0.0825 0.25  ]
    """

    def __init__(
        self,
        model: Model,
        weights: ArrayLike | None = None,
        memory: float | Mapping[GroupKind, float] = math.inf,
        near: ArrayLike | None = None,
    ) -> None:
        n, p = len(model.joints), len(model.parameters)
        self.model = model
        self.weights = np.ones(n) if weights is None else np.asarray(weights, dtype=float)
        if self.weights.shape != (n,) or not (np.isfinite(self.weights) & (self.weights > 0)).all():
            raise ConfigError(f"weights = {self.weights}: give a positive number for each of the {n} joints.")
        self.memory = _parameter_memories(model, memory)
        self.near = np.zeros(p) if near is None else np.asarray(near, dtype=float)
        if self.near.shape != (p,) or not np.isfinite(self.near).all():
            raise ConfigError(f"near has shape {self.near.shape}: give a number for each of the {p} parameters.")
        self._order, self._rank = _forgetting_order(model, self.memory)
        self._R = np.zeros((p + 1, p + 1), order="F")
        self._peak = np.zeros(p)
        self._rows = 0.0
        self._clock = np.full(2, np.nan)  # when the first sample was, and how many steps of forgetting were done
        self._waiting: list[tuple[Any, ...]] = []

    def __repr__(self) -> str:
        shortest = self.memory.min(initial=math.inf)
        memory_words = "nothing forgotten" if shortest == math.inf else f"memory from {shortest:.3g} s"
        return f"<RecursiveLeastSquares of {len(self.memory)} parameters: {self.rows:.0f} rows, {memory_words}>"

    @property
    def rows(self) -> float:
        """Number of rows behind the residual, of all joints; forgotten ones count as much as they still do."""
        self._flush()
        return self._rows

    def update(
        self,
        t: ArrayLike,
        q: ArrayLike,
        dq: ArrayLike,
        ddq: ArrayLike,
        tau: ArrayLike,
        keep: ArrayLike | None = None,
        memory: ArrayLike | None = None,
    ) -> None:
        """Take one sample, t (s) and (n) each, or B of them, (B) and (B, n), and forget for the time that has
        passed.

        ``keep`` (B, n) is False where the equation of a joint is not to be used; ``memory`` (B, m) is that of
        the terms. The estimate is the same for samples one by one and in blocks. Raises InputError for a shape
        that does not fit, a value that is not finite, or a time before the last one where something is
        forgotten.
        """
        n = len(self.model.joints)
        time = np.atleast_1d(np.asarray(t, dtype=float))
        states = [_sample_rows(name, x, len(time), n) for name, x in zip(SIGNAL_NAMES, (q, dq, ddq, tau), strict=True)]
        mask = np.broadcast_to(True if keep is None else np.asarray(keep, dtype=bool), (len(time), n))
        term_memory = None if memory is None else np.asarray(memory, dtype=float).reshape(len(time), -1)
        # time is divided into steps of forgetting, so that the result does not depend on the size of the batches
        for samples, steps in self._forgetting_steps(time):
            self.forget(steps * float(self.memory.min(initial=math.inf)) / FORGETTING_STEPS if steps else 0.0)
            rows = [None if x is None else x[samples] for x in (*states, mask, term_memory)]
            self._waiting.append(tuple(rows))
        if sum(len(batch[0]) for batch in self._waiting) >= BATCH_SAMPLES:
            self._flush()

    def add(self, block: RegressorBlock) -> None:
        """Add rows as they come out of a regression, filtered and decimated, say; nothing is forgotten."""
        self._flush()
        self._add_rows(block.Y, block.tau, block.keep)

    def forget(self, seconds: float) -> None:
        """Forget as much as in so many seconds."""
        if not np.isfinite(self.memory).any() or not seconds > 0:
            return
        self._flush()
        self._normalise_factor()
        memories, p = self.memory[self._order], len(self.memory)
        # a pivot below its share of the peak is not forgotten further: the robot rests, or does not show the parameter
        pivots = np.abs(np.diag(self._R)[:p])
        self._peak = np.maximum(self._peak, pivots)
        min_factors = np.divide(MIN_PIVOT_SHARE * self._peak, pivots, out=np.ones(p), where=pivots > 0)
        self._R[:p] *= np.minimum(np.maximum(np.exp(-0.5 * seconds / memories), min_factors), 1.0)[:, None]
        # the residual keeps rows enough to be known
        # of the residual: what a change has left in it goes as fast
        kept_share = math.exp(-seconds / float(memories.min()))
        kept_share = max(kept_share, min(1.0, MIN_ROWS_PER_PARAMETER * p / self._rows)) if self._rows else 1.0
        self._R[p, p] *= math.sqrt(kept_share)
        self._rows *= kept_share

    @property
    def factors(self) -> TriangularFactors:
        """Triangular factor of all weighted rows (1, p + 1, p + 1), as estimators take it."""
        self._flush()
        p = len(self._order)
        # back to the order of the model's parameters; a QR step makes the factor triangular again
        columns = np.empty_like(self._R)
        columns[:, [*self._order, p]] = np.triu(self._R)
        return TriangularFactors(np.asarray(np.linalg.qr(columns, mode="r"))[None], np.array([round(self._rows)]))

    def estimate(self, estimator: Estimator | None = None) -> Estimate:
        """Return the estimate by all rows as they count now, by default that of least squares.

        ``PhysicallyConsistent()`` gives the nearest consistent one. The ``residual`` is that of all joints together,
        times the noise of each by the weights. Raises the errors of the estimator, ConfigError for one that needs
        the
        samples themselves, and InputError for any but least squares before the first sample.
        """
        method = LeastSquares() if estimator is None else estimator
        if method.needs_samples:
            raise ConfigError(
                f"estimator: {type(method).__name__} needs all samples, of which none is kept; take LeastSquares, "
                "Ridge, or PhysicallyConsistent without such a `fit`."
            )
        if not self.rows and not isinstance(method, LeastSquares):
            raise InputError(f"{type(method).__name__} needs samples, and none was taken yet; ask later.")
        # estimate the difference from the origin, so that what no sample has shown stays there
        origin = self.near if isinstance(method, LeastSquares) else np.zeros(len(self.near))
        regression = Regression(self.model, ()).with_factors(self.factors.subtract_torque(origin))
        correction = call_part(method, Problem(self.model, (), regression), Estimate)
        sigma = float(correction.residual.sigma[0])
        samples = round(self._rows / len(self.weights))
        joint_weights = None if (self.weights == 1.0).all() else self.weights
        residual = Residual(sigma / self.weights, samples, joint_weights)
        return replace(correction, value=origin + correction.value, residual=residual)

    @property
    def state(self) -> dict[str, Array]:
        """State as arrays, to be saved; ``restore`` takes them again."""
        self._flush()
        arrays = {"R": np.triu(self._R), "peak": self._peak.copy(), "clock": self._clock.copy()}
        return arrays | {"rows": np.array(self._rows), "order": self._order.astype(float)}

    def restore(self, state: Mapping[str, Array]) -> None:
        """Continue from a saved state; InputError where it is of another model, or of another memory."""
        if (shape := np.shape(state["R"])) != self._R.shape:
            raise InputError(f"the saved factor has shape {shape}, but the model needs {self._R.shape}; start anew.")
        if not np.array_equal(state["order"], self._order):
            raise InputError("the saved factor is of another memory, for which its parameters are in another order.")
        self._waiting.clear()
        self._R = np.asfortranarray(state["R"], dtype=float).copy(order="F")
        self._peak, self._clock = (np.array(state[name], dtype=float) for name in ("peak", "clock"))
        self._rows = float(state["rows"])

    def _forgetting_steps(self, t: Array) -> list[tuple[slice, int]]:
        """Return the samples between two steps of forgetting, with the number of steps before them."""
        shortest = float(self.memory.min(initial=math.inf))
        if shortest == math.inf or not len(t):
            return [(slice(0, len(t)), 0)]
        if np.isnan(self._clock[0]):
            self._clock = np.array([t[0], 0.0])
        # steps are counted from the first sample, so that rounding does not accumulate
        step_numbers = np.floor((t - self._clock[0]) * (FORGETTING_STEPS / shortest))
        previous_numbers = np.concatenate([self._clock[1:], step_numbers[:-1]])
        if not (step_numbers >= previous_numbers).all():
            k = int(np.flatnonzero(~(step_numbers >= previous_numbers))[0])
            raise InputError(f"t = {float(t[k])!r} s is before the sample before it, or not finite; leave it out.")
        self._clock[1] = step_numbers[-1]
        starts = [0, *(np.flatnonzero(np.diff(step_numbers)) + 1).tolist()]
        pairs = pairwise([*starts, len(t)])
        return [(slice(a, b), int(step_numbers[a] - previous_numbers[a])) for a, b in pairs]

    def _flush(self) -> None:
        """Add the waiting samples to the factor."""
        if not self._waiting:
            return
        waiting, self._waiting = self._waiting, []
        columns = zip(*waiting, strict=True)
        q, dq, ddq, tau, keep, memory = (x[0] if len(x) == 1 or x[0] is None else np.concatenate(x) for x in columns)
        self._add_rows(self.model.regressor(q, dq, ddq, memory), tau, keep)

    def _add_rows(self, Y: Array, tau: Array, keep: NDArray[np.bool_] | None) -> None:
        """Add rows to the factor: Y (B, n, p), tau (B, n)."""
        is_used = slice(None) if keep is None else keep.ravel()
        weight = np.broadcast_to(self.weights, tau.shape).ravel()[is_used]
        p = len(self._order)
        rows = np.empty((len(weight), p + 1), order="F")
        np.multiply(Y.reshape(-1, p)[is_used][:, self._order], weight[:, None], out=rows[:, :p])
        np.multiply(tau.ravel()[is_used], weight, out=rows[:, p])
        _merge_rows(self._R, rows)
        self._rows += len(rows)

    def _normalise_factor(self) -> None:
        """Make each row of R lead with its own parameter, or be zero, so that weights of rows keep the solution.

        What the data leave at columns that depend on others, in any motion or so far, is residual.
        """
        R, r, p = np.triu(self._R), self._rank, len(self._order)
        # what the data leave after r independent columns is residual: one number keeps it
        R[p, p] = np.linalg.norm(R[r:, p])
        R[r:p] = 0.0
        self._R = np.asfortranarray(R)
        for _ in range(3):  # rounding may leave some after the first time
            # rows without a pivot of their own would move the solution when they are forgotten: rotate them into the
            # others
            limit = PIVOT_TOLERANCE * np.linalg.norm(self._R[:, :p], axis=0)
            empty_rows = np.flatnonzero(np.abs(np.diag(self._R)[:p]) <= limit)
            rows = self._R[empty_rows]
            rows[:, :p][np.abs(rows[:, :p]) <= limit] = 0.0
            if not rows.any():
                return
            self._R[empty_rows] = 0.0
            rows = np.asfortranarray(rows[rows.any(axis=1)])
            _merge_rows(self._R, rows)


def _parameter_memories(model: Model, memory: float | Mapping[GroupKind, float]) -> Array:
    """Return the memory (p) of each parameter in s, infinite where it is never forgotten."""
    memories = list(memory.values()) if isinstance(memory, Mapping) else [memory]
    if invalid := [seconds for seconds in memories if not seconds > 0]:
        raise ConfigError(f"memory = {invalid[0]!r}: give a positive number of seconds, or inf to forget nothing.")
    if not isinstance(memory, Mapping):
        return np.full(len(model.parameters), float(memory))
    return np.array([math.inf if kind is None else float(memory.get(kind, math.inf)) for kind in kinds_of(model)])


def _forgetting_order(model: Model, memory: Array) -> tuple[NDArray[np.intp], int]:
    """Return the order of the parameters in R, those that are forgotten fastest first, and the number that lead a row.

    The others, at the end, depend on these in any motion.
    """
    # stable, so that parameters of equal memory keep their order
    order = np.argsort(memory, kind="stable")
    if not np.isfinite(memory).any():
        return order, len(order)
    basis = structural_base_parameters(model)
    sizes = basis.scale[list(basis.independent), None] * basis.combination / basis.scale
    leading = independent_columns(sizes[:, order])
    dependent = [k for k in range(len(order)) if k not in leading]
    return order[[*leading, *dependent]], len(leading)


def _merge_rows(R: Array, rows: Array) -> None:
    """Merge rows, which are overwritten, into the factor R, both in Fortran order."""
    from scipy.linalg.lapack import dtpqrt

    if len(rows):
        with one_thread():
            dtpqrt(0, min(PANEL_COLUMNS, len(R)), R, rows, overwrite_a=1, overwrite_b=1)


def _sample_rows(name: str, value: ArrayLike, rows: int, joints: int) -> Array:
    """Return a signal as (rows, joints); InputError for another shape, or values that are not finite."""
    x = np.asarray(value, dtype=float)
    x = x[None] if x.ndim == 1 and rows == 1 else x
    if x.shape != (rows, joints):
        raise InputError(f"{name} has shape {x.shape}; {rows} samples of {joints} joints are ({rows}, {joints}).")
    if not np.isfinite(x).all():
        raise InputError(f"{name} has values that are not finite; leave these samples out.")
    return x
