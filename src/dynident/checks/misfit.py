"""What plain least squares leaves of the torque, and how much of it one more unknown would explain: score tests.

The parameters of the model are eliminated (variable projection; Golub and Pereyra 1973): of the derivative of the
torque by an unknown only the part orthogonal to the regressor counts, and its regression on the residual is one
Gauss-Newton step towards the unknown. An unknown whose derivative lies within the regressor cannot be seen.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from dynident.checks.case import Case
from dynident.errors import brief
from dynident.models import Model, Parameter
from dynident.regression import EntryBlock, Rank, TriangularFactors, factorise, rank_of
from dynident.regression.long_run import long_run

__all__ = ["Evidence", "Misfit", "misfit"]

Array = NDArray[np.float64]
BATCH = 64  # columns that are tested together
WORTH = 0.1  # share of the squared residual that an unknown must explain: 5 % of the error
PART, LEAST = 0.3, 0.1  # or this part of what is not white noise, counted as at least that share
FOLDS = 5  # consecutive parts of the data; the value from the others must explain each of them
TELLING = 0.02  # share of an unknown's effect below which a part says nothing of its sign
ROUNDS = 3  # of the weights of the joints
UNSEEN = 1e-5  # share of a derivative, beside the regressor, below which it is rounding error
FLOOR = 1e-7  # share of a joint's torque below which its residual is rounding error


@dataclass(frozen=True, eq=False)
class Evidence:
    """What one unknown explains of a weighted ``residual`` (M, n), in consecutive logs of these ``lengths``: ``z``
    (M, n) is the part of the torque's derivative by it that nothing else explains.
    """

    residual: Array
    z: Array
    lengths: tuple[int, ...]

    __repr__ = brief

    @cached_property
    def value(self) -> float:
        """The unknown."""
        return float(np.vdot(self.z, self.residual)) / self._norm

    @cached_property
    def share(self) -> float:
        """Share of the squared residual that it explains."""
        return self.value**2 * self._norm / float(np.vdot(self.residual, self.residual))

    @cached_property
    def by_joint(self) -> Array:
        """The same of each joint (n)."""
        before, after = (np.square(x).sum(axis=0) for x in (self.residual, self._left))
        return np.asarray(1.0 - after / np.where(before > 0, before, 1.0))

    @cached_property
    def std(self) -> float:
        """Its standard error, for correlated residuals."""
        scores = np.split((self.z * self._left).sum(axis=1)[:, None], np.cumsum(self.lengths)[:-1])
        return float(np.sqrt(long_run(scores)[0, 0])) / self._norm

    @cached_property
    def held_out(self) -> float:
        """Share explained in parts of the data with the value from the other parts."""
        inner, norm = self._parts
        others = norm.sum() - norm
        value = (inner.sum() - inner) / np.where(others > 0, others, 1.0)
        return float((2 * value * inner - value**2 * norm).sum()) / float(np.vdot(self.residual, self.residual))

    @property
    def agreed(self) -> bool:
        """Whether the value has the same sign in all parts."""
        inner, norm = self._parts
        return bool(np.ptp(np.sign(inner[norm > TELLING * norm.sum()])) == 0)

    @cached_property
    def _norm(self) -> float:
        return float(np.vdot(self.z, self.z))

    @cached_property
    def _left(self) -> Array:
        return self.residual - self.value * self.z

    @cached_property
    def _parts(self) -> tuple[Array, Array]:
        """Inner products of consecutive parts with the residual, and squared norms of the parts."""
        inner, norm = (np.array_split(x.sum(axis=1), FOLDS) for x in (self.z * self.residual, np.square(self.z)))
        return np.array([x.sum() for x in inner]), np.array([x.sum() for x in norm])


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
        """Share of the squared residual that an unknown must explain: less where most of it is white noise."""
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

    def beside(self, columns: Array) -> Array:
        """Return the weighted part (K, M, n) of columns (K, M, n) that the regressor does not span."""
        z = (columns * self.weight).reshape(len(columns), -1)
        for _ in range(2):  # once more for the digits
            z = z - (z @ self.basis) @ self.basis.T
        return z.reshape(columns.shape)

    def evidence(self, columns: Iterable[Array]) -> Iterator[Evidence | None]:
        """Yield what each column (M, n), the derivative of the torque by an unknown, explains; None where it cannot be
        seen."""
        rest = iter(columns)
        while some := list(islice(rest, BATCH)):  # together they are projected much faster than one by one
            for column, z in zip(some, self.beside(np.array(some)), strict=True):
                size = UNSEEN * float(np.linalg.norm(column * self.weight))
                seen = float(np.linalg.norm(z)) > size and self.size > 0
                yield Evidence(self.residual, z, self.case.lengths) if seen else None


def misfit(case: Case, weight: Array | None = None) -> Misfit:
    """Return the fit of a case by least squares on the directions that the data determine.

    Each joint counts by one over the standard deviation of its residual, or by ``weight`` (n).
    """
    (rows, n), own = case.q.shape, len(case.model.parameters)
    block = _block(case)
    factors = factorise([block], block.structure)
    size = np.sqrt(np.square(case.tau).mean(axis=0))
    floor = FLOOR * np.where(size > 0, size, size.max(initial=0.0) or 1.0)
    given, weight = weight is not None, 1.0 / np.maximum(size, floor) if weight is None else weight
    theta, rank = _solved(factors, weight, case)
    for _ in range(0 if given else ROUNDS - 1):
        deviation = np.sqrt(factors.residual(theta) / np.maximum(factors.rows, 1))
        weight = 1.0 / np.maximum(deviation, floor)
        theta, rank = _solved(factors, weight, case, rank.unweighted or rank)
    W = np.where(case.keep, weight, 0.0)
    basis = (block.times(W.T).regressor(rank.determined / rank.values[: rank.rank])).reshape(rows * n, -1)
    left = (case.tau * W).ravel()
    for _ in range(2):  # once more for the digits
        left = left - basis @ (basis.T @ left)
    found = _completed(theta, case.model, rank)
    return Misfit(case, found, theta[own:], W, basis, left.reshape(rows, n), block.torque(theta).T)


def _block(case: Case) -> EntryBlock:
    """Return the rows of a case, with the columns beside those of the model."""
    own, n = case.model.structure, case.q.shape[1]
    entries = case.model.entries(**case.states, joint=own.joint, parameter=own.parameter)
    entries *= np.broadcast_to(case.gain, n)[own.joint, None]
    rows = [
        row for j, part in enumerate(own.parts) for row in (entries[part], *(one[None, :, j] for one in case.extra))
    ]
    return EntryBlock(own.beside(len(case.extra)), np.concatenate(rows), case.tau.T, case.keep.T)


def _solved(factors: TriangularFactors, weight: Array, case: Case, shown: Rank | None = None) -> tuple[Array, Rank]:
    """Return the parameters with those of the extra columns, and the rank; ``shown`` is the rank without weights."""
    extra = (Parameter(f"extra {k}", "") for k in range(len(case.extra)))
    R = factors.stacked(weight)
    rank = rank_of(R, (*case.model.parameters, *extra), None, shown)
    p = R.shape[1] - 1
    theta = rank.determined @ (rank.left[:, : rank.rank].T @ R[:p, p] / rank.values[: rank.rank])
    return np.asarray(theta), rank


def _completed(theta: Array, model: Model, rank: Rank) -> Array:
    """Return the parameters of the model with the file's values in the directions that the data leave free."""
    nominal = np.zeros_like(theta)
    nominal[: len(model.parameters)] = [parameter.value or 0.0 for parameter in model.parameters]
    free = rank.vectors[:, rank.rank :]
    found = theta + free @ (free.T @ (nominal * rank.scale)) / rank.scale
    return np.asarray(found[: len(model.parameters)])
