"""What an identification says of the arm, as measurements of its base parameters with their errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.errors import InputError, brief
from dynident.identification import Identification

__all__ = ["Evidence"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Evidence:
    """Base parameters ``value`` (r) = ``combination`` (r, p) theta, as they were identified, with their ``covariance``
    (r, r), the parts ``by_joint`` (r, n) that the torque of each joint has in them, and its ``shares`` (n) in their
    errors.

    Where the torque of joint j is (1 + e_j) times the true one, the values are too large by ``by_joint`` e; where its
    friction grows with k_j times the load, which the model does not know, by ``by_load`` (r, n) k, None if not known.
    """

    value: Array
    combination: Array
    covariance: Array
    by_joint: Array
    shares: Array
    by_load: Array | None = None

    __repr__ = brief

    @classmethod
    def of(cls, found: Identification, name: str = "the result") -> Evidence:
        """Return what a result says, before constraints; InputError where it does not know its covariance."""
        errors, base, consistency = found.errors, found.base.on_data, found.estimate.consistency
        if errors.base_covariance is None or errors.base_by_joint is None or errors.base_shares is None:
            raise InputError(f"{name}: does not hold the covariance of its base parameters; identify again.")
        free = None if consistency is None else consistency.unconstrained
        theta = found.estimate.value if free is None else free
        B = np.eye(len(theta)) if base is None else base.combination
        return cls(B @ theta, B, errors.base_covariance, errors.base_by_joint, errors.base_shares, errors.base_by_load)

    def white(self) -> Array:
        """Return what makes the errors of the values independent, of variance one (r, r); InputError where the
        covariance is not positive definite."""
        scale = np.sqrt(np.diag(self.covariance))
        if not (np.isfinite(scale) & (scale > 0)).all():
            raise InputError("a base parameter has no standard error; identify again, with a longer recording.")
        try:
            half = np.linalg.cholesky(self.covariance / np.outer(scale, scale))
        except np.linalg.LinAlgError:
            raise InputError("the covariance of the base parameters is singular; identify again.") from None
        return np.asarray(np.linalg.inv(half) / scale)
