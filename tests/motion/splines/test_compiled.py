"""What the kernel does against NumPy and LAPACK: every function, all levels of this CPU, over the range of p."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import product
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynident.motion.splines import (
    GCV,
    REML,
    Constraint,
    Fixed,
    Interpolation,
    SmoothingSpline,
    compiled,
    noise_sigma,
    smooth,
)
from dynident.motion.splines.banded import Grid, IllConditionedError, Solution, System, second_difference
from dynident.motion.splines.compiled import (
    BareProblem,
    Solver,
    SplineTrial,
    column_ranges,
    scale_columns,
    slopes,
    spline_values,
)
from dynident.runtime.kernel import kernel
from tests.kernel_levels import BEST, functions_of

compiled_only = pytest.mark.skipif(kernel().level is None, reason=f"there is no compiled kernel: {kernel().about}")


@contextmanager
def kernel_level(level: str) -> Iterator[None]:
    """A level of the kernel for a while, or with ``off`` NumPy and LAPACK."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(compiled, "function", functions_of(level))
        patch.setattr(Solver, "_local", threading.local())
        yield


def steps(n: int, spread: float, rng: np.random.Generator) -> np.ndarray:
    step = np.exp(spread * rng.standard_normal(n - 1))
    return step / step.mean()


def trials(n: int, count: int, spread: float, weighted: bool, p: np.ndarray, seed: int) -> list[SplineTrial]:
    rng = np.random.default_rng(seed)
    grid = Grid(steps(n, spread, rng))
    out = []
    for k in range(count):
        variance = np.exp(rng.uniform(-2, 2, n)) if weighted else None
        y = np.sin(np.arange(n) * (k + 1) / 7) + 0.1 * rng.standard_normal(n)
        out.append(SplineTrial(BareProblem(System(grid, variance), second_difference(y, grid.step)), float(p[k])))
    return out


def changed(asked: list[SplineTrial], **what: bool) -> list[SplineTrial]:
    return [SplineTrial(x.series, x.p, **what) for x in asked]


@compiled_only
@settings(max_examples=60, deadline=None)
@given(
    n=st.integers(3, 60),
    count=st.integers(1, 20),
    spread=st.sampled_from([0.0, 0.2, 1.0]),
    weighted=st.booleans(),
    p=st.lists(st.floats(-25.0, 6.0), min_size=20, max_size=20),
    seed=st.integers(0, 2**20),
)
def test_solutions_are_those_of_lapack(
    n: int, count: int, spread: float, weighted: bool, p: list[float], seed: int
) -> None:
    asked = trials(n, count, spread, weighted, np.exp(p), seed)
    solver = Solver()
    for case, (result, expected) in zip(asked, pairs(solver, changed(asked, refine=True)), strict=True):
        if isinstance(expected, IllConditionedError) or isinstance(result, IllConditionedError):
            continue  # at the limit of double precision either may fail, but says so
        np.testing.assert_allclose(result.u, expected.u, atol=1e-11 * np.linalg.norm(expected.u))
        np.testing.assert_allclose(result.rss, expected.rss, rtol=1e-10)
        assert result.residual < max(1e-9, 10 * expected.residual)
        assert result.p == case.p
    condition = 1e-15 * np.minimum(n, np.exp(-np.array(p) / 4)) ** 4 * np.exp(8 * spread) * (50 if weighted else 1)
    for k, (result, expected) in enumerate(pairs(solver, changed(asked, trace=True, determinant=True))):
        if isinstance(expected, Solution) and isinstance(result, Solution) and condition[k] < 1e-6:
            rtol = 1e-11 + 100 * condition[k]
            full = expected.rss + expected.p * expected.energy
            np.testing.assert_allclose(result.rss, expected.rss, atol=rtol * full)
            np.testing.assert_allclose(result.slope * result.rss, expected.slope * expected.rss, atol=2 * rtol * full)
            np.testing.assert_allclose(result.energy, expected.energy, rtol=rtol, atol=rtol * full / result.p)
            np.testing.assert_allclose(result.log_det, expected.log_det, atol=rtol * n * 10)
            np.testing.assert_allclose([result.rise, result.bend], [expected.rise, expected.bend], atol=rtol * n)


def pairs(solver: Solver, asked: list[SplineTrial]) -> list[tuple[compiled.Answer, compiled.Answer]]:
    """Answers of the kernel and of LAPACK."""
    with kernel_level("off"):
        expected = Solver()(asked)
    return list(zip(solver(asked), expected, strict=True))


@compiled_only
@pytest.mark.parametrize("n", [4, 5, 12, 13, 200])
def test_a_series_has_the_same_bits_alone_and_beside_others(n: int) -> None:
    asked = trials(n, 11, 0.3, True, np.exp(np.linspace(-12, 3, 11)), 0)
    for what in ({"refine": True}, {"trace": True, "determinant": True}):
        together = Solver()(changed(asked, **what))
        for case, result in zip(changed(asked, **what), together, strict=True):
            (alone,) = Solver()([case])
            for name in ("rss", "residual", "accuracy", "slope", "energy", "rise", "bend"):
                np.testing.assert_array_equal(getattr(alone, name), getattr(result, name), err_msg=name)
            np.testing.assert_array_equal(alone.u, result.u)


@compiled_only
def test_all_levels_give_the_same_bits() -> None:
    rng = np.random.default_rng(0)
    t = np.cumsum(rng.uniform(0.5, 1.5, 700)) * 1e-3
    y = np.sin(np.outer(t, np.arange(1, 12))) + 1e-2 * rng.standard_normal((700, 11))
    weights, result = rng.uniform(0.5, 2, y.shape), []
    for level in BEST:
        with kernel_level(level):
            result.append([noise_sigma(t, y), noise_sigma(t, y, weights)])
            for rule, weight in product((Constraint(), Fixed(lam=1e-6), GCV(), REML()), (None, weights)):
                fit = smooth(t, y, rule, sigma=0.01, weights=weight)
                alone = smooth(t, y[:, 0], rule, sigma=0.01)
                result[-1] += [fit.values, fit.c, fit.derivative(1), fit.p, fit.edf, fit.S, alone.c, alone.p]
    for case, other in product(result[:1], result[1:]):
        for first, second in zip(case, other, strict=True):
            np.testing.assert_array_equal(first, second)


@compiled_only
@pytest.mark.parametrize("rule", [Constraint(), Constraint(S=30.0), Fixed(lam=1e-4), GCV(), REML(), Interpolation()])
@pytest.mark.parametrize("weighted", [False, True])
@pytest.mark.parametrize("columns", [1, 2, 9])
def test_splines_are_those_of_lapack(rule: Any, weighted: bool, columns: int) -> None:
    for n, spread in product((30, 301), (0.0, 0.5)):
        rng = np.random.default_rng(n)
        t = np.concatenate(([0.0], np.cumsum(steps(n, spread, rng)))) * 0.01
        y = np.sin(np.outer(3 * t, np.arange(1, columns + 1))) + 0.02 * rng.standard_normal((n, columns))
        weights = rng.uniform(0.3, 3, y.shape) if weighted else None
        motion = smooth(t, y, rule, sigma=0.02, weights=weights)
        with kernel_level("off"):
            expected = smooth(t, y, rule, sigma=0.02, weights=weights)
            assert_same(motion, expected)


FIGURES = ("values", "c", "p", "lam", "S", "sigma", "residual", "accuracy")


@compiled_only
@settings(max_examples=60, deadline=None)
@given(
    n=st.sampled_from([4, 5, 6, 30, 301, 1000]),
    spread=st.sampled_from([0.0, 0.2, 1.0]),
    speed=st.floats(-3.0, -0.3),
    noise=st.floats(-5.0, 1.0),
    share=st.floats(-1.0, 0.3),
    known=st.booleans(),
    seed=st.integers(0, 2**20),
)
def test_a_single_series_is_fitted_to_the_same_bits_as_beside_others(
    n: int, spread: float, speed: float, noise: float, share: float, known: bool, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    x = np.concatenate(([0.0], np.cumsum(steps(n, spread, rng))))
    y = 3.0 + 1e3 * (np.sin(10**speed * x) + 10**noise * rng.standard_normal(n))
    sigma = 1e3 * 10**noise if known or n < 6 else None
    for rule in (Constraint(), Constraint(S=n * 10**share), Fixed(p=10**share), Fixed(lam=10**noise), GCV()):
        together = smooth(0.01 * x - 1.0, np.column_stack([y, y]), rule, sigma=sigma)
        for shape in ((n,), (n, 1)):
            alone = smooth(0.01 * x - 1.0, y.reshape(shape), rule, sigma=sigma)
            for name in FIGURES:
                first_column = getattr(together, name)[..., :1]
                expected = first_column if len(shape) == 2 else first_column[..., 0]
                np.testing.assert_array_equal(getattr(alone, name), expected, err_msg=f"{name} by {rule}", strict=True)


def assert_same(spline: SmoothingSpline, expected: SmoothingSpline) -> None:
    for name in ("p", "S", "edf"):
        np.testing.assert_allclose(getattr(spline, name), getattr(expected, name), rtol=1e-7, err_msg=name)
    for order, rtol in ((0, 1e-9), (1, 1e-8), (2, 1e-7)):
        first, second = spline.derivative(order), expected.derivative(order)
        np.testing.assert_allclose(first, second, atol=rtol * np.abs(second).max())


@compiled_only
@pytest.mark.parametrize("columns", [1, 3])
@pytest.mark.parametrize("n", [3, 4, 255, 256, 257, 600])
def test_what_is_done_to_the_data(n: int, columns: int) -> None:
    rng = np.random.default_rng(n)
    grid, t = Grid(steps(n, 0.5, rng)), np.zeros(n)
    np.cumsum(grid.step, out=t[1:])
    y = 5 + rng.standard_normal((n, columns))
    unit, size, bend = ((2.0 ** rng.integers(-3, 3, columns)).tolist() for _ in range(3))
    systems = [System(grid, rng.uniform(0.5, 2, n)) for _ in range(columns)]
    u = list(rng.standard_normal((columns, n - 2)))
    result: list[Any] = [*scale_columns(grid, t, y, unit)[:2], *spline_values(y, systems, u, size, bend)]
    left, (low, high, finite) = scale_columns(grid, t, y, unit)[2], column_ranges(y)
    with kernel_level("off"):
        expected: list[Any] = [*scale_columns(grid, t, y, unit)[:2], *spline_values(y, systems, u, size, bend)]
        assert slopes(t, *expected[2:]) is None
        for first, second in zip((low, high), column_ranges(y), strict=False):
            np.testing.assert_array_equal(first, second)
    assert finite
    for first, second in zip(result, expected, strict=True):
        np.testing.assert_allclose(first, second, atol=1e-13 * np.abs(second).max(), rtol=1e-13)
    for k in range(columns):
        line = np.polyval(np.polyfit(t, y[:, k], 1), t)
        if n > 3:
            np.testing.assert_allclose(left[k], np.sum(((y[:, k] - line) * unit[k]) ** 2), rtol=1e-9)


@compiled_only
@pytest.mark.parametrize("columns", [1, 3, 9])
@pytest.mark.parametrize("weights", [None, 1, 9])
@pytest.mark.parametrize("n", [6, 300])
def test_the_noise_is_that_of_numpy(n: int, weights: int | None, columns: int) -> None:
    rng = np.random.default_rng(n)
    t, y = np.cumsum(steps(n + 1, 0.5, rng)), rng.standard_normal((n, 9))[:, :columns]
    weight = None if weights is None else rng.uniform(0.5, 2, (n, min(weights, columns)))
    result = noise_sigma(t, y, weight)
    with kernel_level("off"):
        np.testing.assert_allclose(result, noise_sigma(t, y, weight), rtol=1e-12)
    np.testing.assert_array_equal(noise_sigma(t, y[:, 0], None if weight is None else weight[:, 0]), result[0])


@compiled_only
@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("shape", [(41, 1), (20, 3)])
def test_a_value_that_is_not_finite_is_seen_wherever_it_is(wrong: float, shape: tuple[int, int]) -> None:
    for k in range(shape[0] * shape[1]):
        y = np.ones(shape)
        y.flat[k] = wrong
        assert not column_ranges(y)[2]


@compiled_only
@pytest.mark.parametrize("refine", [True, False])
def test_a_system_that_breaks_down_says_so_beside_ones_that_do_not(refine: bool) -> None:
    system, z = System(Grid(np.diff(1e-6 * np.arange(60_000)) * 1e6)), np.sin(40e-6 * np.arange(59_998))
    asked = [SplineTrial(BareProblem(system, z), p, refine) for p in (0.5 / 20_000.0**4, 1e-4, 1.0, 1e-3)]
    for solved in (Solver()(asked), [Solver()([x])[0] for x in asked]):
        assert all(isinstance(x, Solution) and np.isfinite(x.rss) for x in solved[1:])
        assert isinstance(solved[0], IllConditionedError)
        assert str(solved[0]) == "the Cholesky factorisation broke down"
