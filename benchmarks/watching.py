"""A robot that is watched, with changes whose truth is known: python3 benchmarks/watching.py.

The demo arm, identified by its own two recordings, moves for two hours along a motion that never repeats, and rests for
5 s in every 2 min. Positions are those of its encoders, torques have its coloured noise, and joints rub by 2 % of their
load, which the model does not know. The friction of a joint rises slowly, a payload is picked up and put down, an
encoder dies for a minute, a torque sensor gets an offset. Printed is for each what was said and how late, then what was
said in ``--quiet`` further runs in which nothing changes. All runs differ in motion and noise; they follow the planned
motion exactly, as a closed loop of two hours would take hours to simulate. ``--csv FILE`` writes one run as a text file
for ``dynident watch``.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

os.environ.update(dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1"))

import numpy as np
import polars as pl
from demo_files import ENCODER_STEP, NOISE_CORRELATION, NOISE_SHARE, TORQUE_STEP
from numpy.typing import NDArray
from scipy.signal import lfilter

from dynident.apps.demo import demo_files
from dynident.apps.demo.arm import JOINTS, TIME_OFFSET, true_model, true_values
from dynident.apps.online import (
    Alarm,
    Back,
    Changed,
    Event,
    Fault,
    NewMotion,
    Passed,
    Signal,
    Unsteady,
    Watcher,
    WatchSettings,
)
from dynident.apps.online.report import event_line
from dynident.cli.identification import draft_from_files
from dynident.identification import Identification
from dynident.project.project import read_project
from dynident.regression import GroupKind

Array = NDArray[np.float64]
HOURS, RATE, CHUNK = 2.0, 100.0, 10.0  # h, Hz, s that come at a time
EVERY, REST, RAMP = 120.0, 5.0, 1.0  # s
HARMONICS = 12  # of each joint, from 0.05 to 0.5 Hz, in no ratio
REACH, PACE = 0.7, 0.5  # shares of the limits of position and speed
LOADED = 0.02  # friction by the load, as a share of it, that the model does not have
COLOUR = NOISE_CORRELATION ** (250.0 / RATE)  # of the noise from sample to sample, as it is in the demo's recordings
EFFORT = np.array([joint.effort for joint in JOINTS])
NAMES = tuple(joint.name for joint in JOINTS)


@dataclass(frozen=True)
class Happening:
    """What happens from ``start`` to ``stop`` (s): ``share`` of the change ``of`` the parameters, by time; or the
    encoder of a ``dead`` joint. ``sign`` is the group of what a watch should say, and its joint."""

    name: str
    start: float
    stop: float
    sign: tuple[GroupKind | None, str]
    of: dict[str, float] = field(default_factory=dict)
    slow: bool = False
    dead: str = ""

    def share(self, t: float) -> float:
        if self.slow:
            return float(np.clip((t - self.start) / (self.stop - self.start), 0.0, 1.0))
        return float(self.start <= t < self.stop)


HAPPENINGS = (
    Happening("friction of elbow rises by 40 % in 1 h", 1800, 5400, (GroupKind.FRICTION, "elbow"),
              {"Fv_elbow": 2.4, "Fc_elbow": 0.88}, slow=True),
    Happening("payload of 1 kg", 2400, 3600, (GroupKind.PAYLOAD, "wrist_roll"),
              {"hand.mass": 1.0, "hand.mz": 0.1, "hand.Ixx": 0.01, "hand.Iyy": 0.01}),
    Happening("encoder of wrist_pitch dead", 4500, 4560, (None, "wrist_pitch"), dead="wrist_pitch"),
    Happening("offset of shoulder_lift by 2 N m", 6000, 1e9, (GroupKind.OFFSET, "shoulder_lift"),
              {"offset_shoulder_lift": 2.0}),
)  # fmt: skip


class Arm:
    """The arm in motion: samples of its sensors, a chunk at a time."""

    def __init__(self, seed: int, happenings: Sequence[Happening]) -> None:
        self.rng, self.happenings = np.random.default_rng([7, seed]), happenings
        self.model, self.theta = true_model(), true_values()
        self.bodies = np.where([name.startswith(("F", "offset")) for name in self.model.names], 0.0, self.theta)
        n = len(JOINTS)
        self.phase = self.rng.uniform(0, 2 * np.pi, (HARMONICS, n))
        self.omega = 2 * np.pi * self.rng.uniform(0.05, 0.5, (HARMONICS, n))
        size = self.rng.uniform(0.4, 1.0, (HARMONICS, n))
        reach, fastest = (np.array([getattr(joint, name) for joint in JOINTS]) for name in ("reach", "velocity"))
        largest = np.minimum(REACH * reach / size.sum(axis=0), PACE * fastest / (size * self.omega).sum(axis=0))
        self.size = 2.0 * largest * size  # all harmonics together hardly ever reach half of their sum
        self.last, self.held = np.zeros((1, n)), np.full(n, np.nan)

    def course(self, t: Array) -> tuple[Array, Array, Array]:
        """Return q, dq, ddq (N, 6) at times t (N): the motion stands still where the path's own time does."""
        s, ds, dds = _paced(t)
        angle = self.omega * s[:, None, None] + self.phase
        q = (self.size * np.cos(angle)).sum(axis=1)
        case = -(self.size * self.omega * np.sin(angle)).sum(axis=1)
        two = -(self.size * self.omega**2 * np.cos(angle)).sum(axis=1)
        return q, case * ds[:, None], two * ds[:, None] ** 2 + case * dds[:, None]

    def samples(self, hours: float) -> Iterator[tuple[Array, Array, Array]]:
        """Yield t (N), q and tau (N, 6)."""
        rows = round(CHUNK * RATE)
        for k in range(round(hours * 3600 / CHUNK)):
            t = (k * rows + np.arange(rows)) / RATE
            q = ENCODER_STEP * np.round(self.course(t)[0] / ENCODER_STEP)
            for happening in self.happenings:
                if happening.dead:
                    self._die(happening, t, q)
            yield t, q, self.torque(t)

    def _die(self, happening: Happening, t: Array, q: Array) -> None:
        j = NAMES.index(happening.dead)
        gone = (t >= happening.start) & (t < happening.stop)
        if gone.any():
            self.held[j] = q[np.argmax(gone), j] if np.isnan(self.held[j]) else self.held[j]
            q[gone, j] = self.held[j]

    def torque(self, t: Array) -> Array:
        """Return the torque as it is logged, late and with noise."""
        state = self.course(t + TIME_OFFSET)
        theta = self.theta.copy()
        for happening in self.happenings:
            share = happening.share(float(t[0]))
            for name, value in happening.of.items():
                theta[self.model.names.index(name)] += share * value
        rubs = LOADED * np.abs(self.model.torque(*state, theta=self.bodies)) * np.tanh(state[1] / 0.02)
        white = self.rng.standard_normal(state[0].shape) * np.sqrt(1 - COLOUR**2)
        noise, self.last = lfilter([1.0], [1.0, -COLOUR], white, axis=0, zi=self.last)
        tau = self.model.torque(*state, theta=theta) + rubs + NOISE_SHARE * EFFORT * noise
        return np.asarray(TORQUE_STEP * np.round(tau / TORQUE_STEP))


def _paced(t: Array) -> tuple[Array, Array, Array]:
    """Return the path's own time and its derivatives: it stops for the rests, by ramps of half a cosine."""

    def part(u: Array) -> tuple[Array, Array, Array]:  # a period: moves, slows down, rests, speeds up
        moving = EVERY - REST - 2 * RAMP
        down, up = np.clip(u - moving, 0, RAMP), np.clip(u - moving - RAMP - REST, 0, RAMP)
        w = np.pi / RAMP
        s = np.minimum(u, moving) + (down + np.sin(w * down) / w) / 2 + (up - np.sin(w * up) / w) / 2
        ds = np.where(u < moving, 1.0, (1 + np.cos(w * down)) / 2 + (1 - np.cos(w * up)) / 2)
        dds = np.where(down * (RAMP - down) > 0, -w * np.sin(w * down) / 2, 0.0)
        return s, ds, dds + np.where(up * (RAMP - up) > 0, w * np.sin(w * up) / 2, 0.0)

    turns, u = np.divmod(t, EVERY)
    s, ds, dds = part(u)
    return s + turns * (EVERY - REST - RAMP), ds, dds


def identified(folder: Path) -> Identification:
    """Return the result of the arm's own recordings, as the tutorial has it."""
    files = demo_files(folder)
    logs = [str(files / f"{day}.parquet") for day in ("monday", "tuesday")]
    config = folder / "robot.yaml"
    config.write_text(draft_from_files(str(files / "arm.urdf"), logs, folder)[0].text)
    return read_project(config).identify()


def watched(identification: Identification, arm: Arm, settings: WatchSettings, hours: float) -> list[Event]:
    """Return all that is said of a run."""
    watcher, events = Watcher(identification, np.random.default_rng(0), settings), list[Event]()
    for t, q, tau in arm.samples(hours):
        events += watcher.push(t, q, tau)
    return events


def said(events: Sequence[Event], happening: Happening) -> tuple[float, ...]:
    """Return when a happening was said first at its start, and at its end where it has one; nan where it was not."""
    result = [event.time for event in events if says(event, happening)]
    ends = [happening.start] if happening.slow or happening.stop > 3600 * HOURS else [happening.start, happening.stop]
    return tuple(min((t - end for t in result if t >= end), default=np.nan) for end in ends)


def says(event: Event, happening: Happening) -> bool:
    """Return whether an event says what happened, or of a dead encoder also that it works again."""
    if happening.dead:
        return isinstance(event, Fault | Back) and (event.signal, event.joint) == (Signal.POSITION, happening.dead)
    return isinstance(event, Alarm | Changed | Passed) and (event.kind, event.joint) == happening.sign


def explained(event: Event, happenings: Sequence[Happening]) -> bool:
    """Return whether what an event says is true."""
    if not isinstance(event, Alarm | Changed | Passed | Fault | Unsteady | NewMotion):
        return True
    return any(says(event, happening) and event.time >= happening.start for happening in happenings)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--quiet", type=int, default=10)
    parser.add_argument("--hours", type=float, default=HOURS)
    parser.add_argument("--csv", type=Path)
    given = parser.parse_args()
    if given.csv:
        write(given.csv, given.hours)
        return
    with TemporaryDirectory() as folder:
        identification = identified(Path(folder))
    settings = WatchSettings()
    began, false, lates = time.perf_counter(), 0, list[list[tuple[float, ...]]]()
    for seed in range(given.runs):
        events = watched(identification, Arm(seed, HAPPENINGS), settings, given.hours)
        lates.append([said(events, x) for x in HAPPENINGS])
        wrong = [event for event in events if not explained(event, HAPPENINGS)]
        false += sum(isinstance(event, Alarm) for event in wrong)
        for event in events if seed == 0 else wrong:
            print(f"run {seed}  {event_line(event, NAMES).text}", flush=True)
    for k, case in enumerate(HAPPENINGS if lates else ()):
        for end in range(len(lates[0][k])):
            delayed = np.array([run[k][end] for run in lates])
            where = "" if len(lates[0][k]) == 1 else (", at its start", ", at its end")[end]
            print(f"{case.name}{where}: said after {np.nanmedian(delayed):.1f} s ({np.nanmin(delayed):.1f} to "
                  f"{np.nanmax(delayed):.1f}), in {np.isfinite(delayed).sum()} of {len(delayed)} runs")  # fmt: skip
    quiet = 0
    for seed in range(given.quiet):
        events = watched(identification, Arm(1000 + seed, ()), settings, given.hours)
        wrong = [event for event in events if not explained(event, ())]
        quiet += sum(isinstance(event, Alarm) for event in wrong)
        for event in wrong:
            print(f"quiet {seed}  {event_line(event, NAMES).text}", flush=True)
    hours = (given.runs + given.quiet) * given.hours
    print(f"false alarms: {false} in {given.runs} runs with changes, {quiet} in {given.quiet * given.hours:g} h "
          f"without; stated are {settings.false_alarms * given.quiet * given.hours / 24:.2g}")  # fmt: skip
    print(f"{1e6 * (time.perf_counter() - began) / (3600 * hours * RATE):.0f} us a sample, with its simulation")


def write(path: Path, hours: float) -> None:
    """Write a run as a text file with the columns of the arm's recordings."""
    with open(path, "w") as file:
        for k, (t, q, tau) in enumerate(Arm(0, HAPPENINGS).samples(hours)):
            columns = {"time_s": t}
            for j, name in enumerate(NAMES):
                columns |= {f"{name}.position_rad": q[:, j], f"{name}.torque_Nm": tau[:, j]}
            pl.DataFrame(columns).write_csv(file, include_header=not k)


if __name__ == "__main__":
    main()
