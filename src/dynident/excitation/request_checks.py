"""What a request for a motion must be: refused before any work where it contradicts itself, the model or the limits."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ConfigError, Note, choices, listed
from dynident.excitation.request import Criterion, Program, Request
from dynident.excitation.spaces.pairing import refuse_contact
from dynident.excitation.spaces.space import Space
from dynident.excitation.trajectories.limits import MotionLimits
from dynident.models import HasMemory, Model
from dynident.regression import BaseParameters

__all__ = ["LeftOut", "check_request", "named_rows", "without_memory"]

Array = NDArray[np.float64]
FAMILIES = ("fourier", "bspline")


@dataclass(frozen=True)
class LeftOut(Note):
    """Terms that remember the motion, by their kind, were left out of the design: their information is not counted."""

    terms: tuple[str, ...]


def without_memory(model: Model, theta: Array, request: Request) -> tuple[Model, Array, Request, tuple[Note, ...]]:
    """Return the model without terms that remember the motion, with the parameters (p) and request that fit it."""
    keeps = [not isinstance(term, HasMemory) for term in model.terms]
    if all(keeps):
        return model, theta, request, ()
    terms = list(zip(model.terms, keeps, strict=True))
    kept = np.concatenate([np.full(len(term.parameters), keep) for term, keep in terms])
    bare = replace(model, terms=tuple(term for term, keep in terms if keep), load=None)
    prior = None if request.prior is None else request.prior[np.ix_(kept, kept)]
    left = LeftOut(tuple(type(term).__name__ for term, keep in terms if not keep))
    return bare, theta[kept], replace(request, prior=prior), (left,)


def check_request(model: Model, theta: Array, limits: MotionLimits, space: Space, request: Request) -> None:
    """Raise ConfigError for a request that contradicts itself, the model or the limits, InputError for a start pose in
    collision."""
    n, p = len(model.joints), len(model.parameters)
    if limits.joints != (names := tuple(joint.name for joint in model.joints)):
        raise ConfigError(f"the limits are of the joints {limits.joints}, the model has {names}.")
    if theta.shape != (p,) or not np.isfinite(theta).all():
        raise ConfigError(f"theta has shape {theta.shape}, expected {p} finite numbers, those of the model.")
    sigma = np.asarray(request.sigma, dtype=float)
    if sigma.shape != (n,) or not (np.isfinite(sigma) & (sigma > 0)).all():
        raise ConfigError(f"the noise of the torque is {sigma}; give a positive number for each of {n} joints.")
    for name in ("duration", "period", "rate"):
        if not (np.isfinite(value := getattr(request, name)) and value > 0):
            raise ConfigError(f"{name} is {value}; give a positive number.")
    for name in ("harmonics", "starts"):
        if (count := getattr(request, name)) < 1:
            raise ConfigError(f"{name} is {count}; give 1 or more.")
    if request.family not in FAMILIES:
        raise ConfigError(f"family is {request.family!r}; {choices(request.family, FAMILIES)}")
    moves = request.program in (Program.MOTION, Program.ALL)
    if moves and request.family == "fourier" and request.period > request.duration:
        raise ConfigError(
            f"the period of {request.period:g} s is longer than the duration of {request.duration:g} s: give a shorter "
            "period, or a longer duration."
        )
    if request.prior is not None and np.shape(request.prior) != (p, p):
        raise ConfigError(f"the prior information has shape {np.shape(request.prior)}, expected ({p}, {p}).")
    if request.start is not None:
        _check_start(limits, space, request.start, request.clearance)


def _check_start(limits: MotionLimits, space: Space, start: Array, clearance: float) -> None:
    if start.shape != limits.lower.shape:
        raise ConfigError(f"the start has shape {start.shape}, expected ({len(limits.lower)},).")
    for name, value, low, high in zip(limits.joints, start, limits.lower, limits.upper, strict=True):
        if not low <= value <= high:
            raise ConfigError(
                f"start: joint {name!r} is at {value:g}, outside of {low:.4g} to {high:.4g}, which are its limits less "
                "the margin."
            )
    refuse_contact(space, start, clearance, "the start")


def named_rows(basis: BaseParameters, theta: Array, request: Request, scale: Array) -> Array | None:
    """Return the rows (k, r) of the A-optimal criterion: the named parameters over the sizes of their values, where
    these are zero over what is usual by ``scale`` (r); None for another criterion, or no names.

    Raises ConfigError for a name that the model does not have, or that leads no base parameter.
    """
    leading = list(basis.leading)
    for name in request.named:
        if name not in basis.names:
            raise ConfigError(f"parameters: there is no parameter {name!r}; {choices(name, basis.names)}")
        if name not in leading:
            raise ConfigError(
                f"parameters: no motion shows {name!r} by itself; those that lead a base parameter are "
                f"{listed(leading, 12)}."
            )
    if request.criterion is not Criterion.A_OPTIMAL or not request.named:
        return None
    which = [leading.index(name) for name in request.named]
    sizes = np.abs(basis.to_base(theta)[which])
    effects = (sizes * scale[which])[sizes > 0]
    usual = float(np.exp(np.log(effects).mean())) if len(effects) else 1.0
    return np.asarray(np.eye(basis.rank)[which] / np.where(sizes > 0, sizes, usual / scale[which])[:, None])
