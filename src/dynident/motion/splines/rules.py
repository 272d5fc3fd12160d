"""How much to smooth: each rule chooses p of eq. (32), half a Lagrange multiplier, for one series.

A rule is a frozen dataclass of settings. p is searched (``search.py``) in scaled units, so that no rule depends on the
units of time or position.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from dynident.motion.splines.banded import Solution
from dynident.motion.splines.search import (
    SplineSearch,
    gcv_criterion,
    once,
    reml_criterion,
    search_constraint,
    search_minimum,
)
from dynident.motion.splines.series import ScaledSeries
from dynident.runtime import ConfigError, choices


class Rule(ABC):
    """Base of the rules; ``needs_sigma``: whether the noise must be known or estimated."""

    needs_sigma: ClassVar[bool] = False

    @abstractmethod
    def choose(self, series: ScaledSeries, column: int) -> SplineSearch:
        """Search for p (scaled units) by trials, of which it yields lists, and return the solution there."""


@dataclass(frozen=True)
class Constraint(Rule):
    """The article's rule, eq. (14): sum(((g - y) / delta)^2) = S; S = n (the number of samples) where not given.

    S is a number or one per column. A straight line is returned where it satisfies the constraint, the interpolating
    spline for S = 0. The search for p (``search_constraint``) stops at a relative error of 1e-10 in S, or where
    rounding prevents further improvement: the result holds the S reached, and an error above 1e-6 is raised.
    """

    S: float | Sequence[float] | None = None
    needs_sigma: ClassVar[bool] = True

    def choose(self, series: ScaledSeries, column: int) -> SplineSearch:
        """Solve F(p)^2 = S."""
        S = _setting_of_column(self.S, column, "S")
        S = float(len(series.data)) if S is None else S
        if not 0 <= S < np.inf:
            raise ConfigError(f"S is {S}; it must be a finite number >= 0 (S = n with the right sigma).")
        if S == 0:
            return _interpolation(series)
        target = S * (series.noise * series.noise)
        if series.straight_rss <= target or series.is_straight:
            return series.straight_solution()
        return (yield from search_constraint(series, target))


@dataclass(frozen=True)
class Fixed(Rule):
    """A given p of eq. (32), half the Lagrange multiplier, or lam = 1 / (2 p), the factor of the integral of g''^2.

    lam multiplies the integral in sum(((g - y) / delta)^2) + lam * integral(g''^2). One number, or one per column.
    """

    p: float | Sequence[float] | None = None
    lam: float | Sequence[float] | None = None

    def __post_init__(self) -> None:
        if (self.p is None) == (self.lam is None):
            raise ConfigError("give exactly one of p and lam to Fixed (lam = 1 / (2 p)).")

    def choose(self, series: ScaledSeries, column: int) -> SplineSearch:
        """Solve once."""
        p, lam = _setting_of_column(self.p, column, "p"), _setting_of_column(self.lam, column, "lam")
        name, value = ("p", p) if lam is None else ("lam", lam)
        if value is None or not value >= 0:
            raise ConfigError(f"{name} is {value}; it must be a number >= 0.")
        # no smoothing, lam = 0, is p = inf
        p = value if lam is None else 0.5 / value if value else np.inf
        if p == np.inf:
            return _interpolation(series)
        return series.straight_solution() if p == 0 else (yield from once(series, p / series.p_scale))


@dataclass(frozen=True)
class Interpolation(Rule):
    """No smoothing: the natural cubic spline through the data (S = 0)."""

    def choose(self, series: ScaledSeries, column: int) -> SplineSearch:  # noqa: ARG002
        """Interpolate."""
        yield from ()
        return _interpolation(series)


@dataclass(frozen=True)
class GCV(Rule):
    """Generalised cross-validation: minimises rss / (1 - edf / n)^2; needs no sigma. Craven and Wahba (1979)."""

    def choose(self, series: ScaledSeries, column: int) -> SplineSearch:  # noqa: ARG002
        """Minimise the criterion over log p."""
        return (yield from search_minimum(series, gcv_criterion))


@dataclass(frozen=True)
class REML(Rule):
    """Restricted maximum likelihood (generalised maximum likelihood): needs no sigma. Wahba (1985).

    Q' y is normal with covariance proportional to Q' D^2 Q + p N: minimises (n - 2) log(y' Q u) + log det.
    """

    def choose(self, series: ScaledSeries, column: int) -> SplineSearch:  # noqa: ARG002
        """Minimise the criterion over log p."""
        return (yield from search_minimum(series, reml_criterion))


def kernel_setting(rule: Rule, samples: int) -> tuple[int, float] | None:
    """Return the number and the setting by which ``compiled.fit_single`` has a rule; None where it has not."""
    if type(rule) is GCV:
        return 2, 0.0
    if type(rule) is Constraint and isinstance(rule.S, float | int | None):
        return 0, samples if rule.S is None else rule.S
    if type(rule) is Fixed and isinstance(rule.p, float | int):
        return 1, rule.p
    return (1, 0.5 / rule.lam) if type(rule) is Fixed and isinstance(rule.lam, float | int) and rule.lam else None


def check_columns(rule: Rule, columns: int) -> None:
    """Raise ConfigError where a setting of the rule has entries for more columns than there are."""
    for name in ("S", "p", "lam"):
        value = getattr(rule, name, None)
        entries = 1 if value is None or isinstance(value, float) else int(np.size(np.asarray(value)))
        if entries > max(columns, 1):
            raise ConfigError(f"{name} has {entries} entries, but the data have {columns} columns; give one for each.")


def _setting_of_column(value: float | Sequence[float] | None, column: int, name: str) -> float | None:
    if value is None or isinstance(value, float):
        return value
    values = np.atleast_1d(np.asarray(value, dtype=float))
    if not values.size:
        raise ConfigError(f"{name} has no entries; give a number, or one for each column.")
    if values.size > 1 and column >= values.size:
        raise ConfigError(f"{name} has {values.size} entries, but the data have more than {column} columns.")
    return float(values[column if values.size > 1 else 0])


def _interpolation(series: ScaledSeries) -> Solution:
    return Solution(np.inf, series.system.interpolate(series.z), 0.0, 0.0, 0.0)


RULES: Mapping[str, type[Rule]] = {
    "constraint": Constraint,
    "gcv": GCV,
    "reml": REML,
    "interpolate": Interpolation,
    "fixed": Fixed,
}


def rule_by_name(name: str) -> Rule:
    """Return the rule "constraint", "gcv", "reml" or "interpolate" with its defaults; ConfigError for another name."""
    if name not in (names := [name for name in RULES if name != "fixed"]):
        raise ConfigError(f"there is no rule {name!r}; {choices(name, names)}")
    return RULES[name]()
