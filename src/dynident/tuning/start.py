"""The tuning that an identification is of, and what it leaves to choose from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from dynident.estimators import Estimator, LeastSquares, PhysicallyConsistent
from dynident.identification import Identification
from dynident.log import Log
from dynident.smoothers import Spline, motion_of, position_noise, unshifted
from dynident.splines import Constraint, stretches
from dynident.tuning.smoothed import degree_of
from dynident.tuning.tuning import LEAST, MOST, Tuning, Window

__all__ = ["estimators_of", "noise_of", "start_of"]

Array = NDArray[np.float64]
LEAST_SQUARES, CONSISTENT = "least_squares", "consistent"


def start_of(
    found: Identification, terms: tuple[tuple[str, ...], ...], logs: Mapping[str, Mapping[str, Log]], estimator: str
) -> Tuning:
    """Return the tuning of an identification with these terms, of logs as they were read, by this kind of estimator."""
    recipe, joints = found.recipe, tuple(joint.name for joint in found.model.joints)
    return Tuning(
        degree=_degrees(found, joints),
        terms=terms,
        min_speed=recipe.min_speeds(joints) or (0.0,) * len(joints),
        estimator=estimator,
        excluded=tuple(_excluded(logs)),
        unfitted=recipe.unfitted,
        filter=recipe.filter,
        time_offset=float(recipe.time_offset),
    )


def noise_of(spline: Spline, log: Log) -> Array:
    """Return the noise (n) of the positions in terms of which a spline counts S."""
    if isinstance(spline.sigma, Mapping):
        estimate = position_noise(log)
        return np.array([spline.sigma.get(name, estimate[j]) for j, name in enumerate(log.joints)])
    return position_noise(log) if spline.sigma is None else np.full(len(log.joints), float(spline.sigma))


def _degrees(found: Identification, joints: Sequence[str]) -> tuple[float, ...]:
    """Return log10(S/n) of the smoother as it was used; of another than the spline with S in terms of n, by what it
    left of the positions."""
    recipe = found.recipe
    own = unshifted(recipe.smoothers[0])
    if isinstance(own, Spline) and own.rule == Constraint():
        factors = [own.factor.get(name, 1.0) if isinstance(own.factor, Mapping) else own.factor for name in joints]
        return tuple(float(np.clip(2.0 * np.log10(one), LEAST, MOST)) for one in factors)
    spline = own if isinstance(own, Spline) else Spline()
    left = []
    for one in found.validations:
        if one.role == "train" and one.recorded is not None:
            log = recipe.repaired(one.recorded)
            q, noise = motion_of(own, log).q, noise_of(spline, log)
            left.append([degree_of(log.q[:, j] - q[:, j], float(noise[j])) for j in range(len(joints))])
    return tuple(np.clip(np.mean(left, axis=0), LEAST, MOST).tolist())


def _excluded(logs: Mapping[str, Mapping[str, Log]]) -> list[Window]:
    """Return the windows that logs exclude."""
    found = []
    for some in logs.values():
        for name, log in some.items():
            for part in stretches(log.excluded) if log.excluded is not None else ():
                start, stop = float(log.t[part.start]), float(log.t[part.stop - 1])
                found.append((name, start, stop if stop > start else float(np.nextafter(stop, np.inf))))
    return found


def estimators_of(configured: Estimator, kind: str = "") -> tuple[str, dict[str, Estimator]]:
    """Return the ``kind`` of an estimator, if not given the name of its class, and all that can be chosen: it first."""
    offered: dict[str, Estimator] = {LEAST_SQUARES: LeastSquares(), CONSISTENT: PhysicallyConsistent(strength=0.0)}
    kind = kind or type(configured).__name__
    kind = next((name for name, one in offered.items() if type(one) is type(configured)), kind)
    return kind, {kind: configured} | {name: one for name, one in offered.items() if name != kind}
