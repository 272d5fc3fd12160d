"""Commands for arms of servos: small chirps of all joints at once, within range, speed and acceleration, and clear.

The frequency rises in some joints while it falls in others. Each joint moves slowly, which shows dry friction, and
fast, which shows armature and delay. PACE (arXiv:2509.06342) commands such chirps.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from io import StringIO

import numpy as np

from dynident.apps.excitation.limits import Feasibility, MotionLimits
from dynident.apps.excitation.robot import ExcitationProject
from dynident.runtime import InputError, Noun
from dynident.runtime.arrays import Array

DEFAULT_RATE, DEFAULT_SPEED = 100.0, 1.5  # Hz; rad/s or m/s, where a file has no limit
MAX_AMPLITUDE = {"revolute": 0.25, "prismatic": 0.03}  # rad, m
LOWEST, HIGHEST = 0.1, 4.0  # Hz
MIN_SAMPLES_PER_PERIOD = 8
RAMP = 1.0  # s, in which a chirp grows and fades
SIZES = (1.0, 0.7, 0.5, 0.3, 0.2, 0.1)  # of the chirps, tried until the arm keeps clear
FINE_RATE = 500.0  # Hz, at which limits are looked at


class Chirp(Noun):
    """Commands q (N, n) of the ``joints`` at times t (N) s, in rad or m, from rest to rest at a pose."""

    joints: tuple[str, ...]
    t: Array
    q: Array


def design_chirps(project: ExcitationProject) -> tuple[Chirp, Chirp]:
    """Return a motion and another one for validation, of the rate and length that the project's settings have.

    Raises InputError where the start pose is out of range, or the arm touches something however small the motion is.
    """
    settings, limits, model = project.settings, project.limits, project.prior.model
    feasible = Feasibility(model, project.prior.theta, limits, project.space, project.request.clearance)
    kinds = [joint.kind for joint in model.joints]
    zero = np.zeros(len(kinds)) if project.request.start is None else project.request.start
    most = np.minimum([MAX_AMPLITUDE[kind] for kind in kinds], limits.half / 2)
    # a pose that nobody gives is as near to zero as its swings allow
    pose = np.clip(zero, limits.lower + most, limits.upper - most) if project.request.start is None else zero
    amplitude = np.minimum(most, np.minimum(pose - limits.lower, limits.upper - pose))
    if not (amplitude > 0).all():
        joint = limits.joints[int(np.argmin(amplitude))]
        raise InputError(f"excitation.start: joint {joint!r} has no room to move there; give another pose.")
    rng = np.random.default_rng(settings.seed)
    highest = min(HIGHEST, settings.rate / MIN_SAMPLES_PER_PERIOD)
    fine = np.arange(0.0, settings.duration, 1 / FINE_RATE)
    chirps = []
    for turn in range(2):
        phases = rng.uniform(0, 2 * np.pi, len(kinds))
        swing = np.empty((len(fine), len(kinds)))
        for k, phase in enumerate(phases):
            bounds = amplitude[k], limits.velocity[k], limits.acceleration[k]
            swing[:, k] = _sweep(fine, highest, bounds, rises=(k + turn) % 2 == 0, phase=phase)
        swing /= _largest_share(swing, limits)
        for size in SIZES:
            if feasible.min_gaps(pose + size * swing).min(initial=np.inf) >= 0:
                break
        else:
            raise InputError(
                "the arm touches itself or what is around it at its start; give another pose, `excitation.start`."
            )
        t = np.arange(0.0, settings.duration, 1 / settings.rate)
        q = pose + size * np.column_stack([np.interp(t, fine, column) for column in swing.T])
        chirps.append(Chirp(limits.joints, t, q))
    return chirps[0], chirps[1]


def _sweep(t: Array, highest: float, bounds: tuple[float, float, float], *, rises: bool, phase: float) -> Array:
    """Return a chirp (N) on a logarithm of frequency, whose ``bounds`` are of amplitude, speed and acceleration."""
    place = t / t[-1] if rises else 1 - t / t[-1]
    ratio = highest / LOWEST
    rate = 2 * np.pi * LOWEST * ratio**place
    # the smallest of the three, smoothly: a corner would be a jolt
    amplitude = sum((rate**k / bound) ** 4 for k, bound in enumerate(bounds)) ** -0.25
    ramp = np.clip(np.minimum(t, t[-1] - t) / RAMP, 0.0, 1.0)
    return np.asarray(ramp**2 * (3 - 2 * ramp) * amplitude * np.sin(phase + rate * t[-1] / np.log(ratio)))


def _largest_share(swing: Array, limits: MotionLimits) -> Array:
    """Return the largest share (n) of the limits of speed and acceleration that a swing (N, n) takes, at least 1."""
    speed = np.gradient(swing, 1 / FINE_RATE, axis=0)
    rate = np.gradient(speed, 1 / FINE_RATE, axis=0)
    shares = [np.abs(x).max(axis=0) / limit for x, limit in ((speed, limits.velocity), (rate, limits.acceleration))]
    return np.asarray(np.maximum(np.max(shares, axis=0), 1.0))


def command_csv(chirp: Chirp) -> str:
    """Return commands as CSV with the columns time (s) and by joint cmd_JOINT."""
    names = ["time", *(f"cmd_{joint}" for joint in chirp.joints)]
    return csv_text(names, np.column_stack([chirp.t, chirp.q]), digits=9)


def csv_text(names: Sequence[str], values: Array, digits: int) -> str:
    """Return values (N, k) in so many digits as CSV, with the names of the columns."""
    text = StringIO()
    csv.writer(text, lineterminator="\n").writerow(names)
    np.savetxt(text, values, fmt=f"%.{digits}g", delimiter=",")
    return text.getvalue()
