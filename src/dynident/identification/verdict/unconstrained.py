"""How far an estimate is from what its training data alone would have: what physics or a prior holds back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynident.identification.result import Identification
from dynident.log import subsample, together

__all__ = ["FASTER", "Held", "held_back"]


SAMPLES = 2000  # of all training motions
FASTER = 2.0  # times the speed of the training, at which fits are compared
RANK = 1e-5  # share of the largest singular value below which the data say nothing


@dataclass(frozen=True)
class Held:
    """By how many % the training residual exceeds that of least squares, and by how many % of the torque the two differ
    on the training motion at twice its speed."""

    growth: float
    apart: float


def held_back(found: Identification) -> Held:
    """Compare an estimate with least squares, each joint by its residual, from samples of the training motions."""
    motions = [log.motion for log in found.validations if log.role == "train"]
    rows = subsample(motions, SAMPLES)
    states, tau = together(motions, rows), np.concatenate([one.tau[k] for one, k in zip(motions, rows, strict=True)])
    value, model = found.estimate.value, found.model
    Y = model.regressor(**states)
    left = tau - Y @ value
    noise = np.sqrt(np.mean(left**2, axis=0))
    noise[noise == 0] = 1.0
    recorded = [np.ones(tau.shape[1], bool) if one.keep is None else one.keep.any(axis=0) for one in motions]
    noise[~np.any(recorded, axis=0)] = np.inf
    X, y = (Y / noise[:, None]).reshape(-1, len(value)), (left / noise).ravel()
    size = np.linalg.norm(X, axis=0)
    size[size == 0] = 1.0
    change = np.linalg.lstsq(X / size, y, rcond=RANK)[0] / size
    rest = float(np.linalg.norm(y - X @ change))
    faster = model.regressor(**states | {"dq": FASTER * states["dq"], "ddq": FASTER**2 * states["ddq"]})
    torque = float(np.linalg.norm(faster @ value))
    return Held(
        100.0 * (float(np.linalg.norm(y)) / rest - 1.0) if rest else 0.0,
        100.0 * float(np.linalg.norm(faster @ change)) / torque if torque else 0.0,
    )
