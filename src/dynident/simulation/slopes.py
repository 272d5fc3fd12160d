"""How the torque of a controller changes with what it sees: exactly where it knows, else by differences."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief
from dynident.log import Controller, HasState

__all__ = ["NEAR", "HasSlopes", "Seen", "Slopes", "diagonal", "slopes_of"]

Array = NDArray[np.float64]
NEAR = 1e-6  # rad or m, and per s: the step of differences, and of larger values their share


@dataclass(frozen=True, eq=False)
class Seen:
    """What a controller sees at K samples: ``t`` s, each ``h`` s after the last (K); q, dq (K, n); its state (K, m)."""

    t: Array
    h: Array
    q: Array
    dq: Array
    state: Array

    __repr__ = brief


@dataclass(frozen=True, eq=False)
class Slopes:
    """Derivatives of a controller's torque (K, n, .) and next state (K, m, .) at K samples by q, dq and the state."""

    tau: tuple[Array, Array, Array]
    state: tuple[Array, Array, Array]

    __repr__ = brief


@runtime_checkable
class HasSlopes(Protocol):
    """A controller that knows its derivatives."""

    def slopes(self, seen: Seen, /) -> Slopes:
        """Return the derivatives at what is seen."""


def slopes_of(controller: Controller, seen: Seen) -> Slopes:
    """Return the derivatives of a controller, by central differences where it does not know them."""
    if isinstance(controller, HasSlopes):
        return controller.slopes(seen)
    n, given, called = seen.q.shape[1], np.hstack((seen.q, seen.dq, seen.state)), _function(controller)
    out = np.empty((len(given), n + seen.state.shape[1], given.shape[1]))
    for k, (t, h, row) in enumerate(zip(seen.t.tolist(), seen.h.tolist(), given, strict=True)):
        for j, value in enumerate(row.tolist()):
            step, ends = NEAR * max(abs(value), 1.0), list[Array]()
            for by in (step, -step):
                moved = row.copy()
                moved[j] += by
                ends.append(called(t, h, moved[:n], moved[n : 2 * n], moved[2 * n :]))
            out[k, :, j] = (ends[0] - ends[1]) / (2 * step)
    tau, state = (np.split(part, [n, 2 * n], axis=2) for part in np.split(out, [n], axis=1))
    return Slopes((tau[0], tau[1], tau[2]), (state[0], state[1], state[2]))


def _function(controller: Controller) -> Callable[[float, float, Array, Array, Array], Array]:
    """Return torque and next state (n + m) as a function of t, h, q, dq and the state."""
    if isinstance(controller, HasState):
        return lambda t, h, q, dq, state: np.concatenate(controller.advance(t, h, q, dq, state))
    return lambda t, _, q, dq, __: controller(t, q, dq)


def diagonal(each: Array) -> Array:
    """Return (K, n) as diagonal matrices (K, n, n)."""
    return np.asarray(each[:, :, None] * np.eye(each.shape[1]))
