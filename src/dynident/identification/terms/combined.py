"""Terms on single joints, combined to one term of each class on several joints, with its settings by joint."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from dynident.models import Joint, JointTerm, Term

__all__ = ["combined"]


def combined(joints: tuple[Joint, ...], terms: Sequence[Sequence[Term]]) -> tuple[Term, ...]:
    """Return the terms of each joint as one term per class, in the order in which the classes come first.

    Several of one class on a joint, such as ripples, are one with all of their constants, unless one that must be a
    single number, such as a delay, differs. What is not a ``JointTerm`` stays as it is.
    """
    classes: dict[type[JointTerm], list[list[JointTerm]]] = {}
    alone: list[Term] = []
    for one in (term for some in terms for term in some):
        if isinstance(one, JointTerm):
            some = classes.setdefault(type(one), [])
            place = next((same for same in some if all(_agree(one, other) for other in same)), None)
            some.append([one]) if place is None else place.append(one)
        elif one not in alone:  # one on several joints is chosen at each of them
            alone.append(one)
    return (*(_together(joints, cls, same) for cls, some in classes.items() for same in some), *alone)


def _agree(one: JointTerm, other: JointTerm) -> bool:
    """Whether two terms on single joints are on different ones, or differ in constants alone that can be several."""
    (joint,) = one.acts_on
    if other.acts_on != one.acts_on:
        return True
    pairs = ((one.constant(name, joint), other.constant(name, joint)) for name in one.constants)
    return all(x == y or isinstance(x, tuple) for x, y in pairs)


def _together(joints: tuple[Joint, ...], cls: type[JointTerm], terms: Sequence[JointTerm]) -> Term:
    on = tuple(dict.fromkeys(name for term in terms for name in term.acts_on))
    settings: dict[str, Any] = {}
    for name in cls.constants:
        by_joint = {joint: [one.constant(name, joint) for one in terms if joint in one.acts_on] for joint in on}
        settings[name] = {joint: _several(values) for joint, values in by_joint.items()}
    return cls(joints, on=on, **settings)


def _several(values: Sequence[Any]) -> Any:
    if len(values) == 1 or not isinstance(values[0], tuple):
        return values[0]
    return tuple(one for value in values for one in value)
