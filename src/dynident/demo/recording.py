"""Recordings of the demo arm: a Fourier series, followed in closed loop, as encoders and drives report it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import polars as pl
from numpy.typing import NDArray

from dynident.demo.arm import JOINTS, STEP, TIME_OFFSET, true_model, true_values
from dynident.log import Motion
from dynident.simulation import CascadePD
from dynident.validation import free_run

__all__ = ["DAYS", "SEED", "Day", "fourier", "recorded"]

Array = NDArray[np.float64]
SEED = 12
EVERY = 4  # of the samples of the drives, every fourth is logged
ENCODER = 2 * np.pi / 2**21  # rad
TORQUE = 0.01  # N m: the torque is logged in such steps
NOISE, REMAINS = 0.003, 0.8  # of the torque: share of the joint's limit, and how much of it is there 4 ms later
HARMONICS = 5
BEFORE = 1.0  # s that the arm moves before the recording begins


@dataclass(frozen=True)
class Day:
    """A recording: its length, the period of the motion's first harmonic (s), and its share of the joints' reach."""

    name: str
    duration: float
    period: float
    share: float


DAYS = (Day("monday", 20.0, 10.0, 0.6), Day("tuesday", 15.0, 7.5, 0.5))


@dataclass(frozen=True)
class _Encoders:
    """A controller that sees positions, and so velocities, in the encoders' steps."""

    drives: CascadePD

    @property
    def joints(self) -> tuple[str, ...]:
        return self.drives.joints

    def __call__(self, t: float, q: Array, dq: Array) -> Array:
        now, before = (ENCODER * np.round(one / ENCODER) for one in (q, q - STEP * dq))
        return self.drives(t, now, (now - before) / STEP)


def fourier(rng: np.random.Generator, day: Day, t: Array) -> tuple[Array, Array, Array]:
    """Return q, dq and ddq (N, 6) of a random Fourier series that keeps to the joints' limits, at times t (s)."""
    n = len(JOINTS)
    reach, fastest = (np.array([getattr(joint, name) for joint in JOINTS]) for name in ("reach", "velocity"))
    phases, sizes = rng.uniform(0, 2 * np.pi, (HARMONICS, n)), rng.uniform(0.4, 1.0, (HARMONICS, n))
    sizes /= np.sqrt(np.arange(1, HARMONICS + 1))[:, None]
    w = 2 * np.pi / day.period * np.arange(1, HARMONICS + 1)

    def derivative(order: int, at: Array) -> Array:
        angle = w[:, None] * at[:, None, None] + phases + order * np.pi / 2
        return np.asarray((w[:, None] ** order * sizes * np.cos(angle)).sum(axis=1))

    whole = np.linspace(0, day.period, 2000)
    scale = np.minimum(
        day.share * reach / np.abs(derivative(0, whole)).max(axis=0),
        0.8 * fastest / np.abs(derivative(1, whole)).max(axis=0),
    )
    q, dq, ddq = (scale * derivative(order, t) for order in range(3))
    return q, dq, ddq


def recorded(rng: np.random.Generator, day: Day, duration: float | None = None) -> pl.DataFrame:
    """Return the log of a day, or of its first seconds: time, and by joint position, torque, and reference."""
    lead, rows = round(BEFORE / STEP), round((duration or day.duration) / STEP / EVERY)
    t: Array = STEP * np.arange(-lead, EVERY * rows + 1, dtype=np.float64)
    reference, speed, _ = fourier(rng, day, t)
    reference = np.asarray(np.round(reference, 5), dtype=np.float64)
    names = tuple(joint.name for joint in JOINTS)
    still = np.zeros_like(reference)
    start = Motion(t, reference, speed, still, still, names, np.ones(len(t), dtype=bool), day.name)
    gains = (np.array([getattr(joint, name) for joint in JOINTS]) for name in ("kp", "kv", "effort"))
    kp, kv, effort = (gain.astype(float) for gain in gains)
    drives = CascadePD(names, t, reference, kp, kv, np.ones(len(names)), effort, still)
    run = free_run(true_model(), true_values(), start, _Encoders(drives))
    rows_logged = lead + EVERY * np.arange(rows)
    last = rows_logged + round(TIME_OFFSET / STEP + EVERY / 2)  # of the cycles whose mean is reported
    tau = np.mean([run.tau[last - k] for k in range(1, EVERY + 1)], axis=0) + effort * NOISE * _coloured(
        rng, rows, len(names)
    )
    return _table(
        t[rows_logged],
        ENCODER * np.round(run.q[rows_logged] / ENCODER),
        TORQUE * np.round(tau / TORQUE),
        reference[rows_logged],
    )


def _coloured(rng: np.random.Generator, rows: int, n: int) -> Array:
    """Return noise (rows, n) of variance 1, each sample of which keeps a share of the one before."""
    from scipy.signal import lfilter

    white = rng.standard_normal((rows, n)) * np.sqrt(1 - REMAINS**2)
    white[0] /= np.sqrt(1 - REMAINS**2)
    return np.asarray(lfilter([1.0], [1.0, -REMAINS], white, axis=0))


def _table(t: Array, q: Array, tau: Array, reference: Array) -> pl.DataFrame:
    columns = {"time_s": pl.Series(np.round(t, 6))}
    for j, joint in enumerate(JOINTS):
        for name, values in (("position_rad", q), ("torque_Nm", tau), ("reference_rad", reference)):
            columns[f"{joint.name}.{name}"] = pl.Series(values[:, j], dtype=pl.Float32)
    return pl.DataFrame(columns)
