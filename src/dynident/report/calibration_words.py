"""Text for what was chosen and calibrated before a fit, and for the settings of a run."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from dynident.estimators import instruments
from dynident.estimators.instruments import InstrumentKind
from dynident.estimators.notes import FirstModel, StartedElsewhere, StillSimulating
from dynident.identification import (
    BaseTilt,
    Gain,
    NotFitted,
    NotJudged,
    PriorStrength,
    Rests,
    SmootherChoice,
    SteepBase,
    SubstituteUsed,
    TimeOffset,
)
from dynident.identification.terms import NotChosen, PlainTerms
from dynident.motion.smoothers import strip_time_offset
from dynident.report.note_words import words
from dynident.report.words import part_words, percent, short
from dynident.runtime import join_names

if TYPE_CHECKING:
    from dynident.identification import Identification

KINDS = {
    InstrumentKind.SIMULATED: "the motion that the model makes in the loop of the controller",
    InstrumentKind.REPEATED: "another pass of the same motion",
    InstrumentKind.LAGGED: "the motion before and after each sample",
}

STARTS = {
    FirstModel.SMOOTHED: "least squares of a smoothing spline",
    FirstModel.KALMAN: "least squares of a Kalman smoother",
    FirstModel.CONSISTENT: "the physically consistent fit",
    FirstModel.INSTRUMENTS: "instrumental variables",
    FirstModel.NOMINAL: "the values of the robot file",
    FirstModel.MASS: "least squares with a positive definite mass matrix",
}


@words.register
def _(note: instruments.InstrumentsUsed) -> str:
    kinds = ", and ".join(KINDS[kind] for kind in note.kinds)
    change = ""
    if note.parameter is not None:
        change = f"; least squares differs most in {note.parameter}, by {short(note.moved, 2)} standard errors"
    noise = ""
    if note.lag is not None:
        noise = f". That holds where noise of the positions is not correlated over {short(note.lag, 2)} s"
    return f"instruments are {kinds} (least correlation with the regressor {short(note.correlation, 3)}){change}{noise}"


@words.register
def _(note: instruments.WeakInstruments) -> str:
    return (
        f"weak instruments: they hardly show {note.parameter} (correlation {short(note.correlation, 2)}, F = "
        f"{short(note.statistic, 2)}, 10 would do); values and standard errors are not reliable there"
    )


@words.register
def _(note: instruments.NotSimulated) -> str:
    return (
        "instruments were not simulated, as neither least squares nor the physically consistent model can be simulated "
        f"in the loop of the controller: {note.reason}"
    )


@words.register
def _(note: instruments.MotionMovesOn) -> str:
    why = f": {note.reason}" if note.reason else ""
    return (
        f"instruments have not settled after {note.iterations} simulations (the last one moved the value by "
        f"{short(note.moved, 2)} standard errors){why}"
    )


@words.register
def _(note: StartedElsewhere) -> str:
    return f"simulated, least squares fails or is farther off: the iteration began with {STARTS[note.start]}"


@words.register
def _(note: StillSimulating) -> str:
    return (
        f"not converged: after {note.iterations} simulations the parameters still move, by "
        f"{short(note.moved, 2)} standard errors"
    )


def settings_of(identification: Identification) -> dict[str, str]:
    """Return the settings of a run as text: the recipe as used, and what was chosen and calibrated."""
    recipe, calibration = identification.recipe, identification.calibration
    tilt = recipe.base_tilt
    settings = {"estimator": part_words(recipe.estimator)}
    settings |= {"low-pass": part_words(recipe.filter)} if recipe.filter is not None else {}
    settings["seed of the random poses"] = str(identification.provenance.seed)
    settings["smoother used"] = "; ".join(part_words(strip_time_offset(smoother)) for smoother in recipe.smoothers)
    numbers = {
        "low speeds left out": _speed_text(recipe.min_speed),
        "time offset used": f"{short(1e3 * float(recipe.time_offset), 4)} ms" if recipe.time_offset else None,
        "base tilt used": _angles(*tilt, 3) if isinstance(tilt, tuple) and any(tilt) else None,
        "free simulation": f"begun anew every {short(recipe.restart)} s" if recipe.restart else None,
    }
    choices = {
        "smoother": calibration.smoother,
        "time offset": calibration.time_offset,
        "base tilt": calibration.base_tilt,
        "strength of the prior": calibration.prior_strength,
    }
    settings |= {key: str(value) for key, value in numbers.items() if value is not None}
    return settings | {key: words(choice) for key, choice in choices.items() if choice is not None}


@words.register
def _(choice: SmootherChoice) -> str:
    pairs = zip(choice.candidates, choice.errors, strict=True)
    trials = "; ".join(f"{part_words(candidate)}: {_error_text(error)}" for candidate, error in pairs)
    return f"{part_words(choice.smoother)}, by the cross-validated torque error on the training logs ({trials})"


def _error_text(error: float) -> str:
    return percent(error) if np.isfinite(error) else "cannot smooth these logs"


def _speed_text(speed: Mapping[str, float] | float | None) -> str | None:
    """Return the minimum speed, or that of each joint, in words."""
    if speed is None:
        return None
    if isinstance(speed, Mapping):
        return f"{join_names(f'{name} below {short(float(limit))}' for name, limit in speed.items())} rad/s or m/s"
    return f"below {short(float(speed))} rad/s or m/s"


@words.register
def _(time_offset: TimeOffset) -> str:
    error = np.inf if time_offset.std is None else 1e3 * time_offset.std
    if not time_offset.seconds:
        if time_offset.gain is not None:
            return f"none, as the best one does not predict left-out stretches better: {words(time_offset.gain)}"
        uncertainty = f" significantly; its standard error would be {short(error, 2)} ms" if np.isfinite(error) else ""
        return f"none, as none lowers the training error ({percent(time_offset.before)}){uncertainty}"
    lagging, leading = ("positions", "torques") if time_offset.seconds > 0 else ("torques", "positions")
    size = f"{short(1e3 * abs(time_offset.seconds), 2)}" + (f" +- {short(error, 1)}" if np.isfinite(error) else "")
    return f"{lagging} are stamped {size} ms later than {leading}; {_error_change(time_offset)}"


@words.register
def _(gain: Gain) -> str:
    return f"{short(gain.share, 2)} +- {short(gain.std, 2)} % of the squared cross-validated error"


@words.register
def _(note: Rests) -> str:
    ends = [f"{short(length)} s at its {end}" for end, length in (("start", note.start), ("end", note.end)) if length]
    parts = [f"{' and '.join(ends)}, where the arm is at rest, are left out of fit and errors"] if ends else []
    if note.within:
        parts.append(f"rests of {short(note.within)} s within are {_inner_rests(note)}")
    return f"{note.log}: {'; '.join(parts)}"


def _inner_rests(note: Rests) -> str:
    if note.gain is None:
        return "counted in its errors"
    if note.left_out:
        return f"left out of the fit, which gains {words(note.gain)} in motion"
    return f"fitted: without them {words(note.gain)} in motion would be gained"


@words.register
def _(tilt: BaseTilt) -> str:
    dx, dy = np.rad2deg(tilt.std)
    if not (tilt.x or tilt.y):
        why = "" if tilt.gain is None else f": the best tilt would gain {words(tilt.gain)}"
        if tilt.steep:
            why += f", but is {_angles(*tilt.steep)}, more than a mounting error"
        uncertainty = f" (+- {dx:.2f} and {dy:.2f} deg about x and y)" if np.isfinite(dx + dy) else ""
        return f"the base is taken as level{uncertainty}{why}"
    angles = f"{_angles(tilt.x, tilt.y, 2)} (+- {dx:.2f} and {dy:.2f})"
    return f"the base is tilted by {angles}; {_error_change(tilt)}"


@words.register
def _(prior: PriorStrength) -> str:
    if not prior.strength:
        return f"the robot file's inertias count only where the data show nothing: else {words(prior.gain)} gained"
    return f"the robot file's inertias count with a strength of {prior.strength:g}, which gains {words(prior.gain)}"


@words.register
def _(note: PlainTerms) -> str:  # noqa: ARG001
    return (
        "the terms of the joints are rotor inertia, viscous and Coulomb friction and offset: there are too few samples "
        "to choose others by; record longer, or name them by `terms` of the model"
    )


@words.register
def _(note: NotChosen) -> str:
    return (
        f"the estimator's settings name {', '.join(note.names)}, which the model with the terms chosen does not have; "
        "what they say of these is ignored. Name the terms by `terms` of the model to have them"
    )


@words.register
def _(note: NotFitted) -> str:
    return f"torques that are not fitted, only predicted and judged, by `unfitted`: {', '.join(note.joints)}"


@words.register
def _(note: NotJudged) -> str:
    return (
        f"{percent(note.share)} of {note.log}, which is held out, are not judged, by `exclude`: its torque error is "
        "that of the rest. Exclude only what the robot is not to blame for, such as a collision"
    )


@words.register
def _(note: SubstituteUsed) -> str:
    return (
        f"{note.log} has not the motion that {note.smoother} is made for; as it is only judged, another smooths it: "
        f"{note.method}. Its torque error also holds what that leaves of the noise or takes of the motion: compare it "
        "with that of other models on this recording, not with the error on training"
    )


@words.register
def _(note: SteepBase) -> str:
    return (
        f"the torques ask for a base that is tilted by {_angles(note.x, note.y)}, more than a mounting error; it is "
        "taken as level. If the robot is mounted so, set `gravity` of the model; if not, check the zeros and axes of "
        "its joints, the signs of its torques, and what it carries"
    )


def _angles(x: float, y: float, decimals: int = 1) -> str:
    """Return rotations in rad about x and y in words."""
    return f"{np.rad2deg(x):z.{decimals}f} deg about x and {np.rad2deg(y):z.{decimals}f} deg about y"


def _error_change(correction: TimeOffset | BaseTilt) -> str:
    return f"with it, the training error is {percent(correction.after)} instead of {percent(correction.before)}"
