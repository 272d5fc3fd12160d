"""The geometry that a model takes for known: zeros of the joints, and origins and axes of their frames."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dynident.checks import robot_notes
from dynident.checks.case import Case
from dynident.checks.finding import Topic
from dynident.checks.misfit import Misfit
from dynident.checks.suspect import Others, Suspect
from dynident.models import HasGeometry, Joint, Model
from dynident.models.robot_file import RobotJoint

__all__ = ["displaced", "geometry_suspects"]

Array = NDArray[np.float64]
STEP = 1e-5  # rad or m, of the differences
ANGLE, LENGTH = 0.6, 0.6  # rad, m: errors beyond are no small ones
ZERO, ORIGIN, NEW_ORIGIN, AXIS = 0, 2, 3, 4  # orders: the likeliest fault first


def geometry_suspects(model: Model) -> list[Suspect]:
    """Return the zero of each joint and, where a term has frames, the components of their origins and axes."""
    found = [_zero(j, joint) for j, joint in enumerate(model.joints)]
    for term in model.terms:
        if isinstance(term, HasGeometry):
            frames = {joint.name: joint for joint in term.file.joints}
            for joint in model.joints:
                if joint.name in frames:
                    found += [_origin(frames[joint.name], k) for k in range(3)]
                    across = _across(frames[joint.name].axis)
                    found += [_axis(frames[joint.name], one, alone) for one in across for alone in (False, True)]
    return found


def displaced(model: Model, joint: str, by: Array) -> Model:
    """Return the model with the frame of a joint displaced, as ``HasGeometry`` says."""
    move = tuple(map(float, by))
    terms = [term.with_displacement(joint, move) if isinstance(term, HasGeometry) else term for term in model.terms]
    return replace(model, terms=tuple(terms))


def _zero(j: int, joint: Joint) -> Suspect:
    def corrected(case: Case, value: float) -> Case:
        q = case.q.copy()
        q[:, j] += value
        return replace(case, q=q)

    limit = ANGLE if joint.kind == "revolute" else LENGTH
    return Suspect(joint.name, Topic.ZERO, _slope(corrected), corrected, robot_notes.ZeroOff, limit, ZERO)


def _origin(joint: RobotJoint, k: int) -> Suspect:
    by, given = np.eye(9)[k], float(joint.placement[k, 3])

    def corrected(case: Case, value: float) -> Case:
        return replace(case, model=displaced(case.model, joint.name, value * by))

    def note(value: float, std: float, share: float, others: Others) -> robot_notes.WrongValue:
        return robot_notes.LengthWrong("xyz"[k], given, given + value, std, share, others)

    order = ORIGIN if abs(given) > STEP else NEW_ORIGIN
    return Suspect(joint.name, Topic.LENGTH, _slope(corrected), corrected, note, LENGTH, order)


def _axis(joint: RobotJoint, across: Array, alone: bool) -> Suspect:
    by = np.concatenate([np.zeros(6), across]) if alone else np.concatenate([np.zeros(3), across, np.zeros(3)])

    def corrected(case: Case, value: float) -> Case:
        return replace(case, model=displaced(case.model, joint.name, value * by))

    def note(value: float, std: float, share: float, others: Others) -> robot_notes.WrongValue:
        return robot_notes.AxisTilted(tuple(np.round(across, 6).tolist()), value, alone, std, share, others)

    return Suspect(joint.name, Topic.AXIS, _slope(corrected), corrected, note, ANGLE, AXIS)


def _across(axis: Array) -> Array:
    """Return two unit vectors (2, 3) across an axis, coordinate axes where it is one."""
    first = np.eye(3)[int(np.argmin(np.abs(axis)))]
    one = first - (first @ axis) * axis
    one /= np.linalg.norm(one)
    return np.array([one, np.cross(axis, one)])


def _slope(corrected: Callable[[Case, float], Case]) -> Callable[[Misfit], Array]:
    """Return the derivative of the torque at the fitted parameters, by a difference."""

    def derivative(fit: Misfit) -> Array:
        return np.asarray((corrected(fit.case, STEP).torque(fit.theta) - fit.torque) / STEP)

    return derivative
