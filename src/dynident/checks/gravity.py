"""The direction of gravity that fits the torques, against the one that was assumed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from dynident.checks import notes
from dynident.checks.finding import Finding, Topic
from dynident.checks.torque import nominal, nuisance, thinned
from dynident.errors import Severity
from dynident.log import Motion
from dynident.models import HasGravity, Model

__all__ = ["gravity_findings"]

Array = NDArray[np.float64]

ANGLE = 40.0  # deg from which another direction is asked about; smaller angles are a tilt, or wrong inertias
CLEAR = 0.7  # share of the torque's variance, beside friction and rotor, that the found direction must explain
BETTER = 0.5  # times the unexplained variance of the assumed direction: above, both explain it about as well
SEEN = 0.02  # share of the largest singular value below which the motion does not show a direction
STANDARD = 9.81  # m/s^2, the size where no gravity was assumed
FACTOR = 3.0  # times the assumed size, or a third: then inertias or units are wrong, not the direction


def gravity_findings(model: Model, motions: Sequence[Motion]) -> Iterator[Finding]:
    """Yield a question where the robot file's inertias fit the torques under another direction of gravity.

    One factor of the inertial torque and the three components of gravity are fitted over all joints, each scaled by
    its torque, together with friction, rotor inertia and offset of each joint. Nothing is yielded where the motion
    does not determine them.
    """
    terms = [term for term in model.terms if isinstance(term, HasGravity)]
    if len(terms) != 1:
        return
    assumed = np.array(terms[0].gravity)
    size = float(np.linalg.norm(assumed)) or STANDARD
    X, y = _rows(model, motions, size)
    down = _down(X, y, assumed / size) if len(y) else None
    if down is not None:
        fitted = np.round(size * down, 1) + 0.0
        note = notes.OtherGravity(tuple(fitted.tolist()), tuple(assumed.tolist()))
        yield Finding(Severity.WARNING, None, note, Topic.GRAVITY)


def _rows(model: Model, motions: Sequence[Motion], size: float) -> tuple[Array, Array]:
    """Return the nominal torques (M, 4) of ``_columns`` and the measured ones (M), each joint's by the norm of its
    torque and without what friction, rotor and offset explain; none where a nominal inertia is missing.
    """
    q, dq, ddq, tau = thinned(motions)
    if nominal(model, q, dq, ddq) is None:
        return np.empty((0, 4)), np.empty(0)
    columns = _columns(model, q, dq, ddq, size)
    left = [
        _without(np.column_stack([columns[:, :, j].T, tau[:, j]]), nuisance(q, dq, ddq, j)) for j in range(q.shape[1])
    ]
    scaled = [each / weight for each in left if (weight := float(np.linalg.norm(each[:, -1]))) > 0]
    rows = np.concatenate([np.empty((0, 5)), *scaled])
    return rows[:, :-1], rows[:, -1]


def _down(X: Array, y: Array, assumed: Array) -> Array | None:
    """Return the direction (3) of gravity in a fit of y (M) by X (M, 4), if it is clearly not the assumed one (3)."""
    _, acting, axes = np.linalg.svd(X[:, 1:], full_matrices=False)
    shown = axes[acting > SEEN * acting[0]]  # of a planar arm not the axis of its joints
    A = np.column_stack([X[:, 0], X[:, 1:] @ shown.T])
    singular = np.linalg.svd(A, compute_uv=False)
    if singular[-1] <= SEEN * singular[0]:
        return None
    share, *parts = np.linalg.lstsq(A, y)[0]
    along = np.column_stack([X[:, 0], X[:, 1:] @ assumed])
    usual = np.maximum(np.linalg.lstsq(along, y)[0], 0.0)
    rest, before = float(np.square(y - A @ [share, *parts]).sum()), float(np.square(y - along @ usual).sum())
    found = _completed(parts @ shown, shown, assumed)
    length = float(np.linalg.norm(found))
    likely = share > 0 and 1 / FACTOR < length < FACTOR
    explains = rest < (1 - CLEAR) * float(y @ y) and rest < BETTER * before
    if likely and explains and float(found @ assumed) / length < np.cos(np.deg2rad(ANGLE)):
        return np.asarray(found / length)
    return None


def _completed(found: Array, shown: Array, assumed: Array) -> Array:
    """Return a gravity (3) that was ``found`` along the ``shown`` directions (r, 3), of at least the assumed size."""
    hidden = assumed - assumed @ shown.T @ shown
    size = float(np.linalg.norm(hidden))
    more = np.sqrt(max(float(assumed @ assumed) - float(found @ found), 0.0))
    return found + hidden / size * more if size > SEEN else found


def _columns(model: Model, q: Array, dq: Array, ddq: Array, size: float) -> Array:
    """Return the nominal torques (4, M, n) of inertia, and of a gravity along x, y and z of the root link."""
    still = np.zeros_like(q)

    def under(gravity: Array) -> Model:
        return model.with_gravity(lambda _: gravity)

    pulled = [_torque(under(size * axis), q, still, still) for axis in np.eye(3)]
    return np.array([_torque(under(np.zeros(3)), q, dq, ddq), *pulled])


def _torque(model: Model, q: Array, dq: Array, ddq: Array) -> Array:
    torque = nominal(model, q, dq, ddq)
    return np.zeros_like(q) if torque is None else torque


def _without(series: Array, others: Array) -> Array:
    """Return the columns minus their projection on the others."""
    return np.asarray(series - others @ np.linalg.lstsq(others, series)[0])
