"""Verifies a written model: loads it again, by independent readers where there are any, and compares its torque."""

from __future__ import annotations

import importlib.util

import numpy as np
from numpy.typing import NDArray

from dynident.export.exporter import Exporter, Reader, States
from dynident.export.identified import Identified
from dynident.export.written import Proof, Written
from dynident.log import Motion, subsample

__all__ = ["prove", "random_states", "spread"]

Array = NDArray[np.float64]
SMALL = 1e-6  # a joint's torque counts as no smaller than this share of the largest joint's
FOREIGN = {"Pinocchio": ("pinocchio", "pin"), "MuJoCo": ("mujoco", "mujoco")}  # their modules and packages


def spread(motions: tuple[Motion, ...], count: int = 500) -> States:
    """Return q, dq, ddq of about ``count`` usable samples (N, n), evenly spread over the motions."""
    pairs = list(zip(motions, subsample(motions, count), strict=True))
    names = ("q", "dq", "ddq")
    q, dq, ddq = (np.concatenate([getattr(motion, name)[rows] for motion, rows in pairs]) for name in names)
    return q, dq, ddq


def random_states(joints: int, rng: np.random.Generator, count: int = 500) -> States:
    """Return random q, dq, ddq (count, joints) of a few rad or m, per s and per s^2, for use without a motion."""
    q, dq, ddq = rng.uniform(-3, 3, (3, count, joints))
    return q, dq, ddq


def prove(written: Written, identified: Identified, states: States, exporter: Exporter) -> Proof:
    """Compare the torque of the text, loaded again, with that of the model without the terms left out.

    The exporter names the readers and the terms that it can hold.
    """
    expected = exporter.torque(identified, states)
    found: dict[str, float] = {}
    skipped: list[str] = []
    for name, reader in exporter.readers.items():
        module, package = FOREIGN.get(name, ("", ""))
        if module and importlib.util.find_spec(module) is None:
            own = " and ".join(other for other in exporter.readers if other not in FOREIGN)
            skipped.append(f"{name} is not installed (the package `{package}`): only {own} loaded the file")
            continue
        try:
            found[name] = _difference(reader(written.text, identified, states), expected)
        except Exception as error:  # another library's parser may raise anything
            reason = " ".join(str(error).split())
            if name in FOREIGN and _fails(reader, identified):
                skipped.append(f"{name} can read neither this file nor the original: {reason}")
            else:
                found[name] = float("inf")
                skipped.append(f"{name} cannot read it: {reason}")
    return Proof(found, len(expected), tuple(skipped))


def _difference(torque: Array, expected: Array) -> float:
    size = np.linalg.norm(expected, axis=0)
    scale = np.maximum(size, SMALL * size.max())
    error = np.linalg.norm(torque - expected, axis=0)
    worst = np.divide(error, scale, out=np.where(error > 0, np.inf, 0.0), where=scale > 0).max()
    return float(worst) if np.isfinite(worst) else float("inf")


def _fails(reader: Reader, identified: Identified) -> bool:
    """Whether a reader cannot read the original file either."""
    bodies, _ = identified.bodies
    none: Array = np.zeros((0, len(bodies.joints)))
    try:
        reader(bodies.xml, identified, (none, none, none))
    except Exception:  # another library's parser may raise anything
        return True
    return False
