"""How far an identification of the demo arm is from the truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.demo.arm import JOINTS, LINKS
from dynident.demo.recording import SEED, Day, fourier
from dynident.demo.truth import demo_truth
from dynident.errors import brief
from dynident.identification import Identification
from dynident.log import Motion
from dynident.models import Model

__all__ = ["Compared", "Comparison", "compare_with_truth"]

Array = NDArray[np.float64]
WITHIN = 1.96  # standard errors that hold 95 %
UNSEEN = Day("unseen", 10.0, 8.0, 0.55)
OUT = (0.0, np.pi / 2, 0.0, 0.0, 0.0, 0.0)  # the arm stretched out


@dataclass(frozen=True)
class Compared:
    """A value as found and as it is, with the standard error of the first where it is known."""

    name: str
    found: float
    true: float
    std: float | None
    unit: str


@dataclass(frozen=True, eq=False)
class Comparison:
    """Relative torque errors (%) on a motion never recorded, against the true torque without noise: of the identified
    model, and of the robot file's inertias with the true friction; single values; how many of the ``base`` parameters
    are ``within`` 1.96 of their standard errors."""

    torque_error: float
    file_error: float
    values: tuple[Compared, ...]
    within: int
    base: int

    __repr__ = brief


def compare_with_truth(found: Identification) -> Comparison:
    """Return how far a result of ``dynident identify`` on the demo arm is from the truth, whatever its terms are."""
    truth, value = demo_truth(), found.estimate.value
    t = np.arange(0.0, UNSEEN.duration, 0.01)
    states = fourier(np.random.default_rng([SEED, len(UNSEEN.name)]), UNSEEN, t)
    used = np.ones(len(t), dtype=bool)
    motion = Motion(t, *states, np.zeros_like(states[0]), tuple(joint.name for joint in JOINTS), used)
    drawn = np.concatenate([*(link.shape.inertia(link.mass) for link in LINKS), truth.value[10 * len(LINKS) :]])
    true, ours, files = (
        model.torque(**model.remembering(motion).states(), theta=theta)
        for model, theta in ((truth.model, truth.value), (found.model, value), (truth.model, drawn))
    )
    base, wrong = found.base.on_data, value - _projected(found.model, motion, true)
    off = np.abs(wrong if base is None else base.combination @ wrong)
    std = found.errors.best if found.errors.best_base is None else found.errors.best_base
    return Comparison(
        _share(ours - true, true),
        _share(files - true, true),
        _values(found),
        int((off < WITHIN * std).sum()),
        len(off),
    )


def _projected(model: Model, motion: Motion, torque: Array) -> Array:
    """Return parameters (p) with which a model comes nearest to a torque (N, n): the truth in its own terms."""
    Y = model.regressor(**model.remembering(motion).states())
    rows = Y.reshape(-1, Y.shape[-1])
    size = np.linalg.norm(rows, axis=0) + np.finfo(float).tiny
    return np.asarray(np.linalg.lstsq(rows / size, torque.ravel(), rcond=1e-9)[0] / size)


def _values(found: Identification) -> tuple[Compared, ...]:
    truth, lines = demo_truth(), list[Compared]()
    offset, tilt = found.calibration.time_offset, found.calibration.base_tilt
    if offset is not None:
        std = None if offset.std is None else 1e3 * offset.std
        lines.append(Compared("time offset", 1e3 * offset.seconds, 1e3 * truth.time_offset, std, "ms"))
    if tilt is not None:
        for axis, *angles in zip("xy", (tilt.x, tilt.y), truth.tilt, tilt.std, strict=True):
            value, true, std = np.rad2deg(angles).tolist()
            lines.append(Compared(f"tilt about {axis}", value, true, std, "deg"))
    lines.append(Compared("gravity, arm stretched out", _held(found), _held(None), None, "N m"))
    known = dict(zip(truth.model.names, truth.value.tolist(), strict=True))
    for k, one in enumerate(found.model.parameters):
        if one.role in ("viscous", "coulomb") and one.name in known:
            std, value = float(found.errors.best[k]), float(found.estimate.value[k])
            lines.append(Compared(one.name, value, known[one.name], std, one.unit))
    return tuple(lines)


def _held(found: Identification | None) -> float:
    """Return the torque of gravity at the shoulder's lift with the arm stretched out, as found or, for None, true."""
    truth, pose, rest = demo_truth(), np.array([OUT]), np.zeros((1, len(OUT)))
    model, theta = (truth.model, truth.value) if found is None else (found.model, found.estimate.value)
    without = np.where([one.name.startswith("offset") for one in model.parameters], 0.0, theta)
    memory = np.zeros((1, model.memory)) if model.memory else None
    torque = model.torque(pose, rest, rest, without, memory)[0]
    return float(torque[[joint.name for joint in JOINTS].index("shoulder_lift")])


def _share(error: Array, whole: Array) -> float:
    return 100.0 * float(np.linalg.norm(error) / np.linalg.norm(whole))
