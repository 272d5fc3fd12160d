"""What the lag of a stream leaves, and how fast an estimate follows a robot that changes: the tables of docs/online.md.

    python benchmarks/tracking.py

The lag: seven joints at 1 kHz with noise of 1e-4 rad, beside the spline through the whole recording. The memory: an arm
of seven joints moves for 24 minutes at 100 Hz, with encoder and torque noise. Its Coulomb and viscous friction fall by
40 % as it warms up, exp(-t / 5 min); from minute 12 to 18 it carries 1 kg. A result of the cold arm is followed. The
figures are rms errors of the torque that the estimates predict for other states, in % of that torque, without noise.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from bodies import states
from factors import arm
from numpy.typing import NDArray

from dynident.apps.online import FixedLag, StreamSmoothing, Tracker, estimate_smoothing
from dynident.estimators import LeastSquares
from dynident.identification import Recipe, identify
from dynident.models import Model
from dynident.motion.log import Log
from dynident.motion.smoothers import Spline
from dynident.motion.splines import Fixed, smooth
from dynident.regression import GroupKind

Array = NDArray[np.float64]
STEP, SIGMA, NOISE = 0.01, 1e-5, 0.1  # s, rad, N m
MINUTES, WARM, PICKED, PUT = 24.0, 300.0, 720.0, 1080.0  # the rest in s
PAYLOAD = (1.0, (0.02, 0.0, 0.1))  # kg, m
AFTER = {"2 s later": 2.0, "10 s": 10.0, "1 min": 60.0}
SEEN = [PICKED - 1.0, *(PICKED + x for x in AFTER.values()), PUT - 1.0, *(PUT + x for x in AFTER.values())]  # s
HEAD = ["minute 12", *AFTER, "minute 18", *AFTER]
FRICTION, CARRIED = GroupKind.FRICTION, GroupKind.PAYLOAD
MEMORIES: dict[str, Any] = {
    "nothing forgotten": math.inf,
    "all 60 s": 60.0,
    "all 5 s": 5.0,
    "friction 60 s, payload 5 s": {FRICTION: 60.0, CARRIED: 5.0},
    "friction 60 s, payload 1 s": {FRICTION: 60.0, CARRIED: 1.0},
}


def lags() -> None:
    """Print what each lag leaves of velocity and acceleration, rms over that of the derivative, of the worst joint."""
    rng, width = np.random.default_rng(0), np.linspace(4e-3, 8e-3, 7)
    t = 1e-3 * np.arange(40_000, dtype=np.float64)
    q = np.sin(np.outer(t, np.linspace(1, 6, 7))) + np.cos(np.outer(t, np.linspace(3, 1, 7)))
    q += 1e-4 * rng.standard_normal(q.shape)
    motion = smooth(t, q, Fixed(lam=(width**4 / 1e-3).tolist()), sigma=1.0)
    print("| lag | said to be left | velocity | acceleration |\n|---|---|---|---|")
    for lag in (None, 0.12, 0.08, 0.05, 0.03, 0.01, 0.002):
        stream = FixedLag([f"joint{k}" for k in range(7)], StreamSmoothing(1e-3, width), lag, window=16)
        result = [x.motion for x in stream.push(t, q, q)]
        rows, cells = slice(200, sum(map(len, result))), []
        for name, order in (("dq", 1), ("ddq", 2)):
            exact = motion.derivative(order)
            off = np.concatenate([getattr(x, name) for x in result])[rows] - exact[rows]
            cells.append(float((np.sqrt((off**2).mean(axis=0)) / exact.std(axis=0)).max()))
        print(
            f"| {1e3 * stream.lag:.0f} ms | {stream.remaining_error.max():.1e} | {cells[0]:.1e} | {cells[1]:.1e} |",
            flush=True,
        )


def truth(model: Model, t: float) -> Array:
    """The parameters (p) at a time."""
    theta = np.array([0.5 if parameter.value is None else parameter.value for parameter in model.parameters])
    rubs = [parameter.role in ("viscous", "coulomb") for parameter in model.parameters]
    theta[rubs] *= 1.0 - 0.4 * (1.0 - math.exp(-t / WARM))
    if PICKED <= t < PUT:
        last = [k for k, x in enumerate(model.parameters) if x.body][-10:]
        m, (x, y, z) = PAYLOAD
        theta[last] += m * np.array([1, x, y, z, y * y + z * z, -x * y, x * x + z * z, -x * z, -y * z, x * x + y * y])
    return theta


def recorded(model: Model) -> Log:
    """Positions and torques of all the time."""
    samples, rng = round(60 * MINUTES / STEP), np.random.default_rng(0)
    q, dq, ddq = states(7, samples)  # of steps of 5 ms
    dq, ddq = dq * (5e-3 / STEP), ddq * (5e-3 / STEP) ** 2
    t = STEP * np.arange(samples, dtype=np.float64)
    tau = np.empty_like(q)
    for start in range(0, samples, 10):
        part = slice(start, start + 10)
        tau[part] = model.torque(q[part], dq[part], ddq[part], truth(model, float(t[start])))
    tau += NOISE * rng.standard_normal(q.shape)
    return Log(t, q + SIGMA * rng.standard_normal(q.shape), tau, tuple(joint.name for joint in model.joints))


def memories() -> None:
    """Print the errors of the estimates with each memory."""
    model = arm(7)
    log = recorded(model)
    recipe = Recipe(Spline(sigma=SIGMA), LeastSquares(weights="per_joint"), outliers="keep", rests="keep")
    result = identify(model, {"cold": log.window(0.0, 60.0)}, (), recipe)
    smoothing = estimate_smoothing(result, log.window(0.0, 30.0))
    other = model.random_states(np.random.default_rng(5), 500)
    print(f"\n| memory | {' | '.join(HEAD)} |\n|---|{'---|' * len(HEAD)}")
    for name, memory in MEMORIES.items():
        tracker, actual, begin = Tracker(result, smoothing, lag=0.3, memory=memory, window=16), [], 0
        for at in SEEN:
            stop = int(np.searchsorted(log.t, at))
            tracker.push(log.t[begin:stop], log.q[begin:stop], log.tau[begin:stop])
            begin, theta = stop, truth(model, at)
            expected = model.torque(**other, theta=theta)
            off = model.torque(**other, theta=tracker.estimate().value) - expected
            actual.append(100 * float(np.linalg.norm(off) / np.linalg.norm(expected)))
        print(f"| {name} | {' | '.join(f'{x:.2g}' for x in actual)} |", flush=True)


if __name__ == "__main__":
    lags()
    memories()
