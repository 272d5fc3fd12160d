"""What physics demands of the parameters, as a barrier: matrices, linear in theta, that must stay positive definite."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from dynident.inertia import to_pseudo
from dynident.log import Log
from dynident.model import Model
from dynident.terms.term import INERTIAL

__all__ = ["Barrier", "Demand", "demands"]

Array = NDArray[np.float64]
SIGNED = ("viscous", "coulomb", "rotor")
INNER = 500  # steps at one weight of the barrier; a few are needed, but many along the edge of a thin body
ROUND = 0.01  # least eigenvalue of a body to draw others to, beside its diagonal
POSES = 16  # configurations of the recordings at which the mass matrix must be positive definite


@dataclass(frozen=True, eq=False)
class Demand:
    """Matrices (K, s, s) = ``slopes`` (K, s, s, p) theta that must be positive definite.

    ``centre`` (K, s, s), where given, is what they are drawn to: the cost is then the log-det divergence from it, which
    also keeps a body finite that the data leave free.
    """

    slopes: Array
    centre: Array | None = None

    @cached_property
    def pull(self) -> Array:
        """Gradient (p) of the part of the divergence that is linear in theta; zero without a centre."""
        if self.centre is None:
            return np.zeros(self.slopes.shape[-1])
        turned = np.linalg.solve(self.centre[:, None], np.moveaxis(self.slopes, -1, 1))
        return np.asarray(np.trace(turned, axis1=-2, axis2=-1).mean(axis=0))


@dataclass(frozen=True, eq=False)
class Barrier:
    """``weight`` times the sum of -log det, or of log-det divergences, of the demanded matrices (mean over the K)."""

    demands: tuple[Demand, ...] = ()
    weight: float = 1e-3

    @cached_property
    def _matrices(self) -> tuple[tuple[Demand, NDArray[np.intp]], ...]:
        """Demands on matrices, and which parameters they are of."""
        larger = [one for one in self.demands if one.slopes.shape[1] > 1]
        return tuple((one, np.flatnonzero(np.abs(one.slopes).sum(axis=(0, 1, 2)))) for one in larger)

    @cached_property
    def _numbers(self) -> tuple[Array, Array]:
        """Rows (L, p) of numbers that must be positive, and their share in the sum (L)."""
        rows = [one.slopes[:, 0, 0] for one in self.demands if one.slopes.shape[1] == 1]
        if not rows:
            return np.zeros((0, 0)), np.zeros(0)
        return np.concatenate(rows), np.concatenate([np.full(len(one), 1.0 / len(one)) for one in rows])

    @cached_property
    def bound(self) -> NDArray[np.bool_]:
        """Which parameters (p) belong to a matrix, so that they must follow others; (1), false, without matrices."""
        rows = [np.abs(one.slopes).sum(axis=(0, 1, 2)) for one, _ in self._matrices]
        return np.asarray(np.sum(rows, axis=0) > 0) if rows else np.zeros(1, dtype=bool)

    def inside(self, theta: Array) -> bool:
        """Return whether all matrices are positive definite at theta (p)."""
        rows, _ = self._numbers
        if len(rows) and (rows @ theta).min() <= 0:
            return False
        try:
            for one, columns in self._matrices:
                np.linalg.cholesky(one.slopes[..., columns] @ theta[columns])
        except np.linalg.LinAlgError:
            return False
        return True

    def value(self, theta: Array, weight: float | None = None) -> float:
        """Return the barrier at theta (p), infinite outside."""
        if not self.inside(theta):
            return np.inf
        rows, share = self._numbers
        found = -float(share @ np.log(rows @ theta)) if len(rows) else 0.0
        for one, columns in self._matrices:
            found -= float(np.linalg.slogdet(one.slopes[..., columns] @ theta[columns])[1].mean())
            found += float(one.pull @ theta)
        return (self.weight if weight is None else weight) * found

    def slopes(self, theta: Array, weight: float | None = None) -> tuple[Array, Array]:
        """Return gradient (p) and Hessian (p, p) at a theta inside."""
        p, (rows, share) = len(theta), self._numbers
        gradient, hessian = np.zeros(p), np.zeros((p, p))
        if len(rows):
            turned = rows / (rows @ theta)[:, None]
            gradient -= share @ turned
            hessian += (turned * share[:, None]).T @ turned
        for one, columns in self._matrices:
            K, own = len(one.slopes), one.slopes[..., columns]
            inward = np.linalg.inv(own @ theta[columns])
            # (K, c, s, s)
            turned = inward[:, None] @ np.moveaxis(own, -1, 1)
            gradient[columns] -= np.trace(turned, axis1=-2, axis2=-1).sum(axis=0) / K
            flat = turned.transpose(1, 0, 2, 3).reshape(len(columns), -1)
            hessian[np.ix_(columns, columns)] += flat @ turned.transpose(1, 0, 3, 2).reshape(len(columns), -1).T / K
            gradient += one.pull
        weight = self.weight if weight is None else weight
        return weight * gradient, weight * hessian

    def minimum(self, theta: Array, H: Array, g: Array, accuracy: float, free: NDArray[np.intp]) -> Array:
        """Return the step d (p) from a theta inside that minimises d' H d / 2 - g' d plus the barrier at theta + d.

        Only the parameters ``free`` move. ``H`` may be singular where the barrier is curved. Newton's method; a heavier
        barrier leads around the boundary where the step is long. ``accuracy`` is of the minimum.
        """
        d, weight = np.zeros(len(theta)), self.weight
        push, stiff = self.slopes(theta)
        step = _solved(H + stiff, g - push, free)
        if not self.inside(theta + step):
            weight = max(weight, 0.1 * float((g - push) @ step) / max(len(self.demands), 1))
        while True:
            for _ in range(INNER):
                push, stiff = self.slopes(theta + d, weight)
                pull = g - H @ d - push
                step = _solved(H + stiff, pull, free)
                fall = float(pull @ step)
                if fall < 2 * max(accuracy, 0.1 * (weight - self.weight)):
                    break
                length = self._length(theta, d, step, H, g, weight, fall)
                if not length:
                    break
                d = d + length * step
            if weight <= self.weight:
                return d
            weight = max(0.1 * weight, self.weight)

    def _length(self, theta: Array, d: Array, step: Array, H: Array, g: Array, weight: float, fall: float) -> float:
        """Return how far to go along an inner step: backtracking, 0 where rounding leaves nothing to gain."""
        here, slope, bend = self.value(theta + d, weight), float((H @ d - g) @ step), float(step @ H @ step)
        length = 1.0
        while length > 1e-6:
            change = length * slope + 0.5 * length**2 * bend
            if self.value(theta + (d + length * step), weight) - here + change <= -0.1 * length * fall:
                return length
            length *= 0.6
        return 0.0


def _solved(H: Array, g: Array, free: NDArray[np.intp]) -> Array:
    """Return H^-1 g over the free parameters, with directions in which H is only rounding held still."""
    out = np.zeros(len(g))
    H, g = H[np.ix_(free, free)], g[free]
    scale = 1.0 / np.sqrt(np.maximum(np.diag(H), 1e-200))
    scaled = H * np.outer(scale, scale)
    try:
        out[free] = scale * cho_solve(cho_factor(scaled, check_finite=False), g * scale, check_finite=False)
    except np.linalg.LinAlgError:
        values, vectors = np.linalg.eigh(scaled)
        kept = values > 1e-14 * values[-1]
        out[free] = scale * (vectors[:, kept] @ ((vectors[:, kept].T @ (g * scale)) / values[kept]))
    return out


def _body(known: Sequence[float | None], start: Array) -> Array:
    """Return the pseudo-inertia (4, 4) to draw a body to: the nominal one, or where that is none a start made round."""
    if None not in known:
        nominal = to_pseudo(np.array(known, dtype=float))
        scale = np.sqrt(np.maximum(np.diag(nominal), 1e-300))
        if np.linalg.eigvalsh(nominal / np.outer(scale, scale))[0] > ROUND:
            return nominal
    found = to_pseudo(start)
    size = np.abs(np.diag(found))
    return np.asarray(found + ROUND * np.diag(np.maximum(size, 1e-3 * size.max())))


def demands(model: Model, logs: Sequence[Log], start: Array) -> tuple[Demand, ...]:
    """Return what physics demands: bodies with a mass distribution, friction and rotors that are not negative.

    Bodies are drawn to their nominal ones, or to those of ``start`` (p). A model without bodies must have a positive
    definite mass matrix at configurations of the logs, where it has one at all.
    """
    found, p = [], len(model.parameters)
    place = {(x.body, x.role): k for k, x in enumerate(model.parameters) if x.body}
    unit = np.eye(p)
    for body in dict.fromkeys(x.body for x in model.parameters if x.role in INERTIAL):
        columns = [place[body, role] for role in INERTIAL if (body, role) in place]
        if len(columns) == len(INERTIAL):
            slopes = np.moveaxis(to_pseudo(unit[columns].T), 0, -1)[None]
            known = [model.parameters[k].value for k in columns]
            found.append(Demand(slopes, _body(known, start[columns])[None]))
    if not found:
        q = np.concatenate([log.q[:: max(len(log) * len(logs) // POSES, 1)] for log in logs])
        slopes = np.stack([model.mass_matrix(q, one) for one in unit], axis=-1)
        if (np.abs(slopes).sum(axis=(0, 2, 3)) > 0).all():
            found.append(Demand(slopes))
    for k, parameter in enumerate(model.parameters):
        if parameter.role in SIGNED:
            found.append(Demand(unit[k].reshape(1, 1, 1, p)))
    return tuple(found)
