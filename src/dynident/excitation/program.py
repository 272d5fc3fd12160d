"""What an arm does besides the optimised motion: each joint at constant speeds, and poses for gravity."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ConfigError
from dynident.excitation.request import Program, Request
from dynident.excitation.trajectories.feasibility import Feasibility
from dynident.excitation.trajectories.friction_program import friction_program
from dynident.excitation.trajectories.poses import gravity_program
from dynident.excitation.trajectories.trajectory import Piece

__all__ = ["FRICTION", "GRAVITY", "home_of", "slow_pieces"]

Array = NDArray[np.float64]
FRICTION, GRAVITY = 0.4, 0.2  # shares of the duration of ``Program.ALL``; the motion has the rest
SPEEDS = (5, 4, 3, 2)  # of each joint: fewer where there is no time for more


def slow_pieces(feasible: Feasibility, request: Request, rng: np.random.Generator) -> tuple[Piece, ...]:
    """Return what of a request's program is not the optimised motion: from rest to rest in one pose, none for
    ``Program.MOTION``.

    Raises ConfigError where the time does not suffice.
    """
    match request.program:
        case Program.FRICTION:
            return _friction(feasible, request.duration, request.start, rng)
        case Program.GRAVITY:
            return gravity_program(feasible, request.duration, request.start, _weights(request), rng)
        case Program.ALL:
            try:
                friction = _friction(feasible, FRICTION * request.duration, request.start, rng)
                home = home_of(friction)
                return (*friction, *gravity_program(feasible, GRAVITY * request.duration, home, _weights(request), rng))
            except ConfigError as error:
                raise ConfigError(
                    f"of the duration of {request.duration:g} s, {FRICTION:.0%} are for friction and {GRAVITY:.0%} for "
                    f"poses: {error}"
                ) from error
    return ()


def home_of(pieces: tuple[Piece, ...]) -> Array:
    """Return the pose (n) in which pieces begin."""
    return np.asarray(pieces[0].course.states(np.zeros(1))[0, 0])


def _friction(
    feasible: Feasibility, duration: float, start: Array | None, rng: np.random.Generator
) -> tuple[Piece, ...]:
    """Return each joint at as many speeds as there is time for."""
    state = rng.bit_generator.state
    for speeds in SPEEDS:
        rng.bit_generator.state = state
        try:
            return friction_program(feasible, duration, start, rng, speeds)
        except ConfigError:
            if speeds == SPEEDS[-1]:
                raise
    raise AssertionError


def _weights(request: Request) -> Array:
    return np.asarray(1 / np.square(request.sigma))
