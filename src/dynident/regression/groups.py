"""What of a robot can change by itself, as directions of its base parameters."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief
from dynident.models import (
    Counterbalance,
    CoupledFriction,
    CoupledMotor,
    Drift,
    JointTerm,
    Model,
    Offset,
    Parameter,
    Ripple,
    RotorInertia,
    Spring,
    Term,
)
from dynident.regression.base_parameters import BaseParameters

__all__ = ["Group", "GroupKind", "groups_of", "independent_columns", "kinds_of"]

Array = NDArray[np.float64]
LASTING = (RotorInertia, Spring, Counterbalance, Drift)  # terms of joints that are no friction
DISTINCT = 1e-6  # of a direction of unit length: what is left of it beside those before


class GroupKind(StrEnum):
    """What of a robot can change: friction of a joint, what the last body carries, an offset of a sensor, a ripple of
    a gear, the residual of a joint: torque that the model leaves, whatever its cause."""

    FRICTION = "friction"
    PAYLOAD = "payload"
    OFFSET = "offset"
    RIPPLE = "ripple"
    RESIDUAL = "residual"


@dataclass(frozen=True, eq=False)
class Group:
    """One thing that can change by itself: the ``directions`` (b, k) in which it moves the base parameters.

    ``joint`` is the joint whose friction, offset or ripple it is, of a payload the joint that moves its body;
    ``names`` (k) say what the directions are, with ``units`` (k). Of a residual the directions (n, 1) are of the
    logarithms of the residuals of n joints, so that a size is the logarithm of a factor.
    """

    kind: GroupKind
    joint: str
    directions: Array
    names: tuple[str, ...]
    units: tuple[str, ...]

    __repr__ = brief


def groups_of(model: Model, basis: BaseParameters) -> tuple[Group, ...]:
    """Return friction, offset and ripple of each joint or coupled motor, and the payload of each last body.

    ``basis`` are base parameters of the model. The directions of a group are independent columns of their map, those of
    its parameters: what has no effect, or the same as those before, is left out. A group without any is left out.
    """
    found: dict[tuple[GroupKind, str], list[int]] = {}
    for k, (kind, joint) in enumerate(_places(model)):
        if kind is not None:
            found.setdefault((kind, joint), []).append(k)
    for joint, columns in _payloads(model):
        found.setdefault((GroupKind.PAYLOAD, joint), []).extend(columns)
    order = list(GroupKind)
    ordered = sorted(found.items(), key=lambda item: order.index(item[0][0]))
    groups = (_group(model, basis, kind, joint, columns) for (kind, joint), columns in ordered)
    return tuple(group for group in groups if group.names)


def kinds_of(model: Model) -> tuple[GroupKind | None, ...]:
    """Return what each of the p parameters belongs to: as ``groups_of``, None for bodies before the last and rotors."""
    kinds = [kind for kind, _ in _places(model)]
    for _, columns in _payloads(model):
        for k in columns:
            kinds[k] = GroupKind.PAYLOAD
    return tuple(kinds)


def _places(model: Model) -> Iterator[tuple[GroupKind | None, str]]:
    """Yield for each parameter what it belongs to, and the name of its joint or motor; bodies to nothing."""
    for term in model.terms:
        for k, parameter in enumerate(term.parameters):
            yield _kind(term, parameter), _joint(term, k)


def _kind(term: Term, parameter: Parameter) -> GroupKind | None:
    if isinstance(term, Offset):
        return GroupKind.OFFSET
    if isinstance(term, Ripple):
        return GroupKind.RIPPLE
    if isinstance(term, CoupledMotor):
        return {"rotor": None, "": GroupKind.OFFSET}.get(parameter.role, GroupKind.FRICTION)
    rubs = isinstance(term, JointTerm | CoupledFriction) and not isinstance(term, LASTING)
    return GroupKind.FRICTION if rubs or parameter.role in ("viscous", "coulomb") else None


def _joint(term: Term, parameter: int) -> str:
    """Return the name of the motor, or of the joint, that a parameter of single joints acts on."""
    if isinstance(term, CoupledMotor | CoupledFriction):
        return term.name
    return term.joints[int(np.argmax(Model((term,)).support[:, parameter]))].name


def _payloads(model: Model) -> Iterator[tuple[str, list[int]]]:
    """Yield the joint that moves it and the parameters of each body that carries no other: its weight is on more
    joints than that of any body beside it."""
    bodies: dict[str, list[int]] = {}
    for k, parameter in enumerate(model.parameters):
        if parameter.body:
            bodies.setdefault(parameter.body, []).append(k)
    felt = {body: frozenset(np.flatnonzero(model.support[:, columns].any(axis=1))) for body, columns in bodies.items()}
    for body, columns in bodies.items():
        if felt[body] and not any(felt[body] < other for other in felt.values()):
            carriers = {joint: sum(joint in other for other in felt.values()) for joint in felt[body]}
            last = min(carriers, key=lambda joint: (carriers[joint], -joint))
            yield model.joints[last].name, columns


def _group(model: Model, basis: BaseParameters, kind: GroupKind, joint: str, columns: Sequence[int]) -> Group:
    sizes = basis.scale[list(basis.independent), None] * basis.combination[:, columns]  # free of units
    kept = [columns[k] for k in independent_columns(sizes)]
    parameters = [model.parameters[k] for k in kept]
    names, units = tuple(one.name for one in parameters), tuple(one.unit for one in parameters)
    return Group(kind, joint, basis.combination[:, kept], names, units)


def independent_columns(columns: Array) -> list[int]:
    """Return the columns that are independent of those before."""
    kept, basis = list[int](), np.zeros((len(columns), 0))
    for k, column in enumerate(columns.T):
        if not (length := np.linalg.norm(column)):
            continue
        rest = column / length
        for _ in range(2):  # the second pass removes what rounding left
            rest = rest - basis @ (basis.T @ rest)
        if (size := np.linalg.norm(rest)) > DISTINCT:
            kept.append(k)
            basis = np.column_stack([basis, rest / size])
    return kept
