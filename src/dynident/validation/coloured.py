"""Standard errors for residuals that are correlated over a good part of the log: each joint's as AR(1).

The long-run covariance of ``hac`` needs many spans of correlation in a log. Where there are few, two figures of each
joint can still be had from the residual, its variance v and its correlation rho at one sample, and the rest follows
from the regressor: S = sum_j Y_j' R_j Y_j with R_j = v_j rho_j^|t - s|. The fit takes above all what is slow out of the
residual; v and rho are those for which the expected residual has the variance and the correlation that are seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynident.filters import one_pole
from dynident.regression import Regression
from dynident.splines import NORMAL_95
from dynident.validation.hac import bread, robust_covariance, samples_of, stretches_of

__all__ = ["coloured_covariance", "coloured_std", "correlated_std"]

Array = NDArray[np.float64]
MOST, PIECE = 10_000, 2_500  # samples of all logs that are looked at, and of one piece of them
ROUNDS, CLOSE = 12, 1e-3
LEAST = 2.0  # degrees of freedom


def correlated_std(
    regression: Regression,
    theta: ArrayLike,
    weights: ArrayLike | None = None,
    columns: Sequence[int] | None = None,
    slopes: Sequence[Array] = (),
    along: Array | None = None,
) -> Array:
    """Return the larger (r) of the standard errors of ``robust_covariance``, whose errors are raised, and coloured;
    with ``along`` (k, r) those of combinations of the columns."""
    asked = _asked(theta, weights, columns, along, *slopes)
    if asked not in regression.known:  # the bias by errors of the motion is compared with them first
        longrun = np.sqrt(np.maximum(np.diag(_long_run(regression, theta, weights, columns, slopes, along)), 0.0))
        with suppress(np.linalg.LinAlgError):  # nearly dependent columns
            longrun = np.maximum(longrun, coloured_std(regression, theta, weights, columns, along, slopes))
        regression.known[asked] = longrun
    return np.asarray(regression.known[asked])


def _asked(*arguments: Any) -> tuple[Any, ...]:
    """Return arguments as the key of what is known of them."""
    return tuple(None if one is None else np.asarray(one).tobytes() for one in arguments)


def _long_run(
    regression: Regression,
    theta: ArrayLike,
    weights: ArrayLike | None,
    columns: Sequence[int] | None,
    slopes: Sequence[Array],
    along: Array | None,
) -> Array:
    asked = ("long run", *_asked(theta, weights, columns, *slopes))
    if asked not in regression.known:
        regression.known[asked] = robust_covariance(regression, theta, weights, columns, slopes)
    covariance = np.asarray(regression.known[asked])
    return covariance if along is None else along @ covariance @ along.T


def coloured_std(
    regression: Regression,
    theta: ArrayLike,
    weights: ArrayLike | None = None,
    columns: Sequence[int] | None = None,
    along: Array | None = None,
    slopes: Sequence[Array] = (),
) -> Array:
    """Return standard errors (r) of a least-squares fit whose residual is AR(1) in each joint, in SI units.

    ``theta`` (p), ``weights`` (n), ``columns`` (r) and ``slopes`` are those of ``robust_covariance``, whose errors are
    raised; ``along`` (k, r) asks for those (k) of combinations of the columns. 1.96
    of these standard errors hold 95 %: they are multiplied by Student's quantile over the normal one, for the degrees
    of freedom that v and rho of few independent samples leave (Satterthwaite). Joints are taken as independent.
    """
    joints, v, rho, half, share = _coloured(regression, theta, weights, columns, slopes)
    half = half if along is None else along @ half
    variance = _diagonal(half, _spread(joints, v, rho) / share)
    return np.sqrt(variance) * _quantile(variance, _doubt(joints, v, rho, half) / share**2) / NORMAL_95


def coloured_covariance(
    regression: Regression,
    theta: ArrayLike,
    weights: ArrayLike | None = None,
    columns: Sequence[int] | None = None,
    slopes: Sequence[Array] = (),
) -> Array:
    """Return the covariance (r, r) of which ``coloured_std`` are the standard errors, before Student's quantile."""
    joints, v, rho, half, share = _coloured(regression, theta, weights, columns, slopes)
    return np.asarray(half @ _spread(joints, v, rho) @ half.T / share)


def _coloured(
    regression: Regression,
    theta: ArrayLike,
    weights: ArrayLike | None,
    columns: Sequence[int] | None,
    slopes: Sequence[Array],
) -> tuple[list[_Joint], Array, Array, Array, float]:
    """Return ``_fitted``, from before where it is known."""
    asked = ("coloured", *_asked(theta, weights, columns, *slopes))
    if asked not in regression.known:
        rows, errors = _pseudo(regression, slopes) if slopes else (regression, regression)
        regression.known[asked] = _fitted(rows, errors, theta, weights, columns)
    found: tuple[list[_Joint], Array, Array, Array, float] = regression.known[asked]
    return found


def _pseudo(regression: Regression, slopes: Sequence[Array]) -> tuple[Regression, Regression]:
    """Return the regressions with the rows and with the residuals of the least squares that a robust fit amounts to:
    w^2 e / m of the residual e, m the mean slope of each joint (Huber, 1981, section 7.6)."""
    used = np.concatenate([one.mask for one in regression.motions])
    m = np.maximum(np.concatenate(slopes)[used].mean(axis=0), 1e-3)
    rows = tuple(np.broadcast_to(np.sqrt(m), one.shape) for one in slopes)
    errors = tuple(np.square(one) / np.sqrt(m) for one in regression.weights)
    return replace(regression, weights=rows), replace(regression, weights=errors)


def _fitted(
    regression: Regression,
    errors: Regression,
    theta: ArrayLike,
    weights: ArrayLike | None,
    columns: Sequence[int] | None,
) -> tuple[list[_Joint], Array, Array, Array, float]:
    """Return the joints with variance and correlation (n), what turns their rows to the columns, and the share of all
    samples that is here; the residuals are those of the regression ``errors``."""
    p, n = len(regression.model.parameters), len(regression.model.joints)
    w = np.ones(n) if weights is None else np.asarray(weights, dtype=float)
    kept = list(range(p)) if columns is None else list(columns)
    scale, inverse = bread(regression, w, kept)
    half: Array = np.asarray(np.linalg.cholesky((inverse + inverse.T) / 2), dtype=np.float64)
    # of rank b_j: turned to its b_j directions now, to r at the end
    turns = [np.linalg.svd(one[:, kept] @ (half / scale[:, None]), full_matrices=False)
             for one in regression.structure.maps]  # fmt: skip
    parts = stretches_of(regression, MOST, PIECE)
    share = sum(map(samples_of, parts)) / samples_of(regression)
    value = np.asarray(theta, dtype=float)
    pairs = zip(parts, stretches_of(errors, MOST, PIECE), strict=True)
    series = [_series(*pair, value, w, [(one[0] * one[1]).T for one in turns]) for pair in pairs]
    joints = [_Joint.of([one[j] for one in series], turn[2]) for j, turn in enumerate(turns)]
    return joints, *_matched(joints, share), half / scale[:, None], share


@dataclass(frozen=True, eq=False)
class _Joint:
    """One joint's pieces: ``rows`` (b, N), of which ``turn`` (b, r) makes the rows Y = rows' turn of the regressor in
    units in which all rows of the fit are orthonormal.

    ``samples`` and ``pairs`` of neighbours that count; sums of squares and products of the residuals (``square``,
    ``product``) and of the rows Y (``gram``, ``lagged``; (r, r)).
    """

    rows: tuple[Array, ...]
    turn: Array
    samples: int
    pairs: int
    square: float
    product: float
    gram: Array
    lagged: Array
    known: dict[str, Any] = field(default_factory=dict)  # the last rho, and what it gave

    @classmethod
    def of(cls, pieces: Sequence[Array], turn: Array) -> _Joint:
        """Return a joint of pieces (b + 1, N), the last row of which is the residual; samples of zeros do not count."""
        rows, left = [one[:-1] for one in pieces], [one[-1] for one in pieces]
        used = [np.abs(e) > 0 for e in left]
        return cls(
            tuple(rows),
            turn,
            max(sum(int(x.sum()) for x in used), 1),
            max(sum(int((x[1:] & x[:-1]).sum()) for x in used), 1),
            sum(float(e @ e) for e in left),
            sum(float(e[1:] @ e[:-1]) for e in left),
            turn.T @ np.sum([y @ y.T for y in rows], axis=0) @ turn,
            turn.T @ np.sum([y[:, 1:] @ y[:, :-1].T for y in rows], axis=0) @ turn,
        )

    def ahead(self, rho: float) -> Array:
        """Return sum_(s < t) rho^(t - s) y_t y_s' (r, r)."""
        if self.known.get("rho") != rho:
            inner = np.sum([rho * y[:, 1:] @ one_pole(rho, y[:, :-1]).T for y in self.rows], axis=0)
            self.known.update(rho=rho, ahead=self.turn.T @ inner @ self.turn)
        return np.asarray(self.known["ahead"])

    def spread(self, v: float, rho: float) -> Array:
        """Return Y' R Y (r, r)."""
        ahead = self.ahead(rho)
        return v * (self.gram + ahead + ahead.T)

    def expected(self, v: float, rho: float, total: Array) -> tuple[float, float]:
        """Return what the fit takes from the sums of squares and of products of this joint's residuals."""
        ahead = float(np.trace(self.ahead(rho)))
        own = v * (float(np.trace(self.gram)) + 2 * ahead)
        next_to = v * ((1 / rho + rho) * ahead + rho * float(np.trace(self.gram)))
        return 2 * own - float((self.gram * total).sum()), 2 * next_to - float((self.lagged * total).sum())


def _series(part: Regression, errors: Regression, theta: Array, w: Array, turns: Sequence[Array]) -> list[Array]:
    """Return for each joint the weighted rows (b, N) of a stretch, turned, and below them its residual."""
    blocks = list(part.entries(theta=theta))
    whole = [np.concatenate([w[j] * block.used(j) for block in blocks], axis=1) for j in range(len(w))]
    if errors.weights is not part.weights:
        left = np.concatenate(
            [np.where(True if keep is None else keep, e, 0.0) for *_, e, keep in errors.residuals(theta)]
        )
        for one, error in zip(whole, (left * w).T, strict=True):
            one[-1] = error
    return [np.concatenate([turn @ one[:-1], one[-1:]]) for turn, one in zip(turns, whole, strict=True)]


def _matched(joints: Sequence[_Joint], share: float) -> tuple[Array, Array]:
    """Return variance and correlation (n) for which the residuals are as expected; ``share`` of the rows is here."""
    seen = np.array([one.square / one.samples for one in joints])
    limit = 1.0 - 2.0 / np.array([one.samples for one in joints])
    v = np.maximum(seen, 1e-300)
    rho = _away(np.clip([one.product / one.pairs / x for one, x in zip(joints, v, strict=True)], -0.99, limit))
    for _ in range(ROUNDS):
        total = _spread(joints, v, rho) / share
        taken = [one.expected(a, b, total) for one, a, b in zip(joints, v, rho, strict=True)]
        squares = [(one.square + more) / one.samples for one, (more, _) in zip(joints, taken, strict=True)]
        products = [(one.product + more) / one.pairs for one, (_, more) in zip(joints, taken, strict=True)]
        v = np.maximum(squares, np.maximum(seen, 1e-300))
        before, rho = rho, _away(np.clip(np.array(products) / v, -0.99, limit))
        if (np.abs(rho - before) < CLOSE * (1 - rho)).all():
            break
    return v, rho


def _spread(joints: Sequence[_Joint], v: Array, rho: Array) -> Array:
    """Return the sum of Y' R Y (r, r) over the joints."""
    return np.asarray(np.sum([one.spread(a, b) for one, a, b in zip(joints, v, rho, strict=True)], axis=0))


def _away(rho: Array) -> Array:
    """Return rho, moved from zero, where 1 / rho times the sum that it multiplies is not defined."""
    return np.where(np.abs(rho) < 1e-6, 1e-6, rho)


def _doubt(joints: Sequence[_Joint], v: Array, rho: Array, half: Array) -> Array:
    """Return the variance (r) of the estimated variances, from that of v and rho of each joint."""
    out = np.zeros(len(half))
    for one, a, b in zip(joints, v, rho, strict=True):
        fresh, step = a * (1 - b * b), 0.5 * np.sqrt((1 - b * b) / one.samples)
        ends = np.clip([b - step, b + step], -0.99, 1 - 0.5 / one.samples)
        low, high = (_diagonal(half, one.spread(fresh / (1 - x * x), x)) for x in _away(ends))
        out += (high - low) ** 2 + 2.0 / one.samples * _diagonal(half, one.spread(a, b)) ** 2
    return out


def _diagonal(half: Array, middle: Array) -> Array:
    """Return the diagonal of half middle half'."""
    return np.asarray(np.maximum(np.einsum("ij,jk,ik->i", half, middle, half, optimize=True), 0.0))


def _quantile(variance: Array, doubt: Array) -> Array:
    """Return Student's 97.5 % quantiles for variances with a variance of their own (Satterthwaite)."""
    from scipy.special import stdtrit

    free = np.divide(2 * variance**2, doubt, out=np.full_like(variance, 1e6), where=doubt > 0)
    return np.asarray(stdtrit(np.maximum(free, LEAST), 0.975))
