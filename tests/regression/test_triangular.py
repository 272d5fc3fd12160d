"""Triangular factors of the entries that hold all others: the same information as of the whole regressor."""

import numpy as np
import pytest
from numpy.typing import NDArray

from dynident.models import random_states
from dynident.regression import EntryBlock, RegressorBlock, factorise, one_thread
from dynident.regression.triangular import _controller
from tests.models.test_structure import arm
from tests.regression.dense import triangularise

Array = NDArray[np.float64]
MODEL = arm()
n, p = len(MODEL.joints), len(MODEL.parameters)


def drawn(samples: int, seed: int = 0) -> tuple[EntryBlock, RegressorBlock]:
    """Random rows, by their entries and whole."""
    rng = np.random.default_rng(seed)
    states, structure = random_states(MODEL.joints, rng, samples), MODEL.structure
    tau, keep = rng.normal(size=(samples, n)), rng.uniform(size=(samples, n)) < 0.8
    entries = MODEL.entries(*states, structure.joint, structure.parameter)
    return EntryBlock(structure, entries, tau.T, keep.T), RegressorBlock(MODEL.regressor(*states), tau, keep)


def squares(factors: Array) -> Array:
    return np.asarray(np.swapaxes(factors, -1, -2) @ factors)


def test_factors_of_the_entries_are_those_of_the_regressor() -> None:
    pairs = [drawn(samples, samples) for samples in (5, 300, 1, 40)]
    factors = factorise([x for x, _ in pairs], MODEL.structure)
    full = triangularise((x for _, x in pairs), n, p)
    size = np.abs(squares(full.factors)).max()
    np.testing.assert_allclose(squares(factors.factors), squares(full.factors), atol=1e-13 * size)
    np.testing.assert_array_equal(factors.rows, full.rows)
    np.testing.assert_array_equal(np.tril(factors.factors, -1), 0.0)
    theta = np.random.default_rng(0).normal(size=p)
    np.testing.assert_allclose(factors.residual(theta), full.residual(theta), rtol=1e-12)


def test_shapes_that_do_not_fit_are_an_error() -> None:
    case, _ = drawn(30)
    with pytest.raises(ValueError, match="must match"):
        EntryBlock(case.structure, case.entries[1:], case.tau)
    with pytest.raises(ValueError, match="must match"):
        EntryBlock(case.structure, case.entries, case.tau[:, 1:])


def test_blas_is_limited_until_the_last_one_is_done() -> None:
    def threads() -> set[int]:
        return {x["num_threads"] for x in _controller().info() if x["user_api"] == "blas"}

    before = threads()
    with one_thread():
        with one_thread():
            assert threads() == {1}
        assert threads() == {1}
    assert threads() == before
