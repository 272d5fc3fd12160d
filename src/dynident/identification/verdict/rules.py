"""The rules of the verdict: is the model fit for use, and if not, why?

The rules and the reasons for their limits are in docs/methods.md.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from weakref import WeakKeyDictionary

import numpy as np

from dynident.errors import Finding
from dynident.estimators import Ridge
from dynident.identification.result import Identification
from dynident.identification.verdict import reasons as why
from dynident.identification.verdict.next_steps import next_steps
from dynident.identification.verdict.reasons import Reason
from dynident.identification.verdict.steps import Remedy, Step
from dynident.identification.verdict.unconstrained import held_back
from dynident.identification.verdict.unknown import unknowns
from dynident.identification.verdict.verdict import HeldOut, LargestResidual, Use, Verdict, WorstRun
from dynident.log import Motion
from dynident.models import INERTIAL
from dynident.regression import UnexcitedParameters
from dynident.validation import REPEATED, Driver, FreeRun, LogValidation, repeat_of

__all__ = ["judge"]


TORQUE = 10.0  # %, held-out torque error up to which a feedforward helps
UNFILTERED = 25.0  # %, the same where the fit has a low-pass: what the filter may take away
JOINT = 25.0  # %, the same of one joint
SMALL = 1.0  # %, of a joint's effort limit: smaller errors are harmless, even if large relative to a small torque
GAP = 2.0  # held-out error over training error, or the other way round
MISSING = 0.25  # share of the base parameters that the data may leave out
LOOP, WINDOW = 1.0, 25.0  # %, position error of the free simulation: with the controller; from the measured torque
GROWTH = 5.0  # %, by which physical constraints may raise the residual
APART = (7.0, 1.0)  # %, by which they may change the torque at twice the speed, for control and for simulation
SLOW = 0.5  # share of the speed of the training that the fastest held-out motion must have
_VERDICTS: WeakKeyDictionary[Identification, Verdict] = WeakKeyDictionary()
_DIFFERENCES: WeakKeyDictionary[Motion, WeakKeyDictionary[Motion, float]] = WeakKeyDictionary()


def judge(found: Identification) -> Verdict:
    """Judge an identification by its held-out logs, its mass matrix and free simulations; a pure function.

    It is evaluated once, as each text of a result asks for it.
    """
    if found not in _VERDICTS:
        _VERDICTS[found] = _judged(found)
    return _VERDICTS[found]


def _judged(found: Identification) -> Verdict:
    held = _held_back(found)
    against_use = (*_noted(found, Use.CONTROL), *held.get(Use.CONTROL, ()), *_against_use(found))
    against_simulation = (*_noted(found, Use.SIMULATION), *held.get(Use.SIMULATION, ()), *_against_simulation(found))
    reasons = (*against_use, *against_simulation)
    use = Use.DO_NOT_USE if against_use else Use.CONTROL if against_simulation else Use.SIMULATION
    return Verdict(
        use=use,
        reasons=reasons,
        next=tuple(dict.fromkeys(_ordered(against_use, against_simulation, next_steps(found)))),
        held_out=_held_out(found),
        run=_worst_run(found),
        residual=_largest_residual(found),
        unknown=() if use is Use.DO_NOT_USE else tuple(unknowns(found)),
    )


def _ordered(
    against_use: Sequence[Reason], against_simulation: Sequence[Reason], steps: Sequence[UnexcitedParameters | Step]
) -> Iterator[Remedy | UnexcitedParameters | Step]:
    """Yield what to do: remedies, then motions to record; those for a simulation last where the model is of no use."""
    yield from (reason.remedy for reason in against_use if reason.remedy)
    later = [reason.remedy for reason in against_simulation if reason.remedy]
    yield from (*steps, *later) if against_use else (*later, *steps)


def _noted(found: Identification, use: Use) -> Iterator[Reason]:
    """Yield what the checks and the estimate have found that forbids a use, each kind once."""
    notes = (Finding(note.severity, None, note) for note in found.estimate.notes)
    kinds: dict[object, list[Finding]] = {}
    for one in (*found.findings, *notes):
        if one.forbids is use:
            kinds.setdefault(one.message if isinstance(one.message, str) else type(one.message), []).append(one)
    yield from (why.Noted(tuple(group)) for group in kinds.values())


def _held_back(found: Identification) -> dict[Use, tuple[Reason, ...]]:
    """Return what physical constraints or a prior hold back, under the use that it forbids: an effect that the model
    lacks, a gain or a direction that is wrong. Least squares itself holds nothing back."""
    if found.estimate.consistency is None:
        return {}
    held = held_back(found)
    if held.growth < GROWTH or held.apart < min(APART):
        return {}
    kind = why.DrawnBack if isinstance(found.recipe.estimator, Ridge) else why.HeldBack
    reason = kind(held.growth, held.apart)
    return {Use.CONTROL if held.apart > max(APART) else Use.SIMULATION: (reason,)}


def _against_use(found: Identification) -> Iterator[Reason]:
    """Yield what stands against any use."""
    held, train = _logs(found, "validation"), _logs(found, "train")
    if not held:
        yield why.NoHoldOut()
    again = {a.name: b.name for a in held for b in train if _difference(a.motion, b.motion) < REPEATED}
    if held and len(again) == len(held):
        yield why.Repeats(tuple(again.items()))
    joints = [joint.name for joint in found.model.joints]
    if silent := [name for k, name in enumerate(joints) if not any(np.ptp(one.motion.tau[:, k]) for one in train)]:
        yield why.SilentTorque(tuple(silent))
    for log in held:
        yield from _wrong(log, max(map(_error, train)))
    worst, largest = max(train, key=_error), max(map(_error, held), default=0.0)
    if _error(worst) > TORQUE and _error(worst) > GAP * largest > 0:  # nan where the held-out torque is zero
        yield why.TrainedWorse(worst.name, _error(worst), _error(worst) / largest)
    if found.mass and not found.mass.positive:
        yield why.MassMatrixNotPositive(found.mass.smallest)
    lost, whole = _unexcited(found)
    if lost > MISSING * whole:
        yield why.MostlyUnexcited(lost, whole)


def _difference(one: Motion, other: Motion) -> float:
    """Return how far a motion is from repeating another (%), computed once: each text of a result judges it."""
    known = _DIFFERENCES.setdefault(one, WeakKeyDictionary())
    if other not in known:
        known[other] = repeat_of(one, other).error
    return known[other]


def _wrong(log: LogValidation, trained: float) -> Iterator[Reason]:
    """Yield what is wrong with the torque on one held-out log; ``trained`` is the error (%) in training."""
    error = _error(log)
    if not error <= TORQUE:
        yield why.TorqueErrorTooLarge(log.name, error, TORQUE)
    if error != log.errors.relative_error and not log.errors.relative_error <= UNFILTERED:
        yield why.UnfilteredErrorTooLarge(log.name, log.errors.relative_error, UNFILTERED)
    if bad := tuple((joint, size) for joint, size in _joints(log).items() if _harmful(log, joint, size)):
        yield why.JointErrorsTooLarge(log.name, bad, JOINT)
    if error > GAP * trained and error > TORQUE / 2:
        yield why.NotCarriedOver(log.name, error / trained)


def _against_simulation(found: Identification) -> Iterator[Reason]:
    """Yield what stands against a simulation, which turns small physical faults into growing errors."""
    lost, whole = _unexcited(found)
    if 0 < lost <= MISSING * whole:
        yield why.PartlyUnexcited(lost, whole)
    if (share := _speed_share(found)) < SLOW:
        yield why.SlowHoldOut(share)
    estimate, parameters = found.estimate, found.model.parameters
    pairs = zip(parameters, estimate.value, strict=True)
    negative = [x.name for x, value in pairs if x.role in ("viscous", "coulomb", "rotor", "mass") and value < 0]
    if negative:
        yield why.NegativeValues(tuple(negative))
    bodies = any(parameter.role in INERTIAL for parameter in parameters)
    smallest = estimate.consistency.eigenvalues.values() if estimate.consistency else ()
    if bodies and not (smallest and min(smallest) >= -1e-9):
        yield why.InertiasFree()
    failed = [(run.name, run.failure) for run in found.runs if run.failure]
    if not found.runs:
        yield why.NoFreeRun()
    elif failed:
        yield why.FreeRunFails(tuple(name for name, _ in failed), failed[0][1])
    else:
        yield from _astray(*_straying(found))


def _speed_share(found: Identification) -> float:
    """Return the rms speed of the fastest held-out motion over that of the fastest in training, joints on a par."""
    held, train = (
        np.array([np.sqrt(np.mean(one.motion.dq[one.motion.mask] ** 2, axis=0)) for one in _logs(found, role)])
        for role in ("validation", "train")
    )
    usual = train.max(axis=0)
    moving = usual > 0
    if not len(held) or not moving.any():
        return 1.0
    return float(np.sqrt(np.mean((held[:, moving] / usual[moving]) ** 2, axis=1)).max())


def _astray(run: FreeRun, joint: str, error: float) -> Iterator[Reason]:
    if not error <= (LOOP if run.driver is Driver.CONTROLLER else WINDOW):
        yield why.FreeRunAstray(run.name, joint, error, run.driver, run.restart)


def _straying(found: Identification) -> tuple[FreeRun, str, float]:
    """Return the free simulation and the joint with the largest position error, % of its motion."""
    every = [(run, joint, error) for run in found.runs for joint, error in run.motion_error.items()]
    return max(every, key=lambda one: -1.0 if np.isnan(one[2]) else one[2])


def _worst_run(found: Identification) -> WorstRun | None:
    if not found.runs or any(run.failure for run in found.runs):
        return None
    run, joint, error = _straying(found)
    return WorstRun(run.name, joint, error)


def _held_out(found: Identification) -> HeldOut | None:
    held = _logs(found, "validation")
    if not held:
        return None
    worst, trained = max(held, key=_error), max(_logs(found, "train"), key=_error)
    filtered = worst.errors.relative_error_filtered is not None
    return HeldOut(
        _error(worst),
        _error(trained),
        (worst.errors.relative_error, trained.errors.relative_error) if filtered else None,
    )


def _largest_residual(found: Identification) -> LargestResidual | None:
    """Return where most of the torque is left; a residual that is not white is advice, not a reason."""
    logs = _logs(found, "validation") or _logs(found, "train")
    sizes = [
        (log.errors.rmse[joint] * _joints(log)[joint], log, joint, test)
        for log in logs
        for joint, test in log.residuals.items()
        if np.isfinite(_joints(log)[joint]) and np.isfinite(test.lag1)
    ]
    if not sizes:
        return None
    _, log, joint, test = max(sizes, key=lambda one: one[0])
    return LargestResidual(joint, log.name, test.causes, log.floors.get(joint), log.over_floor, log.at_floor)


def _logs(found: Identification, role: str) -> list[LogValidation]:
    return [log for log in found.validations if log.role == role]


def _error(log: LogValidation) -> float:
    """Return the error that is judged: after the low-pass of the fit, where one is used."""
    filtered = log.errors.relative_error_filtered
    return log.errors.relative_error if filtered is None else filtered


def _joints(log: LogValidation) -> dict[str, float]:
    return dict(log.errors.per_joint_filtered or log.errors.per_joint)


def _harmful(log: LogValidation, joint: str, error: float) -> bool:
    return error > JOINT and not log.errors.effort_share.get(joint, np.inf) < SMALL


def _unexcited(found: Identification) -> tuple[int, int]:
    """Return how many base parameters the data do not excite, and how many there are."""
    if found.base.on_data is None or found.base.structural is None:
        return max(len(found.estimate.names) - found.estimate.determined.rank, 0), len(found.estimate.names)
    return max(found.base.structural.rank - found.base.on_data.rank, 0), found.base.structural.rank
