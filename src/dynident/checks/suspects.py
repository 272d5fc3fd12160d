"""Values that may be wrong: gains, gears, the clock, zeros, lengths and axes; and the ripple of a joint's torque."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import product
from typing import Any

import numpy as np

from dynident.checks import robot_notes
from dynident.checks.misfit import MAX_CUTOFF, FitCase, Misfit, ScoreTest, misfit
from dynident.checks.robot_notes import Rival, SuspectedValue, SuspectQuantity, TermKind
from dynident.checks.torque import rms_speed
from dynident.models import Joint, Model
from dynident.models.robot_files import RobotJoint
from dynident.runtime import Noun
from dynident.runtime.arrays import Array

Rivals = tuple[Rival, ...]
Note = Callable[[float, float, float, Rivals], SuspectedValue]

# standard errors from zero: many unknowns are tested, and the errors are themselves uncertain
MIN_STANDARD_ERRORS = 6.0
MAX_STEPS = 8
MAX_SETTLED_STEP = 0.1  # of a standard error: a smaller step ends the search


class Suspect(Noun):
    """An unknown of a ``joint`` (None: of all), with what is needed to test and to correct it.

    ``correct_case`` returns the case with it corrected; ``note`` makes the note from its value, standard error,
    share and the rivals that explain as much. ``limit`` is the largest plausible value; of suspects that explain
    about the same the one of the lowest ``order`` is reported; a value beyond ``usual`` comes after all others, one
    below ``least`` is none. What is wrong ``only_in_log`` is right in the motion that the user meets.
    """

    joint: str | None
    quantity: SuspectQuantity
    correct_case: Callable[[FitCase, float], FitCase]
    note: Note
    limit: float
    order: float
    usual: float = np.inf
    least: float = 0.0
    only_in_log: bool = False

    def derivative(self, fit: Misfit) -> Array:
        """Return that of the torque (M, n) at the fitted parameters: exact of a gain, else by a forward difference."""
        if self.quantity is SuspectQuantity.GAIN:
            j = [joint.name for joint in fit.case.model.joints].index(str(self.joint))
            return fit.case.column_of_joint(j, fit.torque[:, j])
        torque = self.correct_case(fit.case, DIFFERENCE_STEP).torque(fit.theta)
        return np.asarray((torque - fit.torque) / DIFFERENCE_STEP)


class SuspectEstimate(Noun):
    """The estimate of a suspect: ``value``, ``std``, the ``share`` that it explains, and the corrected case."""

    suspect: Suspect
    value: float
    std: float
    share: float
    case: FitCase

    @property
    def order(self) -> tuple[bool, float]:
        """The place among others that explain as much: a usual value of a likely fault comes first."""
        return abs(self.value) > self.suspect.usual, self.suspect.order

    @property
    def rival(self) -> Rival:
        """The estimate in short, for the note of another suspect."""
        quantity = self.suspect.quantity
        is_factor = quantity in (SuspectQuantity.GAIN, SuspectQuantity.GEAR, SuspectQuantity.CLOCK)
        value = float(np.exp(self.value)) if is_factor else self.value
        return Rival(self.suspect.joint or "", quantity, value)


def is_convincing(score: ScoreTest, worth: float) -> bool:
    """Return whether an unknown explains enough, in the whole data and in each part, not to be due to chance."""
    clear = score.share > worth and score.held_out > worth and score.has_constant_sign  # what is quick is asked first
    return clear and abs(score.value) > MIN_STANDARD_ERRORS * score.std


def promising_suspects(fit: Misfit, suspects: Sequence[Suspect]) -> Iterator[tuple[Suspect, ScoreTest]]:
    """Yield the suspects whose first step is convincing, with the score test of it."""
    scores = fit.score_tests(suspect.derivative(fit) for suspect in suspects)
    for suspect, score in zip(suspects, scores, strict=True):
        # half of the share that is required in the end, as one step may explain only half of several
        if score is not None and is_convincing(score, fit.min_share / 2):
            yield suspect, score


def estimate_suspect(fit: Misfit, suspect: Suspect) -> SuspectEstimate | None:
    """Return the estimate of a suspect by Gauss-Newton steps.

    None where it is not plausible, or explains too little.
    """
    case, value, std = fit.case, 0.0, np.inf
    weight = fit.weight.max(axis=0)
    # correct by at most half of the limit at a time: the derivative holds only for small values
    for _ in range(MAX_STEPS):
        current_fit = misfit(case, weight)
        (score,) = current_fit.score_tests([suspect.derivative(current_fit)])
        if score is None:
            return None
        step = float(np.clip(score.value, -suspect.limit / 2, suspect.limit / 2))
        case, value, std = suspect.correct_case(case, step), value + step, score.std
        if abs(value) > suspect.limit:
            return None
        if abs(step) < MAX_SETTLED_STEP * std:
            break
    share = 1.0 - misfit(case, weight).size / fit.size
    is_clear = share > fit.min_share and abs(value) > max(MIN_STANDARD_ERRORS * std, suspect.least)
    return SuspectEstimate(suspect, value, std, share, case) if is_clear else None


MIN_BEYOND_OWN = 0.6  # share of what a gear or clock explains that must remain beside effects of single joints
MAX_WORSENING = 0.02  # share by which it may raise a joint's squared residual there
SIGN_WIDTH, STRIBECK_SPEED = 0.05, 0.2  # of the rms speed: widths of a smooth sign, and of friction that falls


def is_beyond_own_effects(fit: Misfit, estimate: SuspectEstimate) -> bool:
    """Return whether a gear or a clock explains what effects of single joints would not; True for other suspects.

    They scale also friction, springs and rotors, so that they take up a part of what these lack: only the coupling
    of the joints and gravity tell what they are.
    """
    names = [joint.name for joint in fit.case.model.joints]
    affected = names if estimate.suspect.joint is None else [estimate.suspect.joint]
    if estimate.suspect.quantity not in (SuspectQuantity.GEAR, SuspectQuantity.CLOCK):
        return True
    columns = [column for name in affected for column in _own_effects(fit, names.index(name))]
    weight = fit.weight.max(axis=0)
    before, after = (
        np.square(misfit(replace(case, extra=(*case.extra, *columns)), weight).residual).sum(axis=0)
        for case in (fit.case, estimate.case)
    )
    explains = before.sum() - after.sum() > MIN_BEYOND_OWN * estimate.share * before.sum()
    return bool(explains and (after <= (1.0 + MAX_WORSENING) * before).all())


def motion_shapes(case: FitCase, speed: Array) -> dict[TermKind, Callable[[int], Array]]:
    """Return the shapes (M) of effects that a joint has by its motion alone, as functions of its number.

    Signs turn over a fraction of the rms ``speed`` (n): a jump would test the noise of the velocity.
    """
    q, dq = case.q, case.dq
    sign = np.tanh(dq / (SIGN_WIDTH * speed))
    return {
        TermKind.VISCOUS: lambda j: dq[:, j],
        TermKind.COULOMB: lambda j: sign[:, j],
        TermKind.OFFSET: lambda _: np.ones(len(q)),
        TermKind.ROTOR: lambda j: case.ddq[:, j],
        TermKind.SPRING: lambda j: q[:, j],
        TermKind.ASYMMETRIC: lambda j: np.abs(dq[:, j]),
        TermKind.QUADRATIC: lambda j: np.abs(dq[:, j]) * dq[:, j],
        TermKind.STRIBECK: lambda j: sign[:, j] * np.exp(-np.abs(dq[:, j]) / (STRIBECK_SPEED * speed[j])),
    }


def _own_effects(fit: Misfit, j: int) -> list[Array]:
    """Return the columns (M, n) of friction, spring, rotor and ripple of a joint."""
    case, ripple = fit.case, find_ripple(fit, j)
    shapes = [shape(j) for shape in motion_shapes(case, rms_speed(case.dq)).values()]
    if ripple is not None:
        shapes += [wave(2 * np.pi / ripple[0] * case.q[:, j]) for wave in (np.sin, np.cos)]
    return [case.column_of_joint(j, x) for x in shapes]


MAX_LOG_GAIN = 3.0  # natural logarithm of a gain: a factor of 20
GAIN_ORDER = 1


def gain_suspects(model: Model) -> list[Suspect]:
    """Return the suspects that the gain of one joint is wrong, by its logarithm; none for an arm of one joint."""

    def correct_case(j: int, case: FitCase, value: float) -> FitCase:
        return replace(case, gain=case.gain * _factor_of_joint(case, j, value))

    note = _note_of_logarithm(robot_notes.TorqueGain)
    return [
        Suspect(joint.name, SuspectQuantity.GAIN, partial(correct_case, j), note, MAX_LOG_GAIN, GAIN_ORDER)
        for j, joint in enumerate(model.joints)
        if len(model.joints) > 1
    ]


def _factor_of_joint(case: FitCase, j: int, logarithm: float) -> Array:
    """Return factors (n) that are one for all joints but j."""
    return np.where(np.arange(case.q.shape[1]) == j, np.exp(logarithm), 1.0)


def _note_of_logarithm(kind: type[SuspectedValue]) -> Note:
    """Return a function for the note of a factor, given its logarithm."""

    def note(value: float, std: float, share: float, rivals: Rivals) -> SuspectedValue:
        factor = float(np.exp(value))
        return kind(factor, factor * std, share, rivals)

    return note


MAX_LOG_FACTOR = 1.0  # natural logarithm of the factor
CLOCK_ORDER = 5  # stamps are wrong less often than robot files
MIN_LOG_GEAR = 0.03  # of the logarithm: smaller ones are no other gear, but an offset that is small, too
GEAR_ORDER = 1.5  # positions share their gear with the torque, where it is wrong more often


def gear_suspects(model: Model) -> list[Suspect]:
    """Return the suspects that the positions of one joint have a wrong factor, by the logarithm of the true one."""

    def correct_case(j: int, case: FitCase, value: float) -> FitCase:
        factor = _factor_of_joint(case, j, value)
        return replace(case, q=factor * case.q, dq=factor * case.dq, ddq=factor * case.ddq, dddq=factor * case.dddq)

    note, kind = _note_of_logarithm(robot_notes.PositionGear), SuspectQuantity.GEAR
    limits = {"limit": MAX_LOG_FACTOR, "order": GEAR_ORDER, "least": MIN_LOG_GEAR}
    return [
        Suspect(joint.name, kind, partial(correct_case, j), note, **limits, only_in_log=True)
        for j, joint in enumerate(model.joints)
    ]


def clock_suspect() -> Suspect:
    """Return the suspect that the clock is wrong; its value is the logarithm of true seconds per stamped second.

    A factor of all accelerations is absorbed by rotor inertias and bodies, but gravity and friction that falls
    with speed do not change.
    """

    def correct_case(case: FitCase, value: float) -> FitCase:
        rate = float(np.exp(-value))
        return replace(case, dq=rate * case.dq, ddq=rate**2 * case.ddq, dddq=rate**3 * case.dddq)

    note, kind = _note_of_logarithm(robot_notes.ClockWrong), SuspectQuantity.CLOCK
    return Suspect(None, kind, correct_case, note, MAX_LOG_FACTOR, CLOCK_ORDER, only_in_log=True)


DIFFERENCE_STEP = 1e-5  # rad, m, or of a logarithm, of the differences
MAX_USUAL_CHANGE, MAX_USUAL_SHIFT = 1 / 3, 0.05  # share of a length in the file, and m where it has none there
MAX_ZERO, MAX_ANGLE, MAX_LENGTH = 1.2, 0.6, 0.6  # rad, rad, m: zeros are often those of another frame
ZERO_ORDER, ORIGIN_ORDER, NEW_ORIGIN_ORDER, AXIS_ORDER = 0, 2, 3, 4  # orders: the likeliest fault first


def geometry_suspects(model: Model) -> list[Suspect]:
    """Return the suspects for the zero of each joint and, where a term has frames, for their origins and axes."""
    suspects = [_zero_suspect(j, joint) for j, joint in enumerate(model.joints)]
    for term in model.terms:
        if term.file is not None and term.has_own("with_displacement"):
            frames = {joint.name: joint for joint in term.file.joints}
            for joint in model.joints:
                if (frame := frames.get(joint.name)) is not None:
                    suspects += [_origin_suspect(frame, k) for k in range(3)]
                    pairs = product(_perpendicular_axes(frame.axis), (False, True))
                    suspects += [_axis_suspect(frame, direction, alone) for direction, alone in pairs]
    return suspects


def displace_joint(model: Model, joint: str, displacement: Array) -> Model:
    """Return the model with the frame of a joint displaced (6 or 9 components), as ``Term.with_displacement`` defines
    it.
    """
    move = tuple(map(float, displacement))
    return replace(model, terms=tuple(term.with_displacement(joint, move) for term in model.terms))


def _zero_suspect(j: int, joint: Joint) -> Suspect:
    def correct_case(case: FitCase, value: float) -> FitCase:
        q = case.q.copy()
        q[:, j] += value
        return replace(case, q=q)

    limit = MAX_ZERO if joint.kind == "revolute" else MAX_LENGTH
    return Suspect(joint.name, SuspectQuantity.ZERO, correct_case, robot_notes.ZeroOff, limit, ZERO_ORDER)


def _origin_suspect(joint: RobotJoint, k: int) -> Suspect:
    displacement, nominal = np.eye(9)[k], float(joint.placement[k, 3])

    def note(value: float, *figures: Any) -> SuspectedValue:
        return robot_notes.LengthWrong(nominal + value, *figures, component="xyz"[k], given=nominal)

    order = ORIGIN_ORDER if abs(nominal) > DIFFERENCE_STEP else NEW_ORIGIN_ORDER
    suspect = _frame_suspect(joint.name, displacement, SuspectQuantity.LENGTH, note, MAX_LENGTH, order)
    # robot files are wrong by a part of a length: a link of no length is rather a wrong gain or clock
    return replace(suspect, usual=MAX_USUAL_CHANGE * abs(nominal) if order == ORIGIN_ORDER else MAX_USUAL_SHIFT)


def _axis_suspect(joint: RobotJoint, across: Array, alone: bool) -> Suspect:
    displacement = np.zeros(9)
    displacement[slice(6, 9) if alone else slice(3, 6)] = across
    note = partial(robot_notes.AxisTilted, axis=tuple(np.round(across, 6).tolist()), alone=alone)
    return _frame_suspect(joint.name, displacement, SuspectQuantity.AXIS, note, MAX_ANGLE, AXIS_ORDER)


def _frame_suspect(
    joint: str, displacement: Array, quantity: SuspectQuantity, note: Note, limit: float, order: int
) -> Suspect:
    """Return the suspect that the frame of a joint is moved along a ``displacement`` (9) of unit size."""

    def correct_case(case: FitCase, value: float) -> FitCase:
        return replace(case, model=displace_joint(case.model, joint, value * displacement))

    return Suspect(joint, quantity, correct_case, note, limit, order)


def _perpendicular_axes(axis: Array) -> Array:
    """Return two unit vectors (2, 3) perpendicular to an axis: coordinate axes where the axis is one."""
    # the coordinate axis that is farthest from the given one
    reference = np.eye(3)[int(np.argmin(np.abs(axis)))]
    first_axis = reference - (reference @ axis) * axis
    first_axis /= np.linalg.norm(first_axis)
    return np.array([first_axis, np.cross(axis, first_axis)])


MIN_PERIODS, MAX_PERIODS = 3.0, 100.0  # periods within a joint's range: slower ones are springs and gravity
PERIOD_SPACING = 0.25  # periods within the range, from one that is tried to the next
MIN_RIPPLE_SHARE = 0.1  # share of a joint's squared residual that a period must explain to be looked at closely
GAUSS_NEWTON_STEPS = 2


def find_ripple(fit: Misfit, j: int) -> tuple[float, Array] | None:
    """Return the period (rad or m) of a joint's largest ripple, and the ripple of unit size at the samples (M).

    Returns None where none is likely. Ripples above half of ``MAX_CUTOFF`` at the largest speed are not seen.
    """
    counted = fit.weight[:, j] > 0
    q, residual = fit.case.q[counted, j], fit.residual[counted, j]
    span = float(np.ptp(q)) if len(q) else 0.0
    if not span > 0 or not residual.any():
        return None
    fastest = float(np.abs(fit.case.dq[counted, j]).max())
    # the grid is finer than the width of a peak, so that none falls between two trial rates
    max_periods = min(MAX_PERIODS, MAX_CUTOFF / 2 * span / (fastest or np.inf))
    rates = 2 * np.pi / span * np.arange(MIN_PERIODS, max_periods, PERIOD_SPACING)
    if not len(rates):
        return None
    power = _position_periodogram(q - q.mean(), residual, rates)
    if power.max() < MIN_RIPPLE_SHARE:
        return None
    rate, spacing = float(rates[int(np.argmax(power))]), PERIOD_SPACING * 2 * np.pi / span
    # refine the rate within one grid step; the parameters of the model are eliminated
    for _ in range(GAUSS_NEWTON_STEPS):
        _, step = _fit_ripple(fit, j, rate)
        rate += float(np.clip(step, -spacing, spacing))
    column, _ = _fit_ripple(fit, j, rate)
    return 2 * np.pi / rate, column


def _position_periodogram(q: Array, residual: Array, rates: Array) -> Array:
    """Return the share of a squared residual (M) that a ripple of each rate (1/rad or 1/m, uniform) explains."""
    # rates are equally spaced: rotate the phasors by one factor per rate instead of computing new exponentials
    phasor = np.exp(1j * rates[0] * q) * residual
    step = np.exp(1j * (rates[-1] - rates[0]) / max(len(rates) - 1, 1) * q)
    power = np.empty(len(rates))
    for k in range(len(rates)):
        power[k] = np.abs(phasor.sum()) ** 2
        phasor *= step
    return np.asarray(2.0 * power / (len(q) * np.square(residual).sum()))


def _fit_ripple(fit: Misfit, j: int, rate: float) -> tuple[Array, float]:
    """Return the ripple of unit size (M) that explains the most at a rate, and the Gauss-Newton step of the rate."""
    q = fit.case.q[:, j]
    waves = np.array([np.sin(rate * q), np.cos(rate * q)])
    columns = np.zeros((4, *fit.residual.shape))
    # sine and cosine of the ripple, and their derivatives with respect to the rate
    columns[:, :, j] = *waves, *(q * waves)
    A, residual = fit.orthogonal_part(columns).reshape(4, -1).T, fit.residual.ravel()
    size = np.linalg.lstsq(A[:, :2], residual, rcond=None)[0]
    slope = size[0] * A[:, 3] - size[1] * A[:, 2]  # by the rate
    step = np.linalg.lstsq(np.column_stack([A[:, :2], slope]), residual, rcond=None)[0][2]
    return np.asarray(size @ waves / (np.linalg.norm(size) or 1.0)), float(step)
