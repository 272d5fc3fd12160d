"""Search for what would explain the residual: the likeliest suspect, then the next with that one corrected."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from dynident.checks.alternatives import better_alternative
from dynident.checks.file_notes import OddScale, UnrelatedTorque
from dynident.checks.low_pass import low_pass_findings
from dynident.checks.misfit import CASE_SAMPLES, FitCase, Misfit, fit_cases, measured_case, misfit
from dynident.checks.missing import (
    MIN_DELAY,
    Cost,
    MissingEffect,
    cost,
    find_missing_effects,
    payload_findings,
    reversal_findings,
    torque_rate,
    unexplained_findings,
    with_missing,
)
from dynident.checks.motion import odd_log_findings
from dynident.checks.robot_notes import MissingTerm, SuspectQuantity, TermKind, TiltedBase, Unexplained
from dynident.checks.suspects import (
    MIN_STANDARD_ERRORS,
    Suspect,
    SuspectEstimate,
    clock_suspect,
    estimate_suspect,
    gain_suspects,
    gear_suspects,
    geometry_suspects,
    is_beyond_own_effects,
    promising_suspects,
)
from dynident.identification import BaseTilt, tilt_base
from dynident.models import Model
from dynident.models.friction import LoadCoulomb
from dynident.motion.log import Motion, subsample
from dynident.regression import ParallelFilter
from dynident.regression.whitening import long_run
from dynident.runtime import Finding, Note, Step, report_progress
from dynident.runtime.arrays import Array

DELAY_SAMPLES = 2000  # of all motions, up to twice as many
MAX_DELAY = 0.05  # s; a later torque is another fault
MIN_HALF_WIDTH = 5e-3  # s, least half width of the differences by time
# a delay of more than so much of the half width needs one of so many times the delay
MAX_DELAY_PER_WIDTH, WIDTH_PER_DELAY = 0.8, 1.5
MIN_DELAY_SIGNIFICANCE = 2.5  # standard errors of the low-passed torque
MIN_DELAY_SHARE = 0.1  # share of the joint's squared residual, as measured, that its delay must explain


def delay_findings(
    fit: Misfit, motions: Sequence[Motion], min_speed: tuple[float, ...] | None = None
) -> Iterator[Finding]:
    """Yield the joints whose torque is late or early relative to the common time offset.

    ``fit`` is that of the low-passed torque.
    """
    low_passed_delay, std, _ = _estimate_delays(fit, torque_rate(fit, fit.case))
    likely = (np.abs(low_passed_delay) > MIN_DELAY_SIGNIFICANCE * std) & (np.abs(low_passed_delay) < MAX_DELAY)
    # both ends are left out, where a shifted motion has no samples
    rows = subsample(motions, DELAY_SAMPLES, MAX_DELAY)
    if not likely.any() or all(len(indices) < 2 for indices in rows):
        return
    model = fit.case.model
    delay, error, share = _measured_delays(model, motions, rows, min_speed)
    # both estimates must agree in sign, and the delay must be significant and long enough to matter
    likely &= (np.sign(delay) == np.sign(low_passed_delay)) & (
        np.abs(delay) > np.maximum(MIN_STANDARD_ERRORS * error, MIN_DELAY)
    )
    for j in np.flatnonzero(likely & (share > MIN_DELAY_SHARE)):
        # the cost is that of correcting the delay in the low-passed fit, which the other causes are measured by, too
        rate = fit.case.column_of_joint(int(j), -torque_rate(fit, fit.case)[:, j])
        corrected_fit = misfit(replace(fit.case, extra=(rate,), beyond=(np.zeros_like(rate),)), fit.weight.max(axis=0))
        figures = float(delay[j]), float(error[j]), float(share[j])
        name, price = model.joints[j].name, cost(fit, corrected_fit).all
        note = MissingTerm(TermKind.DELAY, *figures, cost=price, removed=((name, float(share[j])),))
        yield Finding(note, name)


def _measured_delays(
    model: Model, motions: Sequence[Motion], rows: Sequence[NDArray[np.intp]], min_speed: tuple[float, ...] | None
) -> tuple[Array, Array, Array]:
    """Return the delays (n) in the torque as measured, with their standard errors.

    Also return the share that each explains of its joint's squared residual.
    The time differences are narrow at first, and widened for the value of a delay that explains something then:
    slow errors of a model look like delays over long times, too.
    """
    pairs = [(motion, indices) for motion, indices in zip(motions, rows, strict=True) if len(indices) > 1]

    def shifted_case(time_offset: float) -> FitCase:
        return measured_case(model, [motion.shift(time_offset, indices) for motion, indices in pairs], min_speed)

    step, fit = max(float(np.median(np.diff(motion.t))) for motion in motions), misfit(shifted_case(0.0))
    half_width, next_half_width = 0.0, max(MIN_HALF_WIDTH, step)
    shares: list[Array] = []
    # a difference is valid only for delays within its width: widen it until the largest delay fits
    while half_width < next_half_width:
        half_width = next_half_width
        torque_after, torque_before = (shifted_case(side).torque(fit.theta) for side in (half_width, -half_width))
        estimates = _estimate_delays(fit, (torque_after - torque_before) / (2 * half_width))
        shares.append(estimates[2])
        longest = float(np.abs(estimates[0][shares[0] > MIN_DELAY_SHARE]).max(initial=0.0))
        next_half_width = (
            min(WIDTH_PER_DELAY * longest, MAX_DELAY) if longest > MAX_DELAY_PER_WIDTH * half_width else half_width
        )
    return estimates[0], estimates[1], shares[0]


def _estimate_delays(fit: Misfit, rate: Array) -> tuple[Array, Array, Array]:
    """Return the delays (n) of all joints, their standard errors, and the shares that they explain.

    Each share is that of the joint's squared residual. The standard errors are robust to correlated residuals.
    ``rate`` (M, n) is the rate of change of the torque.
    """
    columns = np.stack([fit.case.column_of_joint(j, -rate[:, j]) for j in range(rate.shape[1])])
    Z = np.moveaxis(fit.orthogonal_part(columns), 0, 2)
    # least squares for all delays at once, with a sandwich estimate of their covariance
    inverse = np.linalg.pinv(np.einsum("mni,mnj->ij", Z, Z), hermitian=True)
    delays = inverse @ np.einsum("mni,mn->i", Z, fit.residual)
    residual = fit.residual - Z @ delays
    scores = np.split(np.einsum("mni,mn->mi", Z, residual), np.cumsum(fit.case.lengths)[:-1])
    std = np.sqrt(np.diag(inverse @ long_run(scores) @ inverse))
    before = np.square(fit.residual).sum(axis=0)
    return delays, std, 1.0 - np.square(residual).sum(axis=0) / np.where(before > 0, before, 1.0)


TRIAL_SAMPLES = 150  # samples with which other columns, signs and axes are tried
STEP_TEXT = "looking for what explains the residual"
MAX_CAUSES = 6  # causes that are looked for one after the other
MAX_TRIED_SUSPECTS = 4  # suspects whose value is sought, of those that one step explains best
MIN_SHARE_RATIO = 0.6  # times the largest share by one step: suspects below are not tried
REVERSAL_TERMS = (TermKind.COULOMB, TermKind.SMOOTH, TermKind.STRIBECK, TermKind.DELAY)  # explain what is left there
MAX_UNEXPLAINED_SHARE = 0.1  # of a joint's squared torque: what a fit of other inertias may leave of right torques
MAX_RIGHT_LOG_GAIN = 0.5  # natural logarithm of a gain, that a coupling with other joints must exclude
MIN_TELLING_ERRORS = 2.0  # standard errors of the difference of two fits: less says nothing of which suspect it is
MIN_TIE_RATIO = 0.9  # times the largest share: suspects from here on cannot be told apart


def robot_findings(
    model: Model,
    motions: Sequence[Motion],
    held_out: Mapping[str, Motion],
    parallel_filter: ParallelFilter | None = None,
    min_speed: tuple[float, ...] | None = None,
    tilt: BaseTilt | None = None,
    plain: Model | None = None,
) -> Iterator[Finding]:
    """Yield what is likely wrong with the robot file, the columns of the logs, or the terms of the model.

    A large fault is reported alone, as small ones cannot be found beside it. ``tilt`` is the tilt of the base
    that fits best. Large faults are searched with ``plain``, the model without the terms that were chosen with
    them, where it is given.
    """
    report_progress(Step(STEP_TEXT))
    # two cases of the same motions: a small one for the many trials of large faults, and one for the tests
    trial_case, case = fit_cases(model, motions, parallel_filter, min_speed, (TRIAL_SAMPLES, CASE_SAMPLES))
    trial_case = trial_case if plain is None else replace(trial_case, model=plain, memory=None)
    large = list(better_alternative(trial_case))
    yield from large
    # with a large fault the residual shows nothing else
    if large:
        return
    odd = list(odd_log_findings(model, motions, held_out, parallel_filter, min_speed))
    odd_logs = {finding.source for finding in odd}
    # what changed between the logs would be taken for a drift or a wrong value: only logs that agree tell of the robot
    others = {motion.source: motion for motion in motions if motion.source in odd_logs}
    if others:
        motions = [motion for motion in motions if motion.source not in odd_logs]
        (case,) = fit_cases(model, motions, parallel_filter, min_speed, (CASE_SAMPLES,))
    findings = list(explain_residual(case, tilt))
    # a delay explains what is left at reversals, so that such joints are not reported twice; a filter explains both
    low_passed = list(low_pass_findings(model, motions, min_speed))
    findings = [x for x in findings if not (low_passed and _is_effect(x, TermKind.DELAY))]
    remaining = [finding for finding in findings if isinstance(finding.message, Unexplained)]
    yield from low_passed
    yield from (finding for finding in findings if finding not in remaining)
    filtered_joints = {joint.name for joint in model.joints} if low_passed else set[str]()
    delayed_joints = _joints_with(findings, TermKind.DELAY) | filtered_joints
    delays = [x for x in delay_findings(misfit(case), motions, min_speed) if x.joint not in delayed_joints]
    yield from delays
    explained_joints = _joints_with([*findings, *delays], *REVERSAL_TERMS) | filtered_joints
    yield from (x for x in reversal_findings(model, motions, min_speed) if x.joint not in explained_joints)
    payloads = list(payload_findings(model, motions, {**held_out, **others}, parallel_filter, min_speed))
    yield from payloads
    loaded_logs = {finding.source for finding in payloads}
    # a log that does not fit with the others explains what is left
    yield from [finding for finding in odd if finding.source not in loaded_logs] or remaining


def refuted_doubts(
    model: Model,
    motions: Sequence[Motion],
    parallel_filter: ParallelFilter | None = None,
    min_speed: tuple[float, ...] | None = None,
) -> dict[type[Note], set[str]]:
    """Return the joints whose torque a fit shows to be right, by the note that doubts it for the inertias of the file.

    The file may lack a tool that the arm carries: the coupling with the other joints shows that a torque is not several
    times too large. Where its inertias are wrong, others explain the torques of all joints, if none is another's.
    """
    (case,) = fit_cases(model, motions, parallel_filter, min_speed, (CASE_SAMPLES,))
    fit, suspects = misfit(case), gain_suspects(model)
    scores = fit.score_tests(suspect.derivative(fit) for suspect in suspects)
    right_gains = {
        str(suspect.joint)
        for suspect, score in zip(suspects, scores, strict=True)
        if score is not None and abs(score.value) + MIN_STANDARD_ERRORS * score.std < MAX_RIGHT_LOG_GAIN
    }
    is_explained = _largest_unexplained_share(fit) < MAX_UNEXPLAINED_SHARE
    return {OddScale: right_gains, UnrelatedTorque: {joint.name for joint in model.joints} if is_explained else set()}


def _largest_unexplained_share(fit: Misfit) -> float:
    """Return the share of a joint's squared torque, beside its mean, that a fit leaves, of the joint with the largest.

    A small torque in the place of a large one is itself explained, at the cost of those of other joints.
    """
    keep = fit.case.keep
    tau, residual = (np.where(keep, x, 0.0) for x in (fit.case.tau, fit.case.tau - fit.torque))
    squares = np.sum(tau**2, axis=0) - np.sum(tau, axis=0) ** 2 / np.maximum(keep.sum(axis=0), 1)
    return float((np.sum(residual**2, axis=0) / np.maximum(squares, 1e-300)).max())


def _joints_with(findings: Sequence[Finding], *effects: TermKind) -> set[str | None]:
    return {finding.joint for finding in findings if _is_effect(finding, *effects)}


def _is_effect(finding: Finding, *effects: TermKind) -> bool:
    return isinstance(finding.message, MissingTerm) and finding.message.effect in effects


def explain_residual(case: FitCase, tilt: BaseTilt | None = None) -> Iterator[Finding]:
    """Yield what would explain a large part of the training residual, one cause after the other.

    A cause is a gain, a zero, a length or an axis that is wrong, or an effect that the model lacks. Each is
    tested with those found before corrected, so that none is reported for what another one causes. Last comes
    what none explains.
    """
    names = tuple(joint.name for joint in case.model.joints)
    model = case.model
    suspects = [*geometry_suspects(model), *gain_suspects(model), *gear_suspects(model), clock_suspect()]
    # friction by the load of the bodies is as much of a gear's loss as a term has
    losses = [term for term in model.terms if isinstance(term, LoadCoulomb)]
    named_effects = {(TermKind.GEAR_LOSS, names.index(name)) for term in losses for name in term.acts_on}
    for k in range(MAX_CAUSES + 1):
        report_progress(Step(STEP_TEXT, k, MAX_CAUSES + 1))
        fit = misfit(case)
        if not fit.size:  # nothing is left, or counts
            return
        if k == MAX_CAUSES:
            yield from unexplained_findings(fit)
            return
        weight = fit.weight.max(axis=0)
        # compare the three kinds of causes by the share of the residual that each explains
        effects = [effect for effect in find_missing_effects(fit) if (effect.kind, effect.j) not in named_effects]
        share = max((effect.score.share for effect in effects), default=0.0)
        # a clock is one of all joints: so are the effects of one kind that it must explain more than
        shares = [sum(x.score.share for x in effects if x.kind is effect.kind) for effect in effects]
        level = replace(case, model=tilt_base(case.model, tilt.x, tilt.y)) if tilt else case
        # the share of a tilted base is that of the fit on the tilted model
        tilt_share = 1.0 - misfit(level, weight).size / fit.size if tilt else 0.0
        share = max(share, tilt_share)
        best, rivals = _likeliest_suspect(fit, suspects, share)
        if best is not None and best.suspect.joint is None and MIN_TIE_RATIO * best.share <= max(shares, default=0.0):
            best, rivals = _likeliest_suspect(fit, [x for x in suspects if x.joint is not None], share)
        # wrong values come before missing effects that explain about as much
        if best is not None and MIN_TIE_RATIO * best.share > share:
            yield _suspect_finding(fit, best, rivals)
            case = best.case
        elif tilt and share == tilt_share > fit.min_share:
            figures = tilt.x, tilt.y, tilt.std, float(tilt.before), float(tilt.after)
            price = cost(fit, misfit(level, weight))
            yield Finding(TiltedBase(*figures, cost=price.all, joint_cost=price.joint, removed=price.removed))
            case, tilt = level, None
        elif effects:
            # an effect is added at all joints that show it, as the cost is that of all of them together
            alike = _select_simplest_kind(effects)
            case = reduce(with_missing, alike, case)
            price = cost(fit, misfit(case, weight))
            named_effects |= {(effect.kind, effect.j) for effect in alike}
            yield from (effect.finding(names, price) for effect in alike)
        else:
            yield from unexplained_findings(fit)
            return


def _select_simplest_kind(effects: Sequence[MissingEffect]) -> list[MissingEffect]:
    """Return the effects of one kind: the simplest of those that explain about the most, at all joints that have it."""
    kinds = list(TermKind)
    alike = [effect for effect in effects if effect.score.share > MIN_TIE_RATIO * effects[0].score.share]
    simplest = min(alike, key=lambda effect: kinds.index(effect.kind))
    return [
        effect for effect in effects if effect.kind is simplest.kind and (effect is simplest or effect.partner is None)
    ]


def _likeliest_suspect(
    fit: Misfit, suspects: Sequence[Suspect], min_share: float
) -> tuple[SuspectEstimate | None, list[SuspectEstimate]]:
    """Return the suspect that explains the most, and those that explain about as much, of which it is the simplest.

    Only suspects that may explain more than ``min_share`` are tried: several steps explain at most about twice as
    much as the first.
    """
    # one step per suspect is cheap; only the best ones are estimated by iteration, equal ones in their order
    ranked_suspects = sorted(promising_suspects(fit, suspects), key=lambda pair: -round(pair[1].share, 6))
    reference_share = max(MIN_SHARE_RATIO * ranked_suspects[0][1].share, min_share / 2) if ranked_suspects else 0.0
    candidates = [suspect for suspect, score in ranked_suspects[:MAX_TRIED_SUSPECTS] if score.share > reference_share]
    # a small gain looks like large ones of the others at first
    if any(suspect.quantity is SuspectQuantity.GAIN for suspect in candidates):
        candidates += [x for x in suspects if x.quantity is SuspectQuantity.GAIN and x not in candidates]
    tried = (estimate_suspect(fit, suspect) for suspect in candidates)
    estimates = [x for x in tried if x is not None and is_beyond_own_effects(fit, x)]
    if not estimates:
        return None, []
    likeliest = max(estimates, key=lambda candidate: candidate.share)
    alike = [x for x in estimates if x.share > MIN_TIE_RATIO * likeliest.share]
    # the likeliest by the data comes first, by its kind where the data say nothing
    alike.sort(key=lambda candidate: (_is_clearly_worse(fit, candidate, likeliest), candidate.order))
    return alike[0], alike[1:]


def _is_clearly_worse(fit: Misfit, candidate: SuspectEstimate, likeliest: SuspectEstimate) -> bool:
    """Return whether a candidate fits worse by more than the error of the difference, whose samples are correlated.

    This is the test of Vuong (1989) for models of which none contains the other.
    """
    if candidate is likeliest:
        return False
    weight = fit.weight.max(axis=0)
    squares = [np.square(misfit(x.case, weight).residual).sum(axis=1) for x in (candidate, likeliest)]
    excess = squares[0] - squares[1]
    parts = np.split((excess - excess.mean())[:, None], np.cumsum(fit.case.lengths)[:-1])
    return bool(excess.sum() > MIN_TELLING_ERRORS * np.sqrt(long_run(parts)[0, 0]))


def _suspect_finding(fit: Misfit, best: SuspectEstimate, rivals: Sequence[SuspectEstimate]) -> Finding:
    suspect, prices = best.suspect, [_suspect_cost(fit, estimate) for estimate in (best, *rivals)]
    note = suspect.note(best.value, best.std, best.share, tuple(estimate.rival for estimate in rivals))
    max_cost, max_joint_cost = max(x.all for x in prices), max(x.joint for x in prices)
    note = replace(note, cost=max_cost, joint_cost=max_joint_cost, removed=prices[0].removed)
    return Finding(note, suspect.joint)


def _suspect_cost(fit: Misfit, estimate: SuspectEstimate) -> Cost:
    # where only the log is wrong, as with its clock, the fit is used on the correct motion
    suspect = estimate.suspect
    used_case = suspect.correct_case(fit.case, estimate.value) if suspect.only_in_log else fit.case
    return cost(replace(fit, case=used_case), misfit(estimate.case, fit.weight.max(axis=0)))
