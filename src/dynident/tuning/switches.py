"""Which terms a model has beside its bodies: kinds that are switched on and off joint by joint."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from dynident.errors import ModelError, listed
from dynident.identification.terms.candidates import KINDS
from dynident.identification.terms.combined import combined
from dynident.models import CoupledMotor, HasMemory, JointTerm, Model, RigidBodies, Term
from dynident.tuning.offered import Offers, kind_of

__all__ = ["Switches"]


@dataclass(frozen=True, eq=False)
class Switches:
    """A ``model`` as a configuration has it, its terms included, and for each of its joints the terms on that joint
    alone by kind: its ``own``, and those ``offered`` beside them.

    What acts on several joints (bodies, coupled motors, terms of the user) is always there. ``kinds`` are the names of
    all kinds that can be switched, none where the model was not built of a robot file.
    """

    model: Model
    own: tuple[Mapping[str, tuple[Term, ...]], ...]
    offered: tuple[Mapping[str, tuple[Term, ...]], ...]

    def __repr__(self) -> str:
        kinds = listed(self.kinds, 6) or "none"
        return f"<Switches of {self.model.name!r}: kinds of terms {kinds}>"

    @classmethod
    def of(cls, model: Model, offers: Offers | None) -> Switches:
        """Return the switches of a model and what it could have besides; without offers nothing can be switched."""
        joints = model.joints
        if offers is None:
            return cls(model, ({},) * len(joints), ({},) * len(joints))
        own = tuple(_own(model, joint.name) for joint in joints)
        more = (offers.at(j) for j in range(len(joints)))
        pairs = zip(own, more, strict=True)
        return cls(model, own, tuple({kind: one for kind, one in some if kind not in had} for had, some in pairs))

    @property
    def start(self) -> tuple[tuple[str, ...], ...]:
        """The kinds of each joint that the model has."""
        return tuple(map(tuple, self.own))

    @cached_property
    def kinds(self) -> tuple[str, ...]:
        """The kinds that can be switched."""
        return tuple(dict.fromkeys(kind for one in (*self.own, *self.offered) for kind in one))

    def terms(self, chosen: tuple[tuple[str, ...], ...]) -> tuple[Term, ...]:
        """Return the terms that are switched on, and those beside the bodies that always are; coupled motors last."""
        have = [term for term in self.model.terms if not isinstance(term, RigidBodies | CoupledMotor)]
        if all(set(kinds) == set(had) for kinds, had in zip(chosen, self.start, strict=True)):
            return tuple(have)
        pieces = [
            [term for kind in _ordered(kinds, self.own[j]) for term in self._piece(j, kind)]
            for j, kinds in enumerate(chosen)
        ]
        return (*combined(self.model.joints, pieces), *(term for term in have if not isinstance(term, JointTerm)))

    def with_terms(self, chosen: tuple[tuple[str, ...], ...]) -> Model:
        """Return the model with these kinds, in the order in which a configuration builds it."""
        if not self.kinds:
            return self.model
        bodies = (term for term in self.model.terms if isinstance(term, RigidBodies))
        motors = (term for term in self.model.terms if isinstance(term, CoupledMotor))
        return replace(self.model, terms=(*bodies, *self.terms(chosen), *motors), load=None)

    @cached_property
    def superset(self) -> Model:
        """The model with all kinds on all joints, except those that remember the motion."""
        if not self.kinds:
            return self.model
        every = []
        for own, more in zip(self.own, self.offered, strict=True):
            some = {**own, **more}
            every.append(tuple(kind for kind, terms in some.items() if not any(map(_remembers, terms))))
        return self.with_terms(tuple(every))

    def _piece(self, joint: int, kind: str) -> tuple[Term, ...]:
        found = self.own[joint].get(kind) or self.offered[joint].get(kind)
        if found is None:
            raise ModelError(f"{self.model.joints[joint].name}: there is no term of kind {kind!r}.")
        return found


def _remembers(term: Term) -> bool:
    return isinstance(term, HasMemory)


def _ordered(kinds: Sequence[str], own: Mapping[str, object]) -> list[str]:
    """Return kinds in one order, whichever they were switched on in: the joint's own first."""
    known = [*own, *(one.name for one in KINDS)]
    return sorted(set(kinds), key=lambda kind: known.index(kind) if kind in known else len(known))


def _own(model: Model, joint: str) -> dict[str, tuple[Term, ...]]:
    """Return the terms of a model on a joint alone, by kind."""
    found: dict[str, tuple[Term, ...]] = {}
    for term in model.terms:
        if isinstance(term, JointTerm) and joint in term.acts_on:
            found[kind_of(term)] = (*found.get(kind_of(term), ()), term.alone(joint))
    return found
