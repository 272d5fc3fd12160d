"""The program in larger and larger units, where the solver fails."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from dynident.errors import ModelError
from dynident.estimators.constraints import Constraints
from dynident.estimators.constraints.cone import Optimum
from dynident.estimators.physically_consistent import staged
from dynident.regression import rank_of


@pytest.mark.parametrize("failure", ["raised", "inexact"])
@pytest.mark.parametrize("failures", [0, 1, 2, 3])
def test_three_units_are_tried(failures: int, failure: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two directions are informed, the third is free; the point is given back in units of one standard error."""
    factor = np.diag([2.0, 3.0, 0.0, 1.0])
    known, asked = staged.read(factor, np.ones(3), rank_of(factor), 10), []

    def solver(*program: Any) -> Optimum:
        asked.append(program)
        if failure == "raised" and len(asked) <= failures:
            raise ModelError("the solver failed")
        return Optimum(np.ones(3), "", 1.0 if len(asked) <= failures else 0.0, 0.0)

    monkeypatch.setattr(staged, "minimise", solver)
    if failures == 3 and failure == "raised":
        with pytest.raises(ModelError, match="the solver failed"):
            staged._solved(known, Constraints())
        return
    found = staged._solved(known, Constraints())
    unit = (1.0, 1e3, 1e6, 1e6)[failures]
    assert len(asked) == min(failures + 1, 3)
    assert found.point.tolist() == [unit, unit, 1.0]
    assert found.good == (failures < 3)
    quadratic, linear, _, base, directions = asked[-1]
    np.testing.assert_allclose(np.diag(quadratic), [1.0, 1.0, max(unit**-2, 1e-8)])
    np.testing.assert_allclose(directions[:, :2], known.informed * unit)
    np.testing.assert_allclose(directions[:, 2:], known.free)
    assert not linear.any()
    assert base is known.base
