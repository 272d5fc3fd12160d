"""The rules of the verdict: is the model fit for use, and if not, why?

The rules and the reasons for their limits are in docs/methods_verdict.md.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from dynident.estimators import Ridge
from dynident.identification import verdict_reasons as why
from dynident.identification.links import scaled_covariance
from dynident.identification.next_steps import next_steps
from dynident.identification.result import Identification
from dynident.identification.unobservable import unknowns
from dynident.identification.verdict import HeldOut, LargestResidual, Verdict, WorstRun
from dynident.identification.verdict_reasons import Reason
from dynident.identification.verdict_steps import NextStep, Remedy, SetRight
from dynident.models import INERTIAL
from dynident.motion.log import stack_states, subsample, thin_motions
from dynident.regression import Regression, UnexcitedParameters, repeats_path
from dynident.runtime import Finding, InputError, Use
from dynident.validation import Driver, FreeRun, LogValidation, NoiseFloor

MAX_SAMPLES = 2000  # of all training motions
SPEED_FACTOR = 2.0  # times the speed of the training, at which fits are compared
RANK_TOLERANCE = 1e-5  # share of the largest singular value below which the data say nothing


@dataclass(frozen=True)
class ConstraintEffect:
    """The effect of constraints or a prior on an estimate, compared with least squares.

    ``growth`` (%) is that of the training residual, ``torque_change`` (%) the difference of the torque on the
    training motion at twice its speed.
    """

    growth: float
    torque_change: float


def constraint_effect(identification: Identification) -> ConstraintEffect:
    """Compare an estimate with least squares on samples of the training, each joint weighted by its residual."""
    motions = thin_motions(identification.training_motions, MAX_SAMPLES)
    value, model = identification.estimate.value, identification.model
    factors = Regression(model, motions).triangular_factors
    noise = np.sqrt(factors.residual(value) / np.maximum(factors.rows, 1))
    residual = factors.subtract_torque(value).stack(1.0 / np.where(noise > 0, noise, 1.0))
    X, y = residual[:, :-1], residual[:, -1]
    size = np.linalg.norm(X, axis=0)
    size[size == 0] = 1.0
    # Least squares in the change of the parameters, so that directions without data stay as estimated.
    change = np.linalg.lstsq(X / size, y, rcond=RANK_TOLERANCE)[0] / size
    residual_norm = float(np.linalg.norm(y - X @ change))
    states = stack_states(motions)
    states |= {"dq": SPEED_FACTOR * states["dq"], "ddq": SPEED_FACTOR**2 * states["ddq"]}
    torque, torque_change = (float(np.linalg.norm(model.torque(**states, theta=theta))) for theta in (value, change))
    return ConstraintEffect(
        100.0 * (float(np.linalg.norm(y)) / residual_norm - 1.0) if residual_norm else 0.0,
        100.0 * torque_change / torque if torque else 0.0,
    )


MAX_SAMPLES_BEYOND = 500  # of all training motions
SIZE_FACTOR = 2.0  # times the size of the training, likewise
MAX_ANNOUNCED_ERROR = 3.0  # %, standard error of the torque there, with which a simulation can be trusted


def announced_error(identification: Identification) -> float | None:
    """Return the standard error (%) of the torque on the training motion at twice its speed and size; None if unknown.

    A motion too small or too slow leaves directions of the parameters to chance, which no like motion shows.
    """
    covariance, basis = scaled_covariance(identification), identification.base.on_data
    if covariance is None:
        return None
    motions, model = identification.training_motions, identification.model
    states = stack_states(motions, subsample(motions, MAX_SAMPLES_BEYOND))
    middle = states["q"].mean(axis=0)
    states |= {"q": middle + SIZE_FACTOR * (states["q"] - middle), "dq": SIZE_FACTOR * SPEED_FACTOR * states["dq"]}
    Y = model.regressor(**states | {"ddq": SIZE_FACTOR * SPEED_FACTOR**2 * states["ddq"]})
    columns = Y if basis is None else Y[:, :, list(basis.independent)]
    # the rms over samples and joints of sqrt(y C y'), by a root of the covariance
    variances, axes = np.linalg.eigh(covariance)
    error = float(np.linalg.norm(columns @ (axes * np.sqrt(np.maximum(variances, 0.0)))))
    torque = float(np.linalg.norm(Y @ identification.estimate.value))
    return 100.0 * error / torque if torque else None


MAX_TORQUE_ERROR = 10.0  # %, held-out torque error up to which a feedforward helps
MAX_UNFILTERED_ERROR = 25.0  # %, the same where the fit has a low-pass: what the filter may take away
MAX_JOINT_ERROR = 25.0  # %, the same of one joint
# %, of a joint's effort limit, or of its largest torque: errors below it are harmless, however small its torque
HARMLESS_EFFORT_SHARE, HARMLESS_TORQUE_SHARE = 3.0, 5.0
MAX_FLOOR_RATIO, MAX_EXCESS_ERROR = 1.5, 3.0  # times what the sensors allow, and %: a joint's error beside its noise
MAX_ERROR_RATIO = 2.0  # held-out error over training error, or the other way round
MAX_UNEXCITED_SHARE = 0.25  # share of the base parameters that the data may leave out
MAX_LOOP_ERROR, MAX_WINDOW_ERROR = 1.0, 25.0  # %, of positions simulated with the controller; from the measured torque
MAX_RESIDUAL_GROWTH = 5.0  # %, by which physical constraints may raise the residual
MAX_TORQUE_CHANGE = 7.0, 1.0  # %, likewise of the torque at twice the speed, for control and for simulation
SYMPTOMS = why.TorqueErrorTooLarge, why.JointErrorsTooLarge, why.NotCarriedOver, why.TrainedWorse, why.HeldBack
MIN_SPEED_SHARE = 0.5  # share of the speed of the training that the fastest held-out motion must have


def judge(identification: Identification) -> Verdict:
    """Judge an identification by its held-out logs, its mass matrix and free simulations; a pure function.

    Raises InputError where ``verdict_of`` has none.
    """
    verdict = verdict_of(identification)
    if verdict is None:
        raise InputError("the result was saved by an older version, without its verdict; identify again.")
    return verdict


def verdict_of(identification: Identification) -> Verdict | None:
    """Return the verdict, which the identification keeps; of a loaded result that which was saved, if one was."""
    has_signals = all(log.signals is not None for log in identification.validations) and identification.validations
    return identification.fact("verdict", lambda: _evaluate(identification) if has_signals else None)


def _evaluate(identification: Identification) -> Verdict:
    by_use = _constraint_reasons(identification)
    against_use, against_simulation = (
        (*_finding_reasons(identification, use), *by_use.get(use, ()), *reasons_against(identification))
        for use, reasons_against in ((Use.CONTROL, _against_use), (Use.SIMULATION, _against_simulation))
    )
    # what alone forbids only a simulation may be the cause of what forbids any use
    if any(isinstance(reason, SYMPTOMS) for reason in against_use):
        causes, against_simulation = _split_causes(against_simulation)
        forbidding_causes, effects = _split_causes(against_use)
        against_use = (*forbidding_causes, *causes, *effects)
    reasons = (*against_use, *against_simulation)
    use = Use.DO_NOT_USE if against_use else Use.CONTROL if against_simulation else Use.SIMULATION
    return Verdict(
        use=use,
        reasons=reasons,
        next=tuple(dict.fromkeys(_order_actions(against_use, against_simulation, next_steps(identification)))),
        held_out=_held_out(identification),
        run=_worst_run(identification),
        residual=_largest_residual(identification),
        unknown=() if use is Use.DO_NOT_USE else tuple(unknowns(identification)),
    )


def _split_causes(reasons: Sequence[Reason]) -> tuple[tuple[Reason, ...], tuple[Reason, ...]]:
    """Return the reasons that may cause others, and those others."""
    causes = tuple(
        reason
        for reason in reasons
        if isinstance(reason, why.ForbiddingFindings)
        or (isinstance(reason, why.Uncertain) and reason.error > MAX_TORQUE_ERROR)
    )
    return causes, tuple(reason for reason in reasons if reason not in causes)


def _order_actions(
    against_use: Sequence[Reason], against_simulation: Sequence[Reason], steps: Sequence[UnexcitedParameters | NextStep]
) -> Iterator[Remedy | UnexcitedParameters | NextStep]:
    """Yield what to do: remedies, then motions to record.

    Remedies for a simulation come last where the model is of no use. What was found comes before the advice to look
    for it, to record more of the same, or to simulate.
    """
    remedies, later_remedies = (
        [reason.remedy for reason in reasons if reason.remedy] for reasons in (against_use, against_simulation)
    )
    actions = [*remedies, *steps, *later_remedies] if against_use else [*later_remedies, *steps]
    corrections = [step for step in steps if isinstance(step, SetRight)]
    later = [action for action in actions if action in (Remedy.CHECK, Remedy.LONGER_TRAINING, Remedy.SIMULATE)]
    if later and corrections:
        k = actions.index(later[0])
        actions[k:k] = corrections
    yield from actions


def _finding_reasons(identification: Identification, use: Use) -> Iterator[Reason]:
    """Yield findings of the checks and notes that forbid a use, each kind once."""
    notes = (Finding(x, severity=x.severity) for x in (*identification.estimate.notes, *identification.notes))
    kinds: dict[object, list[Finding]] = {}
    for finding in (*identification.findings, *notes):
        if finding.forbids is use:
            kinds.setdefault(finding.kind, []).append(finding)
    yield from (why.ForbiddingFindings(tuple(group)) for group in kinds.values())


def _constraint_reasons(identification: Identification) -> dict[Use, tuple[Reason, ...]]:
    """Return the reason of constraints or a prior that hold the estimate back, by the use that it forbids.

    It is a sign of an effect that the model lacks, or of a wrong gain or direction. Least squares itself holds
    nothing back.
    """
    if identification.estimate.consistency is None:
        return {}
    effect = constraint_effect(identification)
    if effect.growth < MAX_RESIDUAL_GROWTH or effect.torque_change < min(MAX_TORQUE_CHANGE):
        return {}
    kind = why.DrawnBack if isinstance(identification.recipe.estimator, Ridge) else why.HeldBack
    reason = kind(effect.growth, effect.torque_change)
    return {Use.CONTROL if effect.torque_change > max(MAX_TORQUE_CHANGE) else Use.SIMULATION: (reason,)}


def _against_use(identification: Identification) -> Iterator[Reason]:
    """Yield the reasons against any use."""
    held_out, train = identification.of_role("validation"), identification.of_role("train")
    if not held_out:
        yield why.NoHoldOut()
    # Held-out logs that repeat the training say nothing about other motions.
    repetitions = {a.name: b.name for a in held_out for b in train if repeats_path(a.motion, b.motion)}
    if held_out and len(repetitions) == len(held_out):
        yield why.Repeats(tuple(repetitions.items()))
    joints = [joint.name for joint in identification.model.joints]
    if silent := [
        name for k, name in enumerate(joints) if not any(np.ptp(validation.motion.tau[:, k]) for validation in train)
    ]:
        yield why.SilentTorque(tuple(silent))
    worst = _worst_log(train)
    trained, largest = worst.errors.in_fit, max((log.errors.in_fit for log in held_out), default=0.0)
    for log in held_out:
        yield from _log_reasons(log, trained)
        if bad := [joint for joint in _imprecise_joints(log) if _is_harmful(identification, log, joint)]:
            errors = tuple((joint, log.errors.joints_in_fit[joint]) for joint in bad)
            yield why.JointErrorsTooLarge(log.name, errors, MAX_JOINT_ERROR)
    if trained > MAX_TORQUE_ERROR and trained > MAX_ERROR_RATIO * largest > 0:  # nan where the held-out torque is zero
        yield why.TrainedWorse(worst.name, trained, trained / largest)
    if identification.mass and not identification.mass.positive:
        yield why.MassMatrixNotPositive(identification.mass.smallest)
    lost, total = _count_unexcited(identification)
    if lost > MAX_UNEXCITED_SHARE * total:
        yield why.MostlyUnexcited(lost, total)


def _log_reasons(log: LogValidation, trained: float) -> Iterator[Reason]:
    """Yield the reasons in the torque error of one held-out log; ``trained`` is the error (%) in training."""
    error = log.errors.in_fit
    if not error <= MAX_TORQUE_ERROR:
        yield why.TorqueErrorTooLarge(log.name, error, MAX_TORQUE_ERROR)
    if error != log.errors.relative_error and not log.errors.relative_error <= MAX_UNFILTERED_ERROR:
        yield why.UnfilteredErrorTooLarge(log.name, log.errors.relative_error, MAX_UNFILTERED_ERROR)
    if error > MAX_ERROR_RATIO * trained and error > MAX_TORQUE_ERROR / 2:
        yield why.NotCarriedOver(log.name, error / trained)


def _joint_reasons(identification: Identification) -> Iterator[Reason]:
    """Yield the reasons in single joints of the held-out logs, which do no harm to control."""
    # a free simulation that was run judges that itself
    for log in identification.of_role("validation") if not identification.runs else ():
        if joints := tuple((joint, floor) for joint, floor in log.floors.items() if _is_above_floor(log, joint, floor)):
            yield why.AboveFloor(log.name, joints)
    for log in identification.of_role("validation"):
        if weak := [joint for joint in _imprecise_joints(log) if not _is_harmful(identification, log, joint)]:
            sizes = tuple((joint, log.errors.joints_in_fit[joint], log.errors.rmse[joint]) for joint in weak)
            yield why.WeakJoints(log.name, sizes)


def _against_simulation(identification: Identification) -> Iterator[Reason]:
    """Yield the reasons against a simulation, which turns small physical faults into growing errors."""
    yield from _joint_reasons(identification)
    error = identification.fact("announced error", lambda: announced_error(identification))
    if error is not None and error > MAX_ANNOUNCED_ERROR:
        yield why.Uncertain(error)
    lost, total = _count_unexcited(identification)
    if 0 < lost <= MAX_UNEXCITED_SHARE * total:
        yield why.PartlyUnexcited(lost, total)
    if (share := _speed_share(identification)) < MIN_SPEED_SHARE:
        yield why.SlowHoldOut(share)
    estimate, parameters = identification.estimate, identification.model.parameters
    pairs = zip(parameters, estimate.value, strict=True)
    negative = [x.name for x, value in pairs if x.role in ("viscous", "coulomb", "rotor", "mass") and value < 0]
    if negative:
        yield why.NegativeValues(tuple(negative))
    bodies = any(parameter.role in INERTIAL for parameter in parameters)
    # Eigenvalues of the pseudo-inertias; a tolerance for values on the boundary of the cone.
    smallest = estimate.consistency.eigenvalues.values() if estimate.consistency else ()
    if bodies and not (smallest and min(smallest) >= -1e-9):
        yield why.InertiasFree()
    failed = [(run.name, run.failure) for run in identification.runs if run.failure]
    if not identification.runs:
        yield why.NoFreeRun()
    elif failed:
        yield why.FreeRunFails(tuple(name for name, _ in failed), failed[0][1])
    else:
        run, joint, error = _largest_motion_error(identification)
        if not error <= (MAX_LOOP_ERROR if run.driver is Driver.CONTROLLER else MAX_WINDOW_ERROR):
            yield why.FreeRunAstray(run.name, joint, error, run.driver, run.restart)


def _speed_share(identification: Identification) -> float:
    """Return the rms speed of the fastest held-out motion relative to the fastest training motion.

    Each joint counts relative to its own speed.
    """
    held_out, train = (
        np.array([np.sqrt(np.mean(x.motion.dq[x.motion.mask] ** 2, axis=0)) for x in identification.of_role(role)])
        for role in ("validation", "train")
    )
    # Joints that rest in training have no speed to compare with.
    fastest = train.max(axis=0)
    moving = fastest > 0
    if not len(held_out) or not moving.any():
        return 1.0
    return float(np.sqrt(np.mean((held_out[:, moving] / fastest[moving]) ** 2, axis=1)).max())


def _largest_motion_error(identification: Identification) -> tuple[FreeRun, str, float]:
    """Return the free simulation and the joint with the largest position error, in % of its motion."""
    errors = [(run, joint, error) for run in identification.runs for joint, error in run.motion_error.items()]
    return max(errors, key=lambda entry: -1.0 if np.isnan(entry[2]) else entry[2])


def _worst_run(identification: Identification) -> WorstRun | None:
    if not identification.runs or any(run.failure for run in identification.runs):
        return None
    run, joint, error = _largest_motion_error(identification)
    return WorstRun(run.name, joint, error)


def _held_out(identification: Identification) -> HeldOut | None:
    held_out = identification.of_role("validation")
    if not held_out:
        return None
    worst, trained = map(_worst_log, (held_out, identification.of_role("train")))
    filtered = worst.errors.relative_error_filtered is not None
    unfiltered = (worst.errors.relative_error, trained.errors.relative_error) if filtered else None
    return HeldOut(worst.errors.in_fit, trained.errors.in_fit, unfiltered)


def _largest_residual(identification: Identification) -> LargestResidual | None:
    """Return the largest torque residual; one that is not white is advice, not a reason."""
    logs = identification.of_role("validation") or identification.of_role("train")
    sizes = [
        (log.floors.get(joint), log.errors.rmse[joint] * log.errors.joints_in_fit[joint], log, joint, test)
        for log in logs
        for joint, test in log.residuals.items()
        if np.isfinite(log.errors.joints_in_fit[joint]) and np.isfinite(test.lag1)
    ]
    if not sizes:
        return None
    # what is at the noise floor comes last: much of a large torque may be its noise
    floor, _, log, joint, test = max(sizes, key=lambda entry: (entry[0] is None or not entry[0].is_reached, entry[1]))
    return LargestResidual(joint, log.name, test.causes, floor, log.over_floor, log.at_floor)


def _worst_log(logs: Sequence[LogValidation]) -> LogValidation:
    return max(logs, key=lambda log: log.errors.in_fit)


def _imprecise_joints(log: LogValidation) -> list[str]:
    return [joint for joint, error in log.errors.joints_in_fit.items() if error > MAX_JOINT_ERROR]


def _is_harmful(identification: Identification, log: LogValidation, joint: str) -> bool:
    """Return whether a joint's error matters beside what it can exert, and is more than the noise of its sensor."""
    if joint in log.floors and log.floors[joint].is_reached:
        return False
    if joint in log.errors.effort_share:
        return log.errors.effort_share[joint] >= HARMLESS_EFFORT_SHARE
    column = [x.name for x in identification.model.joints].index(joint)
    largest = max(float(np.abs(other.motion.tau[:, column]).max(initial=0.0)) for other in identification.validations)
    return 100.0 * log.errors.rmse[joint] >= HARMLESS_TORQUE_SHARE * largest


def _is_above_floor(log: LogValidation, joint: str, floor: NoiseFloor) -> bool:
    """Return whether a joint's torque has an error beside the noise of the sensors that is large, and no chance."""
    excess = log.errors.per_joint[joint] * np.sqrt(max(1.0 - floor.ratio**-2, 0.0))
    return bool(floor.ratio > MAX_FLOOR_RATIO and excess > MAX_EXCESS_ERROR)


def _count_unexcited(identification: Identification) -> tuple[int, int]:
    """Return the number of base parameters that the data do not excite, and the number of all."""
    base, estimate = identification.base, identification.estimate
    if base.on_data is None or base.structural is None:
        rank, total = estimate.determined.rank, len(estimate.names)
    else:
        rank, total = base.on_data.rank, base.structural.rank
    return max(total - rank, 0), total
