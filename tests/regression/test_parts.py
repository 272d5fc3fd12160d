"""Factors of parts of a regression: merged they are those of the whole, whoever computes them."""

from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace
from multiprocessing import get_context

import numpy as np
import pytest

from dynident.regression import (
    ParallelFilter,
    Regression,
    RegressionPart,
    Selection,
    TriangularFactors,
    divide_regression,
    factors_of_parts,
    merge_factors,
)
from dynident.runtime import InputError
from tests.regression.random_motion import ARM, THETA, holes, motion
from tests.regression.test_triangular import squares


def problem(parallel_filter: ParallelFilter | None = None) -> Regression:
    """Motions with holes and without, weights, a bias, and slow samples left out."""
    motions = (motion(mask=holes()), motion(3000, seed=1))
    weights = tuple(np.random.default_rng(k).uniform(0.5, 1.5, x.q.shape) for k, x in enumerate(motions))
    return Regression(ARM, motions, Selection(parallel_filter, (0.5, 0.0)), weights, 0.1 * THETA)


def same(result: TriangularFactors, factors: TriangularFactors) -> None:
    size = np.abs(squares(factors.factors)).max()
    np.testing.assert_allclose(squares(result.factors), squares(factors.factors), atol=1e-11 * size)
    np.testing.assert_array_equal(result.rows, factors.rows)


@pytest.mark.parametrize("parallel_filter", [None, ParallelFilter(decimate=4), ParallelFilter(cutoff=5.0)], ids=str)
def test_merged_parts_are_the_whole_to_rounding(parallel_filter: ParallelFilter | None) -> None:
    regression = problem(parallel_filter)
    parts = divide_regression(regression, 90)
    assert len(parts) > 30
    result = factors_of_parts(regression, parts)
    same(merge_factors(iter(result)), regression.triangular_factors)
    same(merge_factors([merge_factors(result[:7]), merge_factors(result[7:])]), regression.triangular_factors)


def test_parts_hold_every_usable_sample_once_and_reach_over_no_gap() -> None:
    regression = problem()
    for samples in (1, 90, 10**6):
        used = [np.zeros(len(x), dtype=int) for x in regression.motions]
        for part in divide_regression(regression, samples):
            used[part.motion][part.rows] += 1
        for case, count in zip(regression.motions, used, strict=True):
            np.testing.assert_array_equal(count, case.mask)


@pytest.mark.parametrize("kind", ["threads", "processes"])
def test_any_executor_gives_the_same_factors_in_the_same_order(kind: str) -> None:
    regression = problem()
    _ = regression.triangular_factors, regression.cache.setdefault("not to be sent", lambda: None)
    parts = divide_regression(regression, 700)
    pool: Executor = (
        ThreadPoolExecutor(2) if kind == "threads" else ProcessPoolExecutor(2, mp_context=get_context("forkserver"))
    )
    with pool:
        result = factors_of_parts(regression, parts, pool)
    for case, alone in zip(result, factors_of_parts(regression, parts), strict=True):
        np.testing.assert_array_equal(case.factors, alone.factors)


def test_a_part_that_fails_is_named() -> None:
    with pytest.raises(InputError, match="made: samples 5 to 3"):
        factors_of_parts(
            replace(problem(), selection=Selection(ParallelFilter(cutoff=1e9))), [RegressionPart(1, 5, 3000)]
        )
