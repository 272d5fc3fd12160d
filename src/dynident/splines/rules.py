"""How much to smooth: each rule chooses the Lagrange parameter p of eq. (15) for one series.

A rule is a frozen dataclass of settings. p is searched on a logarithmic scale and in scaled units, so that no rule
depends on the units of time or position.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from dynident.errors import ConfigError, choices
from dynident.splines.banded import IllConditionedError, Solution, System, second_difference

__all__ = ["GCV", "REML", "Constraint", "Fixed", "Interpolation", "Rule", "Series", "check_columns", "rule_named"]

Array = NDArray[np.float64]
CHUNK = 4096
EPS = float(np.finfo(np.float64).eps)
STAGNATION = 1e-6  # largest relative error of S allowed for rounding


@dataclass(frozen=True, eq=False)
class Series:
    """One column of data in scaled units, with the factors to convert back.

    ``y`` (N) is the data less the first of them, divided by ``size`` (a power of two), ``z`` = Q' y, ``noise`` the
    root mean square of delta and ``rounding`` the last digit of the data, both divided by ``size``; ``step`` is the
    mean step in the user's unit of time; p of eq. (15) is ``p_scale`` times the scaled one.
    """

    system: System
    y: Array
    z: Array
    noise: float
    size: float
    step: float
    rounding: float

    @classmethod
    def of(cls, system: System, y: Array, noise: float, step: float) -> Series:
        """Scale one column; ``noise`` is the root mean square of delta in the unit of y."""
        rounding = EPS * float(np.abs(y).max())
        y = y - y[0]
        reach = float(np.abs(y).max())
        size = 2.0 ** round(np.log2(reach)) if reach > 0 else 1.0
        y /= size
        return cls(system, y, second_difference(y, system.step), noise / size, size, step, rounding / size)

    @property
    def p_scale(self) -> float:
        """p of eq. (15) over the scaled p."""
        return (self.noise * self.size) ** 2 / self.step**3

    def central(self) -> Series | None:
        """Return the middle of the data, from which a search may start, or None where the data are short."""
        n = len(self.y)
        if n < 4 * CHUNK:
            return None
        part = slice((n - CHUNK) // 2, (n - CHUNK) // 2 + CHUNK)
        step = self.system.step[part][:-1]
        variance = None if self.system.variance is None else self.system.variance[part]
        y = self.y[part]
        return replace(self, system=System(step, variance), y=y, z=second_difference(y, step))

    def line(self) -> Array:
        """Return the weighted least-squares straight line at the samples (the limit p = 0)."""
        x = np.zeros_like(self.y)
        np.cumsum(self.system.step, out=x[1:])
        w = np.broadcast_to(1.0, x.shape) if self.system.variance is None else 1.0 / self.system.variance
        total = float(w.sum())
        x -= float(w @ x) / total
        mean = float(w @ self.y) / total
        wx = x if self.system.variance is None else w * x
        return np.asarray(mean + x * (float(wx @ (self.y - mean)) / float(wx @ x)))

    @property
    def is_straight(self) -> bool:
        """Whether the data are a straight line to within rounding."""
        return float(np.abs(self.y - self.line()).max()) <= 4 * self.rounding + EPS * (64 + len(self.y))

    def straight(self) -> Solution:
        """Return the straight line as a solution with p = 0 and no curvature."""
        v = self.y - self.line()
        rss = float(v @ v if self.system.variance is None else v @ (v / self.system.variance))
        return Solution(0.0, np.zeros(self.system.size), v, rss, 0.0, 0.0)


class Rule(ABC):
    """Base of the rules; ``needs_sigma``: whether the noise must be known or estimated."""

    needs_sigma: ClassVar[bool] = False

    @abstractmethod
    def choose(self, series: Series, column: int, start: float | None = None) -> Solution:
        """Return the solution at the chosen p (scaled units); ``start`` is the scaled p of a similar series."""


@dataclass(frozen=True)
class Constraint(Rule):
    """The article's rule, eq. (14): sum(((g - y) / delta)^2) = S; S = n (the number of samples) where not given.

    S is a number or one per column. A straight line is returned where it satisfies the constraint, the interpolating
    spline for S = 0. p is found by Newton's method on log F against log p, F = |D Q u| (Reinsch's F), with inverse
    Hermite interpolation near the root, kept inside a bracket. It stops at a relative error of 1e-10 in S, or where
    rounding prevents further improvement: the result holds the S reached, and an error above 1e-6 is raised.
    """

    S: float | Sequence[float] | None = None
    needs_sigma: ClassVar[bool] = True

    def choose(self, series: Series, column: int, start: float | None = None) -> Solution:
        """Solve F(p)^2 = S."""
        S = _per_column(self.S, column, "S")
        S = float(len(series.y)) if S is None else S
        if not (np.isfinite(S) and S >= 0):
            raise ConfigError(f"S is {S}; it must be a finite number >= 0 (S = n with the right sigma).")
        if S == 0:
            return _interpolation(series)
        target = S * series.noise**2
        straight = series.straight()
        if straight.rss <= target or series.is_straight:
            return straight
        if start is None:
            start = self._start(series, target)
        return _newton(series, target, start)

    @staticmethod
    def _start(series: Series, target: float) -> float:
        chunk = series.central()
        p = _p_of_bandwidth(20.0)
        if chunk is None:
            return p
        share = target * len(chunk.y) / len(series.y)
        if chunk.straight().rss <= share:
            return p
        try:
            return _newton(chunk, share, p, tolerance=1e-4).p
        except IllConditionedError:
            return p


@dataclass(frozen=True)
class Fixed(Rule):
    """A given Lagrange parameter: p of eq. (15), or lam = 1 / (2 p), the factor of the integral of g''^2.

    lam multiplies the integral in sum(((g - y) / delta)^2) + lam * integral(g''^2). One number, or one per column.
    """

    p: float | Sequence[float] | None = None
    lam: float | Sequence[float] | None = None

    def __post_init__(self) -> None:
        if (self.p is None) == (self.lam is None):
            raise ConfigError("give exactly one of p and lam to Fixed (lam = 1 / (2 p)).")

    def choose(self, series: Series, column: int, start: float | None = None) -> Solution:  # noqa: ARG002
        """Solve once."""
        p, lam = _per_column(self.p, column, "p"), _per_column(self.lam, column, "lam")
        name, value = ("p", p) if lam is None else ("lam", lam)
        if value is None or np.isnan(value) or value < 0:
            raise ConfigError(f"{name} is {value}; it must be a number >= 0.")
        with np.errstate(divide="ignore"):
            p = float(value if lam is None else np.float64(0.5) / value)
        if p == np.inf:
            return _interpolation(series)
        return series.straight() if p == 0 else series.system.solve(p / series.p_scale, series.z)


@dataclass(frozen=True)
class Interpolation(Rule):
    """No smoothing: the natural cubic spline through the data (S = 0)."""

    def choose(self, series: Series, column: int, start: float | None = None) -> Solution:  # noqa: ARG002
        """Interpolate."""
        return _interpolation(series)


@dataclass(frozen=True)
class GCV(Rule):
    """Generalised cross-validation: minimises rss / (1 - edf / n)^2; needs no sigma. Craven and Wahba (1979)."""

    def choose(self, series: Series, column: int, start: float | None = None) -> Solution:  # noqa: ARG002
        """Minimise the criterion over log p."""
        return _search(series, _gcv)


@dataclass(frozen=True)
class REML(Rule):
    """Restricted maximum likelihood (generalised maximum likelihood): needs no sigma. Wahba (1985).

    Q' y is normal with covariance proportional to Q' D^2 Q + p N: minimises (n - 2) log(y' Q u) + log det.
    """

    def choose(self, series: Series, column: int, start: float | None = None) -> Solution:  # noqa: ARG002
        """Minimise the criterion over log p."""
        return _search(series, _reml)


def check_columns(rule: Rule, columns: int) -> None:
    """Raise ConfigError where a setting of the rule has entries for more columns than there are."""
    for name in ("S", "p", "lam"):
        if (given := int(np.size(np.asarray(getattr(rule, name, None))))) > max(columns, 1):
            raise ConfigError(f"{name} has {given} entries, but the data have {columns} columns; give one for each.")


def _per_column(value: float | Sequence[float] | None, column: int, name: str) -> float | None:
    if value is None:
        return None
    values = np.atleast_1d(np.asarray(value, dtype=float))
    if not values.size:
        raise ConfigError(f"{name} has no entries; give a number, or one for each column.")
    if values.size > 1 and column >= values.size:
        raise ConfigError(f"{name} has {values.size} entries, but the data have more than {column} columns.")
    return float(values[column if values.size > 1 else 0])


def _p_of_bandwidth(m: float) -> float:
    """Return the scaled p whose bandwidth (lam / h^3)^(1/4) is m samples."""
    return 0.5 / m**4


def _interpolation(series: Series) -> Solution:
    c = series.system.interpolate(series.z)
    return Solution(np.inf, c, np.zeros_like(series.y), 0.0, 0.0, 0.0)


def _newton(series: Series, target: float, p: float, tolerance: float = 1e-10) -> Solution:
    """Find rss(p) = target; rss falls with p, and log rss against log p is nearly straight."""
    low, high = -np.inf, np.inf  # bracket of the root in log p
    x, refine = float(np.log(p)), False
    before: tuple[float, float, float] | None = None
    best: tuple[float, Solution] | None = None
    for _ in range(200):
        now = series.system.solve(float(np.exp(x)), series.z, refine=refine, slope=True)
        error = float(np.log(max(now.rss, np.finfo(float).tiny) / target))
        if not np.isfinite(now.rss):
            raise IllConditionedError("the search for p left the range of numbers")
        if refine:
            if abs(error) <= tolerance:
                return now
            if best is not None and abs(error) >= abs(best[0]):  # rounding lets it improve no more
                if abs(best[0]) > STAGNATION:
                    raise IllConditionedError(f"S is reached no better than to {abs(best[0]):.0e}")
                return best[1]
            best = (error, now)
        refine = refine or abs(error) < 1e-4
        low, high = (max(x, low), high) if error > 0 else (low, min(x, high))
        here = (x, error, now.slope)
        x = _next(here, before, low, high)
        before = here
    raise IllConditionedError("the search for p does not converge")


def _next(
    here: tuple[float, float, float], before: tuple[float, float, float] | None, low: float, high: float
) -> float:
    """Return the next log p: inverse Hermite interpolation of two points, else Newton, else bisection."""
    x, error, slope = here
    if slope < 0:
        new = x - float(np.clip(error / slope, -7.0, 7.0))
        if before is not None and before[2] < 0 and abs(before[1]) < 1.0 and before[1] != error:
            new = float(np.clip(_hermite(here, before), x - 7.0, x + 7.0))
        if low < new < high:
            return new
    return 0.5 * (low + high) if np.isfinite(low + high) else x + float(np.copysign(3.0, error))


def _hermite(a: tuple[float, float, float], b: tuple[float, float, float]) -> float:
    """Return x(0) of the cubic x(error) through two points (x, error, slope)."""
    h = b[1] - a[1]
    s = -a[1] / h
    return float(
        a[0] * (1 + 2 * s) * (1 - s) ** 2
        + b[0] * s * s * (3 - 2 * s)
        + h * (s * (1 - s) ** 2 / a[2] - s * s * (1 - s) / b[2])
    )


def _gcv(series: Series, x: float) -> float:
    h, n = 0.05, len(series.y)
    p = float(np.exp(x))
    now = series.system.solve(p, series.z, refine=False)
    rise = series.system.log_det(p * float(np.exp(h))) - series.system.log_det(p * float(np.exp(-h)))
    return float(np.log(now.rss) - 2 * np.log(max(n - 2 - rise / (2 * h), 1e-3)))


def _reml(series: Series, x: float) -> float:
    p = float(np.exp(x))
    now = series.system.solve(p, series.z, refine=False)
    return float(np.log(series.z @ now.u)) + series.system.log_det(p) / series.system.size


def _search(series: Series, criterion: Callable[[Series, float], float]) -> Solution:
    """Minimise a criterion over x = log p: a grid (on the middle of long data), then Brent's method from there."""
    if series.is_straight:
        return series.straight()
    chunk = series.central()
    if chunk is None or chunk.is_straight:  # a middle part at rest is not representative
        chunk = series
    widest = min(float(len(chunk.y)), 2000.0)
    grid = np.log(_p_of_bandwidth(1.0)) - 4 * np.linspace(np.log(0.3), np.log(widest), 28)
    x = float(grid[int(np.argmin([_guarded(criterion, chunk, s) for s in grid]))])
    found = minimize_scalar(
        lambda s: _guarded(criterion, series, min(max(float(s), grid[-1]), grid[0])),
        bracket=(x, x + 0.5),
        options={"xtol": 1e-4, "maxiter": 60},
    )
    return series.system.solve(float(np.exp(np.clip(found.x, grid[-1], grid[0]))), series.z)


def _guarded(criterion: Callable[[Series, float], float], series: Series, x: float) -> float:
    """Return the criterion, or infinity where the system is too ill-conditioned to be evaluated."""
    try:
        return criterion(series, x)
    except IllConditionedError:
        return np.inf


_NAMED: dict[str, type[Rule]] = {"constraint": Constraint, "gcv": GCV, "reml": REML, "interpolate": Interpolation}


def rule_named(name: str) -> Rule:
    """Return the rule "constraint", "gcv", "reml" or "interpolate" with its defaults; ConfigError for another name."""
    if name not in _NAMED:
        raise ConfigError(f"there is no rule {name!r}; {choices(name, _NAMED)}")
    return _NAMED[name]()
