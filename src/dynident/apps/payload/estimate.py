"""The payload, drift, friction and gains by generalised least squares, from what identifications say of the arm.

Each identification i measures base parameters b_i = B_i theta_i + H_i e + n_i, of covariance C_i (``ArmEvidence``). All
have one theta; recordings after the result have changes d of friction and offsets, which are the same in all of them;
those with the payload have its parameters phi in the columns T of its body, and changes l of friction, by the load. e
are the errors of the gains, which since the result have changed by g, k what friction grows by with the load, as K_i k,
in all of them. d, l, k, e and g have expected sizes, by which they count as measured to be zero.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from dynident.apps.payload.body import MAX_MASS, Mount
from dynident.identification import Identification
from dynident.models import Model
from dynident.regression import BaseParameters, GroupKind, groups_of
from dynident.runtime import ConfigError, InputError, Noun, WordedEnum
from dynident.runtime.arrays import Array

MAX_PERCENT = 100.0  # %
MAX_DISTANCE = 5.0  # m: a centre of mass beyond is in mm
TYPICAL_DISTANCE, MIN_MASS = 0.5, 0.2  # m, kg: a payload is about so near to its frame, and not taken for lighter
MASS_ERROR, CENTRE_ERROR = 1e-4, 5e-4  # relative error of a known mass; m, of a known centre of mass
ITERATIONS = 5
FREE_FACTOR = 1e6  # of a base parameter, over the torque that it makes: it is not known beforehand


class DriveGains(Noun):
    """The measured torque of each joint is ``factor`` (n) times the true one, with the ``covariance`` (n, n).

    ``known_mass`` (kg) is that of the payload from which they are known.
    """

    joints: tuple[str, ...]
    factor: Array
    covariance: Array
    known_mass: float

    @property
    def std(self) -> Array:
        """Standard errors (n) of the factors."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def correction(self) -> Array:
        """What to multiply the gains of the drives with (n), so that the torque is the true one."""
        return 1.0 / self.factor


@dataclass(frozen=True)
class PayloadRequest:
    """How to look for a payload.

    ``frame`` is the link that carries it (None: the flange). ``removed`` tells that the arm carried it when it was
    identified and no longer does. ``known_mass`` (kg) is its mass where it was weighed, ``known_centre`` (3) in m in
    the frame its centre of mass, where that is known to half a millimetre too: it determines the gains of the wrist.
    ``gain_error`` (%) is the standard deviation of the gains of the drives, common to all and of each, where ``gains``
    of an earlier payload of known mass are not given; ``gain_change`` (%) that by which the gain of a drive may differ
    between the result and the recordings. ``friction_change`` (%) is the standard deviation by which friction and
    offset of a joint may differ between the result and the recordings, and friction again by the load, in % of the
    joint's largest friction parameter. ``load_friction`` (%) is friction of a joint that grows with its load, by about
    this much of the load, which the model does not know. Raises ConfigError for a number out of range.
    """

    frame: str | None = None
    known_mass: float | None = None
    known_centre: tuple[float, float, float] | None = None
    gain_error: float = 3.0
    gains: DriveGains | None = None
    friction_change: float = 30.0
    load_friction: float = 5.0
    removed: bool = False
    gain_change: float = 1.0

    def __post_init__(self) -> None:
        if self.known_mass is not None and not 0 < self.known_mass < np.inf:
            raise ConfigError(f"the known mass is {self.known_mass:g} kg; give a number above 0.")
        if self.known_centre is not None and (self.known_mass is None or not np.isfinite(self.known_centre).all()):
            raise ConfigError("the known centre of mass needs the known mass, and three numbers in m.")
        if self.known_centre is not None and max(map(abs, self.known_centre)) > MAX_DISTANCE:
            raise ConfigError(f"the known centre of mass is {max(map(abs, self.known_centre)):g} m away; give it in m.")
        for name, value in (
            ("gain error", self.gain_error), ("gain change", self.gain_change),
            ("friction change", self.friction_change), ("friction by the load", self.load_friction),
        ):  # fmt: skip
            if not 0 <= value <= MAX_PERCENT:
                raise ConfigError(f"the {name} is {value:g} %; give a number from 0 to {MAX_PERCENT:g}.")
        if self.gains is not None and self.known_mass is not None:
            raise ConfigError("gains and a known mass are given: gains are known by a known mass; give one of them.")


class ArmEvidence(Noun):
    """Base parameters ``value`` (r) = ``combination`` (r, p) theta as identified, with their ``covariance`` (r, r).

    ``by_joint`` (r, n) are the parts that the torque of each joint has in them, ``shares`` (n) its shares in
    their errors. Where the torque of joint j is (1 + e_j) times the true one, the values are too large by
    ``by_joint`` e; where its friction grows with k_j times the load, which the model does not know, by
    ``by_load`` (r, n) k, None if not known.
    """

    value: Array
    combination: Array
    covariance: Array
    by_joint: Array
    shares: Array
    by_load: Array | None = None

    @classmethod
    def of(cls, identification: Identification, name: str = "the result") -> ArmEvidence:
        """Return the evidence of a result, before constraints; InputError where it does not know its covariance."""
        errors, base = identification.errors, identification.base.on_data
        if errors.base_covariance is None or errors.base_by_joint is None or errors.base_shares is None:
            raise InputError(f"{name}: does not hold the covariance of its base parameters; identify again.")
        consistency = identification.estimate.consistency
        free = None if consistency is None else consistency.unconstrained
        theta = identification.estimate.value if free is None else free
        B = np.eye(len(theta)) if base is None else base.combination
        return cls(B @ theta, B, errors.base_covariance, errors.base_by_joint, errors.base_shares, errors.base_by_load)

    def whitening_matrix(self) -> Array:
        """Return the matrix (r, r) that makes the errors of the values independent, of variance one.

        Raises InputError where the covariance is not positive definite.
        """
        scale = np.sqrt(np.diag(self.covariance))
        if not (np.isfinite(scale) & (scale > 0)).all():
            raise InputError("a base parameter has no standard error; identify again, with a longer recording.")
        try:
            half = np.linalg.cholesky(self.covariance / np.outer(scale, scale))
        except np.linalg.LinAlgError:
            raise InputError("the covariance of the base parameters is singular; identify again.") from None
        return np.asarray(np.linalg.inv(half) / scale)


class ErrorSource(WordedEnum):
    """What an error of the payload comes from: drift is that of friction and offsets between recordings."""

    ARM = "arm", "result of the arm"
    LOADED = "loaded", "recordings with the payload"
    UNLOADED = "unloaded", "recordings without"
    DRIFT = "drift", "drift"
    FRICTION = "friction", "friction by the load"
    GAINS = "gains", "gains"
    PRIOR = "prior", "what is known of it"


class PayloadSolution(Noun):
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
    by_source: Mapping[ErrorSource, Array]
    misfit: float
    freedom: float


@dataclass(frozen=True, eq=False)
class _UnknownSlices:
    """The columns of the unknowns, those of the payload last."""

    beta: slice
    drift: slice
    friction: slice
    load: slice
    gains: slice
    gain_changes: slice
    phi: slice

    @classmethod
    def of(cls, *sizes: int) -> _UnknownSlices:
        ends = np.cumsum([0, *sizes]).tolist()
        return cls(*(slice(a, b) for a, b in pairwise(ends)))


@dataclass(frozen=True, eq=False)
class _Effects:
    """How the unknowns change the arm's parameters (p) beside the base parameters of ``basis``.

    They are changed by ``drift`` (p, d), by the load through ``friction`` (p, f), and by the ``payload`` (p, 10).
    """

    basis: BaseParameters
    drift: Array
    friction: Array
    payload: Array


@dataclass(frozen=True, eq=False)
class _Measurements:
    """Measurements of unit variance: ``left`` (m, u) times the unknowns is ``right`` (m).

    Those that are ``weak`` are priors for numerical reasons only.
    """

    source: ErrorSource
    left: Array
    right: Array
    weak: bool = False
    evidence: ArmEvidence | None = None
    white: Array | None = None

    def remove_noise(self, x: Array, place: _UnknownSlices) -> _Measurements:
        """Return the rows with the residual at x (u) removed from the columns of the gains and their changes.

        These columns hold the noise of the measurement: gains below the true ones would otherwise make the residual
        smaller.
        """
        if self.evidence is None or self.white is None:
            return self
        noise = np.linalg.solve(self.white, self.right - self.left @ x)
        left = self.left.copy()
        clean = self.white @ (self.evidence.by_joint - np.outer(noise, self.evidence.shares))
        left[:, place.gains] = clean
        if self.source is not ErrorSource.ARM and place.gain_changes.stop > place.gain_changes.start:
            left[:, place.gain_changes] = clean
        return replace(self, left=left)


def solve_payload(
    identification: Identification,
    basis: BaseParameters,
    mount: Mount,
    evidence: Mapping[ErrorSource, Sequence[ArmEvidence]],
    request: PayloadRequest,
) -> PayloadSolution:
    """Solve for all unknowns by generalised least squares.

    ``identification`` is that of the arm, ``basis`` its base parameters on any motion.
    """
    model, theta = identification.model, identification.estimate.value
    drift, friction = _parameter_changes(model, basis, theta, request.friction_change)
    effects = _Effects(basis, drift, friction, -mount.transform if request.removed else mount.transform)
    n, r = len(model.joints), basis.rank
    has_load = all(measured.by_load is not None for evidence_list in evidence.values() for measured in evidence_list)
    loads = n if has_load and request.load_friction else 0
    place = _UnknownSlices.of(r, drift.shape[1], friction.shape[1], loads, n, n if request.gain_change else 0, 10)
    rows = [_measurement_rows(measured, source, effects, place, 0.01 * request.load_friction)
            for source, evidence_list in evidence.items() for measured in evidence_list]  # fmt: skip
    size = sum(part.stop - part.start for part in vars(place).values())
    # Changes, gains and body have expected sizes: each counts as a measurement that it is zero.
    for source, part, weight in (
        (ErrorSource.DRIFT, place.drift, 1.0), (ErrorSource.FRICTION, place.friction, 1.0),
        (ErrorSource.FRICTION, place.load, 1.0),
        (ErrorSource.GAINS, place.gain_changes, 100.0 / (request.gain_change or 1.0)),
    ):  # fmt: skip
        prior_rows = _diagonal_rows(size, part, np.full(part.stop - part.start, weight))
        rows.append(_Measurements(source, prior_rows, np.zeros(len(prior_rows))))
    rows.append(_gains_prior(request, place, size, n))
    torque = float(np.abs(basis.scale * theta).max())
    # A prior that only keeps base parameters solvable that no result determines.
    wide = np.full(r, FREE_FACTOR * (torque or 1.0)) / basis.scale[list(basis.independent)]
    rows.append(_Measurements(ErrorSource.PRIOR, _diagonal_rows(size, place.beta, 1.0 / wide), np.zeros(r), weak=True))
    mass = MAX_MASS if request.known_mass is None else request.known_mass
    # Prior and noise depend on the solution; a few iterations settle both.
    for _ in range(ITERATIONS):
        x = _least_squares([*rows, *_body_prior(place, size, mass, request)])[0]
        rows, mass = [block.remove_noise(x, place) for block in rows], max(abs(x[place.phi.start]), MIN_MASS)
    return _solution(effects, place, [*rows, *_body_prior(place, size, mass, request)])


def _measurement_rows(
    evidence: ArmEvidence, source: ErrorSource, effects: _Effects, place: _UnknownSlices, load_share: float
) -> _Measurements:
    """Return what an identification measures; friction unknown to it grows by about ``load_share`` of the load."""
    white = evidence.whitening_matrix()
    combination = white @ evidence.combination
    left = np.zeros((len(white), place.phi.stop))
    left[:, place.beta] = combination[:, list(effects.basis.independent)]
    left[:, place.gains] = white @ evidence.by_joint
    if evidence.by_load is not None and place.load.stop > place.load.start:
        left[:, place.load] = load_share * white @ evidence.by_load
    if source is not ErrorSource.ARM:
        left[:, place.drift] = combination @ effects.drift
        if place.gain_changes.stop > place.gain_changes.start:
            left[:, place.gain_changes] = left[:, place.gains]
    if source is ErrorSource.LOADED:
        left[:, place.friction] = combination @ effects.friction
        left[:, place.phi] = combination @ effects.payload
    return _Measurements(source, left, white @ evidence.value, evidence=evidence, white=white)


def _parameter_changes(model: Model, basis: BaseParameters, theta: Array, percent: float) -> tuple[Array, Array]:
    """Return the changes (p, k) of parameters by drift and by the load, each of its expected size.

    Drift changes each parameter of friction and offset, the load those of friction, in % of the joint's largest
    friction.
    """
    names = {name: k for k, name in enumerate(basis.names)}
    columns: dict[str, dict[GroupKind, list[int]]] = {}
    for group in groups_of(model, basis):
        if group.kind in (GroupKind.FRICTION, GroupKind.OFFSET):
            columns.setdefault(group.joint, {})[group.kind] = [names[parameter] for parameter in group.names]
    changes: dict[GroupKind, list[Array]] = {GroupKind.FRICTION: [], GroupKind.OFFSET: []}
    for kinds in columns.values() if percent else ():
        level = 0.01 * percent * np.abs(theta[kinds.get(GroupKind.FRICTION, [])]).max(initial=0.0)
        for kind, columns_of_kind in kinds.items():
            changes[kind] += [level * np.eye(len(theta))[k] for k in columns_of_kind if level]
    empty = np.zeros((0, len(theta)))
    friction, offset = (np.array(columns_of_kind) if columns_of_kind else empty for columns_of_kind in changes.values())
    return np.concatenate([friction, offset]).T, friction.T


def _gains_prior(request: PayloadRequest, place: _UnknownSlices, size: int, n: int) -> _Measurements:
    """Return the prior of the gain errors: a common one and one of each drive, or those found before."""
    share = max(0.01 * request.gain_error, 1e-6)
    mean, covariance = np.zeros(n), share**2 * (np.eye(n) + 1.0)
    if request.gains is not None:
        mean, covariance = request.gains.factor - 1.0, request.gains.covariance
    left = np.zeros((n, size))
    half = np.linalg.cholesky(covariance + 1e-18 * np.eye(n))
    left[:, place.gains] = np.linalg.inv(half)
    return _Measurements(ErrorSource.GAINS, left, np.linalg.solve(half, mean))


def _body_prior(place: _UnknownSlices, size: int, mass: float, request: PayloadRequest) -> list[_Measurements]:
    """Return the priors of a payload of about this ``mass`` near its frame, and what is known of it."""
    sizes = mass * TYPICAL_DISTANCE ** np.array([0, 1, 1, 1, 2, 2, 2, 2, 2, 2])
    sizes[0] = MAX_MASS
    blocks = [_Measurements(ErrorSource.PRIOR, _diagonal_rows(size, place.phi, 1.0 / sizes), np.zeros(10), weak=True)]
    if (weight := request.known_mass) is not None:
        known_values = np.array([1.0, *(request.known_centre or ())])
        error = weight * np.array([MASS_ERROR, CENTRE_ERROR, CENTRE_ERROR, CENTRE_ERROR])[: len(known_values)]
        part = slice(place.phi.start, place.phi.start + len(known_values))
        rows = _diagonal_rows(size, part, 1.0 / error)
        blocks.append(_Measurements(ErrorSource.PRIOR, rows, weight * known_values / error, weak=True))
    return blocks


def _diagonal_rows(size: int, part: slice, values: Array) -> Array:
    left = np.zeros((len(values), size))
    left[:, part] = np.diag(values)
    return left


def _least_squares(rows: Sequence[_Measurements]) -> tuple[Array, Array, Array]:
    """Return the unknowns (u), the triangular factor (u, u) of scaled columns, and the scale (u)."""
    left, right = np.concatenate([block.left for block in rows]), np.concatenate([block.right for block in rows])
    scale = np.linalg.norm(left, axis=0)
    if not (np.isfinite(scale).all() and np.isfinite(right).all()):
        raise InputError("a standard error of the result is not finite; identify again.")
    Q, R = np.linalg.qr(left / scale)
    return np.linalg.solve(R, Q.T @ right) / scale, R, scale


def _solution(effects: _Effects, place: _UnknownSlices, rows: Sequence[_Measurements]) -> PayloadSolution:
    x, R, scale = _least_squares(rows)
    inverse = np.linalg.inv(R) / scale[:, None]
    gain, covariance = inverse[place.phi], inverse @ inverse.T
    parts = dict[ErrorSource, Array]()
    # The variance divides among the sources, since the information is a sum over them.
    for block in rows:  # A^-1 times the information of each source, times A^-1
        half = block.left @ inverse @ gain.T
        parts[block.source] = parts.get(block.source, np.zeros((10, 10))) + half.T @ half
    counted = [block for block in rows if not block.weak]
    misfit = sum(float(np.sum((block.right - block.left @ x) ** 2)) for block in counted)
    # Degrees of freedom of rows with priors: each row less its leverage.
    freedom = sum(len(block.right) - float(np.sum((block.left @ inverse) ** 2)) for block in counted)
    payload_factor = R[-10:, -10:] * scale[place.phi]
    return PayloadSolution(
        effects.basis, x[place.beta], effects.drift @ x[place.drift], effects.friction @ x[place.friction],
        x[place.gains],
        covariance[place.gains, place.gains], x[place.phi], payload_factor.T @ payload_factor, parts,
        misfit, max(freedom, 0.0),
    )  # fmt: skip
