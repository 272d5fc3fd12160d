"""Base parameters: which combinations of the standard parameters act on the torque, and which the data determine.

A rank-revealing decomposition of a triangular factor, after Gautier and Khalil (1990), "Direct calculation of minimum
set of inertial parameters of serial robots", and Gautier (1991), "Numerical calculation of the base inertial
parameters".
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from dynident.models import INERTIAL, Model, Parameter, motion_memory, random_states
from dynident.motion.log import Motion
from dynident.regression.rank import Rank, precision, rank_of, rank_of_information, tied_groups
from dynident.regression.triangular import EntryBlock, TriangularFactors, factorise
from dynident.runtime import ModelError, Note, Noun, join_names
from dynident.runtime.arrays import Array

STATES = 400  # of the arm, drawn at random: they show all that any motion could
MIN_SHARE = 1e-8  # a smaller share in a base parameter is rounding error
MIN_INDEPENDENCE = 1e-2  # a column this far from the span of those already kept is clearly independent


class BaseParameters(Noun):
    """The base parameters beta = B theta = theta_b + K theta_d (r) of the standard parameters theta (p), in SI units.

    ``independent``: the indices b of the standard parameters that lead a base parameter; ``combination`` (r, p): the
    matrix B, the identity in the columns b; ``singular_values`` (p) of the column-scaled factor, in descending order;
    ``scale`` (p): what its columns were divided by (``Rank``).
    """

    names: tuple[str, ...]
    rank: int
    singular_values: Array
    independent: tuple[int, ...]
    combination: Array
    scale: Array

    def __repr__(self) -> str:
        led = join_names(self.leading, 6)
        return f"<BaseParameters: {self.rank} of {len(self.names)} parameters, led by {led}>"

    @property
    def leading(self) -> tuple[str, ...]:
        """Names of the standard parameters that lead a base parameter."""
        return tuple(self.names[k] for k in self.independent)

    @property
    def gap(self) -> float:
        """Ratio of the smallest retained to the largest dropped singular value: the larger, the clearer the rank."""
        retained, dropped = self.singular_values[: self.rank], self.singular_values[self.rank :]
        with np.errstate(over="ignore"):
            return (
                float(retained[-1] / dropped[0]) if len(retained) and len(dropped) and dropped[0] > 0 else float("inf")
            )

    @property
    def dependent(self) -> tuple[int, ...]:
        """Indices d of the standard parameters that lead no base parameter."""
        return tuple(k for k in range(len(self.names)) if k not in self.independent)

    @cached_property
    def groupings(self) -> tuple[str, ...]:
        """Each base parameter as a formula in the standard ones, such as ``Izz1 + Ia1 + 0.05185*m3``."""
        leads = zip(self.combination, self.independent, strict=True)
        return tuple(_formula(row, lead, self.names) for row, lead in leads)

    @property
    def without_effect(self) -> tuple[str, ...]:
        """Names of the standard parameters without effect on the torque."""
        return tuple(self.names[k] for k in np.flatnonzero(~self.combination.any(axis=0)))

    @property
    def single_parameters(self) -> tuple[str, ...]:
        """Names of the standard parameters that are base parameters by themselves."""
        alone = (self.combination != 0).sum(axis=1) == 1
        return tuple(self.names[k] for k, single in zip(self.independent, alone, strict=True) if single)

    @property
    def null_directions(self) -> Array:
        """Directions (p, p - r) of theta that change no torque, one for each dependent parameter."""
        d = list(self.dependent)
        out = np.zeros((len(self.names), len(d)))
        out[d, range(len(d))] = 1.0
        out[list(self.independent)] = -self.combination[:, d]
        return out

    def to_base(self, theta: ArrayLike) -> Array:
        """Return beta (r) = B theta for theta (p); ModelError where the shape does not fit."""
        return self.combination @ _check_vector(theta, len(self.names), "theta")

    def to_standard(self, beta: ArrayLike, reference: ArrayLike | None = None) -> Array:
        """Return the theta (p) with B theta = beta (r) closest to ``reference`` (p, default zero) in scaled columns.

        Raises ModelError where a shape does not fit.
        """
        start = np.zeros(len(self.names)) if reference is None else _check_vector(reference, len(self.names), "near")
        residual = _check_vector(beta, self.rank, "beta") - self.combination @ start
        if not self.rank:
            return start
        rows = self.scale[list(self.independent)]  # rows of unlike units would cost digits
        scaled_combination = rows[:, None] * self.combination / self.scale
        return start + np.linalg.lstsq(scaled_combination, rows * residual)[0] / self.scale


def base_parameters(
    factor: Array | Rank, parameters: Sequence[Parameter], tolerance: float | None = None
) -> BaseParameters:
    """Return the base parameters of a rank, or of the triangular factor (``rank_of``) of a regressor.

    Where there is a choice of leading parameters, the order of preference is: friction and other effects, inertia of
    later bodies, masses, rotor inertia. Raises ConfigError for a tolerance outside (0, 1), ModelError where the shape
    does not fit the parameters.
    """
    p = len(parameters)
    if isinstance(factor, Rank):
        decomposition = factor
    elif factor.shape not in ((p, p), (p + 1, p + 1)):
        raise ModelError(f"factor has shape {factor.shape}, expected ({p}, {p}) or ({p + 1}, {p + 1}).")
    else:
        decomposition = rank_of(factor, parameters, tolerance)
    if decomposition.unweighted is not None and decomposition.unweighted.rank == decomposition.rank:
        decomposition = decomposition.unweighted  # the same directions, in which weights have not made rounding large
    directions = decomposition.vectors[:, : decomposition.rank].T
    # without effect
    directions = np.where(np.linalg.norm(directions, axis=0) <= 10 * decomposition.tolerance, 0.0, directions)
    # unit columns of the factor on the determined directions: their independence does not depend on units
    size = np.linalg.norm(R := decomposition.values[: decomposition.rank, None] * directions, axis=0)
    leaders = sorted(_choose_columns(R / np.where(size > 0, size, 1.0), decomposition.rank, _leader_order(parameters)))
    B = _combination_matrix(directions, leaders, decomposition.scale, decomposition.tolerance)
    return BaseParameters(
        tuple(x.name for x in parameters),
        decomposition.rank,
        decomposition.values,
        tuple(leaders),
        B,
        decomposition.scale,
    )


def base_std(basis: BaseParameters, triangular: TriangularFactors, sigma: Array, weights: Array | None = None) -> Array:
    """Return the standard errors (r) of the base parameters of a least-squares fit.

    ``sigma`` (n) is the standard deviation of each joint's residual, ``weights`` (n) what each joint's rows were
    multiplied with in the fit (one where None): A^-1 (sum w^4 sigma^2 G_j) A^-1 with A = sum w^2 G_j and G_j = X_j' X_j
    over the independent columns; infinite where rounding makes these dependent. Holds for independent errors and an
    exactly known regressor. Raises ModelError where the factors do not fit the base parameters.
    """
    p, leaders = len(basis.names), list(basis.independent)
    if triangular.factors.shape[1:] != (p + 1, p + 1):
        raise ModelError(f"factors have shape {triangular.factors.shape[1:]}, expected ({p + 1}, {p + 1}).")
    w = np.ones(len(triangular.factors)) if weights is None else np.asarray(weights)
    R = triangular.factors[:, :p, leaders] * w[:, None, None]
    decomposition = rank_of(np.asarray(np.linalg.qr(triangular.stack(w)[:, [*leaders, -1]], mode="r")))
    # G_j enters by its factor, so that the squares of small singular values are never formed
    # A^-1 is its square; not formed, to lose no digits
    half = decomposition.determined_directions / decomposition.values[: decomposition.rank]
    spread = ((w * np.asarray(sigma))[:, None, None] * (R @ half)).reshape(-1, decomposition.rank)
    std = np.linalg.norm(np.linalg.qr(spread, mode="r") @ half.T, axis=0)
    return np.where(decomposition.undetermined_mask, np.inf, std)


def informed_std(basis: BaseParameters, information: Array) -> Array:
    """Return the standard errors (r) of the base parameters from Fisher's information (p, p) of the standard ones.

    They are infinite where the information is singular to working precision.
    """
    leaders = list(basis.independent)
    return np.asarray(np.sqrt(np.diag(rank_of_information(information[np.ix_(leaders, leaders)]).covariance())))


def structural_base_parameters(
    model: Model, *, tolerance: float | None = None, unfitted: Collection[str] = ()
) -> BaseParameters:
    """Return the base parameters that a sufficiently exciting motion shows.

    They are those of 400 random states of the arm, the same ones each time, where the torques of all joints but the
    ``unfitted`` ones are fitted. Raises the errors of ``base_parameters`` and of the model.

    >>> from dynident.models.friction import Coulomb, Viscous
    >>> from dynident.models import Model, RotorInertia
    >>> from dynident.models.lagrangian import pendulum
    >>> arm = pendulum()
    >>> structural_base_parameters(Model((*arm.terms, RotorInertia(arm.joints)))).groupings
    ('J + Ia_pivot', 'h')
    """
    factor = _factor(model, model.random_states(np.random.default_rng(0), STATES), unfitted)
    return base_parameters(factor, model.parameters, tolerance)


class UnexcitedParameters(Note):
    """Base parameters that the data do not excite, and the joints whose motion would excite them.

    The joints must move at the same time where ``together`` is set, else one by one; those in ``still`` do not move in
    the data.
    """

    topic = "not excited"
    groupings: tuple[str, ...]
    joints: tuple[str, ...]
    together: bool = False
    still: tuple[str, ...] = ()

    @property
    def motion(self) -> str:
        """The joints to move, and how."""
        how = " at the same time" if self.together else " each by itself"
        # joints that moved, and did not show the parameters, did so while the others stood in too few postures
        how += "" if self.together or self.still else ", in several postures of the others"
        return ", ".join(self.joints) + (how if len(self.joints) > 1 else "")

    def __str__(self) -> str:
        still = f" (at rest in these data: {', '.join(self.still)})" if self.still else ""
        return f"{'; '.join(self.groupings)}: not excited by these data; move {self.motion}{still}."


def find_unexcited(
    structural: BaseParameters, on_data: BaseParameters, model: Model, motions: Sequence[Motion] = ()
) -> tuple[UnexcitedParameters, ...]:
    """Return the missing excitation where the rank on the data is below the structural rank.

    The joints are those that excite the parameters when they move alone, or, where none does, all together; with
    ``motions``, joints that do not move in them are named. Raises ModelError where the parameters of the three
    differ.
    """
    if not structural.names == on_data.names == model.names:
        raise ModelError("both sets of base parameters and the model must have the same parameters, in the same order.")
    # directions that the data leave free, seen by the base parameters that the structure has, free of units
    free = on_data.null_directions
    hidden_directions = free / np.linalg.norm(structural.scale[:, None] * free, axis=0)
    seen_combinations = (
        structural.combination * structural.scale[list(structural.independent), None]
    ) @ hidden_directions
    U, s, Vt = np.linalg.svd(seen_combinations, full_matrices=False)
    k = int((s > 10 * precision(model.parameters) * s.max(initial=1.0)).sum())  # both bases are exact to it
    # only singular values above rounding tell a missing parameter; left vectors tie those that are missing together
    U, lifted = U[:, :k], hidden_directions @ (Vt[:k].T / s[:k])
    still = _still_joints(motions)
    return tuple(
        _unexcited_note(structural, model, group, lifted @ U[group].T, still) for group in tied_groups(U @ U.T, 1e-3)
    )


def _unexcited_note(
    structural: BaseParameters, model: Model, group: list[int], directions: Array, still: Sequence[str]
) -> UnexcitedParameters:
    groupings = tuple(structural.groupings[k] for k in group)
    names = [joint.name for joint in model.joints]
    alone = [name for j, name in enumerate(names) if _is_excited_by(model, j, directions)]
    joints_to_move = [name for name in alone if name in still] or alone or names
    return UnexcitedParameters(
        groupings, tuple(joints_to_move), not alone, tuple(name for name in joints_to_move if name in still)
    )


def _is_excited_by(model: Model, joint: int, directions: Array) -> bool:
    """Return whether moving one joint alone, in a few postures, gives a torque along these directions."""
    rng = np.random.default_rng(1)
    q, dq, ddq = random_states(model.joints, rng, 60)
    other_joints = [j for j in range(len(model.joints)) if j != joint]
    full_effect = np.linalg.norm(_torques_along(model, q, dq, ddq, directions))
    # one joint moves in three postures, in each of which the others stand still
    q[:, other_joints] = np.repeat(q[::20][:, other_joints], 20, axis=0)
    dq[:, other_joints] = ddq[:, other_joints] = 0.0
    effect = _torques_along(model, q, dq, ddq, directions)
    # the torque at rest is not excited by the joint's motion
    by_posture = effect.reshape(3, 20, *effect.shape[1:])
    return bool(np.linalg.norm(by_posture - by_posture.mean(axis=1, keepdims=True)) > 1e-3 * full_effect)


def _torques_along(model: Model, q: Array, dq: Array, ddq: Array, directions: Array) -> Array:
    """Return the torques (N, n, k) of directions (p, k) at states that follow each other."""
    memory = motion_memory(model, np.arange(len(q), dtype=float), q, dq, ddq) if model.memory else None
    return model.regressor(q, dq, ddq, memory) @ directions


def _still_joints(motions: Iterable[Motion]) -> tuple[str, ...]:
    """Return the joints whose velocity never reaches a thousandth of a unit per second in any motion."""
    fastest: dict[str, float] = {}
    for motion in motions:
        for name, peak in zip(motion.joints, np.abs(motion.dq[motion.mask]).max(axis=0, initial=0.0), strict=True):
            fastest[name] = max(fastest.get(name, 0.0), float(peak))
    return tuple(name for name, peak in fastest.items() if peak < 1e-3)


def _factor(model: Model, states: dict[str, Array], unfitted: Collection[str] = ()) -> Array:
    structure = model.structure
    entries = model.entries(**states, joint=structure.joint, parameter=structure.parameter)
    shape = states["q"].T.shape
    keep = np.broadcast_to([[joint.name not in unfitted] for joint in model.joints], shape) if unfitted else None
    return factorise([EntryBlock(structure, entries, np.zeros(shape), keep)], structure).stack()


def _leader_order(parameters: Sequence[Parameter]) -> list[int]:
    """Return the columns in the order in which they are preferred as leaders of a base parameter."""
    bodies = list(dict.fromkeys(x.body for x in parameters))

    def key(k: int) -> tuple[int, int, int]:
        role, body = parameters[k].role, parameters[k].body
        kind = {"mass": 2, "rotor": 3}.get(role, 1 if role in INERTIAL else 0)
        return kind, -bodies.index(body), k

    return sorted(range(len(parameters)), key=key)


def _choose_columns(R: Array, rank: int, order: list[int]) -> list[int]:
    """Choose ``rank`` independent columns: the clearly independent ones in the given order, then the largest left."""
    remainder, columns = R.copy(), list[int]()

    def keep(k: int) -> None:
        """Take a column, and make the others orthogonal to it."""
        nonlocal remainder
        unit = remainder[:, k] / np.linalg.norm(remainder[:, k])
        remainder = remainder - np.outer(unit, unit @ remainder)
        remainder[:, k] = 0.0
        columns.append(k)

    # clearly independent columns in the order of preference, so that leaders do not depend on rounding
    for k in order:
        if len(columns) < rank and np.linalg.norm(remainder[:, k]) > MIN_INDEPENDENCE:
            keep(k)
    while len(columns) < rank:
        keep(int(np.argmax(np.linalg.norm(remainder, axis=0))))
    return columns


def _combination_matrix(directions: Array, leaders: list[int], scale: Array, tolerance: float) -> Array:
    """Return B from the determined ``directions`` (r, p), free of rounding error; ``leaders`` are its unit columns."""
    # row reduction: each leading parameter stands in one base parameter only, with the factor one
    B = np.linalg.solve(directions[:, leaders], directions)
    B = np.where(np.abs(B) < max(MIN_SHARE, tolerance), 0.0, B) * scale / scale[leaders, None]
    # factors that are whole numbers but for rounding are set to them
    rounded = np.round(B)
    B = np.where((rounded != 0) & (np.abs(B - rounded) < MIN_SHARE), rounded, B)
    B[:, leaders] = np.eye(len(leaders))
    return np.asarray(B, dtype=np.float64)


def _formula(row: Array, lead: int, names: tuple[str, ...]) -> str:
    text = names[lead]
    for k in np.flatnonzero(row):
        if k != lead:
            size = f"{abs(row[k]):.4g}"
            text += f" {'-' if row[k] < 0 else '+'} {'' if size == '1' else size + '*'}{names[k]}"
    return text


def _check_vector(value: ArrayLike, size: int, name: str) -> Array:
    array = np.asarray(value, dtype=float)
    if array.shape != (size,):
        raise ModelError(f"{name} has shape {array.shape}, expected ({size},).")
    return array
