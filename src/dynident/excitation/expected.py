"""What a recording of a motion is expected to tell: standard errors, from the information of its torque."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief
from dynident.excitation.criterion import base_information
from dynident.regression import (
    BaseParameters,
    UnexcitedParameters,
    base_parameters,
    compare,
    rank_of_information,
    structural_base_parameters,
)

if TYPE_CHECKING:
    from dynident.models import Model

__all__ = ["Expected", "expected", "information_of", "unexcited"]

Array = NDArray[np.float64]
BLOCK = 2000  # samples at once


@dataclass(frozen=True, eq=False)
class Expected:
    """What a recording of a motion is expected to tell: of the base parameters ``basis`` (r) their ``value`` (r), the
    standard errors ``std`` (r), infinite for those that stay open; log det of the information, in SI units, and the
    condition number of the weighted regressor with columns of length one, both infinite where some stay open."""

    basis: BaseParameters
    value: Array
    std: Array
    log_det: float
    condition: float

    __repr__ = brief

    @property
    def open(self) -> tuple[str, ...]:
        """Names of the parameters that lead a base parameter that stays open."""
        return tuple(name for name, std in zip(self.basis.leading, self.std, strict=True) if not np.isfinite(std))

    @property
    def relative(self) -> Array:
        """Standard errors (r) in % of the values; infinite where that is zero."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(np.where(self.value == 0, np.inf, 100 * self.std / np.abs(self.value)))


def information_of(model: Model, states: Array, weights: Array, min_speed: Array | None = None) -> Array:
    """Return the information (p, p) of the torque along states (at least 3, N, n): the sum of Y' W Y over the samples,
    ``weights`` (n) being one over the variance of each joint's torque.

    Where a joint is slower than its ``min_speed`` (n) its torque does not count.
    """
    p = len(model.parameters)
    out, root = np.zeros((p, p)), np.sqrt(weights)[:, None]
    for k in range(0, states.shape[1], BLOCK):
        rows = model.regressor(*states[:3, k : k + BLOCK]) * root
        if min_speed is not None:
            rows[np.abs(states[1, k : k + BLOCK]) < min_speed] = 0.0
        rows = rows.reshape(-1, p)
        out += rows.T @ rows
    return out


def expected(
    model: Model, theta: Array, information: Array, basis: BaseParameters | None = None, prior: Array | None = None
) -> Expected:
    """Return what the information (p, p) of a motion tells beside what is known before, ``prior`` (p, p), at the values
    theta (p).

    ``basis`` are the base parameters that any motion could show, by default found anew.
    """
    basis = structural_base_parameters(model) if basis is None else basis
    value, own = basis.to_base(theta), _of_base(basis, information, prior)
    rank = rank_of_information(own)
    std = np.sqrt(np.diag(rank.covariance()))
    if rank.rank < basis.rank:
        return Expected(basis, value, std, -np.inf, np.inf)
    log_det = 2 * float(np.log(rank.values).sum() + np.log(rank.scale).sum())
    return Expected(basis, value, std, log_det, rank.condition)


def unexcited(
    model: Model, information: Array, found: Expected, prior: Array | None = None
) -> tuple[UnexcitedParameters, ...]:
    """Return the base parameters that stay open, with the joints whose motion would show them."""
    if np.isfinite(found.std).all():
        return ()
    B = found.basis.combination
    rank = rank_of_information(B.T @ _of_base(found.basis, information, prior) @ B, model.parameters)
    return compare(found.basis, base_parameters(rank, model.parameters), model)


def _of_base(basis: BaseParameters, information: Array, prior: Array | None) -> Array:
    """Return the information (r, r) on the base parameters."""
    kept = list(basis.independent)
    own = information[np.ix_(kept, kept)]
    return np.asarray(own if prior is None else own + base_information(basis, prior))
