"""The normal matrix of eq. (7) about a smoothed motion: the information of positions and torques.

The motion is sought among all cubic splines with a knot at every sample: its acceleration, and with it the torque, is
free at each of them. Coefficients are ordered by sample, then by joint; three of them act on a sample, so that their
normal matrix N is a band of half-bandwidth 3 n - 1, bordered by the parameters: [[N, B], [B', D]]. The Schur complement
D - B' N^-1 B is the Fisher information of the parameters with the motion profiled out, at a cost linear in the samples.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynident.bounds.cramer_rao import variance
from dynident.errors import brief
from dynident.estimators.maximum_likelihood.arrow import Arrow, add_ahead, add_rows, band_of, places
from dynident.log import Motion
from dynident.models import Model
from dynident.regression import fitted_rows, stretches
from dynident.splines.bspline import local_basis

__all__ = ["NormalMatrix", "normal_matrices"]

Array = NDArray[np.float64]
CHUNK = 2048  # samples whose products are held at once
SHORTEST = 8  # least number of samples of an uninterrupted stretch


@dataclass(frozen=True, eq=False)
class NormalMatrix:
    """The normal matrix of one uninterrupted recording of N samples: m = (N + 2) n coefficients, r parameters.

    ``position`` and ``torque`` (3 n, m) are the lower bands of the information of the two measurements on the
    coefficients, ``border`` (m, r) and ``corner`` (r, r) that of the torques on the parameters.
    """

    position: Array
    torque: Array
    border: Array
    corner: Array

    __repr__ = brief

    def information(self, finer_q: float = 1.0, finer_tau: float = 1.0) -> Array:
        """Return the information (r, r) of the parameters, with sigma_q and sigma_tau divided by these factors."""
        a, b = finer_q**2, finer_tau**2
        arrow = Arrow(a * self.position + b * self.torque, b * self.border)
        return np.asarray(b * self.corner - arrow.profiled)


def normal_matrices(
    model: Model,
    theta: ArrayLike,
    motion: Motion,
    sigma_q: ArrayLike,
    sigma_tau: ArrayLike,
    columns: Sequence[int] | None = None,
    min_speed: tuple[float, ...] | None = None,
) -> Iterator[NormalMatrix]:
    """Yield the normal matrix of each uninterrupted stretch of usable samples of ``motion``, about theta (p).

    ``sigma_q`` (rad, m) and ``sigma_tau`` (N m, N) are one number or one per joint. ``columns`` (r) of the regressor
    are the parameters, for example those that lead base parameters; None takes all. Torques of a joint slower than
    ``min_speed`` (n) are not used. Raises ConfigError for a deviation that is not positive, and ModelError where the
    model fails.
    """
    n = len(model.joints)
    precision = [1.0 / variance(*pair, n) for pair in (("sigma_q", sigma_q), ("sigma_tau", sigma_tau))]
    kept = list(range(len(model.parameters)) if columns is None else columns)
    known = _Linearised(model, np.asarray(theta, dtype=float), motion, precision[0], precision[1], kept, min_speed)
    for part in stretches(motion.mask):
        if part.stop - part.start >= SHORTEST:
            yield _built(known, part)


@dataclass(frozen=True, eq=False)
class _Linearised:
    """A model about theta (p) and a motion, the precision (n) of positions and torques, and the columns that count."""

    model: Model
    theta: Array
    motion: Motion
    position: Array
    torque: Array
    columns: list[int]
    min_speed: tuple[float, ...] | None

    def rows(self, at: slice, local: Array) -> tuple[Array, Array, Array]:
        """Return the torque's derivatives by coefficients (k, n, 3 n) and parameters (k, n, r), and weights (k, n).

        ``local`` (3, k, 3) are the splines and their derivatives at the samples.
        """
        states = self.motion.states(at)
        Y, slopes = self.model.regressor(**states)[:, :, self.columns], self.model.partials(**states, theta=self.theta)
        k, n = states["q"].shape
        J = sum(
            np.einsum("ka,kij->kiaj", V, by).reshape(k, n, 3 * n)
            for V, by in zip(local, (slopes.q, slopes.dq, slopes.ddq), strict=True)
        )
        keep = fitted_rows(self.motion, self.min_speed, at)
        return np.asarray(J), Y, np.broadcast_to(self.torque, (k, n)) * (1.0 if keep is None else keep)


def _built(known: _Linearised, part: slice) -> NormalMatrix:
    n, r, rows = len(known.model.joints), len(known.columns), part.stop - part.start
    w, m = 3 * n, rows + 2
    local = _cubic(known.motion.t[part])
    position, torque, border, corner = (np.zeros(size) for size in ((m, n, w), (m, n, w), (m, n, r), (r, r)))
    for start in range(0, rows, CHUNK):
        here = slice(start, min(start + CHUNK, rows))
        k, V = here.stop - here.start, local[0, here]
        J, Y, weight = known.rows(slice(part.start + here.start, part.start + here.stop), local[:, here])
        pull = (J * weight[:, :, None]).swapaxes(1, 2)  # (k, w, n)
        shown = np.einsum("ka,kb,ij->kaibj", V, V, np.diag(known.position))
        at = places(np.arange(here.start, here.stop), 3)
        add_ahead(torque, (pull @ J).reshape(k, 3, n, w), at)
        add_ahead(position, shown.reshape(k, 3, n, w), at)
        add_rows(border, (pull @ Y).reshape(k, 3, n, r), at)
        corner += (Y * weight[:, :, None]).reshape(-1, r).T @ Y.reshape(-1, r)
    return NormalMatrix(band_of(position), band_of(torque), border.reshape(m * n, r), corner)


def _cubic(t: Array) -> Array:
    """Return values, first and second derivatives (3, N, 3) at the knots t (N) of the three cubic B-splines there."""
    h = np.diff(t)
    before, after = t[0] - np.cumsum(h[:2])[::-1], t[-1] + np.cumsum(h[:-4:-1])
    # the fourth spline begins at the knot: it and its derivatives are zero there
    return local_basis(np.concatenate([before, t, after]), 3, np.arange(len(t)) + 2, t)[:, :, :3]
