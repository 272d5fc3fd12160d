"""The smoothing spline against the printed algorithm, dense algebra, scipy, 50 digits, and itself."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline, make_smoothing_spline

from dynident.motion.splines import GCV, REML, Constraint, Fixed, Interpolation, Rule, SmoothingSpline, smooth
from dynident.runtime import ConfigError, InputError
from tests.motion.splines.reference import grid, matrices, second_derivative, series

RULES = [Constraint(), Constraint(S=50.0), Fixed(lam=1e-4), Fixed(p=1e3), GCV(), REML(), Interpolation()]


def printed_algorithm(
    t: np.ndarray, y: np.ndarray, delta: np.ndarray, S: float
) -> tuple[np.ndarray, np.ndarray, float]:
    """Steps (1)-(4) of sec. 2.2 in dense algebra, Newton from p = 0; returns a, c, p."""
    M, N, Q = matrices(t, delta)
    p = 0.0
    for _ in range(60):
        R = np.linalg.cholesky(Q.T @ M**2 @ Q + p * N).T
        u = np.linalg.solve(R, np.linalg.solve(R.T, Q.T @ y))
        v = M @ Q @ u
        e = v @ v
        if e <= S * (1 + 1e-10):
            break
        w = np.linalg.solve(R.T, N @ u)
        p += (e - np.sqrt(S * e)) / (u @ N @ u - p * w @ w)
    return y - M @ v, np.concatenate(([0], p * u, [0])), p


@pytest.mark.parametrize("weighted", [False, True])
@pytest.mark.parametrize("kind", ["uniform", "jittered", "wild"])
def test_agrees_with_the_printed_algorithm(kind: str, weighted: bool) -> None:
    n, sigma = 60, 0.05
    t = grid(n, 0.05, kind)
    rng = np.random.default_rng(2)
    weights = rng.uniform(0.3, 3.0, n) if weighted else np.ones(n)
    delta = sigma / np.sqrt(weights)
    y = np.sin(3 * t) + delta * rng.standard_normal(n)
    a, c, p = printed_algorithm(t, y, delta, S=float(n))
    fit = smooth(t, y, sigma=sigma, weights=weights if weighted else None)
    assert fit.p == pytest.approx(p, rel=1e-6)
    assert fit.lam == pytest.approx(0.5 / p, rel=1e-6)
    np.testing.assert_allclose(fit.values, a, atol=1e-8)
    np.testing.assert_allclose(fit.c, c, atol=1e-6 * np.abs(c).max())


@pytest.mark.parametrize("kind", ["uniform", "jittered", "wild", "wilder"])
@pytest.mark.parametrize("weighted", [False, True])
def test_the_second_derivative_is_as_accurate_as_is_stated(kind: str, weighted: bool) -> None:
    """By 50 digits, over bandwidths, noise and an offset; and the statement is of use: below 1e-11."""
    n = 60
    rng = np.random.default_rng(7)
    t = np.cumsum(np.exp(rng.uniform(-5, 5, n))) if kind == "wilder" else grid(n, 1e-3, kind)
    weights = np.exp(rng.uniform(-3, 3, n)) if weighted else None
    delta = np.ones(n) if weights is None else 1 / np.sqrt(weights)
    step, longest = (t[-1] - t[0]) / (n - 1), 0.0
    for m in (0.3, 1.0, 3.0, 12.0, 100.0):
        for noise, offset in ((1e-2, 0.0), (1e-7, 100.0)):
            y = offset + np.sin(12 * np.arange(n) / n) + noise * rng.standard_normal(n)
            fit = smooth(t, y, Fixed(lam=m**4 * step**3), weights=weights)
            exact = second_derivative(t, y, float(fit.p), delta)
            assert np.linalg.norm(fit.derivative(2) - exact) <= fit.accuracy * np.linalg.norm(exact)
            longest = max(longest, float(fit.accuracy))
    assert longest < (1e-11 if kind != "wilder" else 1e-9)


@pytest.mark.parametrize("kind", ["uniform", "wild"])
def test_fixed_lam_agrees_with_scipy(kind: str) -> None:
    t, y = series(kind=kind)
    weights = np.random.default_rng(0).uniform(0.5, 2, len(t))
    fit, peer = smooth(t, y, Fixed(lam=1e-4), weights=weights), make_smoothing_spline(t, y, weights, lam=1e-4)
    x = np.sort(np.random.default_rng(1).uniform(t[0], t[-1], 500))
    for order in range(4):
        expected = peer.derivative(order)(x) if order else peer(x)
        np.testing.assert_allclose(fit(x, order), expected, atol=1e-6 * np.abs(expected).max())


def test_interpolation_is_the_natural_cubic_spline() -> None:
    t, y = series(kind="wild")
    fit, peer = smooth(t, y, Interpolation()), CubicSpline(t, y, bc_type="natural")
    np.testing.assert_array_equal(fit.values, y)
    np.testing.assert_allclose(fit.c * 2, peer(t, 2), atol=1e-9 * np.abs(peer(t, 2)).max())
    zero = smooth(t, y, Constraint(S=0.0), sigma=1.0)
    np.testing.assert_array_equal(zero.c, fit.c)
    assert (fit.p, fit.lam, fit.S, fit.edf) == (np.inf, 0.0, 0.0, len(t))
    assert fit.residual == 0.0
    assert 0 < fit.accuracy < 1e-12


def test_effective_degrees_of_freedom_are_the_trace() -> None:
    t, y = series(n=120, kind="wild")
    weights = np.random.default_rng(0).uniform(0.5, 2, len(t))
    fit = smooth(t, y, sigma=1e-2, weights=weights)
    M, N, Q = matrices(t, 1e-2 / np.sqrt(weights))
    away = M**2 @ Q @ np.linalg.solve(Q.T @ M**2 @ Q + fit.p * N, Q.T)
    assert fit.edf == pytest.approx(len(t) - np.trace(away), rel=1e-6)


@pytest.mark.parametrize("rule", RULES, ids=repr)
def test_scaling_and_shifting(rule: Constraint) -> None:
    """The unit of time, the unit of y, and their zero change nothing but the numbers' scale."""
    t = np.arange(256) / 256.0
    y = np.sin(6 * t) + 0.01 * np.random.default_rng(0).standard_normal(256)
    sigma = 0.01 if isinstance(rule, Constraint) else None
    a, b = 2.0**10, 2.0**-7
    motion = smooth(t, y, rule, sigma=sigma)
    if not isinstance(rule, Fixed):
        two = smooth(a * t, b * y, rule, sigma=b * sigma if sigma else None)
        np.testing.assert_allclose(two.values, b * motion.values, rtol=0, atol=1e-10 * b)
        np.testing.assert_allclose(two.c, motion.c * b / a**2, rtol=0, atol=1e-7 * np.abs(motion.c).max() * b / a**2)
    three = smooth(t + 1024.0, y + 64.0, rule, sigma=sigma)
    np.testing.assert_allclose(three.values - 64.0, motion.values, rtol=0, atol=1e-10)
    np.testing.assert_allclose(three.c, motion.c, rtol=0, atol=1e-6 * np.abs(motion.c).max())


@pytest.mark.parametrize("rule", RULES, ids=repr)
@pytest.mark.parametrize("weighted", [False, True])
def test_columns_are_smoothed_each_on_its_own(rule: Constraint, weighted: bool) -> None:
    t, y = series(n=200)
    both = np.column_stack((y, 3 * y + t, np.cos(5 * t), 2 * t))
    both[:, 2] += 0.03 * np.random.default_rng(5).standard_normal(len(t))
    weights = np.random.default_rng(6).uniform(0.5, 2, both.shape) if weighted else None
    fit = smooth(t, both, rule, sigma=0.02, weights=weights)
    assert fit.values.shape == fit.derivative(1).shape == both.shape
    assert fit(t[:7] + 1e-4).shape == (7, 4)
    for k in range(4):
        single = smooth(t, both[:, k], rule, sigma=0.02, weights=None if weights is None else weights[:, k])
        assert isinstance(single, SmoothingSpline)
        np.testing.assert_allclose(fit.values[:, k], single.values, atol=1e-7)
        for name in ("p", "lam", "S", "edf", "noise", "bandwidth"):
            both_value, case = getattr(fit, name)[k], getattr(single, name)
            assert np.isnan(case) if np.isnan(both_value) else case == pytest.approx(both_value, rel=1e-4), name


@pytest.mark.parametrize("order", [0, 1, 2, 3])
def test_derivatives_at_samples_are_those_of_the_pieces(order: int) -> None:
    t, y = series(kind="wild")
    fit = smooth(t, y, sigma=1e-2)
    scale = np.abs(fit.derivative(order)).max()
    inside = slice(None, -1) if order == 3 else slice(None)
    np.testing.assert_allclose(fit(t, order)[inside], fit.derivative(order)[inside], atol=1e-12 * scale)
    if order == 3:  # at the end that of the last piece
        np.testing.assert_allclose(fit(0.5 * (t[-2] + t[-1]), 3), fit.derivative(3)[-1], rtol=1e-9)
    before = t[1:] - 1e-9 * np.diff(t)  # continuous up to the second derivative
    if order < 3:
        np.testing.assert_allclose(fit(before, order), fit.derivative(order)[1:], atol=1e-6 * scale)


def test_outside_the_data() -> None:
    t, y = series()
    fit = smooth(t, y, sigma=1e-2)
    with pytest.raises(InputError, match=r"lies outside the data .* extrapolate=True"):
        fit(t[-1] + 0.1)
    beyond = np.array([t[0] - 0.5, t[-1] + 0.5])
    ends, slopes = fit.values[[0, -1]], fit.derivative(1)[[0, -1]]
    np.testing.assert_allclose(fit(beyond, extrapolate=True), ends + slopes * [-0.5, 0.5])
    np.testing.assert_allclose(fit(beyond, 1, extrapolate=True), slopes)
    assert not fit(beyond, 2, extrapolate=True).any()
    assert not fit(beyond, 3, extrapolate=True).any()


@pytest.mark.parametrize(
    ("t", "y", "error", "words"),
    [
        ([0, 1, 1, 2], [0, 1, 2, 3], InputError, r"t\[2\] = .* does not exceed t\[1\]"),
        ([0, 2, 1, 3], [0, 1, 2, 3], InputError, r"t\[2\]"),
        ([0, 1], [0, 1], InputError, "at least 3 samples, got 2"),
        ([0, 1, 2, 3], [0, np.nan, 2, 3], InputError, r"y\[1\] is nan"),
        ([0, 1, np.inf, 3], [0, 1, 2, 3], InputError, r"t\[2\] is inf"),
        ([0, 1, 2], [0, 1], InputError, r"shapes \(3,\) and \(2,\)"),
        ([0, 1, 2, 3], [0, 1, 0, 3], InputError, "too few to estimate sigma"),
    ],
)
def test_bad_data(t: list[float], y: list[float], error: type[Exception], words: str) -> None:
    with pytest.raises(error, match=words):
        smooth(t, y)


@pytest.mark.parametrize(
    ("rule", "options", "words"),
    [
        ("gcv", {}, r"rule is 'gcv'; give a rule, such as Constraint\(\)"),
        (Constraint(S=-1), {}, "S is -1"),
        (Constraint(S=np.nan), {}, "S is nan"),
        (Constraint(S=[1.0, 2.0]), {"columns": 3}, "S has 2 entries"),
        (Fixed(lam=-1.0), {}, "lam is -1"),
        (Constraint(), {"sigma": 0.0}, "sigma is 0.0"),
        (Constraint(), {"sigma": [1.0, -1.0], "columns": 2}, "must be positive"),
        (Constraint(), {"weights": np.zeros(300)}, "weights must be positive"),
        (Constraint(), {"weights": np.ones(3)}, r"shape \(3, 1\); expected \(300,\)"),
    ],
)
def test_bad_settings(rule: Constraint, options: dict, words: str) -> None:
    t, y = series()
    data = np.column_stack([y] * options.pop("columns", 1))
    with pytest.raises(ConfigError, match=words):
        smooth(t, data, rule, **{"sigma": 1e-2, **options})


def test_exactly_one_of_p_and_lam() -> None:
    with pytest.raises(ConfigError, match="exactly one of p and lam"):
        Fixed()
    with pytest.raises(ConfigError, match="a cubic spline has 0, 1, 2 and 3"):
        smooth([0, 1, 2, 3], [0, 1, 0, 1], Interpolation()).derivative(4)


def test_more_smoothing_than_double_precision_resolves_is_refused() -> None:
    n = 60_000
    t = np.arange(n) * 1e-6
    with pytest.raises(InputError, match="cannot be smoothed with these settings"):
        smooth(t, np.sin(40 * t), Fixed(lam=20000.0**4 * 1e-18))


@settings(max_examples=60, deadline=None)
@given(
    steps=st.lists(st.floats(1e-3, 1e3), min_size=6, max_size=40),
    values=st.lists(st.floats(-1e6, 1e6), min_size=41, max_size=41),
    level=st.floats(0.01, 2.0),
)
def test_any_grid_and_values(steps: list[float], values: list[float], level: float) -> None:
    """On any grid the constraint holds (or a line satisfies it), and no curvature remains at the ends."""
    t = np.concatenate(([0.0], np.cumsum(steps)))
    y = np.array(values[: len(t)])
    sigma = 1e-3 * (1.0 + np.abs(y).max())
    S = level * len(t)
    fit = smooth(t, y, Constraint(S=S), sigma=sigma)
    reached = float(np.sum(((fit.values - y) / sigma) ** 2))
    assert reached == pytest.approx(S, rel=1e-7) or (reached < S and fit.p == 0)
    assert fit.c[0] == fit.c[-1] == 0
    assert 2 - 1e-6 <= fit.edf <= len(t) + 1e-6


@pytest.mark.parametrize("lam", [1e-3, 1.0])
def test_of_the_cut_off_frequency_71_percent_pass(lam: float) -> None:
    t = np.arange(20_000) * 1e-3
    cutoff = float(smooth(t, np.sin(t), Fixed(lam=lam)).cutoff)
    passed = smooth(t, np.sin(2 * np.pi * cutoff * t), Fixed(lam=lam)).values[8000:12_000]
    assert np.abs(passed).max() == pytest.approx(np.sqrt(0.5), rel=1e-5)
    assert smooth(t, np.sin(t), Interpolation()).cutoff == np.inf


@pytest.mark.parametrize("rule", RULES, ids=repr)
@pytest.mark.parametrize("sigma", [None, 1e-3])
@pytest.mark.parametrize("slope", [0.0, 3.3])
@pytest.mark.parametrize("n", [7, 500, 20_000])
def test_a_standstill_and_a_straight_line(n: int, slope: float, sigma: float | None, rule: Rule) -> None:
    t = np.arange(n) * 0.002
    y = np.array([0.0, 0.7, 1e-9, 123.456]) + slope * t[:, None]
    fit = smooth(t, y, rule, sigma=sigma)
    size = np.maximum(np.abs(y).max(axis=0), 1e-300)
    assert (np.abs(fit.values - y) <= 1e-9 * size + 1e-7 * np.abs(y)).all()
    assert (np.abs(fit.derivative(1) - slope) <= 1e-6 * size / 0.002 + 1e-7 * slope).all()
    assert np.isfinite(fit.c).all()


def test_numbers_out_of_range_are_refused_in_any_column_and_those_just_in_range_are_not() -> None:
    x = np.linspace(0, 3, 50)
    parabola, wave = np.linspace(0, 1, 50) ** 2, np.sin(x)  # the first spans its size
    for size in (1.1e-100, 0.9e100):
        np.testing.assert_array_equal(smooth(x, size * parabola, Interpolation()).values, size * parabola)
        np.testing.assert_array_equal(smooth(size * np.linspace(0, 1, 50), x, Interpolation()).values, x)
    wide, columns = [0.9e-100 * parabola, 1.1e100 * parabola], np.column_stack([wave, 1e-300 * wave])
    for t, y in [(1e-160 * x, wave), (1e160 * x, wave), (x, 1e160 * wave), (x, columns), *((x, y) for y in wide)]:
        with pytest.raises(InputError, match="out of range"):
            smooth(t, y)


def test_a_rule_that_searches_for_nothing_is_an_error() -> None:
    class Straight(Rule):
        def choose(self, series, column):  # type: ignore[no-untyped-def]
            return series.straight_solution()

    with pytest.raises(ConfigError, match=r"pulse: .*returned Solution, expected a generator"):
        smooth(np.arange(9.0), np.arange(9.0) ** 2, Straight(), names=["pulse"])
