"""The results of an export: the text, its verification, and both together."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Protocol

import numpy as np

from dynident.estimators import Constraints, Limit, bodies_of, parameter_scales, sign_limits
from dynident.estimators.cone import minimise
from dynident.models import Model, smallest_eigenvalue
from dynident.project.export.identified import IdentifiedModel, holdable_mask
from dynident.regression import BaseParameters, structural_base_parameters
from dynident.runtime import ConfigError, ModelError, Noun
from dynident.runtime.arrays import Array

States = tuple[Array, Array, Array]
Reader = Callable[[str, IdentifiedModel, States], Array]

# of a body's own smallest scaled eigenvalue, but no more than the latter is asked for
KEPT_EIGENVALUE_SHARE, MAX_EIGENVALUE_MARGIN = 0.5, 1e-3
REGULARISATION = 1e-9  # the weight of small changes beside that of what is left over
ZERO_SHARES = (1e-2, 1e-4, 0.0)  # what is left of a parameter, as a share of all that can be moved, that may mean zero
MIN_RELATIVE_EFFECT = 1e-8  # a smaller effect of a direction is rounding
MAX_TORQUE_ROUNDING = 1e-9  # largest difference of the torque, relative, that rounding may make


class ExportText(Noun):
    """The text of a model; ``left_out`` describes what its format cannot hold, ``notes`` are remarks."""

    text: str
    left_out: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Proof:
    """The verification of a text: its torque, loaded again, against that of the model without the terms left out.

    ``readers`` has by reader the norm of the difference, relative to that of the torque, at the worst joint, over
    ``samples`` states; ``skipped`` says why other readers could not be used.
    """

    readers: Mapping[str, float]
    samples: int
    skipped: tuple[str, ...] = ()
    limit: float = 1e-8

    @property
    def agreement(self) -> float:
        """The largest difference of all readers; infinite where none could read the text."""
        return max(self.readers.values(), default=float("inf"))

    @property
    def proven(self) -> bool:
        """Whether every reader agrees within the limit."""
        return self.agreement <= self.limit


@dataclass(frozen=True)
class FileError:
    """The relative torque errors (%) of the identified model and of a file on a log; ``role`` is that of the log."""

    log: str
    role: str
    model: float
    file: float


class Export(Noun):
    """A file to be written, or in ``refusal`` the reason why not: wrong for the format, or not verified.

    ``errors`` are those of the dynamics of the file on the logs, where these are known.
    """

    format: str
    file: str
    written: ExportText | None = None
    proof: Proof | None = None
    refusal: str = ""
    errors: tuple[FileError, ...] = ()

    @property
    def ready(self) -> bool:
        """Whether there is a text, and it is verified."""
        return self.written is not None and self.proof is not None and self.proof.proven


class Exporter(Protocol):
    """One format: a frozen dataclass without settings."""

    @property
    def format(self) -> str:
        """The name of the format."""

    @property
    def readers(self) -> Mapping[str, Reader]:
        """Functions that load a text again, by name: each returns its torque (N, n) at states q, dq, ddq (N, n)."""

    def file(self, identified: IdentifiedModel) -> str:
        """Return the usual name of the file."""

    def write(self, identified: IdentifiedModel) -> ExportText:
        """Return the text; ModelError where the format cannot hold the model."""

    def torque(self, identified: IdentifiedModel, states: States) -> Array:
        """Return the torque (N, n) of the terms that the format can hold."""


@lru_cache(maxsize=4)
def place_values(identified: IdentifiedModel, *, armature: bool) -> IdentifiedModel:
    """Return values with the same torque, with as little as possible in parameters that a robot file cannot hold.

    ``armature``: whether it can hold rotor inertia. Bodies stay physically consistent, friction and rotor inertia
    stay non-negative; values are unchanged where some body is not consistent. The parameters move along the null
    space of the structural base parameters, by the conic program min |w theta_u|^2 over those u that cannot be
    held, each with the torque w that it makes per unit in random states.
    """
    is_holdable = holdable_mask(identified, armature=armature)
    _, values = identified.bodies
    # nothing to move or to be moved, or bodies that constraints could not keep consistent
    if (
        identified.keeps_bodies
        or is_holdable.all()
        or not identified.value[~is_holdable].any()
        or min(map(smallest_eigenvalue, values)) <= 0
    ):
        return identified
    base = structural_base_parameters(identified.model)
    if not base.null_directions[~is_holdable].any():
        return identified
    null = _null_space(identified.model, base)
    parameters, effect = identified.model.parameters, float(np.linalg.norm(base.scale * identified.value))
    scale = parameter_scales(parameters, bodies_of(parameters), base.scale, effect)
    # orthonormal in the scaled parameters, so that the conic program is well conditioned
    directions = scale[:, None] * np.linalg.qr(null / scale[:, None])[0]
    value = _move_values(identified, directions, base.scale * ~is_holdable)
    return identified if value is None else replace(identified, value=value)


def _null_space(model: Model, base: BaseParameters) -> Array:
    """Return the directions (p, p - r) that change no torque.

    They are computed from random states, without the rounding of the formulas of ``base``.
    """
    states = _random_states(model)
    # scaled, so that the units of the parameters do not matter
    rows = model.regressor(**states).reshape(-1, len(base.names)) / base.scale
    directions = np.linalg.svd(rows, full_matrices=False)[2][base.rank :].T / base.scale[:, None]
    directions[(base.null_directions == 0).all(axis=1)] = 0.0  # they have no part in any
    return np.asarray(directions)


def _random_states(model: Model) -> dict[str, Array]:
    rng = np.random.default_rng(0)
    q, dq, ddq = rng.uniform(-3, 3, (3, 200, len(model.joints)))
    return {"q": q, "dq": dq, "ddq": ddq, "memory": rng.uniform(-1, 1, (200, model.memory))}


def move_notes(identified: IdentifiedModel, best: IdentifiedModel) -> tuple[str, ...]:
    """Return notes on the parameters that ``place_values`` has moved into others."""
    pairs = zip(identified.model.parameters, identified.value, best.value, strict=True)
    vanished = [f"{x.name} ({before:.4g} {x.unit})" for x, before, after in pairs if before and not after]
    if not vanished:
        return ()
    return (f"{', '.join(vanished)}: part of other parameters in the file, as only their sums act on the torque",)


def _move_values(identified: IdentifiedModel, directions: Array, weight: Array) -> Array | None:
    """Return the values (p) moved along ``directions`` (p, v); None where the torque would change."""
    start, constraints = identified.value, _value_limits(identified)
    U, size, _ = np.linalg.svd(weight[:, None] * directions, full_matrices=False)
    # singular values at rounding level would count directions that have no effect
    effect = np.linalg.norm(U[:, size > MIN_RELATIVE_EFFECT * size[0]].T @ (weight * start))
    if not effect:
        return None
    weight = weight / effect
    slopes, remaining = weight[:, None] * directions, weight * start
    movable = np.linalg.norm(slopes, axis=1) > MIN_RELATIVE_EFFECT * np.linalg.norm(slopes)

    def smallest_change(rows: Array, *equalities: Limit) -> Array:
        """Return the smallest change that minimises some rows under equalities."""
        # regularised, as directions without effect on the rows would leave it singular
        quadratic = rows.T @ rows + REGULARISATION * np.eye(rows.shape[1])
        size = np.diag(quadratic).max()
        within = replace(constraints, limits=(*constraints.limits, *equalities))
        return minimise(quadratic / size, rows.T @ remaining / size, within, start, directions).point

    # set as many small parameters to exactly zero as the constraints allow, from the boldest choice to none
    for share in ZERO_SHARES:
        try:
            vanishing = np.flatnonzero(movable & (np.abs(remaining + slopes @ smallest_change(slopes)) < share))
            labels, zeros = ("nothing left",) * len(vanishing), np.zeros((2, len(vanishing)))
            zero_limit = Limit("nothing left", labels, np.diag(weight)[vanishing], *zeros)
            is_other = movable & ~np.isin(np.arange(len(remaining)), vanishing)
            other_slopes = np.where(is_other, 1.0, 0.0)[:, None] * slopes
            # solve again with these at zero, minimising the others only
            coefficients = smallest_change(other_slopes, zero_limit)
        except (ConfigError, ModelError):  # not all of them can be nothing, or the solver has no answer
            continue
        # the conic solver is exact to its tolerance only: a least-squares step makes the zeros exact
        inverse = np.linalg.pinv(slopes[vanishing], rcond=MIN_RELATIVE_EFFECT)
        coefficients = coefficients - inverse @ (remaining + slopes @ coefficients)[vanishing]
        value = start + directions @ coefficients
        # rounding of the step is set to exactly zero, which notes and files then omit
        value[vanishing] = np.where(np.abs(weight * value)[vanishing] < MAX_TORQUE_ROUNDING, 0.0, value[vanishing])
        if _is_equivalent(identified, value):
            return value
    return None


def _value_limits(identified: IdentifiedModel) -> Constraints:
    """Return the constraints of the values: bodies keep a part of their eigenvalues, and signs stay."""
    parameters, value = identified.model.parameters, identified.value
    matrices = []
    for body in bodies_of(parameters):
        smallest = float(np.linalg.eigvalsh(body.scaled_inertia(value))[0])
        # asked for a part of the present margin only, so that the start is feasible
        matrices.append(body.psd_constraint(len(value), min(KEPT_EIGENVALUE_SHARE * smallest, MAX_EIGENVALUE_MARGIN)))
    limits = []
    for limit in sign_limits(parameters):
        is_met = limit.rows @ value >= 0
        labels = tuple(label for label, met in zip(limit.labels, is_met, strict=True) if met)
        limits.append(Limit(limit.family, labels, limit.rows[is_met], limit.lower[is_met], limit.upper[is_met]))
    return Constraints(tuple(limits), matrices=tuple(matrices))


def _is_equivalent(identified: IdentifiedModel, value: Array) -> bool:
    """Return whether values have the torque of the identified ones, and physically consistent bodies."""
    model = identified.model
    states = _random_states(model)
    torque, moved_torque = model.torque(**states, theta=identified.value), model.torque(**states, theta=value)
    has_same_torque = bool(np.linalg.norm(moved_torque - torque) <= MAX_TORQUE_ROUNDING * np.linalg.norm(torque))
    _, bodies = replace(identified, value=value).bodies
    rows = np.concatenate([limit.rows for limit in sign_limits(model.parameters)])
    nonnegative = [int(row.argmax()) for row in rows if row @ identified.value >= 0]
    has_same_signs = bool((value[nonnegative] >= 0).all())
    return has_same_torque and has_same_signs and all(smallest_eigenvalue(body) > 0 for body in bodies)
