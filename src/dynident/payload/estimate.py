"""The payload, drift, friction and gains by generalised least squares, from what identifications say of the arm.

Each identification i measures base parameters b_i = B_i theta_i + H_i e + n_i, of covariance C_i (``Evidence``). All
have one theta; recordings after the result have changes d of friction and offsets, which are the same in all of them;
those with the payload have its parameters phi in the columns T of its body, and changes l of friction, by the load.
e are the errors of the gains, k what friction grows by with the load, as K_i k, in all of them. d, l, k and e have
expected sizes, by which they count as measured to be zero.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from dynident.errors import InputError, brief
from dynident.models import Model
from dynident.payload.evidence import Evidence
from dynident.payload.mount import Mount
from dynident.payload.request import Request
from dynident.regression import BaseParameters, GroupKind, groups_of

__all__ = ["Solved", "Source", "solved"]

Array = NDArray[np.float64]
LARGEST = 1e3  # kg: weak prior of the mass
WITHIN, LIGHTEST = 0.5, 0.2  # m, kg: a payload is about so near to its frame, and not taken for lighter
WEIGHED, PLACED = 1e-4, 5e-4  # relative error of a known mass; m, of a known centre of mass
ROUNDS = 5
FREE = 1e6  # of a base parameter, over the torque that it makes: it is not known beforehand


class Source(StrEnum):
    """What an error of the payload comes from: the arm's result, recordings with and without the payload, drift of
    friction and offsets between recordings, change of the friction by the load, gains of the drives."""

    ARM = "arm"
    LOADED = "loaded"
    UNLOADED = "unloaded"
    DRIFT = "drift"
    FRICTION = "friction"
    GAINS = "gains"
    PRIOR = "prior"


@dataclass(frozen=True, eq=False)
class Solved:
    """The unknowns: base parameters ``beta`` (r), ``drift`` (p) and ``friction`` (p) as changes of the model's
    parameters, ``gain_errors`` (n) with their covariance, the payload ``phi`` (10).

    ``information`` (10, 10) is on phi, ``by_source`` the parts (10, 10) of its covariance; ``misfit`` the sum of
    squares of what is left, over its ``freedom``.
    """

    basis: BaseParameters
    beta: Array
    drift: Array
    friction: Array
    gain_errors: Array
    gain_covariance: Array
    phi: Array
    information: Array
    by_source: Mapping[Source, Array]
    misfit: float
    freedom: float

    __repr__ = brief


@dataclass(frozen=True, eq=False)
class _Unknowns:
    """Where the unknowns are among the columns: the payload last."""

    beta: slice
    drift: slice
    friction: slice
    load: slice
    gains: slice
    phi: slice

    @classmethod
    def of(cls, *sizes: int) -> _Unknowns:
        ends = np.cumsum([0, *sizes]).tolist()
        return cls(*(slice(a, b) for a, b in pairwise(ends)))


@dataclass(frozen=True, eq=False)
class _Rows:
    """Measurements of unit variance: ``left`` (m, u) times the unknowns is ``right`` (m); the priors of nothing but
    numerics are ``weak``."""

    source: Source
    left: Array
    right: Array
    weak: bool = False
    evidence: Evidence | None = None
    white: Array | None = None

    def cleaned(self, x: Array, gains: slice) -> _Rows:
        """Return the rows with what is left at x (u) taken out of the columns of the gains.

        These hold the noise of what was measured: else gains below the true ones would make it smaller.
        """
        if self.evidence is None or self.white is None:
            return self
        noise = np.linalg.solve(self.white, self.right - self.left @ x)
        left = self.left.copy()
        left[:, gains] = self.white @ (self.evidence.by_joint - np.outer(noise, self.evidence.shares))
        return replace(self, left=left)


def solved(
    model: Model,
    basis: BaseParameters,
    theta: Array,
    mount: Mount,
    evidence: Mapping[Source, Sequence[Evidence]],
    request: Request,
) -> Solved:
    """Return the unknowns; ``theta`` (p) are the arm's parameters and ``basis`` its base parameters on any motion."""
    drift, friction = _changes(model, basis, theta, request.friction_change)
    n, r = len(model.joints), basis.rank
    known = all(one.by_load is not None for several in evidence.values() for one in several)
    place = _Unknowns.of(r, drift.shape[1], friction.shape[1], n if known and request.load_friction else 0, n, 10)
    rows = [_measured(one, source, basis, mount, (drift, friction), place, request)
            for source, several in evidence.items() for one in several]  # fmt: skip
    size = sum(part.stop - part.start for part in vars(place).values())
    rows += _changes_prior(place, size)
    rows.append(_gains_prior(request, place, size, n))
    torque = float(np.abs(basis.scale * theta).max())
    wide = np.full(r, FREE * (torque or 1.0)) / basis.scale[list(basis.independent)]
    rows.append(_Rows(Source.PRIOR, _unit(size, place.beta, 1.0 / wide), np.zeros(r), weak=True))
    mass = LARGEST if request.known_mass is None else request.known_mass
    for _ in range(ROUNDS):
        x = _least_squares([*rows, *_body(place, size, mass, request)])[0]
        rows, mass = [one.cleaned(x, place.gains) for one in rows], max(abs(x[place.phi.start]), LIGHTEST)
    return _found(basis, place, drift, friction, [*rows, *_body(place, size, mass, request)])


def _measured(
    one: Evidence,
    source: Source,
    basis: BaseParameters,
    mount: Mount,
    changes: tuple[Array, Array],
    place: _Unknowns,
    request: Request,
) -> _Rows:
    white = one.white()
    combination = white @ one.combination
    left = np.zeros((len(white), place.phi.stop))
    left[:, place.beta] = combination[:, list(basis.independent)]
    left[:, place.gains] = white @ one.by_joint
    if one.by_load is not None and place.load.stop > place.load.start:
        left[:, place.load] = 0.01 * request.load_friction * white @ one.by_load
    if source is not Source.ARM:
        left[:, place.drift] = combination @ changes[0]
    if source is Source.LOADED:
        left[:, place.friction] = combination @ changes[1]
        left[:, place.phi] = combination @ mount.turn * (-1.0 if request.removed else 1.0)
    return _Rows(source, left, white @ one.value, evidence=one, white=white)


def _changes(model: Model, basis: BaseParameters, theta: Array, percent: float) -> tuple[Array, Array]:
    """Return the changes (p, k) of parameters by drift and by the load, each of its expected size.

    They are of each parameter of friction, and by drift of offsets, too, in % of the joint's largest friction.
    """
    names = {name: k for k, name in enumerate(basis.names)}
    columns: dict[str, dict[GroupKind, list[int]]] = {}
    for group in groups_of(model, basis):
        if group.kind in (GroupKind.FRICTION, GroupKind.OFFSET):
            columns.setdefault(group.joint, {})[group.kind] = [names[one] for one in group.names]
    found: dict[GroupKind, list[Array]] = {GroupKind.FRICTION: [], GroupKind.OFFSET: []}
    for kinds in columns.values() if percent else ():
        level = 0.01 * percent * np.abs(theta[kinds.get(GroupKind.FRICTION, [])]).max(initial=0.0)
        for kind, several in kinds.items():
            found[kind] += [level * np.eye(len(theta))[k] for k in several if level]
    empty = np.zeros((0, len(theta)))
    friction, offset = (np.array(several) if several else empty for several in found.values())
    return np.concatenate([friction, offset]).T, friction.T


def _changes_prior(place: _Unknowns, size: int) -> list[_Rows]:
    pairs = ((Source.DRIFT, place.drift), (Source.FRICTION, place.friction), (Source.FRICTION, place.load))
    found = []
    for source, part in pairs:
        left = _unit(size, part, np.ones(part.stop - part.start))
        found.append(_Rows(source, left, np.zeros(len(left))))
    return found


def _gains_prior(request: Request, place: _Unknowns, size: int, n: int) -> _Rows:
    """Return what is known of the errors of the gains: those of all drives together and of each, or as found before."""
    share = max(0.01 * request.gain_error, 1e-6)
    mean, covariance = np.zeros(n), share**2 * (np.eye(n) + 1.0)
    if request.gains is not None:
        mean, covariance = request.gains.factor - 1.0, request.gains.covariance
    left = np.zeros((n, size))
    half = np.linalg.cholesky(covariance + 1e-18 * np.eye(n))
    left[:, place.gains] = np.linalg.inv(half)
    return _Rows(Source.GAINS, left, np.linalg.solve(half, mean))


def _body(place: _Unknowns, size: int, mass: float, request: Request) -> list[_Rows]:
    """Return that a payload of about this ``mass`` is not far from its frame, and what is known of it."""
    sizes = mass * WITHIN ** np.array([0, 1, 1, 1, 2, 2, 2, 2, 2, 2])
    sizes[0] = LARGEST
    found = [_Rows(Source.PRIOR, _unit(size, place.phi, 1.0 / sizes), np.zeros(10), weak=True)]
    if (weight := request.known_mass) is not None:
        known = np.array([1.0, *(request.known_centre or ())])
        error = weight * np.array([WEIGHED, PLACED, PLACED, PLACED])[: len(known)]
        part = slice(place.phi.start, place.phi.start + len(known))
        found.append(_Rows(Source.PRIOR, _unit(size, part, 1.0 / error), weight * known / error, weak=True))
    return found


def _unit(size: int, part: slice, values: Array) -> Array:
    left = np.zeros((len(values), size))
    left[:, part] = np.diag(values)
    return left


def _least_squares(rows: Sequence[_Rows]) -> tuple[Array, Array, Array]:
    """Return the unknowns (u), the triangular factor (u, u) of scaled columns, and the scale (u)."""
    left, right = np.concatenate([one.left for one in rows]), np.concatenate([one.right for one in rows])
    scale = np.linalg.norm(left, axis=0)
    if not (np.isfinite(scale).all() and np.isfinite(right).all()):
        raise InputError("a standard error of the result is not finite; identify again.")
    Q, R = np.linalg.qr(left / scale)
    return np.linalg.solve(R, Q.T @ right) / scale, R, scale


def _found(basis: BaseParameters, place: _Unknowns, drift: Array, friction: Array, rows: Sequence[_Rows]) -> Solved:
    x, R, scale = _least_squares(rows)
    inverse = np.linalg.inv(R) / scale[:, None]
    gain, spread = inverse[place.phi], inverse @ inverse.T
    parts = dict[Source, Array]()
    for one in rows:  # A^-1 times the information of each source, times A^-1
        half = one.left @ inverse @ gain.T
        parts[one.source] = parts.get(one.source, np.zeros((10, 10))) + half.T @ half
    counted = [one for one in rows if not one.weak]
    misfit = sum(float(np.sum((one.right - one.left @ x) ** 2)) for one in counted)
    freedom = sum(len(one.right) - float(np.sum((one.left @ inverse) ** 2)) for one in counted)
    own = R[-10:, -10:] * scale[place.phi]
    return Solved(
        basis, x[place.beta], drift @ x[place.drift], friction @ x[place.friction], x[place.gains],
        spread[place.gains, place.gains], x[place.phi], own.T @ own, parts,
        misfit, max(freedom, 0.0),
    )  # fmt: skip
