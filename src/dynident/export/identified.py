"""The content of exports: a model with identified values, the drives of its joints, and the inertias of its links."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ModelError, brief
from dynident.models import (
    Coulomb,
    HasMemory,
    Model,
    PerJoint,
    RigidBodies,
    RotorInertia,
    Term,
    Viscous,
    consistency_violations,
    from_pseudo,
    moved,
    smallest_eigenvalue,
    to_pseudo,
)
from dynident.models.friction import RemembersLoad
from dynident.models.robot_file import ArmBody

__all__ = ["Drives", "Identified", "Shares", "drives", "holdable", "link_inertias"]

Array = NDArray[np.float64]
ADVICE = "identify with `estimator: {kind: consistent}` to avoid this; parameters.yaml and model.py hold any values"
ALL = 0.999  # the fixed links keep their nominal inertias up to this share of the largest consistent one


@dataclass(frozen=True, eq=False)
class Identified:
    """A model and the values (p) of its parameters; ``std`` (p) and ``verdict`` (p) where they are known."""

    model: Model
    value: Array
    std: Array | None = None
    verdict: tuple[str, ...] = ()

    __repr__ = brief

    @property
    def parts(self) -> Iterator[tuple[Term, Array]]:
        """Each term with its own values."""
        start = 0
        for term in self.model.terms:
            stop = start + len(term.parameters)
            yield term, self.value[start:stop]
            start = stop

    @property
    def memoryless(self) -> Identified:
        """The model without the terms that remember more than the load: its torque depends on q, dq and ddq of one
        sample alone."""
        kept = [(term, values) for term, values in self.parts if not remembers(term)]
        model = replace(self.model, terms=tuple(term for term, _ in kept))
        return Identified(model, np.concatenate([values for _, values in kept]))

    @property
    def robot(self) -> RigidBodies | None:
        """The bodies of a robot file; robot files hold them as this term has them, and no others."""
        return next((term for term in self.model.terms if isinstance(term, RigidBodies)), None)

    @property
    def bodies(self) -> tuple[RigidBodies, Array]:
        """The rigid bodies and their parameters (n, 10); ModelError where the model does not come from a robot file."""
        if (robot := self.robot) is not None:
            return robot, next(values for term, values in self.parts if term is robot).reshape(-1, 10)
        raise ModelError(f"{self.model.name}: this model does not come from a robot file, so there is none to write.")


def remembers(term: Term) -> bool:
    """Return whether the torque of a term depends on more than a sample, or has no formula in it and the load."""
    return isinstance(term, HasMemory) and not (isinstance(term, RemembersLoad) and term.formula())


@dataclass(frozen=True, eq=False)
class Drives:
    """The joint attributes of a robot file: damping (N m s/rad), friction (N m), armature (kg m^2), or for sliding.

    ``left_out`` describes the parameters that no attribute holds; ``notes`` the values that the file keeps.
    """

    damping: Mapping[str, float] = field(default_factory=dict)
    friction: Mapping[str, float] = field(default_factory=dict)
    armature: Mapping[str, float] = field(default_factory=dict)
    left_out: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def torque(self, joints: tuple[str, ...], dq: Array, ddq: Array) -> Array:
        """Return damping dq + friction sign(dq) + armature ddq, shape (N, n)."""
        damping, friction, armature = (
            np.array([values.get(name, 0.0) for name in joints])
            for values in (self.damping, self.friction, self.armature)
        )
        return np.asarray(damping * dq + friction * np.sign(dq) + armature * ddq)


def drives(identified: Identified, *, armature: bool) -> Drives:
    """Return the part of the other terms that a robot file can hold; ``armature``: whether it can hold rotor inertia.
    A value that is not identified is the file's own.

    Raises ModelError for a negative value, which simulators reject.
    """
    bodies, _ = identified.bodies
    kinds = _kinds(armature)
    found: dict[str, dict[str, float]] = {name: {} for name in kinds.values()}
    left_out: list[str] = []
    for term, values in identified.parts:
        if term is bodies:
            continue
        if not isinstance(term, PerJoint) or type(term) not in kinds:
            left_out += worded(term, values)
            continue
        _add(found[kinds[type(term)]], term, values)
        left_out += _rules(term)
    nominal: dict[str, dict[str, float]] = {name: getattr(bodies, name) for name in found}
    followers = _followers(bodies, found)
    held = {name: {**nominal[name], **found[name], **dict.fromkeys(followers[name], 0.0)} for name in found}
    notes = (*_kept(nominal, found), *_freed(followers))
    return Drives(held["damping"], held["friction"], held.get("armature", {}), tuple(left_out), notes)


def holdable(identified: Identified, *, armature: bool) -> NDArray[np.bool_]:
    """Return which parameters (p) a robot file can hold; ``armature``: whether it can hold rotor inertia."""
    robot, kinds = identified.robot, _kinds(armature)
    held = [
        np.full(len(values), term is robot or (isinstance(term, PerJoint) and type(term) in kinds))
        for term, values in identified.parts
    ]
    return np.concatenate(held)


def _kinds(armature: bool) -> dict[type[Term], str]:
    """Return the attributes that hold terms, by type: another term of the same role need not be such a torque."""
    kinds: dict[type[Term], str] = {Viscous: "damping", Coulomb: "friction"}
    return kinds | ({RotorInertia: "armature"} if armature else {})


def _add(sums: dict[str, float], term: PerJoint, values: Array) -> None:
    """Add a term's values to those of its joints; ModelError where one is negative."""
    for parameter, joint, value in zip(term.parameters, term.on or _names(term), values.tolist(), strict=True):
        if value < 0:
            raise ModelError(f"{parameter.name} is {value:.4g} {parameter.unit}, below zero; {ADVICE}.")
        sums[joint] = sums.get(joint, 0.0) + value


def _rules(term: Term) -> Iterator[str]:
    """Return a note on the sign in friction, where the file cannot hold it."""
    if not isinstance(term, Coulomb):
        return
    rules = [term.rule(joint) for joint in term.acts_on]
    for width, band in dict.fromkeys(rules):
        if width or band:
            rule = f"by tanh over {width:.3g}" if width else f"zero up to {band:.3g}"
            where = [repr(joint) for joint, one in zip(term.acts_on, rules, strict=True) if one == (width, band)]
            of = "" if len(where) == len(rules) else f" of {', '.join(where)}"
            yield f"how Coulomb friction{of} changes its sign: {rule} rad/s or m/s; the file's friction jumps"


def _kept(nominal: Mapping[str, Mapping[str, float]], found: Mapping[str, Mapping[str, float]]) -> Iterator[str]:
    """Return notes on the values that are the file's own."""
    for name, values in nominal.items():
        for joint, value in values.items():
            if value and joint not in found[name]:
                yield f"{name} {value:g} of joint {joint!r} is the file's own; it was not identified"


def _followers(bodies: RigidBodies, names: Iterable[str]) -> dict[str, list[str]]:
    """Return by name of the attribute the mimic joints for which the file gives one."""
    own = {joint.name for joint in bodies.joints}
    follow = [body.joint for body in bodies.arm.bodies if body.joint.name not in own]
    return {name: [joint.name for joint in follow if joint.nominal.get(name)] for name in names}


def _freed(followers: Mapping[str, Sequence[str]]) -> Iterator[str]:
    for name, joints in followers.items():
        if joints:
            yield f"{name} of {', '.join(map(repr, joints))} is set to 0, as the joint that they follow has it"


def _names(term: Term) -> tuple[str, ...]:
    return tuple(joint.name for joint in term.joints)


def worded(term: Term, values: Array) -> Iterator[str]:
    """Yield what is left out with a term."""
    for parameter, value in zip(term.parameters, values, strict=True):
        if value:
            yield f"{parameter.name} = {value:.6g} {parameter.unit} ({parameter.expression})"


@dataclass(frozen=True, eq=False)
class Shares:
    """The identified bodies divided among the links of the file: by link, its parameters (10) in its own frame, None
    for a link that loses its inertia; unchanged links are not listed. ``notes`` give the reasons.
    """

    links: Mapping[str, Array | None]
    notes: tuple[str, ...] = ()


def link_inertias(bodies: RigidBodies, values: Array) -> Shares:
    """Divide the parameters (n, 10) of the bodies among their links; the sums are exact.

    The other links of a body keep the inertias of the file, and its first link gets the rest. Where that rest would not
    be physically consistent, the others keep a share that leaves half of the body along the tightest direction. Raises
    ModelError for a body whose pseudo-inertia is not positive definite.
    """
    links: dict[str, Array | None] = {}
    notes: list[str] = []
    for body, theta in zip(bodies.arm.chosen, values, strict=True):
        _require_physical(body.name, theta)
        others = _others(bodies, body)
        share = _share(theta, others)
        rest = theta.copy()
        for link, (nominal, frame) in others.items():
            if nominal is None:
                links[link] = None
                continue
            rest -= share * moved(nominal, frame)
            if share < 1 and nominal.any():
                links[link] = share * nominal if share else None
        links[body.name] = from_pseudo(to_pseudo(moved(rest, np.linalg.inv(body.frames[0]))))
        notes += _shared_words(body, share, others)
    return Shares(links, tuple(notes))


def _require_physical(name: str, theta: Array) -> None:
    if smallest_eigenvalue(theta) <= 0:
        why = "; ".join(consistency_violations(theta)) or "its pseudo-inertia is singular"
        raise ModelError(f"body {name!r} is not physically consistent: {why}; {ADVICE}.")


def _others(bodies: RigidBodies, body: ArmBody) -> dict[str, tuple[Array | None, Array]]:
    """Return by link, but for the first: its nominal parameters in its own frame, and its frame in the body's."""
    return {link: (bodies.file.links[link], frame) for link, frame in zip(body.links[1:], body.frames[1:], strict=True)}


def _share(theta: Array, others: Mapping[str, tuple[Array | None, Array]]) -> float:
    """Return t so that theta - t (sum of the others) is consistent; 0 where one of the others is not."""
    from scipy.linalg import eigh

    known = [moved(nominal, frame) for nominal, frame in others.values() if nominal is not None and nominal.any()]
    if not known:
        return 1.0
    if any(consistency_violations(nominal) for nominal in known):
        return 0.0
    largest = float(eigh(to_pseudo(sum(known, np.zeros(10))), to_pseudo(theta), eigvals_only=True)[-1])
    return 1.0 if largest <= ALL else 0.5 / largest


def _shared_words(body: ArmBody, share: float, others: Mapping[str, tuple[Array | None, Array]]) -> Iterator[str]:
    for link, (nominal, _) in others.items():
        if nominal is None:
            yield f"link {link!r}: its inertia follows from meshes; now it is part of {body.name!r}"
    weighty = [link for link, (nominal, _) in others.items() if nominal is not None and nominal.any()]
    if weighty and share < 1:
        kept = f"{100 * share:.3g} % of their inertias" if share else "no inertia"
        yield (
            f"body {body.name!r}: the inertias that the file gives {', '.join(map(repr, weighty))} do not fit "
            f"into the identified body; they keep {kept}, and {body.name!r} has the rest"
        )
