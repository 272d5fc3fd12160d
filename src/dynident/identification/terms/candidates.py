"""The kinds of terms that are tried on a joint: one line each, from the simplest on."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from enum import Enum
from functools import partial
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

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
VELOCITIES = (0.1, 0.14, 0.2, 0.3, 0.5)  # likewise; a smaller one is a width
LENGTHS = tuple((1e-4 * 1.25 ** np.arange(28)).tolist())  # of the reach
EXPONENTS = (0.3, 0.5, 0.7, 1.5, 2.0, 3.0)
MIN_DRIFT_DURATION = 18.0  # s: of a recording that could show that friction changes as a robot warms up
STRIBECK_WIDTHS = (0.01, 0.02, 0.03, 0.045)  # of the rms speed: widths of the sign of Stribeck friction


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


def _alone(part: Callable[..., Term], excitation: JointExcitation) -> Sequence[Term]:
    """Return a term without constants on the joint."""
    return (part(excitation.joints, on=(excitation.joint.name,)),)


def _sized_terms(
    part: Callable[..., Term], name: str, scale: str, shares: Sequence[float], excitation: JointExcitation
) -> Sequence[Term]:
    """Return a term in several sizes: its constant ``name`` is a share of the quantity ``scale`` of the excitation."""
    on, size = (excitation.joint.name,), float(getattr(excitation, scale))
    return tuple(part(excitation.joints, on=on, **{name: share * size}) for share in shares)


def _stribeck_terms(excitation: JointExcitation) -> Sequence[Term]:
    return tuple(
        term
        for width in STRIBECK_WIDTHS
        for term in _sized_terms(
            partial(Stribeck, width=width * excitation.speed), "velocity", "speed", VELOCITIES, excitation
        )
    )


def _power_terms(excitation: JointExcitation) -> Sequence[Term]:
    return tuple(Power(excitation.joints, on=(excitation.joint.name,), exponent=exponent) for exponent in EXPONENTS)


def _drift_terms(excitation: JointExcitation) -> Sequence[Term]:
    if excitation.duration < MIN_DRIFT_DURATION:
        return ()
    return _sized_terms(Drift, "time", "duration", (0.3, 1.0, 3.0), excitation)


def _spring_terms(order: int, excitation: JointExcitation) -> Sequence[Term]:
    return (Spring(excitation.joints, on=(excitation.joint.name,), order=order),)


def fixed_terms(terms: tuple[Term, ...], _: JointExcitation) -> tuple[Term, ...]:
    """Return the terms whatever the excitation."""
    return terms


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
    CandidateKind("power", _power_terms, strict=True),
    CandidateKind("wide_coulomb", partial(_sized_terms, WideCoulomb, "width", "speed", WIDE_WIDTHS), strict=True),
    CandidateKind("spring", partial(_spring_terms, 1), strict=True, reaches=True),
    CandidateKind("spring", partial(_spring_terms, 2), strict=True, reaches=True),
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


Array = NDArray[np.float64]
Line = tuple[float, float]
# 1/rad, rad/m, and periods within the reach: slower waves are springs, or errors of the bodies
MIN_RATE, MIN_PERIODS = 4.0, 4.0
MAX_RATE = 600.0  # 1/rad, rad/m
POINTS_PER_RATE = 4  # points of the periodogram per resolved rate
DELAYS = 1e-3 * np.arange(-12.0, 13.0, 2.0)  # s
# of a resolved rate; s: the search around
RATE_OFFSETS, DELAY_OFFSETS = (np.linspace(-0.3, 0.3, 7), 1e-3 * np.arange(-1.5, 1.6, 0.5))
MIN_LINE_RATIO, MEDIAN_WIDTH = 15.0, 30  # times the median of so many resolved rates around it, that a line must exceed
MAX_WHOLE_RATE_LOSS = 2.0  # times that median: what a whole number of periods in a turn may lose


class PositionResidual(Noun):
    """The residual ``r`` (N) of a joint at its positions and velocities ``q``, ``dq`` (N).

    ``block`` (N) is the block of time of each sample, of which there are ``blocks``; samples of block -1 are left
    out. ``turns`` tells whether the joint is revolute.
    """

    q: Array
    dq: Array
    r: Array
    block: NDArray[np.intp]
    blocks: int
    turns: bool = True

    def powers(self, lines: list[Line]) -> Array:
        """Return |sum r exp(-i k (q - d dq))|^2 (F, L) of lines with rates k and delays d, without each block."""
        use = self.block >= 0
        q, dq, r, block = self.q[use], self.dq[use], self.r[use], self.block[use]
        # Sums by block, so that leaving one out is a subtraction.
        starts = np.flatnonzero(np.diff(block, prepend=-1))
        sums = np.zeros((self.blocks, len(lines)), dtype=complex)
        for n, (k, d) in enumerate(lines):
            np.add.at(sums[:, n], block[starts], np.add.reduceat(r * np.exp(-1j * k * (q - d * dq)), starts))
        return np.asarray(np.square(np.abs(sums.sum(axis=0) - sums)))

    def spectra(self, d: float, max_rate: float) -> tuple[Array, Array]:
        """Return rates (K) up to ``max_rate``, and the power (F, K) of a line of delay d, without each block."""
        use = self.block >= 0
        u = self.q[use] - d * self.dq[use]
        span = POINTS_PER_RATE * (float(np.ptp(self.q)) or 1.0)
        # Positions are binned for an FFT, with enough bins that the largest rate is well below their Nyquist rate.
        bins = int(2 ** np.ceil(np.log2(2.0 * span * max_rate / np.pi)))
        at = ((u - u.min()) / span * bins).astype(int) % bins
        sums = np.bincount(self.block[use] * bins + at, self.r[use], self.blocks * bins).reshape(self.blocks, bins)
        rate = np.asarray(2.0 * np.pi * np.arange(bins // 2 + 1) / span, dtype=float)
        in_range = rate <= max_rate
        spectra = np.fft.rfft(sums, axis=1)[:, in_range]
        power: Array = np.square(np.abs(spectra.sum(axis=0) - spectra))
        return rate[in_range], power


def largest_lines(residual: PositionResidual, fastest: float) -> tuple[Line, ...]:
    """Return rates k (1/rad, rad/m) and delays d (s) of the largest lines, leaving out each block in turn.

    So a fold finds what its own training shows. A line must stand out of the rates around it: errors of the
    bodies and of friction are broad. No rate exceeds ``fastest``. That of a revolute joint is a whole number
    where one fits as well: the wave closes after a turn.
    """
    from scipy.ndimage import median_filter

    reach = float(np.ptp(residual.q))
    min_rate, max_rate = max(MIN_RATE, 2.0 * np.pi * MIN_PERIODS / max(reach, 1e-12)), min(MAX_RATE, fastest)
    if not reach or min_rate >= max_rate:
        return ()
    by_delay = [residual.spectra(d, max_rate) for d in DELAYS.tolist()]
    rate, power = by_delay[0][0], np.stack([spectra for _, spectra in by_delay])  # (D, F, K)
    # The median over neighbouring rates is the level of a broad residual; only lines far above it count.
    around = median_filter(power.mean(axis=(0, 1)), MEDIAN_WIDTH * POINTS_PER_RATE, mode="nearest")
    power *= (power > MIN_LINE_RATIO * around) & (rate >= min_rate)
    lines: dict[Line, None] = {}
    flat = power.transpose(1, 0, 2).reshape(residual.blocks, -1)
    for place in np.unique(np.argmax(flat, axis=1)[flat.any(axis=1)]).tolist():
        d, k = divmod(place, len(rate))
        lines |= dict.fromkeys(
            _refine_line(residual, (float(rate[k]), float(DELAYS[d])), reach, MAX_WHOLE_RATE_LOSS * float(around[k]))
        )
    return tuple(lines)


def _refine_line(residual: PositionResidual, line: Line, reach: float, loss: float) -> list[Line]:
    """Return the best lines near ``line``, leaving out each block in turn.

    A whole rate is preferred where it loses no more power than ``loss``.
    """
    k, d = line
    # The periodogram is too coarse for rate and delay: search a fine grid around its maximum.
    rates = k + RATE_OFFSETS * 2.0 * np.pi / reach
    whole_rates = np.unique(np.round(rates)) if residual.turns else np.zeros(0)
    whole_rates = whole_rates[(whole_rates >= rates[0]) & (whole_rates <= rates[-1])]
    delays = d + DELAY_OFFSETS
    lines = [(x, y) for x in [*rates.tolist(), *whole_rates.tolist()] for y in delays.tolist()]
    power = residual.powers(lines)
    n_free = len(rates) * len(delays)
    best = np.argmax(power[:, :n_free], axis=1)
    if len(whole_rates):
        best_whole = n_free + np.argmax(power[:, n_free:], axis=1)
        fold_index = np.arange(residual.blocks)
        best = np.where(power[fold_index, best_whole] > power[fold_index, best] - loss, best_whole, best)
    return [lines[n] for n in np.unique(best).tolist()]


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
