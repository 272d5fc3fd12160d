"""How to identify: the parts that can be exchanged, as asked for and as used."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

from dynident.errors import ConfigError, changed, choices
from dynident.estimators import Estimator, LeastSquares
from dynident.log import Log, Motion
from dynident.regression import ParallelFilter
from dynident.smoothers import Smoother, Spline

__all__ = ["Recipe"]


@dataclass(frozen=True)
class Recipe:
    """How to identify: the interchangeable parts, with the article's method as the default.

    Of several smoothers, ``choose_smoother`` takes one by the cross-validated torque error on the training logs.
    ``min_speed``, a speed (rad/s, m/s) or one by joint name, leaves slower samples out of that joint's equation in the
    fit. ``time_offset`` (s) is how much later than the torque the positions show the motion, and ``base_tilt`` are the
    rotations (rad) of the robot's base about the x and y axes of its root link; "estimate" finds either on the training
    logs. ``restart`` (s) asks for free simulations from the measured torque; logs that know their controller need none.

    A recipe as used, that of an ``Identification``, has one smoother, which gives the motion with the time offset, and
    numbers: nothing in it is left to choose.

    >>> import dynident as dy
    >>> dy.Recipe(dy.Difference("central"), time_offset="estimate")
    Recipe(smoother=Difference(scheme='central'), time_offset='estimate')
    """

    smoother: Smoother | tuple[Smoother, ...] = field(default_factory=Spline)
    estimator: Estimator = field(default_factory=LeastSquares)
    filter: ParallelFilter | None = None
    min_speed: Mapping[str, float] | float | None = None
    time_offset: float | Literal["estimate"] = 0.0
    base_tilt: tuple[float, float] | Literal["estimate"] | None = None
    restart: float | None = None

    __repr__ = changed

    def __post_init__(self) -> None:
        for family, parts in (("smoother", self.smoothers), ("estimator", (self.estimator,))):
            for part in parts:
                if isinstance(part, type) or not callable(part):  # a name, or a class without its parentheses
                    example = "Spline()" if family == "smoother" else "LeastSquares()"
                    raise ConfigError(f"{family}: {part!r} is no {family}; give an object, such as dynident.{example}.")

    @property
    def smoothers(self) -> tuple[Smoother, ...]:
        """The smoothers to choose from, most often one."""
        return self.smoother if isinstance(self.smoother, tuple) else (self.smoother,)

    def motion(self, log: Log) -> Motion:
        """Return the motion of a log by the smoother; ConfigError where it is still to be chosen among several.

        Raises the errors of the smoother.
        """
        if len(self.smoothers) != 1:
            raise ConfigError(f"the recipe has {len(self.smoothers)} smoothers to choose from; name one, or identify.")
        return self.smoothers[0](log)

    def min_speeds(self, joints: Sequence[str]) -> tuple[float, ...] | None:
        """Return ``min_speed`` for each joint; ConfigError where it names another."""
        if self.min_speed is None or not isinstance(self.min_speed, Mapping):
            return None if self.min_speed is None else (float(self.min_speed),) * len(joints)
        for name in self.min_speed:
            if name not in joints:
                raise ConfigError(f"min_speed: there is no joint {name!r}; {choices(name, joints)}")
        return tuple(float(self.min_speed.get(name, 0.0)) for name in joints)
