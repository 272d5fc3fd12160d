"""Triangular factors of the entries that hold all others: the same information as of the whole regressor."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from dynident.models import random_states
from dynident.regression import EntryBlock, RegressorBlock, TriangularFactors, factorise, one_thread
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
    found = factorise([one for one, _ in pairs], MODEL.structure)
    whole = triangularise((one for _, one in pairs), n, p)
    size = np.abs(squares(whole.factors)).max()
    np.testing.assert_allclose(squares(found.factors), squares(whole.factors), atol=1e-13 * size)
    np.testing.assert_array_equal(found.rows, whole.rows)
    np.testing.assert_array_equal(np.tril(found.factors, -1), 0.0)
    theta = np.random.default_rng(0).normal(size=p)
    np.testing.assert_allclose(found.residual(theta), whole.residual(theta), rtol=1e-12)


def test_few_rows_are_stacked_to_a_whole_factor() -> None:
    factors = np.zeros((2, 4, 4))
    factors[:, 0] = [[1, 2, 3, 4], [0, 1, 0, 1]]
    assert TriangularFactors(factors, np.array([1, 1])).stack().shape == (4, 4)


def test_a_block_gives_regressor_torque_and_weighted_rows() -> None:
    one, whole = drawn(30)
    theta, weight = np.random.default_rng(2).normal(size=p), np.random.default_rng(3).uniform(1, 2, (n, 30))
    np.testing.assert_allclose(one.regressor(), whole.Y, atol=1e-12 * np.abs(whole.Y).max())
    np.testing.assert_allclose(one.torque(theta).T, whole.Y @ theta, rtol=1e-9)
    np.testing.assert_allclose(one.regressor(np.eye(p)[:, :3]), whole.Y[:, :, :3], atol=1e-12 * np.abs(whole.Y).max())
    heavy = one.scale_rows(weight)
    np.testing.assert_allclose(heavy.regressor(), whole.Y * weight.T[:, :, None], atol=1e-12 * np.abs(whole.Y).max())
    np.testing.assert_array_equal(heavy.tau, one.tau * weight)


def test_shapes_that_do_not_fit_are_an_error() -> None:
    one, _ = drawn(30)
    with pytest.raises(ValueError, match="must match"):
        EntryBlock(one.structure, one.entries[1:], one.tau)
    with pytest.raises(ValueError, match="must match"):
        EntryBlock(one.structure, one.entries, one.tau[:, 1:])


def test_blas_is_limited_until_the_last_one_is_done() -> None:
    def threads() -> set[int]:
        return {one["num_threads"] for one in _controller().info() if one["user_api"] == "blas"}

    before = threads()
    with one_thread():
        with one_thread():
            assert threads() == {1}
        assert threads() == {1}
    assert threads() == before
