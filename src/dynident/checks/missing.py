"""Effects that a model may lack: friction of other kinds, springs, rotors, coupled or cogging motors."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise, tee

import numpy as np
from numpy.typing import NDArray

from dynident.checks.misfit import FOLDS, FitCase, Misfit, ScoreTest, fit_case, measured_case, misfit, steady_mask
from dynident.checks.motion_notes import OtherPayload
from dynident.checks.robot_notes import (
    MAX_SIMULATION_COST,
    LeftAtReversals,
    MissingTerm,
    TermKind,
    TermLeftOut,
    Unexplained,
)
from dynident.checks.suspects import MIN_STANDARD_ERRORS, find_ripple, motion_shapes
from dynident.checks.torque import rms_speed
from dynident.identification.terms import TermChoice, TrialOutcome
from dynident.identification.verdict_rules import SPEED_FACTOR
from dynident.models import INERTIAL, Model
from dynident.motion.log import Motion, subsample, thin_motions
from dynident.regression import ParallelFilter
from dynident.runtime import Finding, Noun, Severity
from dynident.runtime.arrays import Array


@dataclass(frozen=True)
class Cost:
    """The cost of a fault: the change of the torque at twice the speed in %, of ``all`` joints and of the worst one.

    ``removed`` is the share by joint of the squared low-passed residual beside white noise, where there is one. An
    unknown that is six standard errors from zero explains 1/36 of this by chance.
    """

    all: float
    joint: float
    removed: tuple[tuple[str, float], ...] = ()


def faster_case(case: FitCase) -> FitCase:
    """Return the case with the same path at twice the speed; its torque is still the measured one."""
    dq, ddq, dddq = (SPEED_FACTOR**k * x for k, x in enumerate((case.dq, case.ddq, case.dddq), start=1))
    return replace(case, dq=dq, ddq=ddq, dddq=dddq, gain=1.0)


def cost(before: Misfit, after: Misfit) -> Cost:
    """Return how much the torque at twice the speed differs between two fits, relative to the second."""
    right_torque = _faster_torque(after)
    change = _faster_torque(before) - right_torque
    # a joint without torque counts as unchanged
    size = np.linalg.norm(right_torque, axis=0)
    joints = np.linalg.norm(change, axis=0) / np.where(size > 0, size, np.inf)
    relative_change = float(np.linalg.norm(change) / (np.linalg.norm(right_torque) or np.inf))
    remaining = mean_square(after)
    decrease = mean_square(before) - remaining
    # a share, as other motions leave more; noise in which more than what remains would be white is ripple, too
    coloured = remaining - np.where(before.case.noise < remaining, before.case.noise, 0.0)
    share = decrease / np.maximum(decrease + coloured, 1e-300)
    removed = tuple((joint.name, float(x)) for joint, x in zip(before.case.model.joints, share, strict=True) if x > 0)
    return Cost(100.0 * relative_change, 100.0 * float(joints.max()), removed)


def mean_square(fit: Misfit) -> Array:
    """Return the mean squared residual (n) of the samples that count."""
    return np.asarray(np.square(fit.unweighted).sum(axis=0) / np.maximum(fit.case.keep.sum(axis=0), 1))


def _faster_torque(fit: Misfit) -> Array:
    """Return the torque (M, n) of a fit at twice the speed, with a fitted gain divided out of the extra columns."""
    added = sum((value * column for value, column in zip(fit.extra, fit.case.beyond, strict=False)), np.float64(0.0))
    return np.asarray(faster_case(fit.case).torque(fit.theta) + added / fit.case.gain)


TIME_STEP = 1e-4  # s, of the differences in time
MIN_JOINT_SHARE = 0.1  # share of a joint's squared residual that an effect of its own must explain to be reported
MIN_TORQUE_SHARE = 0.005  # share of a joint's torque (rms) below which an effect is none
MIN_DELAY = 1e-3  # s: a shorter one is that of a cycle, or of a ripple
MIN_WARNING_SHARE = 0.4  # ... and to be warned of
MIN_OPEN_GAIN = 10.0  # %, of the squared error: a term that gains more, but within its error, was not refused
LIBRARY_TERMS = (TermKind.VISCOUS, TermKind.COULOMB, TermKind.OFFSET, TermKind.ROTOR)  # terms of the library
POSITIVE_TERMS = (TermKind.VISCOUS, TermKind.COULOMB, TermKind.ROTOR, TermKind.LOAD, TermKind.GEAR_LOSS)
# the kinds by which a choice of terms has tried an effect
TRIED_KINDS = {kind: {kind.term} for kind in TermKind if kind.term}
TRIED_KINDS |= {kind: {"coulomb", "dahl"} for kind in (TermKind.COULOMB, TermKind.SMOOTH)}
Effect = tuple[TermKind, int, int | None, float, Array]  # kind, joint, other joint, period (rad or m), column (M, n)


class MissingEffect(Noun):
    """An effect that would explain much of the residual, with the score test of it.

    It is one of joint ``j``, with the joint ``partner``; ``period`` is that of a ripple. ``fast_column`` is its
    ``column`` (M, n) at twice the speed.
    """

    kind: TermKind
    j: int
    partner: int | None
    period: float
    column: Array
    fast_column: Array
    score: ScoreTest

    @property
    def share(self) -> float:
        """Share of the joint's own squared residual that the effect explains."""
        return float(self.score.by_joint[self.j])

    def finding(self, names: tuple[str, ...], cost: Cost) -> Finding:
        """Return the finding, with what the effect costs."""
        partner = "" if self.partner is None else names[self.partner]
        figures = self.score.value, self.score.std, self.share, partner, self.period
        left_out = self.share > MIN_WARNING_SHARE and self.kind in LIBRARY_TERMS
        removed = tuple(entry for entry in cost.removed if entry[0] in (names[self.j], partner))
        note = (TermLeftOut if left_out else MissingTerm)(self.kind, *figures, cost=cost.all, removed=removed)
        severity = Severity.WARNING if self.share > MIN_WARNING_SHARE or note.forbidden else Severity.INFO
        return Finding(note, names[self.j], severity=severity)


def find_missing_effects(fit: Misfit) -> list[MissingEffect]:
    """Return the effects that explain much of a joint's residual, in descending order of their share."""
    ripples = [find_ripple(fit, j) for j in range(fit.case.q.shape[1])]
    # columns and their tests pass in batches: all of them together may not fit in memory
    columns, columns_copy = tee(_effect_columns(fit, fit.case, ripples))
    scores = zip(columns, fit.score_tests(column for *_, column in columns_copy), strict=True)
    error = fit.error
    significant = {
        k: (description, score)
        for k, (description, score) in enumerate(scores)
        if score is not None and _is_significant(*description[:3], score, error)
    }
    if not significant:
        return []
    # columns at twice the speed are only made for the effects that count
    beyond = (
        column
        for k, (*_, column) in enumerate(_effect_columns(fit, faster_case(fit.case), ripples))
        if k in significant
    )
    effects = [
        MissingEffect(*description, fast_column, score)
        for (description, score), fast_column in zip(significant.values(), beyond, strict=True)
    ]
    return sorted(effects, key=lambda effect: -effect.score.share)


def _is_significant(kind: TermKind, j: int, partner: int | None, score: ScoreTest, error: Array) -> bool:
    """Return whether an effect explains enough of a joint's torque, is sensible, and is not due to chance.

    ``error`` (n) is the share of the torque that the fit leaves.
    """
    share = float(score.by_joint[j])
    least = MIN_DELAY if kind is TermKind.DELAY else 0.0
    is_sensible = (score.value if kind in POSITIVE_TERMS else abs(score.value)) > least
    is_mutual = kind is not TermKind.COUPLED or partner is None or score.by_joint[partner] > MIN_JOINT_SHARE
    # cheap tests come first, as most effects fail them
    if not (share > MIN_JOINT_SHARE and share**0.5 * error[j] > MIN_TORQUE_SHARE and is_sensible and is_mutual):
        return False
    is_lasting = score.has_constant_sign and score.held_out > 0.5 * score.share
    return is_lasting and abs(score.value) > MIN_STANDARD_ERRORS * score.std


def with_missing(case: FitCase, effect: MissingEffect) -> FitCase:
    """Return the case with the column of an effect added."""
    return replace(case, extra=(*case.extra, effect.column), beyond=(*case.beyond, effect.fast_column))


def is_tried_effect(finding: Finding, choice: TermChoice | None = None) -> bool:
    """Return whether a finding is an effect that a choice of terms has tried on that joint.

    It entered there, or was rejected by samples kept aside: what gains much there, but within its error, is open.
    Without a choice, return whether one would try it, as it tries all friction that builds up gradually.
    """
    if not isinstance(finding.message, MissingTerm) or finding.joint is None:
        return choice is None and isinstance(finding.message, LeftAtReversals)
    kinds = TRIED_KINDS.get(finding.message.effect, set())
    if choice is None:
        return bool(kinds)
    # ripple, ripple 2, ...
    trials = (trial for trial in choice.trials_of(finding.joint) if trial.kind.split()[0] in kinds)
    return any(trial.outcome is not TrialOutcome.WITHIN_ERROR or trial.gain <= MIN_OPEN_GAIN for trial in trials)


def _effect_columns(fit: Misfit, case: FitCase, ripples: Sequence[tuple[float, Array] | None]) -> Iterator[Effect]:
    """Yield every kind of effect in the motion of a case, with the values of the fit and its ``ripples`` by joint."""
    (load, friction), n = _load_and_friction(fit, case), case.q.shape[1]
    age = np.linspace(-1.0, 1.0, len(case.q))  # a drift grows linearly over all logs, in their order
    # a delay is one of the log: the torque that the user meets has none
    torque_derivative = torque_rate(fit, case) if case is fit.case else np.zeros_like(case.q)
    is_coulomb = np.array([parameter.role == "coulomb" for parameter in case.model.parameters])
    friction_jumps = np.asarray(case.torque(is_coulomb.astype(float)).any(axis=0))
    by_motion = motion_shapes(case, rms_speed(fit.case.dq))
    torque, rms_torque = case.torque(fit.theta), np.maximum(np.sqrt(np.mean(fit.torque**2, axis=0)), 1e-12)
    load_ratio = np.minimum(np.abs(torque), np.abs(fit.torque).max(axis=0)) / rms_torque  # beyond, nobody knows
    # each shape is made only when it is asked for, as their columns together are large
    shapes: dict[TermKind, Callable[[int], Array]] = {
        **by_motion,
        TermKind.LOAD: lambda j: by_motion[TermKind.COULOMB](j) * np.abs(load[:, j]),
        TermKind.GEAR_LOSS: lambda j: by_motion[TermKind.COULOMB](j) * np.abs(torque[:, j]),
        TermKind.DRIFT: lambda j: age * friction[:, j],
        TermKind.GAIN_DRIFT: lambda j: age * torque[:, j],
        TermKind.DELAY: lambda j: -torque_derivative[:, j],
        TermKind.SATURATION: lambda j: -(load_ratio[:, j] ** 2) * torque[:, j],
    }
    for kind, shape in shapes.items():
        for j in range(n):
            has_coulomb = kind is TermKind.COULOMB and friction_jumps[j]
            yield TermKind.SMOOTH if has_coulomb else kind, j, None, 0.0, case.column_of_joint(j, shape(j))
    for j, ripple_fit in enumerate(ripples):
        if ripple_fit is not None:
            yield TermKind.RIPPLE, j, None, ripple_fit[0], case.column_of_joint(j, ripple_fit[1])
    # the torque of a neighbour shows wrong wiring and coupled drives, in both directions of the chain
    for i, j in (*pairwise(range(n)), *pairwise(range(n - 1, -1, -1))):
        yield TermKind.NEIGHBOUR, j, i, 0.0, case.column_of_joint(j, torque[:, i])
    for i, j in combinations(range(n), 2):
        column = case.column_of_joint(i, case.ddq[:, j]) + case.column_of_joint(j, case.ddq[:, i])
        yield TermKind.COUPLED, j, i, 0.0, column


def _load_and_friction(fit: Misfit, case: FitCase) -> tuple[Array, Array]:
    """Return the torques (M, n) of the rigid bodies and of friction; without bodies, of all terms but friction."""
    parameters = case.model.parameters
    is_rigid = np.array([parameter.role in INERTIAL for parameter in parameters])
    is_friction = np.array([parameter.role in ("viscous", "coulomb") for parameter in parameters])
    is_rigid = is_rigid if is_rigid.any() else ~is_friction
    load, friction = (case.torque(np.where(part, fit.theta, 0.0)) for part in (is_rigid, is_friction))
    return load, friction


def torque_rate(fit: Misfit, case: FitCase) -> Array:
    """Return the time derivative (M, n) of the fitted torque in the motion of a case, in N m/s or N/s."""
    # move the states along their own derivatives, so that also thinned samples have a derivative
    ahead, behind = (
        replace(case, q=case.q + h * case.dq, dq=case.dq + h * case.ddq, ddq=case.ddq + h * case.dddq)
        for h in (TIME_STEP, -TIME_STEP)
    )
    return np.asarray((ahead.torque(fit.theta) - behind.torque(fit.theta)) / (2 * TIME_STEP))


MIN_PAYLOAD_SHARE = 0.5  # of the squared residual of both logs that another payload must explain
PAYLOAD_SAMPLES = 800
MIN_PAYLOAD_MASS = 0.02  # kg


def payload_findings(
    model: Model,
    motions: Sequence[Motion],
    held_out: Mapping[str, Motion],
    parallel_filter: ParallelFilter | None = None,
    min_speed: tuple[float, ...] | None = None,
) -> Iterator[Finding]:
    """Yield the logs of ``held_out`` in which the last body is heavier or lighter than in training.

    The training logs and one other are fitted together, with separate columns for the last body in that log: what
    training does not determine then explains nothing.
    """
    last = [k for k, parameter in enumerate(model.parameters) if parameter.role in INERTIAL][-10:]
    for name, motion in held_out.items() if last else ():
        note = _other_payload(fit_case(model, [*motions, motion], parallel_filter, min_speed, PAYLOAD_SAMPLES), last)
        if note is not None:
            yield Finding(note, source=name)


def _other_payload(case: FitCase, last: Sequence[int]) -> OtherPayload | None:
    in_log = np.arange(len(case.q)) >= len(case.q) - case.lengths[-1]
    # the columns of the last body count only in the other log
    columns = _last_body_regressor(case, last) * in_log[:, None, None]
    before = misfit(case)
    weight = before.weight.max(axis=0)
    # the mass is tested with the nine other parameters of the last body free, as a payload changes all ten
    extended_case = replace(case, extra=tuple(columns[:, :, k] for k in range(1, 10)))
    fit = misfit(extended_case, weight)
    (score,) = fit.score_tests([columns[:, :, 0]])
    if score is None or abs(score.value) < max(MIN_STANDARD_ERRORS * score.std, MIN_PAYLOAD_MASS):
        return None
    share = 1.0 - fit.size * (1.0 - score.share) / before.size
    if share <= MIN_PAYLOAD_SHARE:
        return None
    return OtherPayload(score.value, score.std, share, cost=_payload_cost(case, last, in_log))


def _payload_cost(case: FitCase, last: Sequence[int], in_log: NDArray[np.bool_]) -> float:
    """Return the torque of the payload in the other log at twice its speed, in % of the total torque there."""
    columns = _last_body_regressor(case, last) * in_log[:, None, None]
    fit, fast_case = misfit(replace(case, extra=tuple(columns[:, :, k] for k in range(10)))), faster_case(case)
    added = (_last_body_regressor(fast_case, last) @ fit.extra)[in_log]
    total = added + fast_case.torque(fit.theta)[in_log]
    return 100.0 * float(np.linalg.norm(added) / (np.linalg.norm(total) or np.inf))


def _last_body_regressor(case: FitCase, last: Sequence[int]) -> Array:
    """Return the regressor (M, n, 10) of the last body."""
    return case.model.regressor(**case.states)[:, :, list(last)]


REVERSAL_SAMPLES = 1000  # of all motions, up to twice as many
REVERSAL_TIME = 0.05  # s, from a reversal
MIN_REVERSAL_SHARE = 0.4  # share of a joint's squared residual, as for effects that are warned of
SMOOTH_WIDTHS = (0.01, 0.02, 0.04, 0.08, 0.16, 0.32)  # of the rms speed: where friction may turn smoothly
MAX_SMOOTH_REMAINDER = 0.5  # share of the squared residual that a smooth friction may leave to be taken for the cause
MIN_REVERSAL_ERROR = 0.5  # %, of a joint's torque, as there
# share of it that must be outside the fifth of the data with the most: more than a single event
MIN_LASTING_SHARE = 0.2


def unexplained_findings(fit: Misfit) -> Iterator[Finding]:
    """Yield that much of the low-passed torque is left that is no white noise, for the joint with the most of it.

    Samples near reversals do not count, as everywhere in the low-passed torque.
    """
    case, counted = fit.case, fit.case.keep
    # subtract the expected white noise, which no model explains
    power = np.maximum(np.square(fit.unweighted).sum(axis=0) - counted.sum(axis=0) * case.noise, 0.0)
    torque = np.square(np.where(counted, case.tau, 0.0)).sum(axis=0)
    share = 100.0 * float(np.sqrt(power.sum() / (torque.sum() or np.inf)))
    if share > MAX_SIMULATION_COST:
        j = int(np.argmax(power))
        yield Finding(Unexplained(share, 100.0 * float(np.sqrt(power[j] / torque[j]))), case.model.joints[j].name)


def reversal_findings(
    model: Model, motions: Sequence[Motion], min_speed: tuple[float, ...] | None = None
) -> Iterator[Finding]:
    """Yield the joints whose torque, as measured, has most of its residual near their reversals."""
    rows = subsample(motions, REVERSAL_SAMPLES)
    pairs = [(motion, indices) for motion, indices in zip(motions, rows, strict=True) if len(indices) > 1]
    if not pairs:
        return
    case = measured_case(model, thin_motions(motions, REVERSAL_SAMPLES), min_speed)
    fit = misfit(case)
    near_reversals = np.concatenate([~steady_mask(motion, REVERSAL_TIME)[indices] for motion, indices in pairs])
    between_signs = np.concatenate([_between_signs(motion)[indices] for motion, indices in pairs])
    counted = (fit.weight > 0) & ~between_signs
    for j, joint in enumerate(model.joints):
        share = _share_near(np.square(fit.residual[:, j]), near_reversals[:, j], counted[:, j])
        excess_error = 100.0 * share**0.5 * float(fit.error[j])
        if share > MIN_REVERSAL_SHARE and excess_error > MIN_REVERSAL_ERROR:
            width = _smooth_friction_width(case, fit, j)
            severity = Severity.INFO if width else Severity.WARNING
            yield Finding(LeftAtReversals(excess_error, share, width), joint.name, severity=severity)


def _between_signs(motion: Motion) -> NDArray[np.bool_]:
    """Return the two samples (N, n) of each reversal, of whose signs of the velocity noise decides."""
    turns = np.pad(np.diff(np.signbit(motion.dq), axis=0), ((1, 1), (0, 0)))
    return np.asarray(turns[1:] | turns[:-1])


def _smooth_friction_width(case: FitCase, fit: Misfit, j: int) -> float:
    """Return the width (rad/s or m/s) of the friction whose smooth sign explains a joint's residual, 0 where none does.

    It turns with the velocity alone; backlash and elastic gears come after a reversal, and stay unexplained.
    """
    speed = float(rms_speed(case.dq)[j])
    # each width is fitted with all parameters of the model free, also the Coulomb friction with its jump
    remaining = {}
    for width in (share * speed for share in SMOOTH_WIDTHS):
        column = case.column_of_joint(j, np.tanh(case.dq[:, j] / width))
        smooth_fit = misfit(replace(case, extra=(*case.extra, column)), fit.weight.max(axis=0))
        remaining[width] = float(mean_square(smooth_fit)[j])
    best = min(remaining, key=lambda width: remaining[width])
    return best if remaining[best] < MAX_SMOOTH_REMAINDER * float(mean_square(fit)[j]) else 0.0


def _share_near(squared: Array, near_reversals: NDArray[np.bool_], counted: NDArray[np.bool_]) -> float:
    """Return the share of the squared residuals (M) by which those near reversals exceed the others.

    Zero where most of it may be a single event.
    """
    inside, outside = near_reversals & counted, ~near_reversals & counted
    if not inside.any() or not outside.any():
        return 0.0
    excess = np.where(inside, squared - float(squared[outside].mean()), 0.0)
    # without the part of the data that has the most, the excess must remain
    parts = np.array([part.sum() for part in np.array_split(excess, FOLDS)])
    lasting = parts.sum() - parts.max() > MIN_LASTING_SHARE * parts.sum()
    return float(parts.sum()) / float(squared[counted].sum()) if lasting else 0.0
