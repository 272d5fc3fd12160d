"""Stand-in until branch a has the criterion: log det alone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynident.models import Model

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class InformationCriterion:
    model: Model
    columns: Array
    weights: Array
    prior: Array | None = None
    kind: Any = None
    scale: Any = None
    named: Any = None

    def value_and_slopes(self, q: Array, dq: Array, ddq: Array) -> tuple[float, Array]:
        root = np.sqrt(self.weights)[:, None]
        A = (self.model.regressor(q, dq, ddq)[:, :, self.columns] * root).reshape(-1, len(self.columns))
        M = A.T @ A + (0.0 if self.prior is None else self.prior)
        sign, value = np.linalg.slogdet(M)
        if sign <= 0:
            return np.inf, np.zeros((3, *q.shape))
        G = np.zeros((*q.shape, len(self.model.parameters)))
        G[:, :, self.columns] = (-2 * A @ np.linalg.inv(M)).reshape(*q.shape, -1) * root
        return -float(value), self.model.weighted_gradient(q, dq, ddq, G)
