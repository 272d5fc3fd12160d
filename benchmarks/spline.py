"""Smoothing splines with both derivatives at the samples, by dynident and by its peers."""

from __future__ import annotations

import subprocess
from collections.abc import Callable

import numpy as np

LAM = 1e-6  # in sum((g - y)^2) + lam * integral(g''^2)
SIGMA = 1e-3
Call = Callable[[], object]
R = """
n <- {n}; t <- (0:(n - 1)) * 1e-3; y <- sin(t) + 0.5 * sin(3.1 * t) + {sigma} * rnorm(n)
once <- function() {{
  fit <- smooth.spline(t, y, all.knots = TRUE, keep.data = FALSE{rule})
  predict(fit, t, deriv = 1); predict(fit, t, deriv = 2)
}}
invisible(once()); number <- max(1, floor(3e5 / n))
cat(sum(system.time(for (k in 1:number) once())[1:2]) / number)
"""


def signal(n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """sin t + 0.5 sin 3.1 t at 1 kHz with noise; and its second derivative."""
    t = np.arange(n) * 1e-3
    noise = SIGMA * np.random.default_rng(0).standard_normal(n)
    return t, np.sin(t) + 0.5 * np.sin(3.1 * t) + noise, -np.sin(t) - 0.5 * 3.1**2 * np.sin(3.1 * t)


def constraint(way: str, n: int, series: int = 1) -> Call:
    """S = n, of one series or several together."""
    t, y, _ = signal(n)
    if way == "FITPACK":
        return lambda: fitpack(t, y)
    from dynident.motion.splines import Constraint, smooth

    if series > 1:
        angle = np.outer(t, 1 + 0.2 * np.arange(series) % 2)  # other speeds, and other smoothing
        y = np.sin(angle) + 0.5 * np.sin(3.1 * angle) + SIGMA * np.random.default_rng(1).standard_normal((n, series))

    def ours() -> None:
        fit = smooth(t, y, Constraint(), sigma=SIGMA)
        fit.derivative(1)
        fit.derivative(2)

    return ours


def fixed(way: str, n: int) -> Call:
    """A smoothing that is given."""
    t, y, _ = signal(n)
    match way:
        case "csaps":
            return lambda: csaps_spline(t, y)
        case "SciPy":
            return lambda: scipy_spline(t, y, LAM)
        case "R":  # on <0, 1>, of the mean of the squares
            return lambda: in_r(n, f", lambda = {LAM / n / t[-1] ** 3}")
    from dynident.motion.splines import Fixed, smooth

    def ours() -> None:
        fit = smooth(t, y, Fixed(lam=LAM))
        fit.derivative(1)
        fit.derivative(2)

    return ours


def gcv(way: str, n: int) -> Call:
    """A smoothing by generalised cross-validation."""
    t, y, _ = signal(n)
    match way:
        case "SciPy":
            return lambda: scipy_spline(t, y, None)
        case "R":
            return lambda: in_r(n, "")
    from dynident.motion.splines import GCV, smooth

    def ours() -> None:
        fit = smooth(t, y, GCV())
        fit.derivative(1)
        fit.derivative(2)

    return ours


def fitpack(t: np.ndarray, y: np.ndarray) -> np.ndarray:
    from scipy.interpolate import UnivariateSpline

    fit = UnivariateSpline(t, y, w=np.full(len(t), 1 / SIGMA), s=len(t))
    fit.derivative(1)(t)
    return np.asarray(fit.derivative(2)(t))


def scipy_spline(t: np.ndarray, y: np.ndarray, lam: float | None) -> np.ndarray:
    from scipy.interpolate import make_smoothing_spline

    fit = make_smoothing_spline(t, y, lam=lam)
    fit.derivative(1)(t)
    return np.asarray(fit.derivative(2)(t))


def csaps_spline(t: np.ndarray, y: np.ndarray) -> np.ndarray:
    from csaps import CubicSmoothingSpline

    fit = CubicSmoothingSpline(t, y, smooth=1 / (1 + LAM)).spline
    fit.derivative(1)(t)
    return np.asarray(fit.derivative(2)(t))


def in_r(n: int, rule: str) -> dict[str, float]:
    """Measure R's smooth.spline with a knot at each sample, inside R."""
    text = R.format(n=n, sigma=SIGMA, rule=rule)
    try:
        done = subprocess.run(["Rscript", "-e", text], capture_output=True, text=True, check=True)
    except FileNotFoundError:
        raise FileNotFoundError("Rscript is not found") from None
    return {"cpu": float(done.stdout)}
