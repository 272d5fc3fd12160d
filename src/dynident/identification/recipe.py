"""How to identify: the parts that can be exchanged, as asked for and as used."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from numbers import Real
from reprlib import repr as short
from typing import Any, Literal, TypeVar, get_type_hints

import numpy as np

from dynident.errors import ConfigError, changed, choices
from dynident.estimators import Estimate, Estimator, LeastSquares
from dynident.identification.rests import trimmed
from dynident.log import Log, Motion
from dynident.regression import ParallelFilter
from dynident.smoothers import Smoother, Spline, motion_of, repaired

__all__ = ["Recipe"]

Recorded = TypeVar("Recorded", Log, Motion)


def _makes(result: type, value: object) -> bool:
    """Tell whether a value is a part that makes this, as far as it declares what it makes."""
    if not callable(value) or isinstance(value, type):
        return False
    try:
        made = get_type_hints(type(value).__call__).get("return")
    except (AttributeError, NameError, TypeError):  # a part of the user need not declare it
        return True
    return not isinstance(made, type) or made not in (Motion, Estimate) or made is result


def _is_smoother(value: object) -> bool:
    if isinstance(value, tuple):
        return len(value) > 0 and all(_makes(Motion, one) for one in value)
    return _makes(Motion, value)


def _is_estimator(value: object) -> bool:
    return _makes(Estimate, value)


def _is_number(value: Any) -> bool:
    return not isinstance(value, bool) and isinstance(value, Real) and math.isfinite(value)


def _is_speed(value: Any) -> bool:
    values = value.values() if isinstance(value, Mapping) else (value,)
    return value is None or all(_is_number(one) and one >= 0 for one in values)


def _are_proposing(value: object) -> bool:
    return isinstance(value, tuple) and all(isinstance(one, type) and hasattr(one, "proposed") for one in value)


def _are_names(value: object) -> bool:
    return isinstance(value, tuple) and all(isinstance(one, str) for one in value)


def _is_sought(value: object) -> bool:
    return isinstance(value, str) and value == "estimate"


def _is_tilt(value: object) -> bool:
    return isinstance(value, tuple) and len(value) == 2 and all(map(_is_number, value))


_FIELDS: Mapping[str, tuple[Callable[[Any], bool], str]] = {
    "smoother": (_is_smoother, "a smoother, such as Spline(), or a tuple of them"),
    "estimator": (_is_estimator, "an estimator, such as LeastSquares()"),
    "filter": (lambda value: isinstance(value, ParallelFilter | None), "a ParallelFilter or None"),
    "min_speed": (_is_speed, "a number of at least 0, such numbers by joint, or None"),
    "time_offset": (lambda value: _is_sought(value) or _is_number(value), "a finite number (s) or 'estimate'"),
    "base_tilt": (
        lambda value: value is None or _is_sought(value) or _is_tilt(value), "two angles (rad), 'estimate' or None",
    ),
    "outliers": (lambda value: value in ("mask", "keep"), "'mask' or 'keep'"),
    "rests": (lambda value: value in ("trim", "keep"), "'trim' or 'keep'"),
    "terms": (lambda value: value in (None, "auto"), "'auto' or None"),
    "proposed": (_are_proposing, "classes of terms with a class method `proposed`, in a tuple"),
    "unfitted": (_are_names, "names of joints, in a tuple"),
    "restart": (lambda value: value is None or (_is_number(value) and value > 0), "a positive number (s) or None"),
}  # fmt: skip


@dataclass(frozen=True)
class Recipe:
    """How to identify: the interchangeable parts, with the article's method as the default.

    Of several smoothers, ``choose_smoother`` takes one by the cross-validated torque error on the training logs.
    ``min_speed``, a speed (rad/s, m/s) or one by joint name, leaves slower samples out of that joint's equation in the
    fit. ``time_offset`` (s) is how much later than the torque the positions show the motion, and ``base_tilt`` are the
    rotations (rad) of the robot's base about the x and y axes of its root link; "estimate" finds either on the training
    logs. ``restart`` (s) asks for free simulations from the measured torque; logs that know their controller need none.
    ``outliers`` "mask" replaces spikes and frozen stretches of positions, and leaves wrong torques out of the fit.
    ``rests`` "trim" cuts long rests of the whole arm off the ends of the logs, and leaves those within out of the fit
    where this predicts the torque in motion better.
    ``terms`` "auto" adds to the model the terms of each joint that the training logs choose, as ``choose_terms`` does,
    and chooses ``min_speed`` with them where none is given; classes of terms in ``proposed``, which say by their method
    ``proposed`` in what sizes they are to be tried on a joint, then take part. The torque equations of ``unfitted``
    joints are not fitted; their torque is predicted and judged all the same.

    A recipe as used, that of an ``Identification``, has one smoother, which gives the motion with the time offset, and
    numbers: nothing in it is left to choose. Raises ConfigError for a field of another type.

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
    outliers: Literal["mask", "keep"] = "mask"
    rests: Literal["trim", "keep"] = "trim"
    terms: Literal["auto"] | None = None
    proposed: tuple[type, ...] = ()
    unfitted: tuple[str, ...] = ()

    __repr__ = changed

    def __post_init__(self) -> None:
        for name in ("smoother", "base_tilt", "unfitted"):
            if isinstance(value := getattr(self, name), list):
                object.__setattr__(self, name, tuple(value))
        for name, (fits, wanted) in _FIELDS.items():
            if not fits(value := getattr(self, name)):
                raise ConfigError(f"recipe: {name} is {short(value)}; it must be {wanted}.")

    @property
    def smoothers(self) -> tuple[Smoother, ...]:
        """The smoothers to choose from, most often one."""
        return self.smoother if isinstance(self.smoother, tuple) else (self.smoother,)

    def motion(self, log: Log) -> Motion:
        """Return the motion of a log that is judged, by the smoother, or its substitute where that does not apply.

        Raises the errors of the smoother, and ConfigError where it is still to be chosen among several.
        """
        if len(self.smoothers) != 1:
            raise ConfigError(f"the recipe has {len(self.smoothers)} smoothers to choose from; name one, or identify.")
        return motion_of(self.smoothers[0], self.repaired(log), judged=True)

    def trimmed(self, log: Log) -> Log:
        """Return the log without long rests of the whole arm at its ends."""
        return trimmed(log) if self.rests == "trim" else log

    def repaired(self, log: Log, *, torque: bool = False) -> Log:
        """Return the log without outliers of the positions; with ``torque``, suspect torques are not kept, either, nor
        those of joints that are not fitted."""
        found = repaired(log, torque=torque) if self.outliers == "mask" else log
        return self.fitting(found) if torque else found

    def fitting(self, one: Recorded) -> Recorded:
        """Return a log or motion that keeps for the fit nothing of the joints that are not fitted."""
        if not self.unfitted:
            return one
        keep = np.broadcast_to([name not in self.unfitted for name in one.joints], one.q.shape)
        return replace(one, keep=keep if one.keep is None else keep & one.keep)

    def check_joints(self, joints: Sequence[str]) -> None:
        """Raise ConfigError where joints that are not fitted are unknown, or all of them."""
        for name in self.unfitted:
            if name not in joints:
                raise ConfigError(f"unfitted: there is no joint {name!r}; {choices(name, joints)}")
        if set(joints) <= set(self.unfitted):
            raise ConfigError("unfitted: names every joint, so that nothing is left to fit; leave one out.")

    def min_speeds(self, joints: Sequence[str]) -> tuple[float, ...] | None:
        """Return ``min_speed`` for each joint; ConfigError where it names another."""
        if self.min_speed is None or not isinstance(self.min_speed, Mapping):
            return None if self.min_speed is None else (float(self.min_speed),) * len(joints)
        for name in self.min_speed:
            if name not in joints:
                raise ConfigError(f"min_speed: there is no joint {name!r}; {choices(name, joints)}")
        return tuple(float(self.min_speed.get(name, 0.0)) for name in joints)
