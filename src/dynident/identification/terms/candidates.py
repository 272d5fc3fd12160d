"""The kinds of terms that are tried on a joint: one line each, from the simplest on."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from enum import Enum
from functools import partial
from typing import Any, Protocol, runtime_checkable

import numpy as np

from dynident.models import Joint, RotorInertia, Term
from dynident.models.friction import (
    AsymmetricViscous,
    Coulomb,
    Dahl,
    Drift,
    JointTerm,
    LoadCoulomb,
    LoadDahl,
    LoadViscous,
    Offset,
    Power,
    Spring,
    Stribeck,
    Viscous,
    WideCoulomb,
)
from dynident.runtime import InputError, Note, Noun, Severity, brief
from dynident.runtime.families import TERMS

WIDTHS = tuple((0.005 * 1.25 ** np.arange(21)).tolist())  # of the rms speed; others make up for coarser ones
# likewise: beside the sign, over which friction still rises
WIDE_WIDTHS = tuple((0.1 * 1.25 ** np.arange(12)).tolist())
LENGTHS = tuple((1e-4 * 1.25 ** np.arange(28)).tolist())  # of the reach
EXPONENTS = (0.3, 0.5, 0.7, 1.5, 2.0, 3.0)
MIN_DRIFT_DURATION = 18.0  # s: of a recording that could show that friction changes as a robot warms up
# of the rms speed: width of the sign and velocity of Stribeck friction; where the sign rises slower, so does Coulomb's
STRIBECK_SIZES = tuple(
    (width, velocity)
    for width in (0.0, 0.01, 0.02, 0.03, 0.045)
    for velocity in (0.02, 0.03, 0.045, 0.07, 0.1, 0.14, 0.2, 0.3, 0.5)
    if velocity >= 4.0 * width
)


@dataclass(frozen=True)
class JointExcitation:
    """The excitation of a ``joint``, one of ``joints``, in the training.

    ``speed`` is its rms speed (rad/s, m/s), ``reach`` the range in which it moves (rad, m), ``duration`` (s) that
    of the longest recording.
    """

    joints: tuple[Joint, ...]
    joint: Joint
    speed: float
    reach: float
    duration: float


@runtime_checkable
class Proposes(Protocol):
    """A class of terms that says how it is tried on a joint."""

    @classmethod
    def proposed(cls, excitation: Any, /) -> Sequence[Term]:
        """Return the term on the joint of the ``JointExcitation`` alone, in all sizes that are to be tried."""


@dataclass(frozen=True)
class CandidateKind:
    """A ``name`` and the ``sizes`` of a term on one joint, which count as one trial.

    A ``strict`` kind needs ``MIN_STRICT_GAIN_ERRORS``. One that is ``presumed`` belongs to the plain set: it stays
    unless it is seen to do nothing. A ``dry`` one is friction with the sign of the motion: another of these ends the
    presumption. One that ``reaches`` must hold further out than it was fitted, and is not tried where its
    ``needs_load`` cannot be met.
    """

    name: str
    sizes: Callable[[JointExcitation], Sequence[Term]]
    strict: bool = False
    presumed: bool = False
    dry: bool = False
    reaches: bool = False
    needs_load: bool = False


def kind_of_class(name: str, term_class: type[Proposes]) -> CandidateKind:
    """Return the kind of a class of terms that proposes its own sizes, such as a user's: a strict one."""
    return CandidateKind(
        name, term_class.proposed, strict=True, needs_load=bool(getattr(term_class, "needs_load", False))
    )


def _alone(part: Callable[..., Term], excitation: JointExcitation, **settings: int) -> Sequence[Term]:
    """Return a term without constants to be tried on the joint."""
    return (part(excitation.joints, on=(excitation.joint.name,), **settings),)


def _sized_terms(
    part: Callable[..., Term], name: str, scale: str, shares: Sequence[float], excitation: JointExcitation
) -> Sequence[Term]:
    """Return a term in several sizes: its constant ``name`` in ``shares`` of a ``scale`` of the excitation, if any."""
    on, size = (excitation.joint.name,), float(getattr(excitation, scale)) if scale else 1.0
    return tuple(part(excitation.joints, on=on, **{name: share * size}) for share in shares)


def _stribeck_terms(excitation: JointExcitation) -> Sequence[Term]:
    on, speed = (excitation.joint.name,), excitation.speed
    return tuple(
        Stribeck(excitation.joints, on=on, width=width * speed, velocity=velocity * speed)
        for width, velocity in STRIBECK_SIZES
    )


def _drift_terms(excitation: JointExcitation) -> Sequence[Term]:
    if excitation.duration < MIN_DRIFT_DURATION:
        return ()
    return _sized_terms(Drift, "time", "duration", (0.3, 1.0, 3.0), excitation)


def fixed_terms(terms: tuple[Term, ...], _: JointExcitation) -> tuple[Term, ...]:
    """Return the terms whatever the excitation."""
    return terms


class TermGroup(Noun):
    """A ``kind`` with its sizes: the ``terms`` on one joint, and the indices ``at`` of the columns of each."""

    kind: CandidateKind
    terms: tuple[Term, ...]
    at: tuple[tuple[int, ...], ...]


KINDS = (
    CandidateKind("offset", partial(_alone, Offset), presumed=True),
    CandidateKind("viscous", partial(_alone, Viscous), presumed=True),
    CandidateKind("coulomb", partial(_sized_terms, Coulomb, "width", "speed", (0.0, *WIDTHS)), presumed=True, dry=True),
    CandidateKind("rotor", partial(_alone, RotorInertia), presumed=True),
    CandidateKind(
        "load_coulomb",
        partial(_sized_terms, LoadCoulomb, "width", "speed", (0.0, *WIDTHS)),
        dry=True,
        needs_load=True,
    ),
    CandidateKind("load_viscous", partial(_alone, LoadViscous), needs_load=True),
    CandidateKind("stribeck", _stribeck_terms),
    CandidateKind("asymmetric_viscous", partial(_alone, AsymmetricViscous)),
    CandidateKind("dahl", partial(_sized_terms, Dahl, "length", "reach", LENGTHS), dry=True),
    CandidateKind("load_dahl", partial(_sized_terms, LoadDahl, "length", "reach", LENGTHS), dry=True, needs_load=True),
    CandidateKind("power", partial(_sized_terms, Power, "exponent", "", EXPONENTS), strict=True),
    CandidateKind("wide_coulomb", partial(_sized_terms, WideCoulomb, "width", "speed", WIDE_WIDTHS), strict=True),
    CandidateKind("spring", partial(_alone, Spring, order=1), strict=True, reaches=True),
    CandidateKind("spring", partial(_alone, Spring, order=2), strict=True, reaches=True),
    CandidateKind("drift", _drift_terms, strict=True),
)
PLAIN_KINDS = ("offset", "rotor", "viscous", "coulomb")


def library_kinds() -> tuple[CandidateKind, ...]:
    """Return the kinds that are tried, and after these the terms of ``TERMS`` that say themselves how they are."""
    terms = ((kind, TERMS.get(kind)) for kind in TERMS.table)
    return (*KINDS, *(kind_of_class(kind, term) for kind, term in terms if hasattr(term, "proposed")))


class TrialOutcome(Enum):
    """What became of a trial."""

    ENTERED = "entered"
    TOO_SMALL = "too small"  # the gain is less than the least share
    WITHIN_ERROR = "within error"  # less than ``MIN_GAIN_ERRORS`` of its standard errors, or ``MIN_STRICT_GAIN_ERRORS``
    REFUTED_FASTER = "refuted by faster motion"
    REFUTED_FURTHER = "refuted further out"
    REFUTED_BY_LOG = "refuted by another recording"
    NEGATIVE = "negative"  # a coefficient that physics does not let be negative
    NOT_EXCITED = "not excited"
    REDUNDANT = "redundant"  # it had entered, and others made it needless
    KEPT = "kept"  # friction of a joint that moves one way only, which cannot be told from an offset


class TooFewSamplesError(InputError):
    """There are too few samples to choose the terms by."""


class PlainTerms(Note):
    """The terms are the plain set: there are too few samples to choose others by."""

    severity = Severity.INFO

    def __str__(self) -> str:
        return (
            "the terms of the joints are rotor inertia, viscous and Coulomb friction and offset: there are too few "
            "samples to choose others by; record longer, or name them by `terms` of the model"
        )


class NotChosen(Note):
    """Parameters that settings of the estimator name, and that the model with the terms chosen does not have."""

    names: tuple[str, ...]

    def __str__(self) -> str:
        return (
            f"the estimator's settings name {', '.join(self.names)}, which the model with the terms chosen does not "
            "have; what they say of these is ignored. Name the terms by `terms` of the model to have them"
        )


Setting = int | float | str | bool | tuple[int | float | str, ...] | None


def settings_of(term: Term) -> tuple[tuple[str, Setting], ...]:
    """Return the constants of a term by name."""
    if isinstance(term, JointTerm):
        return tuple((name, term.constant(name, term.acts_on[0])) for name in term.constants)
    return tuple(getattr(term, "settings", ()))


@dataclass(frozen=True)
class TermTrial:
    """A ``kind`` of term that was tried on one ``joint``, with its best ``settings``, beside all others chosen for it.

    ``gain`` is what it removes of the squared cross-validated error of the joint (%), with its standard error ``std``
    from the blocks of time. ``faster`` and ``faster_std`` are the same where the slow samples are fitted and the fast
    ones judged by; None where this was not asked.
    """

    joint: str
    kind: str
    settings: tuple[tuple[str, Setting], ...]
    gain: float
    std: float
    outcome: TrialOutcome
    faster: float | None = None
    faster_std: float | None = None


@dataclass(frozen=True)
class TermChoice:
    """The ``terms`` chosen for the joints, and all ``trials`` in the order in which they were made.

    ``before`` and ``after`` are the cross-validated errors (%) of the n ``joints`` with the plain set (offset, viscous
    and Coulomb friction) and with the terms chosen; ``min_speed`` (n), in rad/s or m/s, is the speed below which the
    samples of a joint are left out of its fit. ``load`` are the parameters of the bodies that the load was found with.
    Without trials, the terms are the plain set with rotor inertia, and the errors nan: there were too few samples.
    """

    joints: tuple[str, ...]
    terms: tuple[Term, ...]
    trials: tuple[TermTrial, ...]
    before: tuple[float, ...]
    after: tuple[float, ...]
    min_speed: tuple[float, ...]
    load: tuple[float, ...] | None = field(default=None, repr=False)

    __repr__ = brief

    @property
    def error(self) -> float:
        """The geometric mean of the joints' cross-validated errors (%) with the terms chosen, nan without trials."""
        return float(np.exp(np.mean(np.log(np.maximum(self.after, np.finfo(float).tiny)))))

    def trials_of(self, joint: str) -> tuple[TermTrial, ...]:
        """Return the trials of a joint."""
        return tuple(trial for trial in self.trials if trial.joint == joint)


def combine_terms(joints: tuple[Joint, ...], terms: Sequence[Sequence[Term]]) -> tuple[Term, ...]:
    """Return the terms of each joint as one term per class, in the order in which the classes first occur.

    Several terms of one class on a joint, such as ripples, become one with all of their constants, unless a
    constant that must be a single number, such as a delay, differs. What is not a ``JointTerm`` stays as it is.
    """
    classes: dict[type[JointTerm], list[list[JointTerm]]] = {}
    other_terms: list[Term] = []
    for joint_term in (term for groups in terms for term in groups):
        if isinstance(joint_term, JointTerm):
            groups = classes.setdefault(type(joint_term), [])
            # The first group in which every member is compatible: two ripples of different delay need two terms.
            match = next(
                (group for group in groups if all(_is_compatible(joint_term, member) for member in group)), None
            )
            groups.append([joint_term]) if match is None else match.append(joint_term)
        elif joint_term not in other_terms:  # one on several joints is chosen at each of them
            other_terms.append(joint_term)
    return (*(_combine_class(joints, cls, group) for cls, groups in classes.items() for group in groups), *other_terms)


def _is_compatible(first: JointTerm, second: JointTerm) -> bool:
    """Return whether two single-joint terms can be combined to one."""
    (joint,) = first.acts_on
    if second.acts_on != first.acts_on:
        return True
    pairs = ((first.constant(name, joint), second.constant(name, joint)) for name in first.constants)
    return all(x == y or isinstance(x, tuple) for x, y in pairs)


def _combine_class(joints: tuple[Joint, ...], cls: type[JointTerm], terms: Sequence[JointTerm]) -> Term:
    on = tuple(dict.fromkeys(name for term in terms for name in term.acts_on))
    settings: dict[str, Any] = {}
    for name in cls.constants:
        by_joint = {
            joint: [joint_term.constant(name, joint) for joint_term in terms if joint in joint_term.acts_on]
            for joint in on
        }
        settings[name] = {joint: _combine_values(values) for joint, values in by_joint.items()}
    return cls(joints, on=on, **settings)


def _combine_values(values: Sequence[Any]) -> Any:
    if len(values) == 1 or not isinstance(values[0], tuple):
        return values[0]
    return tuple(constant for value in values for constant in value)
