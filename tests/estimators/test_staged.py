"""The program in larger and larger units, where the solver fails."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from dynident.estimators import Constraints
from dynident.estimators import programs as staged
from dynident.estimators.cone import Optimum
from dynident.regression import rank_of
from dynident.runtime import ModelError


@pytest.mark.parametrize("failure", ["raised", "inexact"])
@pytest.mark.parametrize("failures", [0, 1, 2, 3])
def test_three_units_are_tried(failures: int, failure: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two directions are informed, the third is free; the point is given back in units of one standard error."""
    factor = np.diag([2.0, 3.0, 0.0, 1.0])
    known, asked = staged.information_from_factor(factor, np.ones(3), rank_of(factor), 10), []

    def solver(*program: Any) -> Optimum:
        asked.append(program)
        if failure == "raised" and len(asked) <= failures:
            raise ModelError("the solver failed")
        return Optimum(np.ones(3), "", 1.0 if len(asked) <= failures else 0.0, 0.0)

    monkeypatch.setattr(staged, "minimise", solver)
    if failures == 3:
        path = staged._solve_scaled(known, Constraints())
        np.testing.assert_allclose(path, 0.0, atol=1e-9)  # the optimum, as nothing is constrained
        monkeypatch.setattr(staged, "minimise_from_inside", lambda *_: None)
        asked.clear()
        with pytest.raises(ModelError, match=r"the solver failed|hold to 1\.0e"):
            staged._solve_scaled(known, Constraints())
        return
    found = staged._solve_scaled(known, Constraints())
    unit = (1.0, 1e3, 1e6)[failures]
    assert len(asked) == failures + 1
    assert found.tolist() == [unit, unit, 1.0]
    quadratic, linear, _, base, directions = asked[-1]
    np.testing.assert_allclose(np.diag(quadratic), [1.0, 1.0, max(unit**-2, 1e-8)])
    np.testing.assert_allclose(directions[:, :2], known.informed * unit)
    np.testing.assert_allclose(directions[:, 2:], known.free)
    assert not linear.any()
    assert base is known.base


def test_where_the_penalty_is_not_small_the_free_directions_get_a_larger_unit(monkeypatch: pytest.MonkeyPatch) -> None:
    factor = np.diag([2.0, 3.0, 0.0, 1.0])
    known, asked = staged.information_from_factor(factor, np.ones(3), rank_of(factor), 10), []

    def solved(wider: staged.Information, _: Constraints) -> np.ndarray:
        asked.append(float(np.linalg.norm(wider.free)))
        return np.array([0.0, 0.0, 30.0 / asked[-1]])  # the same w, in each unit

    monkeypatch.setattr(staged, "_solve_scaled", solved)
    found = staged._solve_program(known, Constraints())
    assert asked == pytest.approx([1.0, 10.0, 100.0, 1000.0][: len(asked)])
    assert found[2] == pytest.approx(30.0)
    assert (30.0 / asked[-1]) ** 2 <= staged.MAX_PENALTY_SHARE * known.noise
