"""A matrix with a band and a border that does not determine a trajectory."""

from __future__ import annotations

import numpy as np
import pytest

from dynident.estimators.maximum_likelihood.trajectory import Arrow
from dynident.runtime import ModelError


def test_what_is_not_determined_is_refused() -> None:
    with pytest.raises(ModelError, match="not determined"):
        Arrow(np.zeros((2, 5)), np.zeros((5, 1))).solve_band(np.ones((5, 1)))
