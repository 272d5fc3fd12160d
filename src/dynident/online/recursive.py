"""Recursive least squares by square roots: one triangular factor that rows enter, and that forgets by group.

The factor R of the weighted rows [X | y] so far is all that least squares needs of them (``regression/triangular.py``),
so that memory and time of a sample do not grow. Rows enter by Householder reflections of [R; rows], never by squares.

Forgetting multiplies rows of R. Its first row holds all that is known of the first parameter once all others are given,
the next what is known of the second given those after it, and so on: with the parameters that change fastest first, the
rows of a group times exp(-t / (2 T)) forget it over T seconds, what is known of those after it stays as it is, and so
does the solution of R theta = y. It is the step of a Kalman filter whose process noise is, in each direction, the share
exp(t / T) - 1 of the variance given all that is forgotten more slowly. What no motion shows is not forgotten below a
share of the most that was ever known of it, so that an estimate is not lost while the robot rests.

References: Bierman (1977), "Factorization methods for discrete sequential estimation"; Parkum, Poulsen and Holst
(1992), "Recursive forgetting algorithms".
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynident.errors import ConfigError, InputError, called
from dynident.estimators import Estimate, Estimator, LeastSquares, Problem, Residual, needs_samples
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

__all__ = ["RecursiveLeastSquares"]

Array = NDArray[np.float64]
PANEL = 16  # columns that LAPACK eliminates together
WAITING = 64  # samples that are computed together, as each call has its cost
STEPS = 100  # of forgetting in the shortest memory
LEAST = 0.03  # of the largest pivot that a parameter ever had: it is not forgotten further, 0.1 % of the information
ENOUGH = 10  # rows for each parameter: of fewer the residual is not forgotten
EMPTY = 1e-10  # of its column: a smaller pivot is rounding
NAMES = ("q", "dq", "ddq", "tau")


class RecursiveLeastSquares:
    """The least-squares fit of a model to all samples so far, or to the latest, of which none is kept.

    ``weights`` (n) multiply the rows of each joint: one over its noise, such as ``estimate.residual.weights`` of a
    result; None for ones. ``memory`` (s) is after which time samples count exp(-1): one number for all parameters, or
    by ``GroupKind``, where parameters of no group named are never forgotten; by default none is. ``near`` (p) are the
    values from which an estimate of least squares moves no further than the samples ask for; None for zero.

    Raises ConfigError for a memory or weights that are not positive, and for a shape that does not fit.

    >>> import numpy as np
    >>> import dynident as dy
    >>> from dynident.models.gallery import pendulum
    >>> from dynident.online import RecursiveLeastSquares
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
        self.memory = _memories(model, memory)
        self.near = np.zeros(p) if near is None else np.asarray(near, dtype=float)
        if self.near.shape != (p,) or not np.isfinite(self.near).all():
            raise ConfigError(f"near has shape {self.near.shape}: give a number for each of the {p} parameters.")
        self._order, self._rank = _nested(model, self.memory)
        self._R = np.zeros((p + 1, p + 1), order="F")
        self._peak = np.zeros(p)
        self._rows = 0.0
        self._clock = np.full(2, np.nan)  # when the first sample was, and how many steps of forgetting were done
        self._waiting: list[tuple[Any, ...]] = []

    def __repr__(self) -> str:
        shortest = self.memory.min(initial=math.inf)
        what = "nothing forgotten" if shortest == math.inf else f"memory from {shortest:.3g} s"
        return f"<RecursiveLeastSquares of {len(self.memory)} parameters: {self.rows:.0f} rows, {what}>"

    @property
    def rows(self) -> float:
        """The number of rows behind the residual, of all joints; forgotten ones count as much as they still do."""
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
        """Take one sample, t (s) and (n) each, or B of them, (B) and (B, n), and forget for the time that has passed.

        ``keep`` (B, n) is False where the equation of a joint is not to be used; ``memory`` (B, m) is what terms
        remember. The estimate is the same for samples one by one and in blocks. Raises InputError for a shape that does
        not fit, a value that is not finite, or a time before the last one where something is forgotten.
        """
        n = len(self.model.joints)
        time = np.atleast_1d(np.asarray(t, dtype=float))
        states = [_rows_of(name, x, len(time), n) for name, x in zip(NAMES, (q, dq, ddq, tau), strict=True)]
        kept = np.broadcast_to(True if keep is None else np.asarray(keep, dtype=bool), (len(time), n))
        more = None if memory is None else np.asarray(memory, dtype=float).reshape(len(time), -1)
        for part, steps in self._passed(time):
            self.forget(steps * float(self.memory.min(initial=math.inf)) / STEPS if steps else 0.0)
            cut = [None if x is None else x[part] for x in (*states, kept, more)]
            self._waiting.append(tuple(cut))
        if sum(len(one[0]) for one in self._waiting) >= WAITING:
            self._flush()

    def add(self, block: RegressorBlock) -> None:
        """Take rows as they come out of a regression, filtered and decimated, say; nothing is forgotten."""
        self._flush()
        self._enter(block.Y, block.tau, block.keep)

    def forget(self, seconds: float) -> None:
        """Forget as much as in so many seconds."""
        if not np.isfinite(self.memory).any() or not seconds > 0:
            return
        self._flush()
        self._tidy()
        own, p = self.memory[self._order], len(self.memory)
        pivots = np.abs(np.diag(self._R)[:p])
        self._peak = np.maximum(self._peak, pivots)
        least = np.divide(LEAST * self._peak, pivots, out=np.ones(p), where=pivots > 0)
        self._R[:p] *= np.minimum(np.maximum(np.exp(-0.5 * seconds / own), least), 1.0)[:, None]
        left = math.exp(-seconds / float(own.min()))  # of the residual: what a change has left in it goes as fast
        left = max(left, min(1.0, ENOUGH * p / self._rows)) if self._rows else 1.0
        self._R[p, p] *= math.sqrt(left)
        self._rows *= left

    @property
    def factors(self) -> TriangularFactors:
        """The triangular factor of all weighted rows (1, p + 1, p + 1), as estimators take it."""
        self._flush()
        p = len(self._order)
        columns = np.empty_like(self._R)
        columns[:, [*self._order, p]] = np.triu(self._R)
        return TriangularFactors(np.asarray(np.linalg.qr(columns, mode="r"))[None], np.array([round(self._rows)]))

    def estimate(self, estimator: Estimator | None = None) -> Estimate:
        """Return the estimate by all rows as they count now, by default of least squares.

        ``PhysicallyConsistent()`` gives the nearest consistent one. Its ``residual`` is that of all joints together,
        times the noise of each by the weights. Raises the errors of the estimator, ConfigError for one that needs
        the samples themselves, and InputError for any but least squares before the first sample.
        """
        chosen = LeastSquares() if estimator is None else estimator
        if needs_samples(chosen):
            raise ConfigError(
                f"estimator: {type(chosen).__name__} needs all samples, of which none is kept; take LeastSquares, "
                "Ridge, or PhysicallyConsistent without such a `fit`."
            )
        if not self.rows and not isinstance(chosen, LeastSquares):
            raise InputError(f"{type(chosen).__name__} needs samples, and none was taken yet; ask later.")
        near = self.near if isinstance(chosen, LeastSquares) else np.zeros(len(self.near))
        regression = Regression(self.model, ()).with_factors(self.factors.less(near))
        found = called(chosen, Problem(self.model, (), regression), Estimate)
        left = float(found.residual.sigma[0])
        samples = round(self._rows / len(self.weights))
        alike = None if (self.weights == 1.0).all() else self.weights
        return replace(found, value=near + found.value, residual=Residual(left / self.weights, samples, alike))

    @property
    def state(self) -> dict[str, Array]:
        """All that it knows, as arrays, to be saved; ``restore`` takes them again."""
        self._flush()
        return {
            "R": np.triu(self._R),
            "peak": self._peak.copy(),
            "clock": self._clock.copy(),
            "rows": np.array(self._rows),
            "order": self._order.astype(float),
        }

    def restore(self, state: Mapping[str, Array]) -> None:
        """Continue from a saved state; InputError where it is of another model, or of another memory."""
        if (found := np.shape(state["R"])) != self._R.shape:
            raise InputError(f"the saved factor has shape {found}, but the model needs {self._R.shape}; start anew.")
        if not np.array_equal(state["order"], self._order):
            raise InputError("the saved factor is of another memory, for which its parameters are in another order.")
        self._waiting.clear()
        self._R = np.asfortranarray(state["R"], dtype=float).copy(order="F")
        self._peak, self._clock = (np.array(state[name], dtype=float) for name in ("peak", "clock"))
        self._rows = float(state["rows"])

    def _passed(self, t: Array) -> list[tuple[slice, int]]:
        """Return the samples between two steps of forgetting, with the number of steps before them."""
        shortest = float(self.memory.min(initial=math.inf))
        if shortest == math.inf or not len(t):
            return [(slice(0, len(t)), 0)]
        if np.isnan(self._clock[0]):
            self._clock = np.array([t[0], 0.0])
        at = np.floor((t - self._clock[0]) * (STEPS / shortest))
        before = np.concatenate([self._clock[1:], at[:-1]])
        if not (at >= before).all():
            k = int(np.flatnonzero(~(at >= before))[0])
            raise InputError(f"t = {float(t[k])!r} s is before the sample before it, or not finite; leave it out.")
        self._clock[1] = at[-1]
        starts = [0, *(np.flatnonzero(np.diff(at)) + 1).tolist()]
        return [(slice(a, b), int(at[a] - before[a])) for a, b in zip(starts, [*starts[1:], len(t)], strict=True)]

    def _flush(self) -> None:
        """Let the samples that wait enter."""
        if not self._waiting:
            return
        waiting, self._waiting = self._waiting, []
        q, dq, ddq, tau, keep, memory = (_joined(one) for one in zip(*waiting, strict=True))
        self._enter(self.model.regressor(q, dq, ddq, memory), tau, keep)

    def _enter(self, Y: Array, tau: Array, keep: NDArray[np.bool_] | None) -> None:
        """Let rows enter the factor: Y (B, n, p), tau (B, n)."""
        used = slice(None) if keep is None else keep.ravel()
        weight = np.broadcast_to(self.weights, tau.shape).ravel()[used]
        p = len(self._order)
        rows = np.empty((len(weight), p + 1), order="F")
        np.multiply(Y.reshape(-1, p)[used][:, self._order], weight[:, None], out=rows[:, :p])
        np.multiply(tau.ravel()[used], weight, out=rows[:, p])
        _merge(self._R, rows)
        self._rows += len(rows)

    def _tidy(self) -> None:
        """Let each row of R be led by its own parameter, or be zero: then weights of rows do not move the solution.

        What is left of the data at columns that depend on others, in any motion or so far, is residual.
        """
        R, r, p = np.triu(self._R), self._rank, len(self._order)
        R[p, p] = np.linalg.norm(R[r:, p])
        R[r:p] = 0.0
        self._R = np.asfortranarray(R)
        for _ in range(3):  # rounding may leave some after the first time
            limit = EMPTY * np.linalg.norm(self._R[:, :p], axis=0)
            low = np.flatnonzero(np.abs(np.diag(self._R)[:p]) <= limit)
            rows = self._R[low]
            rows[:, :p][np.abs(rows[:, :p]) <= limit] = 0.0
            if not rows.any():
                return
            self._R[low] = 0.0
            rows = np.asfortranarray(rows[rows.any(axis=1)])
            _merge(self._R, rows)


def _memories(model: Model, memory: float | Mapping[GroupKind, float]) -> Array:
    """Return the memory (p) of each parameter in s, infinite where it is never forgotten."""
    given = list(memory.values()) if isinstance(memory, Mapping) else [memory]
    if wrong := [value for value in given if not value > 0]:
        raise ConfigError(f"memory = {wrong[0]!r}: give a positive number of seconds, or inf to forget nothing.")
    if not isinstance(memory, Mapping):
        return np.full(len(model.parameters), float(memory))
    return np.array([math.inf if kind is None else float(memory.get(kind, math.inf)) for kind in kinds_of(model)])


def _nested(model: Model, memory: Array) -> tuple[NDArray[np.intp], int]:
    """Return the parameters in the order of R, those that are forgotten fastest first, and how many of them lead a row:
    the others, at the end, depend on these in any motion."""
    order = np.argsort(memory, kind="stable")
    if not np.isfinite(memory).any():
        return order, len(order)
    basis = structural_base_parameters(model)
    sizes = basis.scale[list(basis.independent), None] * basis.combination / basis.scale
    leading = independent_columns(sizes[:, order])
    rest = [k for k in range(len(order)) if k not in leading]
    return order[[*leading, *rest]], len(leading)


def _merge(R: Array, rows: Array) -> None:
    """Let rows, which are lost, enter the factor R, both in Fortran's order."""
    from scipy.linalg.lapack import dtpqrt

    if len(rows):
        with one_thread():
            dtpqrt(0, min(PANEL, len(R)), R, rows, overwrite_a=1, overwrite_b=1)


def _rows_of(name: str, value: ArrayLike, rows: int, joints: int) -> Array:
    """Return the value as (rows, joints)."""
    x = np.asarray(value, dtype=float)
    x = x[None] if x.ndim == 1 and rows == 1 else x
    if x.shape != (rows, joints):
        raise InputError(f"{name} has shape {x.shape}; {rows} samples of {joints} joints are ({rows}, {joints}).")
    if not np.isfinite(x).all():
        raise InputError(f"{name} has values that are not finite; leave these samples out.")
    return x


def _joined(parts: tuple[Any, ...]) -> Any:
    """Return the parts as one array; None where they are not given."""
    return parts[0] if len(parts) == 1 or parts[0] is None else np.concatenate(parts)
