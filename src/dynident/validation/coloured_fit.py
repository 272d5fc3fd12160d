"""The residual of a fit as a first-order autoregression, AR(1), in each joint, and the standard errors that follow.

Two figures of each joint are estimated from the residual, its variance v and its correlation rho at one sample. The
rest follows from the regressor: S = sum_j Y_j' R_j Y_j with R_j = v_j rho_j^|t - s|. The fit absorbs mainly slow parts
of the residual; v and rho are those for which the expected residual has the observed variance and correlation.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dynident.motion.filters import one_pole_filter
from dynident.motion.splines import NORMAL_95
from dynident.regression import Regression
from dynident.runtime import Noun
from dynident.runtime.arrays import Array
from dynident.validation.standard_errors import bread, robust_covariance, stretches_of

MAX_COLOURED_SAMPLES, COLOURED_PIECE = 10_000, 2_500  # the same of a coloured residual
MAX_ROUNDS, RHO_TOLERANCE = 12, 1e-3
MIN_DEGREES = 2.0  # degrees of freedom


def correlated_std(
    regression: Regression,
    theta: ArrayLike,
    weights: ArrayLike | None = None,
    columns: Sequence[int] | None = None,
    slopes: Sequence[Array] = (),
    along: Array | None = None,
) -> Array:
    """Return the larger (r) of the standard errors by ``robust_covariance`` and by ``ColouredFit``.

    With ``along`` (k, r) they are those of combinations of the columns. Raises the errors of
    ``robust_covariance``.
    """
    # cached: several standard errors of one fit ask for the same figures
    key = "std", *_cache_key(theta, weights, columns, along, *slopes)
    covariance_key = "long run", *_cache_key(theta, weights, columns, *slopes)
    if key not in regression.cache:
        if covariance_key not in regression.cache:
            regression.cache[covariance_key] = robust_covariance(regression, theta, weights, columns, slopes)
        covariance = np.asarray(regression.cache[covariance_key])
        covariance = covariance if along is None else along @ covariance @ along.T
        std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        with suppress(np.linalg.LinAlgError):  # nearly dependent columns
            std = np.maximum(std, ColouredFit.of(regression, theta, weights, columns, slopes).std(along))
        regression.cache[key] = std
    return np.asarray(regression.cache[key])


class ColouredFit(Noun):
    """The residual of a fit as AR(1): variance ``v`` (n) and correlation ``rho`` (n) of the ``joints``.

    ``half`` (r, r) turns their rows to the columns; the pieces of the joints hold the ``share`` of all samples.
    """

    joints: list[_JointPieces]
    v: Array
    rho: Array
    half: Array
    share: float

    @classmethod
    def of(
        cls,
        regression: Regression,
        theta: ArrayLike,
        weights: ArrayLike | None = None,
        columns: Sequence[int] | None = None,
        slopes: Sequence[Array] = (),
    ) -> ColouredFit:
        """Return the residual of a fit, with the arguments of ``robust_covariance``; cached on the regression."""
        key = ("coloured", *_cache_key(theta, weights, columns, *slopes))
        fit: ColouredFit | None = regression.cache.get(key)
        if fit is not None:
            return fit
        rows, errors = _equivalent_regressions(regression, slopes) if slopes else (regression, regression)
        p, n = len(rows.model.parameters), len(rows.model.joints)
        w = np.ones(n) if weights is None else np.asarray(weights, dtype=float)
        fitted_columns = list(range(p)) if columns is None else list(columns)
        scale, inverse = bread(rows, w, fitted_columns)
        half: Array = np.asarray(np.linalg.cholesky((inverse + inverse.T) / 2), dtype=np.float64)
        # rows of rank b_j are turned to b_j directions, which is less than the r columns where few act on a joint
        turns = [np.linalg.svd(entry[:, fitted_columns] @ (half / scale[:, None]), full_matrices=False)
                 for entry in rows.structure.maps]  # fmt: skip
        parts = stretches_of(rows, MAX_COLOURED_SAMPLES, COLOURED_PIECE)
        share = sum(part.usable_samples for part in parts) / rows.usable_samples
        pairs = zip(parts, stretches_of(errors, MAX_COLOURED_SAMPLES, COLOURED_PIECE), strict=True)
        to_directions = [(entry[0] * entry[1]).T for entry in turns]
        series = [_turned_rows(*pair, np.asarray(theta, dtype=float), w, to_directions) for pair in pairs]
        joints = [_JointPieces.of([entry[j] for entry in series], turn[2]) for j, turn in enumerate(turns)]
        regression.cache[key] = fit = cls(joints, *_match_moments(joints, share), half / scale[:, None], share)
        return fit

    @property
    def covariance(self) -> Array:
        """The covariance (r, r) of the fit, before Student's quantile."""
        return np.asarray(self.half @ _total_covariance(self.joints, self.v, self.rho) @ self.half.T / self.share)

    def std(self, along: Array | None = None) -> Array:
        """Return the standard errors (r), or those of combinations ``along`` (k, r) of the columns.

        1.96 of them hold 95 %: they are multiplied by Student's quantile over the normal one, for the degrees of
        freedom that v and rho of few independent samples leave (Satterthwaite). Joints are taken as independent.
        """
        half = self.half if along is None else along @ self.half
        variance = _quadratic_diagonal(half, _total_covariance(self.joints, self.v, self.rho) / self.share)
        doubt = self._variance_of_variances(half) / self.share**2
        return np.sqrt(variance) * _student_quantile(variance, doubt) / NORMAL_95

    def _variance_of_variances(self, half: Array) -> Array:
        """Return the variance (r) of the estimated variances, from that of v and rho of each joint."""
        out = np.zeros(len(half))
        for joint, a, b in zip(self.joints, self.v, self.rho, strict=True):
            # the derivative by rho at a constant innovation variance, by a difference of about one standard error
            innovation, step = a * (1 - b * b), 0.5 * np.sqrt((1 - b * b) / joint.samples)
            ends = _avoid_zero(np.clip([b - step, b + step], -0.99, 1 - 0.5 / joint.samples))
            low, high = (_quadratic_diagonal(half, joint.score_covariance(innovation / (1 - x * x), x)) for x in ends)
            variance = _quadratic_diagonal(half, joint.score_covariance(a, b))
            out += (high - low) ** 2 + 2.0 / joint.samples * variance**2
        return out


def _equivalent_regressions(regression: Regression, slopes: Sequence[Array]) -> tuple[Regression, Regression]:
    """Return the regressions with the rows and with the residuals of the equivalent least-squares fit.

    A robust fit amounts to least squares with the residual w^2 e / m of the residual e, m the mean slope of each
    joint (Huber, 1981, section 7.6).
    """
    usable = np.concatenate([series.mask for series in regression.motions])
    m = np.maximum(np.concatenate(slopes)[usable].mean(axis=0), 1e-3)
    rows = tuple(np.broadcast_to(np.sqrt(m), series.shape) for series in slopes)
    errors = tuple(np.square(series) / np.sqrt(m) for series in regression.weights)
    return replace(regression, weights=rows), replace(regression, weights=errors)


class _JointPieces(Noun):
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
    cache: dict[str, Any] = field(default_factory=dict)  # the last rho, and what it gave

    @classmethod
    def of(cls, pieces: Sequence[Array], turn: Array) -> _JointPieces:
        """Return a joint of pieces (b + 1, N), the last row of which is the residual; samples of zeros do not count."""
        rows, residuals = [piece[:-1] for piece in pieces], [piece[-1] for piece in pieces]
        nonzero = [np.abs(e) > 0 for e in residuals]
        return cls(
            tuple(rows),
            turn,
            max(sum(int(x.sum()) for x in nonzero), 1),
            max(sum(int((x[1:] & x[:-1]).sum()) for x in nonzero), 1),
            sum(float(e @ e) for e in residuals),
            sum(float(e[1:] @ e[:-1]) for e in residuals),
            turn.T @ np.sum([y @ y.T for y in rows], axis=0) @ turn,
            turn.T @ np.sum([y[:, 1:] @ y[:, :-1].T for y in rows], axis=0) @ turn,
        )

    def lagged_sum(self, rho: float) -> Array:
        """Return sum_(s < t) rho^(t - s) y_t y_s' (r, r)."""
        if self.cache.get("rho") != rho:
            inner = np.sum([rho * y[:, 1:] @ one_pole_filter(rho, y[:, :-1]).T for y in self.rows], axis=0)
            # the sum over s of rho^(t - s) y_s is a first-order recursion
            self.cache.update(rho=rho, ahead=self.turn.T @ inner @ self.turn)
        return np.asarray(self.cache["ahead"])

    def score_covariance(self, v: float, rho: float) -> Array:
        """Return Y' R Y (r, r)."""
        lagged = self.lagged_sum(rho)
        return v * (self.gram + lagged + lagged.T)

    def absorbed_sums(self, v: float, rho: float, total: Array) -> tuple[float, float]:
        """Return what the fit absorbs of the sums of squares and of products of this joint's residuals."""
        lagged = float(np.trace(self.lagged_sum(rho)))
        variance_sum = v * (float(np.trace(self.gram)) + 2 * lagged)
        neighbour_sum = v * ((1 / rho + rho) * lagged + rho * float(np.trace(self.gram)))
        absorbed = float((self.gram * total).sum()), float((self.lagged * total).sum())
        return 2 * variance_sum - absorbed[0], 2 * neighbour_sum - absorbed[1]


def _turned_rows(part: Regression, errors: Regression, theta: Array, w: Array, turns: Sequence[Array]) -> list[Array]:
    """Return for each joint the weighted and turned rows (b, N) of a stretch, and below them its residual."""
    blocks = list(part.entries(theta=theta))
    weighted_rows = [np.concatenate([w[j] * block.joint_rows(j) for block in blocks], axis=1) for j in range(len(w))]
    if errors.weights is not part.weights:
        series = errors.residuals(theta)
        residuals = np.concatenate([np.where(True if keep is None else keep, e, 0.0) for *_, e, keep in series])
        for rows, error in zip(weighted_rows, (residuals * w).T, strict=True):
            rows[-1] = error
    return [np.concatenate([turn @ rows[:-1], rows[-1:]]) for turn, rows in zip(turns, weighted_rows, strict=True)]


def _match_moments(joints: Sequence[_JointPieces], share: float) -> tuple[Array, Array]:
    """Return the variance and correlation (n) that give the observed residuals.

    ``share`` is the share of all rows that the pieces hold.
    """
    mean_squares = np.array([joint.square / joint.samples for joint in joints])
    limit = 1.0 - 2.0 / np.array([joint.samples for joint in joints])
    v = np.maximum(mean_squares, 1e-300)
    products = np.array([joint.product / joint.pairs for joint in joints])
    rho = _avoid_zero(np.clip(products / v, -0.99, limit))
    # fixed point: given v and rho, the fit absorbs a known part of the residual, which is added to what is seen
    for _ in range(MAX_ROUNDS):
        total = _total_covariance(joints, v, rho) / share
        absorbed = [joint.absorbed_sums(a, b, total) for joint, a, b in zip(joints, v, rho, strict=True)]
        squares = [(joint.square + lost) / joint.samples for joint, (lost, _) in zip(joints, absorbed, strict=True)]
        pairs = zip(joints, absorbed, strict=True)
        products = np.array([(joint.product + lost) / joint.pairs for joint, (_, lost) in pairs])
        # not below what is seen, as the fit can only make residuals smaller
        v = np.maximum(squares, np.maximum(mean_squares, 1e-300))
        previous, rho = rho, _avoid_zero(np.clip(products / v, -0.99, limit))
        if (np.abs(rho - previous) < RHO_TOLERANCE * (1 - rho)).all():
            break
    return v, rho


def _total_covariance(joints: Sequence[_JointPieces], v: Array, rho: Array) -> Array:
    """Return the sum of Y' R Y (r, r) over the joints."""
    parts = [joint.score_covariance(a, b) for joint, a, b in zip(joints, v, rho, strict=True)]
    return np.asarray(np.sum(parts, axis=0))


def _avoid_zero(rho: Array) -> Array:
    """Return rho kept away from zero, where a sum is multiplied by 1 / rho."""
    return np.where(np.abs(rho) < 1e-6, 1e-6, rho)


def _quadratic_diagonal(half: Array, middle: Array) -> Array:
    """Return the diagonal of half middle half'."""
    return np.asarray(np.maximum(np.einsum("ij,jk,ik->i", half, middle, half, optimize=True), 0.0))


def _student_quantile(variance: Array, doubt: Array) -> Array:
    """Return Student's 97.5 % quantiles for variances with a variance of their own (Satterthwaite)."""
    from scipy.special import stdtrit

    degrees = np.divide(2 * variance**2, doubt, out=np.full_like(variance, 1e6), where=doubt > 0)
    return np.asarray(stdtrit(np.maximum(degrees, MIN_DEGREES), 0.975))


def _cache_key(*arguments: Any) -> tuple[Any, ...]:
    """Return arguments as a key of the cache."""
    return tuple(None if argument is None else np.asarray(argument).tobytes() for argument in arguments)
