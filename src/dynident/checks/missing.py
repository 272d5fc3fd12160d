"""Effects that a model lacks: friction of other kinds, springs, rotors, coupled or cogging motors; joint by joint."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, tee

import numpy as np
from numpy.typing import NDArray

from dynident.checks.case import Case
from dynident.checks.cost import Cost, faster
from dynident.checks.finding import Finding, Topic
from dynident.checks.misfit import Evidence, Misfit
from dynident.checks.ripple import ripple
from dynident.checks.robot_notes import MissingTerm, TermKind, TermLeftOut
from dynident.checks.suspect import CERTAIN
from dynident.errors import Severity, brief
from dynident.identification.terms import TermChoice
from dynident.models import INERTIAL

__all__ = ["Missing", "missing", "torque_rate", "tried_by", "with_missing"]

Array = NDArray[np.float64]
STEP = 1e-4  # s, of the differences in time
SLOW = 0.05  # of the rms speed: width of the sign of a velocity
STRIBECK = 0.2  # of the rms speed: where friction has fallen
WORTH = 0.1  # share of a joint's squared residual that an effect of its own must explain to be reported
FELT = 0.005  # share of a joint's torque (rms) below which an effect is none
WARNED = 0.4  # ... and to be warned of
OFFERED = (TermKind.VISCOUS, TermKind.COULOMB, TermKind.OFFSET, TermKind.ROTOR)  # terms of the library
POSITIVE = (TermKind.VISCOUS, TermKind.COULOMB, TermKind.ROTOR, TermKind.LOAD, TermKind.SATURATION)
TRIED = {  # the kinds by which a choice of terms has tried an effect
    TermKind.VISCOUS: {"viscous"},
    TermKind.COULOMB: {"coulomb", "dahl"},
    TermKind.SMOOTH: {"coulomb", "dahl"},
    TermKind.OFFSET: {"offset"},
    TermKind.ROTOR: {"rotor"},
    TermKind.SPRING: {"spring"},
    TermKind.ASYMMETRIC: {"asymmetric_viscous"},
    TermKind.QUADRATIC: {"power"},
    TermKind.STRIBECK: {"stribeck"},
    TermKind.LOAD: {"load_coulomb"},
    TermKind.RIPPLE: {"ripple"},
}
Effect = tuple[TermKind, int, int | None, float, Array]  # kind, joint, other joint, period (rad or m), column (M, n)


@dataclass(frozen=True, eq=False)
class Missing:
    """An effect that would explain much of the residual: of joint ``j``, with the joint ``partner``, of a ripple the
    ``period``, by its column, and the column ``beyond``, at twice the speed."""

    kind: TermKind
    j: int
    partner: int | None
    period: float
    column: Array
    beyond: Array
    evidence: Evidence

    __repr__ = brief

    @property
    def share(self) -> float:
        """Share of the joint's own squared residual."""
        return float(self.evidence.by_joint[self.j])

    def finding(self, names: tuple[str, ...], cost: Cost) -> Finding:
        """Return the finding, with what the effect costs."""
        partner = "" if self.partner is None else names[self.partner]
        figures = self.evidence.value, self.evidence.std, self.share, partner, self.period
        left_out = self.share > WARNED and self.kind in OFFERED
        own = tuple(one for one in cost.removed if one[0] in (names[self.j], partner))
        note = (TermLeftOut if left_out else MissingTerm)(self.kind, *figures, cost=cost.all, removed=own)
        severity = Severity.WARNING if self.share > WARNED or note.forbidden else Severity.INFO
        return Finding(severity, names[self.j], note, Topic.MISSING_TERM)


def missing(fit: Misfit) -> list[Missing]:
    """Return the effects that explain much of a joint's residual, the most explaining first."""
    ripples = [ripple(fit, j) for j in range(fit.case.q.shape[1])]
    columns, same = tee(_columns(fit, fit.case, ripples))
    seen = zip(columns, fit.evidence(column for *_, column in same), strict=True)
    error = fit.error
    found = {k: (what, one) for k, (what, one) in enumerate(seen) if one is not None and _counts(*what[:3], one, error)}
    if not found:
        return []
    beyond = (column for k, (*_, column) in enumerate(_columns(fit, faster(fit.case), ripples)) if k in found)
    every = [Missing(*what, far, one) for (what, one), far in zip(found.values(), beyond, strict=True)]
    return sorted(every, key=lambda one: -one.evidence.share)


def _counts(kind: TermKind, j: int, partner: int | None, evidence: Evidence, error: Array) -> bool:
    """Tell whether an effect explains enough of a joint's torque, of which the fit leaves the share ``error`` (n),
    makes sense, and is no chance."""
    share = float(evidence.by_joint[j])
    sensible = kind not in POSITIVE or evidence.value > 0
    mutual = kind is not TermKind.COUPLED or partner is None or evidence.by_joint[partner] > WORTH
    if not (share > WORTH and share**0.5 * error[j] > FELT and sensible and mutual):
        return False
    lasting = evidence.agreed and evidence.held_out > 0.5 * evidence.share
    return lasting and abs(evidence.value) > CERTAIN * evidence.std


def with_missing(case: Case, found: Missing) -> Case:
    """Return the case with the effect among its columns."""
    return replace(case, extra=(*case.extra, found.column), beyond=(*case.beyond, found.beyond))


def tried_by(finding: Finding, choice: TermChoice | None = None) -> bool:
    """Return whether a finding is an effect that a choice of terms has tried on that joint, where it entered or was
    refused by samples kept aside; without a choice, whether one would try it."""
    if not isinstance(finding.message, MissingTerm) or finding.joint is None:
        return False
    kinds = TRIED.get(finding.message.effect, set())
    if choice is None:
        return bool(kinds)
    return not kinds.isdisjoint(one.kind.split()[0] for one in choice.of(finding.joint))  # ripple, ripple 2, ...


def _columns(fit: Misfit, case: Case, ripples: Sequence[tuple[float, Array] | None]) -> Iterator[Effect]:
    """Yield every kind of effect, in the motion of a case, with the values of the fit and its ``ripples`` by joint."""
    (load, friction), n = _parts(fit, case), case.q.shape[1]
    age = np.linspace(-1.0, 1.0, len(case.q))  # over all logs, in their order
    rate = torque_rate(fit, case)
    friction_jumps = _has_coulomb(case)
    speed = np.maximum(np.sqrt(np.mean(fit.case.dq**2, axis=0)), 1e-12)
    sign = np.tanh(case.dq / (SLOW * speed))
    torque, usual = case.torque(fit.theta), np.maximum(np.sqrt(np.mean(fit.torque**2, axis=0)), 1e-12)
    met = np.minimum(np.abs(torque), np.abs(fit.torque).max(axis=0)) / usual  # beyond, nobody knows
    shapes: dict[TermKind, Callable[[int], Array]] = {
        TermKind.VISCOUS: lambda j: case.dq[:, j],
        TermKind.COULOMB: lambda j: sign[:, j],
        TermKind.OFFSET: lambda _: np.ones(len(case.q)),
        TermKind.ROTOR: lambda j: case.ddq[:, j],
        TermKind.SPRING: lambda j: case.q[:, j],
        TermKind.ASYMMETRIC: lambda j: np.abs(case.dq[:, j]),
        TermKind.QUADRATIC: lambda j: np.abs(case.dq[:, j]) * case.dq[:, j],
        TermKind.STRIBECK: lambda j: sign[:, j] * np.exp(-np.abs(case.dq[:, j]) / (STRIBECK * speed[j])),
        TermKind.LOAD: lambda j: sign[:, j] * np.abs(load[:, j]),
        TermKind.DRIFT: lambda j: age * friction[:, j],
        TermKind.DELAY: lambda j: -rate[:, j],
        TermKind.SATURATION: lambda j: -(met[:, j] ** 2) * torque[:, j],
    }
    for kind, shape in shapes.items():
        for j in range(n):
            known = kind is TermKind.COULOMB and friction_jumps[j]
            yield TermKind.SMOOTH if known else kind, j, None, 0.0, _only(case, j, shape(j))
    for j, found in enumerate(ripples):
        if found is not None:
            yield TermKind.RIPPLE, j, None, found[0], _only(case, j, found[1])
    for i, j in (*pairwise(range(n)), *pairwise(range(n - 1, -1, -1))):
        yield TermKind.NEIGHBOUR, j, i, 0.0, _only(case, j, torque[:, i])
    for i in range(n):
        for j in range(i + 1, n):
            yield TermKind.COUPLED, j, i, 0.0, _only(case, i, case.ddq[:, j]) + _only(case, j, case.ddq[:, i])


def _only(case: Case, j: int, x: Array) -> Array:
    """Return columns (M, n) that are x (M) at one joint."""
    column = np.zeros_like(case.q)
    column[:, j] = x
    return column


def _parts(fit: Misfit, case: Case) -> tuple[Array, Array]:
    """Return the torques (M, n) of the rigid bodies and of friction; without bodies, of all but friction."""
    parameters = case.model.parameters
    rigid = np.array([parameter.role in INERTIAL for parameter in parameters])
    rubs = np.array([parameter.role in ("viscous", "coulomb") for parameter in parameters])
    rigid = rigid if rigid.any() else ~rubs
    load, friction = (case.torque(np.where(part, fit.theta, 0.0)) for part in (rigid, rubs))
    return load, friction


def _has_coulomb(case: Case) -> NDArray[np.bool_]:
    """Return which joints (n) have Coulomb friction in the model."""
    coulomb = np.array([parameter.role == "coulomb" for parameter in case.model.parameters])
    return np.asarray(case.torque(coulomb.astype(float)).any(axis=0))


def torque_rate(fit: Misfit, case: Case) -> Array:
    """Return the rate of change (M, n) of the fitted torque in the motion of a case, in N m/s or N/s."""
    ahead, behind = (
        replace(case, q=case.q + h * case.dq, dq=case.dq + h * case.ddq, ddq=case.ddq + h * case.dddq)
        for h in (STEP, -STEP)
    )
    return np.asarray((ahead.torque(fit.theta) - behind.torque(fit.theta)) / (2 * STEP))
