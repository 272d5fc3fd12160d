"""What is asked of a payload identification, and what is known of the drives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ConfigError, brief

__all__ = ["DriveGains", "Request"]

Array = NDArray[np.float64]
MOST = 100.0  # %
FARTHEST = 5.0  # m: a centre of mass beyond is in mm


@dataclass(frozen=True, eq=False)
class DriveGains:
    """The measured torque of each joint is ``factor`` (n) times the true one, with the ``covariance`` (n, n).

    ``known_mass`` (kg) is that of the payload from which they are known.
    """

    joints: tuple[str, ...]
    factor: Array
    covariance: Array
    known_mass: float

    __repr__ = brief

    @property
    def std(self) -> Array:
        """Standard errors (n) of the factors."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def correction(self) -> Array:
        """What to multiply the gains of the drives with (n), so that the torque is the true one."""
        return 1.0 / self.factor


@dataclass(frozen=True)
class Request:
    """How to look for a payload.

    ``frame`` is the link that carries it (None: the flange); ``removed``: the arm carried it when it was identified and
    does no more. ``known_mass`` (kg) is its mass where it was weighed, ``known_centre`` (3) in m in the frame its
    centre of mass, where that is known to half a millimetre, too: it tells the gains of the wrist. ``gain_error`` (%)
    is how wrong the gains of the drives may be, one standard deviation, all of them together and each by itself, where
    ``gains`` of an earlier payload of known mass are not given. ``friction_change`` (%): by how much friction and
    offset of a joint may differ between the result and the recordings, and friction again by the load, one standard
    deviation in % of the joint's largest friction parameter. ``load_friction`` (%): friction of a joint that grows with
    its load, by about this much of the load, which the model does not know. Raises ConfigError for a number out of
    range.
    """

    frame: str | None = None
    known_mass: float | None = None
    known_centre: tuple[float, float, float] | None = None
    gain_error: float = 3.0
    gains: DriveGains | None = None
    friction_change: float = 30.0
    load_friction: float = 5.0
    removed: bool = False

    def __post_init__(self) -> None:
        if self.known_mass is not None and not 0 < self.known_mass < np.inf:
            raise ConfigError(f"the known mass is {self.known_mass:g} kg; give a number above 0.")
        if self.known_centre is not None and (self.known_mass is None or not np.isfinite(self.known_centre).all()):
            raise ConfigError("the known centre of mass needs the known mass, and three numbers in m.")
        if self.known_centre is not None and max(map(abs, self.known_centre)) > FARTHEST:
            raise ConfigError(f"the known centre of mass is {max(map(abs, self.known_centre)):g} m away; give it in m.")
        given = {"gain error": self.gain_error, "friction change": self.friction_change}
        for name, value in (given | {"friction by the load": self.load_friction}).items():
            if not 0 <= value <= MOST:
                raise ConfigError(f"the {name} is {value:g} %; give a number from 0 to {MOST:g}.")
        if self.gains is not None and self.known_mass is not None:
            raise ConfigError("gains and a known mass are given: gains are known by a known mass; give one of them.")
