"""What a page shows, its address, which says all of it, and changes of it by the controls of the page."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import Any, TypeVar
from urllib.parse import parse_qsl, quote

import numpy as np
from pydantic import TypeAdapter, ValidationError
from pydantic_core import from_json

from dynident.apps.tuning.bench import Bench
from dynident.apps.tuning.tuning import Tuning
from dynident.project.python_file import error_text
from dynident.regression import ParallelFilter
from dynident.runtime import ConfigError, choices, number, part_text

T = TypeVar("T")
_TUNING_ADAPTER = TypeAdapter(Tuning)
SHOWN = ("joint", "log", "only_this_joint", "column")
Change = tuple[str, str, str]  # what, before, now


@dataclass(frozen=True)
class View:
    """A ``tuning``, the ``joint`` and the ``log`` that are drawn, whether a change is of that joint ``alone``, and the
    other ``column`` of the recording that is drawn ("": none)."""

    tuning: Tuning
    joint: str
    log: str
    alone: bool = False
    column: str = ""

    @classmethod
    def start(cls, bench: Bench) -> View:
        """Return the view that is shown first."""
        return cls(bench.start, bench.joints[0], bench.log_names[0])

    @classmethod
    def of_query(cls, text: str, bench: Bench) -> View:
        """Return the view of an address (its part after the question mark); ConfigError where it makes no sense."""
        settings = {**cls.start(bench)._settings(), **_parse_fields(text)}
        joint, log, alone, column = (settings.pop(key) for key in SHOWN)
        for key, value, allowed in (("joint", joint, bench.joints), ("log", log, bench.log_names)):
            if value not in allowed:
                raise ConfigError(f"address: there is no {key} {value!r}; {choices(value, allowed)}")
        if unknown := settings.keys() - {field.name for field in fields(Tuning)}:
            name = min(unknown)
            raise ConfigError(f"address: there is no setting {name!r}; {choices(name, [*asdict(bench.start), *SHOWN])}")
        try:
            tuning = _TUNING_ADAPTER.validate_python(settings)
        except ValidationError as error:
            raise ConfigError(error_text(error, settings, "address")) from None
        bench.check(tuning)
        return cls(tuning, joint, log, alone is True, str(column or ""))

    def to_query(self, bench: Bench) -> str:
        """Return the part of an address from the question mark on: what differs from the start, each value as JSON.

        Such as ``?degree=[1.2,0.5]&joint=%22elbow%22``. Numbers are exact.
        """
        start = View.start(bench)._settings()
        changed = {key: value for key, value in self._settings().items() if value != start[key]}
        pairs = (f"{key}={quote(json.dumps(value, separators=(',', ':')), '[]{}:,')}" for key, value in changed.items())
        return f"?{'&'.join(pairs)}" if changed else ""

    def _settings(self) -> dict[str, Any]:
        """Return all settings by their names in an address."""
        return {**asdict(self.tuning), **dict(zip(SHOWN, (self.joint, self.log, self.alone, self.column), strict=True))}


def _parse_fields(text: str) -> dict[str, Any]:
    """Return the values of an address by name; ConfigError where one is no JSON."""
    values = {}
    for name, value in parse_qsl(text.removeprefix("?"), keep_blank_values=True):
        try:
            values[name] = from_json(value, allow_inf_nan=False)
        except ValueError as error:
            raise ConfigError(f"address: {name} is {value[:80]!r}, which is no JSON: {error}.") from None
    return values


_VIEWS: Mapping[str, Callable[[View, str], View]] = {
    "joint": lambda view, name: replace(view, joint=name),
    "log": lambda view, name: replace(view, log=name),
    "reach": lambda view, name: replace(view, alone=name == "one"),
}


def apply_control(view: View, control: str, value: Any, bench: Bench) -> View:
    """Return the view after its ``control``, such as "min_speed" or "term:viscous", got a ``value``.

    A control of joints acts on the joint that is drawn, or on all, as the view says. Raises ConfigError
    where there is no such control or its value makes no sense.
    """
    name, _, argument = control.partition(":")
    if name in _VIEWS:
        return _VIEWS[name](view, argument)
    if name == "column":
        if value:
            bench.other_column(view.log, str(value), np.zeros(0))
        return replace(view, column=str(value or ""))
    if name not in _SETTINGS:
        raise ConfigError(f"there is no control {name!r}; {choices(name, [*_VIEWS, 'column', *_SETTINGS])}")
    tuning = _SETTINGS[name](view, bench, argument or value)
    bench.check(tuning)
    return replace(view, tuning=tuning)


def _set_degree(view: View, bench: Bench, value: Any) -> Tuning:
    degree = view.tuning.with_degree(_parse_number("degree of smoothing", value)).degree
    return replace(view.tuning, degree=_replace_values(view, bench, view.tuning.degree, degree))


def _set_mark(view: View, bench: Bench, name: Any) -> Tuning:
    marks = bench.curve(view.tuning, view.joint if view.alone else None).marks
    if name not in marks:
        raise ConfigError(f"there is no mark {name!r}; {choices(str(name), list(marks))}")
    return replace(view.tuning, degree=_replace_values(view, bench, view.tuning.degree, marks[name]))


def _set_min_speed(view: View, bench: Bench, value: Any) -> Tuning:
    speed = _parse_number("minimum speed", value or 0.0)
    min_speed = view.tuning.min_speed
    return replace(view.tuning, min_speed=_replace_values(view, bench, min_speed, [speed] * len(min_speed)))


def _toggle_term(view: View, bench: Bench, kind: Any) -> Tuning:
    """Switch a kind of terms on or off, opposite to its state on the joint that is drawn."""
    # the joint that is drawn decides whether the kind is switched on or off, on all joints alike
    is_on = kind in view.tuning.terms[bench.joints.index(view.joint)]
    new = [(set(old) | {kind}) - ({kind} if is_on else set()) for old in view.tuning.terms]
    new_terms = [tuple(candidate for candidate in bench.switches.kinds if candidate in kinds) for kinds in new]
    return replace(view.tuning, terms=_replace_values(view, bench, view.tuning.terms, new_terms))


def _toggle_fitted_joint(view: View, bench: Bench, joint: Any) -> Tuning:
    """Fit the torque of a joint, or leave it out."""
    unfitted = set(view.tuning.unfitted) ^ {joint}
    return replace(view.tuning, unfitted=tuple(name for name in bench.joints if name in unfitted))


def _set_decimation(view: View, bench: Bench, value: Any) -> Tuning:  # noqa: ARG001 -- as the others
    factor = _parse_number("decimation", value or 1)
    return _with_filter(view, decimate=int(factor) if factor.is_integer() else factor)


def _with_filter(view: View, **changed: Any) -> Tuning:
    """Return the setting with another filter, or without one where it would do nothing."""
    before = view.tuning.filter or ParallelFilter(decimate=5)
    settings = {"decimate": before.decimate, "cutoff": before.cutoff} | changed
    # a filter that neither decimates nor has a cut-off of its own is none
    if settings == {"decimate": 1, "cutoff": None}:
        return replace(view.tuning, filter=None)
    return replace(view.tuning, filter=replace(before, **settings))


def _exclude_window(view: View, bench: Bench, value: Any) -> Tuning:  # noqa: ARG001
    """Leave out a window of the log that is drawn."""
    start, stop = sorted(_parse_number("window", time) for time in value)
    if start == stop:
        raise ConfigError("window: drag over some samples, or give two times.")
    return view.tuning.exclude(view.log, start, stop)


_SETTINGS: Mapping[str, Callable[[View, Bench, Any], Tuning]] = {
    "degree": _set_degree,
    "mark": _set_mark,
    "min_speed": _set_min_speed,
    "term": _toggle_term,
    "fitted": _toggle_fitted_joint,
    "filter": lambda view, _, value: _with_filter(view) if value == "low-pass" else replace(view.tuning, filter=None),
    "decimate": _set_decimation,
    "cutoff": lambda view, _, value: _with_filter(view, cutoff=_parse_number("cut-off", value) if value else None),
    "estimator": lambda view, _, value: replace(view.tuning, estimator=str(value)),
    "offset": lambda view, _, value: replace(view.tuning, time_offset=_parse_number("time offset", value or 0.0) / 1e3),
    "exclude": _exclude_window,
    "include": lambda view, _, value: replace(
        view.tuning, excluded=tuple(window for k, window in enumerate(view.tuning.excluded) if str(k) != str(value))
    ),
    "reset": lambda _view, bench, _value: bench.start,
}


def _replace_values(view: View, bench: Bench, values: Sequence[T], new_values: Sequence[T]) -> tuple[T, ...]:
    """Return the values by joint with new ones: of the joint that is drawn, or of all."""
    return tuple(
        new if not view.alone or name == view.joint else old
        for name, old, new in zip(bench.joints, values, new_values, strict=True)
    )


def _parse_number(quantity: str, value: Any) -> float:
    try:
        return float(value)
    except (TypeError, ValueError):
        raise ConfigError(f"{quantity}: {value!r} is no number.") from None


def setting_changes(before: Tuning, now: Tuning, joints: Sequence[str]) -> list[Change]:
    """Return the differences between two settings: the quantity, its old and new value; those of all joints once."""
    changes: list[Change] = []
    for quantity, (field, words) in JOINT_SETTINGS.items():
        values = zip(getattr(before, field), getattr(now, field), strict=True)
        pairs = [(words(old), words(new)) for old, new in values]
        is_common = len(joints) > 1 and len(set(pairs)) == 1
        places = ["all joints"] if is_common else joints
        changes += [(f"{quantity} of {place}", *pair) for place, pair in zip(places, pairs, strict=False)]
    changes += [(quantity, describe(before), describe(now)) for quantity, describe in SHARED_SETTINGS.items()]
    return [change for change in changes if change[1] != change[2]]


def degree_words(degree: float) -> str:
    """Return a degree of smoothing as its S/n."""
    return f"S/n = {number(10.0**degree, 3)}"


def estimator_words(kind: str) -> str:
    """Return the name of a kind of estimator; one of the user keeps its own."""
    return {"consistent": "physically consistent"}.get(kind, kind.replace("_", " "))


def _window_words(tuning: Tuning) -> str:
    windows = (f"{log} {number(start, 4)} to {number(stop, 4)} s" for log, start, stop in tuning.excluded)
    return "; ".join(windows) or "none"


JOINT_SETTINGS: Mapping[str, tuple[str, Callable[[Any], str]]] = {  # the field, and the words for a value
    "smoothing": ("degree", degree_words),
    "minimum speed": ("min_speed", lambda speed: number(speed, 3)),
    "terms": ("terms", lambda kinds: ", ".join(kinds) or "none"),
}
SHARED_SETTINGS: Mapping[str, Callable[[Tuning], str]] = {
    "joints not fitted": lambda tuning: ", ".join(tuning.unfitted) or "none",
    "parallel filter": lambda tuning: "none" if tuning.filter is None else part_text(tuning.filter),
    "estimator": lambda tuning: estimator_words(tuning.estimator),
    "time offset": lambda tuning: f"{number(1e3 * tuning.time_offset, 4)} ms",
    "samples left out": _window_words,
}
