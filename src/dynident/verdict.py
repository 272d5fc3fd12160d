"""The verdict on an identification in words, by rules that are written down: is the model fit for use, and if not, why?

The rules and the reasons for their limits are in docs/methods.md.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dynident.control import FreeRun
from dynident.identify import Identification
from dynident.log import Motion, subsample
from dynident.terms.term import INERTIAL
from dynident.validation import LogValidation, relative_error

__all__ = ["Verdict", "judge"]

Array = NDArray[np.float64]
Word = Literal["good for control", "good for simulation", "do not use"]

TORQUE = 10.0  # %, held-out torque error up to which a feedforward helps
UNFILTERED = 25.0  # %, the same where the fit has a low-pass: what the filter may take away
JOINT = 25.0  # %, the same of one joint
SMALL = 1.0  # %, of a joint's effort limit: errors below it do no harm, whatever they are of a small torque
GAP = 2.0  # held-out error over training error
REPEAT = 10.0  # %, torques of two logs that differ by less are of the same motion
MISSING = 0.25  # share of the base parameters that the data may leave out
LOOP, WINDOW = 1.0, 25.0  # %, position error of the free simulation: with the controller; from the measured torque
UNSURE = 0.3  # standard error over value from which a parameter wants better data
EFFECT = 1.0  # %, of the torque, that the standard error must be worth for that
MOST = 5  # next steps on single parameters


@dataclass(frozen=True)
class Verdict:
    """What a model is fit for: one ``word``, three ``sentences``, all ``reasons`` against more, and what to do next.

    "good for simulation" includes control. ``reasons`` are empty only for it.
    """

    word: Word
    sentences: tuple[str, str, str]
    reasons: tuple[str, ...]
    next_steps: tuple[str, ...]


@dataclass(frozen=True)
class _Reason:
    """One reason against a use, and what to do about it."""

    words: str
    remedy: str = ""


def judge(found: Identification) -> Verdict:
    """Judge an identification by its held-out logs, its mass matrix and free simulations; a pure function."""
    against_use, against_simulation = tuple(_against_use(found)), tuple(_against_simulation(found))
    word: Word = "do not use" if against_use else "good for control" if against_simulation else "good for simulation"
    all_reasons = (*against_use, *against_simulation)
    reasons = tuple(reason.words for reason in all_reasons)
    remedies = [reason.remedy for reason in all_reasons if reason.remedy]
    sentences = (f"{_FIRST[word]}: {_errors(found)}.", _second(found, word, reasons), _third(found))
    return Verdict(word, sentences, reasons, tuple(dict.fromkeys([*remedies, *_next_steps(found)])))


_FIRST: dict[Word, str] = {
    "do not use": "Do not use this model yet",
    "good for control": "Good for control (feedforward, gravity compensation) on motions like these",
    "good for simulation": "Good for simulation and control on motions like these",
}
_HOLD_OUT = "Record another motion and name it under `validation`; windows of one recording do for a first look."
_OTHER = "Record a motion of other paths and speeds to hold out; a repeat only shows how repeatable the robot is."
_CLOSER = (
    "Run `dynident check` on the configuration: it asks about signs, gains, units and gravity. Then look at the "
    "residuals of the largest joints below; other friction terms or less noise in the motion may help."
)
_COLUMN = "Look whether the right torque column is named, and was recorded."
_LONGER = "Record a longer training motion that covers the speeds and accelerations of the held-out one."
_PHYSICAL = "Fit with `estimator: {kind: consistent}`: bodies and friction are then possible, the mass matrix positive."
_SIMULATE = "Add `simulation:` to the configuration: the controller where it is known, else `kind: measured_torque`."
_LOOP = "Simulate in the loop of the controller, where it is known: an arm driven by torque alone drifts for any model."


def _against_use(found: Identification) -> Iterator[_Reason]:
    """Yield what stands against any use."""
    held, train = _logs(found, "validation"), _logs(found, "train")
    if not held:
        yield _Reason("no log was held out, so nothing shows how the model does on unseen motion", _HOLD_OUT)
    again = {a.name: b.name for a in held for b in train if _repeat(a.motion, b.motion)}
    if held and len(again) == len(held):
        repeats = ", ".join(f"{name} repeats the motion of {other}" for name, other in again.items())
        yield _Reason(f"{repeats}: nothing shows how the model does on another motion", _OTHER)
    silent = [
        joint.name for k, joint in enumerate(found.model.joints) if not any(one.motion.tau[:, k].any() for one in train)
    ]
    if silent:
        yield _Reason(f"the torque of {', '.join(silent)} is zero in all of the training: nothing shows it", _COLUMN)
    for log in held:
        yield from _wrong(log, max(map(_error, train)))
    if found.mass and not found.mass.positive:
        yield _Reason(f"the mass matrix is not positive definite (eigenvalue {found.mass.smallest:.3g})", _PHYSICAL)
    lost, whole = _missing(found)
    if lost > MISSING * whole:
        yield _Reason(f"the data do not show {lost} of {whole} base parameters")


def _wrong(log: LogValidation, trained: float) -> Iterator[_Reason]:
    """Yield what is wrong with the torque on one held-out log; ``trained`` is the error (%) in training."""
    error = _error(log)
    if not error <= TORQUE:
        yield _Reason(f"the torque error on {log.name} is {error:.3g} %, above {TORQUE:g} %", _CLOSER)
    if error != log.relative_error and not log.relative_error <= UNFILTERED:
        words = f"unfiltered, the torque error on {log.name} is {log.relative_error:.3g} %, above {UNFILTERED:g} %"
        yield _Reason(words, _CLOSER)
    bad = [f"{joint} {size:.3g} %" for joint, size in _joints(log).items() if _harmful(log, joint, size)]
    if bad:
        words = f"on {log.name} single joints have a torque error above {JOINT:g} %: {', '.join(bad)}"
        yield _Reason(words, _LONGER)
    if error > GAP * trained and error > TORQUE / 2:
        words = f"the error on {log.name} is {error / trained:.2g} times that of the training: it does not carry over"
        yield _Reason(words, _LONGER)


def _against_simulation(found: Identification) -> Iterator[_Reason]:
    """Yield what stands against a simulation, which turns small physical flaws into growing errors."""
    lost, whole = _missing(found)
    if 0 < lost <= MISSING * whole:
        yield _Reason(f"the data do not show {lost} of {whole} base parameters: what excites them is not predicted")
    estimate, parameters = found.estimate, found.model.parameters
    pairs = zip(parameters, estimate.value, strict=True)
    negative = [x.name for x, value in pairs if x.role in ("viscous", "coulomb", "rotor", "mass") and value < 0]
    if negative:
        shown = ", ".join(negative[:MOST]) + (f" and {len(negative) - MOST} more" if len(negative) > MOST else "")
        yield _Reason(f"negative values that physics forbids: {shown}", _PHYSICAL)
    bodies = any(parameter.role in INERTIAL for parameter in parameters)
    if bodies and not (estimate.eigenvalues and min(estimate.eigenvalues.values()) >= -1e-9):
        yield _Reason("the bodies' inertias were not held to what is physically possible", _PHYSICAL)
    failed = [run for run in found.runs if run.failure]
    if not found.runs:
        yield _Reason("no free simulation was asked for", _SIMULATE)
    elif failed:
        yield _Reason(f"the free simulation of {', '.join(run.name for run in failed)} fails: {failed[0].failure}")
    else:
        yield from _astray(*_worst_run(found))


def _astray(run: FreeRun, joint: str, error: float) -> Iterator[_Reason]:
    looped = run.driver == "controller"
    if not error <= (LOOP if looped else WINDOW):
        way = "in the controller's loop" if looped else f"within {run.restart:g} s of the measured torque"
        words = f"the free simulation of {run.name} is off by {_percent(error)} of the way of {joint} {way}"
        yield _Reason(words, "" if looped else _LOOP)


def _worst_run(found: Identification) -> tuple[FreeRun, str, float]:
    """Return the free simulation and the joint with the largest position error, % of its way."""
    every = [(run, joint, error) for run in found.runs for joint, error in run.motion_error.items()]
    return max(every, key=lambda one: -1.0 if np.isnan(one[2]) else one[2])


def _errors(found: Identification) -> str:
    held = _logs(found, "validation")
    if not held:
        return "no log was held out"
    worst, trained = max(held, key=_error), max(_logs(found, "train"), key=_error)
    if worst.relative_error_filtered is None:
        return (
            f"on held-out motion it leaves {worst.relative_error:.3g} % of the torque unexplained, "
            f"in training {trained.relative_error:.3g} %"
        )
    return (
        f"on held-out motion it leaves {_error(worst):.3g} % of the torque unexplained after the low-pass of the fit "
        f"(training {_error(trained):.3g} %), and {worst.relative_error:.3g} % of it as measured "
        f"({trained.relative_error:.3g} %)"
    )


def _second(found: Identification, word: Word, reasons: tuple[str, ...]) -> str:
    if not reasons:
        run, joint, error = _worst_run(found)
        return (
            "Its mass matrix is positive definite in all poses tried, and its free simulation is off by at "
            f"most {_percent(error)} of the way ({joint}, {run.name})."
        )
    more = f"; and {len(reasons) - 2} more" if len(reasons) > 2 else ""
    what = "Against its use" if word == "do not use" else "Not for simulation"
    return f"{what}: {'; '.join(reasons[:2])}{more}."


def _third(found: Identification) -> str:
    """Say where the worst joint's error comes from; a residual that is not white is advice, not a reason."""
    logs = _logs(found, "validation") or _logs(found, "train")
    sizes = {
        (log.name, joint): (log.rmse[joint] * _joints(log)[joint], test)
        for log in logs
        for joint, test in log.residuals.items()
        if np.isfinite(_joints(log)[joint]) and np.isfinite(test.lag1)
    }
    if not sizes:
        return "Nothing can be said of what is left of the torque."
    (log_name, joint), (_, test) = max(sizes.items(), key=lambda one: one[1][0])
    points = f"points to {test.words}" if test.words else "has no single cause"
    return f"What is left of the torque is largest in {joint} ({log_name}) and {points}."


def _next_steps(found: Identification) -> Iterator[str]:
    """Yield what to record next, beyond the remedies of the reasons."""
    held = _logs(found, "validation") or _logs(found, "train")
    yield from (one.words for one in found.missing)
    yield from _unsure(found)
    words = {joint: test.words for log in held for joint, test in log.residuals.items()}
    if reversing := [joint for joint, said in words.items() if "reversals" in said]:
        yield f"{', '.join(reversing)}: record slow motion through zero speed, or try `coulomb_width` or `slow`."
    if rippled := [joint for joint, said in words.items() if "a ripple at" in said]:
        yield f"{', '.join(rippled)}: record constant speeds to see whether the ripple follows the position."


def _unsure(found: Identification) -> Iterator[str]:
    """Yield which motion would sharpen the parameters that are known least, of those that move the torque."""
    basis = found.basis
    if basis is None:
        value, names, std = found.estimate.value, found.estimate.names, found.std_hac
        leads: tuple[int, ...] = tuple(range(len(value)))
    else:
        value, names, leads = basis.to_base(found.estimate.value), basis.groupings, basis.independent
        std = found.base_std if found.base_std_hac is None else found.base_std_hac
    if std is None:
        return
    share = 100.0 * std * _effects(found)[list(leads)]
    unsure = np.flatnonzero((std > UNSURE * np.abs(value)) & (share > EFFECT) & np.isfinite(std))
    for k in sorted(unsure, key=lambda k: -share[k])[:MOST]:
        yield (
            f"{names[k]} is {value[k]:.3g} +- {std[k]:.2g} (one standard error, {_percent(share[k])} of the torque): "
            f"{_motion_for(found, leads[k])}."
        )


def _effects(found: Identification) -> Array:
    """Return the torque of one unit of each parameter (p) over that measured, both rms over the training."""
    columns, torque = [], []
    for log in _logs(found, "train"):
        motion = log.motion
        (rows,) = subsample([motion], 500)
        columns.append(found.model.regressor(motion.q[rows], motion.dq[rows], motion.ddq[rows]))
        torque.append(motion.tau[rows])
    size = float(np.linalg.norm(np.concatenate(torque)))
    return np.asarray(np.linalg.norm(np.concatenate(columns), axis=(0, 1)) / (size or 1.0), dtype=np.float64)


def _motion_for(found: Identification, column: int) -> str:
    """Say which motion shows a parameter: it acts on the torque by position, velocity or acceleration."""
    model, n = found.model, len(found.model.joints)
    rng = np.random.default_rng(0)
    q, dq, ddq = rng.uniform(-1.0, 1.0, (3, 20, n))
    still = np.zeros_like(q)
    whole = model.regressor(q, dq, ddq)[:, :, column]
    acting = [joint.name for joint, size in zip(model.joints, np.abs(whole).max(axis=0), strict=True) if size > 1e-9]
    joint = acting[-1] if acting else "the joints"
    role = model.parameters[column].role
    if role in ("viscous", "coulomb"):
        return f"move {joint} at several constant speeds in both directions"
    if np.abs(model.regressor(q, still, still)[:, :, column]).max() > 1e-9:
        return f"hold {joint} still or move it slowly in many poses"
    if np.abs(model.regressor(q, still, ddq)[:, :, column]).max() > 1e-9:
        return f"accelerate {joint} harder, in several poses of the others"
    return f"move {joint} at several constant speeds in both directions"


def _logs(found: Identification, role: str) -> list[LogValidation]:
    return [log for log in found.logs if log.role == role]


def _error(log: LogValidation) -> float:
    """Return the error that the model is asked to keep small: after the low-pass of the fit, where one is used."""
    return log.relative_error if log.relative_error_filtered is None else log.relative_error_filtered


def _joints(log: LogValidation) -> dict[str, float]:
    return dict(log.per_joint_filtered or log.per_joint)


def _harmful(log: LogValidation, joint: str, error: float) -> bool:
    return error > JOINT and not log.effort_share.get(joint, np.inf) < SMALL


def _missing(found: Identification) -> tuple[int, int]:
    """Return how many base parameters the data leave out, and how many there are."""
    if found.basis is None or found.structural is None:
        return max(len(found.estimate.names) - found.estimate.rank, 0), len(found.estimate.names)
    return max(found.structural.rank - found.basis.rank, 0), found.structural.rank


def _percent(value: float) -> str:
    return f"{value:.2g} %" if value < 10 else f"{value:.0f} %"


def _repeat(one: Motion, other: Motion) -> bool:
    """Tell whether the torques of two motions are the same, time by time from their starts."""
    t = one.t - one.t[0]
    use = one.mask & (t <= other.t[-1] - other.t[0])
    if use.sum() < max(0.5 * one.mask.sum(), 10):
        return False
    twin = np.column_stack([np.interp(t[use], other.t - other.t[0], column) for column in other.tau.T])
    return relative_error(one.tau[use], twin) < REPEAT
