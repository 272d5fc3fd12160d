"""From a control that was moved to the next setting."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeVar

from dynident.errors import ConfigError, choices
from dynident.regression import ParallelFilter

if TYPE_CHECKING:
    from dynident.tuning import Bench, Tuning
    from dynident.ui.view import View

__all__ = ["edited"]

One = TypeVar("One")


def edited(view: View, control: str, value: Any, bench: Bench) -> View:
    """Return what a page shows after its ``control``, such as "min_speed" or "term:viscous", got a ``value``; what
    acts on joints does on that which is drawn, or on all, as the view says.

    Raises ConfigError where there is no such control or its value makes no sense.
    """
    name, _, argument = control.partition(":")
    if name in _VIEWS:
        return _VIEWS[name](view, argument)
    if name not in _SETTINGS:
        raise ConfigError(f"there is no control {name!r}; {choices(name, [*_VIEWS, *_SETTINGS])}")
    return replace(view, tuning=_SETTINGS[name](view, bench, argument or value))


_VIEWS: Mapping[str, Callable[[View, str], View]] = {
    "joint": lambda view, name: replace(view, joint=name),
    "log": lambda view, name: replace(view, log=name),
    "reach": lambda view, name: replace(view, alone=name == "one"),
}


def _degree(view: View, bench: Bench, value: Any) -> Tuning:
    joint = bench.joints.index(view.joint) if view.alone else None
    return view.tuning.with_degree(_number("degree of smoothing", value), joint)


def _mark(view: View, bench: Bench, name: Any) -> Tuning:
    marks = bench.curve(view.tuning, view.joint if view.alone else None).marks
    if name not in marks:
        raise ConfigError(f"there is no mark {name!r}; {choices(str(name), list(marks))}")
    degree, own = view.tuning.degree, tuple(float(one) for one in marks[name])
    joint = bench.joints.index(view.joint)
    return replace(view.tuning, degree=(*degree[:joint], own[joint], *degree[joint + 1 :]) if view.alone else own)


def _min_speed(view: View, bench: Bench, value: Any) -> Tuning:
    speed = _number("minimum speed", 0.0 if value in (None, "") else value, least=0.0)
    return replace(view.tuning, min_speed=_at(view, bench, view.tuning.min_speed, speed))


def _term(view: View, bench: Bench, kind: Any) -> Tuning:
    """Switch a kind of terms on or off, as it then is on the joint that is drawn."""
    off = kind in view.tuning.terms[bench.joints.index(view.joint)]
    new = [(set(old) | {kind}) - ({kind} if off else set()) for old in view.tuning.terms]
    ordered = [tuple(one for one in bench.kinds if one in some) for some in new]
    pairs = zip(bench.joints, view.tuning.terms, ordered, strict=True)
    return replace(
        view.tuning, terms=tuple(some if not view.alone or joint == view.joint else old for joint, old, some in pairs)
    )


def _fitted(view: View, bench: Bench, joint: Any) -> Tuning:
    """Fit the torque of a joint, or leave it out."""
    unfitted = set(view.tuning.unfitted) ^ {joint}
    return replace(view.tuning, unfitted=tuple(one for one in bench.joints if one in unfitted))


def _filter(view: View, bench: Bench, value: Any) -> Tuning:  # noqa: ARG001 -- as the others
    if value == "none":
        return replace(view.tuning, filter=None)
    return replace(view.tuning, filter=view.tuning.filter or ParallelFilter(decimate=5))


def _decimate(view: View, bench: Bench, value: Any) -> Tuning:  # noqa: ARG001
    whole = _number("decimation", 1 if value in (None, "") else value, least=1)
    if whole != int(whole):
        raise ConfigError(f"decimation: {whole:g} is no whole number.")
    return _filtered(view, decimate=int(whole))


def _cutoff(view: View, bench: Bench, value: Any) -> Tuning:  # noqa: ARG001
    return _filtered(view, cutoff=None if value in (None, "") else _number("cut-off", value, least=1e-6))


def _filtered(view: View, **changed: Any) -> Tuning:
    """Return the setting with another filter; one that does nothing is none."""
    before = view.tuning.filter or ParallelFilter(decimate=5)
    both = {"decimate": before.decimate, "cutoff": before.cutoff} | changed
    if both == {"decimate": 1, "cutoff": None}:
        return replace(view.tuning, filter=None)
    return replace(view.tuning, filter=replace(before, **both))


def _estimator(view: View, bench: Bench, value: Any) -> Tuning:
    if value not in bench.estimators:
        raise ConfigError(f"there is no estimator {value!r} here; {choices(str(value), bench.estimators)}")
    return replace(view.tuning, estimator=value)


def _offset(view: View, bench: Bench, value: Any) -> Tuning:  # noqa: ARG001
    return replace(view.tuning, time_offset=_number("time offset", 0.0 if value in (None, "") else value) / 1e3)


def _exclude(view: View, bench: Bench, value: Any) -> Tuning:  # noqa: ARG001
    """Leave out a window of the log that is drawn."""
    start, stop = sorted(_number("window", one) for one in value)
    if start == stop:
        raise ConfigError("window: drag over some samples, or give two times.")
    return view.tuning.excluding(view.log, start, stop)


def _include(view: View, bench: Bench, value: Any) -> Tuning:  # noqa: ARG001
    left = [one for k, one in enumerate(view.tuning.excluded) if str(k) != str(value)]
    return replace(view.tuning, excluded=tuple(left))


def _reset(view: View, bench: Bench, value: Any) -> Tuning:  # noqa: ARG001
    return bench.start


_SETTINGS: Mapping[str, Callable[[View, Bench, Any], Tuning]] = {
    "degree": _degree,
    "mark": _mark,
    "min_speed": _min_speed,
    "term": _term,
    "fitted": _fitted,
    "filter": _filter,
    "decimate": _decimate,
    "cutoff": _cutoff,
    "estimator": _estimator,
    "offset": _offset,
    "exclude": _exclude,
    "include": _include,
    "reset": _reset,
}


def _at(view: View, bench: Bench, values: Sequence[One], value: One) -> tuple[One, ...]:
    """Return values by joint with a new one: of the joint that is drawn, or of all."""
    return tuple(
        value if not view.alone or name == view.joint else old for name, old in zip(bench.joints, values, strict=True)
    )


def _number(what: str, value: Any, least: float = -math.inf) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise ConfigError(f"{what}: {value!r} is no number.") from None
    if not math.isfinite(number) or number < least:
        raise ConfigError(f"{what}: {number:g} must be {'finite' if least == -math.inf else f'at least {least:g}'}.")
    return number
