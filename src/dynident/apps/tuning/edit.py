"""Changes of a setting by the controls of the page."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeVar

from dynident.regression import ParallelFilter
from dynident.runtime import ConfigError, choices, number, part_text, percent

if TYPE_CHECKING:
    from dynident.apps.tuning.answers import View
    from dynident.apps.tuning.bench import Bench
    from dynident.apps.tuning.tuning import Tuning

SettingValue = TypeVar("SettingValue")
_VIEWS: Mapping[str, Callable[[View, str], View]] = {
    "joint": lambda view, name: replace(view, joint=name),
    "log": lambda view, name: replace(view, log=name),
    "reach": lambda view, name: replace(view, alone=name == "one"),
}

Change = tuple[str, str, str]  # what, before, now


def apply_control(view: View, control: str, value: Any, bench: Bench) -> View:
    """Return the view after its ``control``, such as "min_speed" or "term:viscous", got a ``value``.

    A control of joints acts on the joint that is drawn, or on all, as the view says. Raises ConfigError
    where there is no such control or its value makes no sense.
    """
    name, _, argument = control.partition(":")
    if name in _VIEWS:
        return _VIEWS[name](view, argument)
    if name not in _SETTINGS:
        raise ConfigError(f"there is no control {name!r}; {choices(name, [*_VIEWS, *_SETTINGS])}")
    return replace(view, tuning=_SETTINGS[name](view, bench, argument or value))


def _set_degree(view: View, bench: Bench, value: Any) -> Tuning:
    joint = bench.joints.index(view.joint) if view.alone else None
    return view.tuning.with_degree(_parse_number("degree of smoothing", value), joint)


def _set_mark(view: View, bench: Bench, name: Any) -> Tuning:
    marks = bench.curve(view.tuning, view.joint if view.alone else None).marks
    if name not in marks:
        raise ConfigError(f"there is no mark {name!r}; {choices(str(name), list(marks))}")
    degree, mark_degrees = view.tuning.degree, tuple(float(value) for value in marks[name])
    joint = bench.joints.index(view.joint)
    return replace(
        view.tuning, degree=(*degree[:joint], mark_degrees[joint], *degree[joint + 1 :]) if view.alone else mark_degrees
    )


def _set_min_speed(view: View, bench: Bench, value: Any) -> Tuning:
    speed = _parse_number("minimum speed", 0.0 if value in (None, "") else value, minimum=0.0)
    return replace(view.tuning, min_speed=_set_joint_value(view, bench, view.tuning.min_speed, speed))


def _toggle_term(view: View, bench: Bench, kind: Any) -> Tuning:
    """Switch a kind of terms on or off, opposite to its state on the joint that is drawn."""
    # the joint that is drawn decides whether the kind is switched on or off, on all joints alike
    is_on = kind in view.tuning.terms[bench.joints.index(view.joint)]
    new = [(set(old) | {kind}) - ({kind} if is_on else set()) for old in view.tuning.terms]
    new_terms = [tuple(candidate for candidate in bench.kinds if candidate in kinds) for kinds in new]
    pairs = zip(bench.joints, view.tuning.terms, new_terms, strict=True)
    return replace(
        view.tuning, terms=tuple(kinds if not view.alone or joint == view.joint else old for joint, old, kinds in pairs)
    )


def _toggle_fitted_joint(view: View, bench: Bench, joint: Any) -> Tuning:
    """Fit the torque of a joint, or leave it out."""
    unfitted = set(view.tuning.unfitted) ^ {joint}
    return replace(view.tuning, unfitted=tuple(name for name in bench.joints if name in unfitted))


def _set_filter(view: View, bench: Bench, value: Any) -> Tuning:  # noqa: ARG001 -- as the others
    if value == "none":
        return replace(view.tuning, filter=None)
    return replace(view.tuning, filter=view.tuning.filter or ParallelFilter(decimate=5))


def _set_decimation(view: View, bench: Bench, value: Any) -> Tuning:  # noqa: ARG001
    factor = _parse_number("decimation", 1 if value in (None, "") else value, minimum=1)
    if factor != int(factor):
        raise ConfigError(f"decimation: {factor:g} is no whole number.")
    return _with_filter(view, decimate=int(factor))


def _set_cutoff(view: View, bench: Bench, value: Any) -> Tuning:  # noqa: ARG001
    return _with_filter(view, cutoff=None if value in (None, "") else _parse_number("cut-off", value, minimum=1e-6))


def _with_filter(view: View, **changed: Any) -> Tuning:
    """Return the setting with another filter, or without one where it would do nothing."""
    before = view.tuning.filter or ParallelFilter(decimate=5)
    settings = {"decimate": before.decimate, "cutoff": before.cutoff} | changed
    # a filter that neither decimates nor has a cut-off of its own is none
    if settings == {"decimate": 1, "cutoff": None}:
        return replace(view.tuning, filter=None)
    return replace(view.tuning, filter=replace(before, **settings))


def _set_estimator(view: View, bench: Bench, value: Any) -> Tuning:
    if value not in bench.estimators:
        raise ConfigError(f"there is no estimator {value!r} here; {choices(str(value), bench.estimators)}")
    return replace(view.tuning, estimator=value)


def _set_time_offset(view: View, bench: Bench, value: Any) -> Tuning:  # noqa: ARG001
    return replace(view.tuning, time_offset=_parse_number("time offset", 0.0 if value in (None, "") else value) / 1e3)


def _exclude_window(view: View, bench: Bench, value: Any) -> Tuning:  # noqa: ARG001
    """Leave out a window of the log that is drawn."""
    start, stop = sorted(_parse_number("window", time) for time in value)
    if start == stop:
        raise ConfigError("window: drag over some samples, or give two times.")
    return view.tuning.exclude(view.log, start, stop)


def _include_window(view: View, bench: Bench, value: Any) -> Tuning:  # noqa: ARG001
    remaining = [window for k, window in enumerate(view.tuning.excluded) if str(k) != str(value)]
    return replace(view.tuning, excluded=tuple(remaining))


def _reset_all(view: View, bench: Bench, value: Any) -> Tuning:  # noqa: ARG001
    return bench.start


_SETTINGS: Mapping[str, Callable[[View, Bench, Any], Tuning]] = {
    "degree": _set_degree,
    "mark": _set_mark,
    "min_speed": _set_min_speed,
    "term": _toggle_term,
    "fitted": _toggle_fitted_joint,
    "filter": _set_filter,
    "decimate": _set_decimation,
    "cutoff": _set_cutoff,
    "estimator": _set_estimator,
    "offset": _set_time_offset,
    "exclude": _exclude_window,
    "include": _include_window,
    "reset": _reset_all,
}


def _set_joint_value(
    view: View, bench: Bench, values: Sequence[SettingValue], value: SettingValue
) -> tuple[SettingValue, ...]:
    """Return the values by joint with a new one: of the joint that is drawn, or of all."""
    return tuple(
        value if not view.alone or name == view.joint else old for name, old in zip(bench.joints, values, strict=True)
    )


def _parse_number(quantity: str, value: Any, minimum: float = -math.inf) -> float:
    try:
        parsed = float(value)
    except (TypeError, ValueError):
        raise ConfigError(f"{quantity}: {value!r} is no number.") from None
    if not math.isfinite(parsed) or parsed < minimum:
        raise ConfigError(
            f"{quantity}: {parsed:g} must be {'finite' if minimum == -math.inf else f'at least {minimum:g}'}."
        )
    return parsed


def setting_changes(before: Tuning, now: Tuning, joints: Sequence[str]) -> list[Change]:
    """Return the differences between two settings: the quantity, its old and its new value; those of all joints
    once.
    """
    differences = [
        *_joint_changes("smoothing", before.degree, now.degree, joints, degree_words),
        *_joint_changes("minimum speed", before.min_speed, now.min_speed, joints, lambda value: number(value, 3)),
        *_joint_changes("terms", before.terms, now.terms, joints, lambda kinds: ", ".join(kinds) or "none"),
    ]
    for quantity, describe in SHARED_SETTINGS.items():
        if (was := describe(before)) != (is_now := describe(now)):
            differences.append((quantity, was, is_now))
    return [*differences, *_window_changes(before, now)]


def degree_words(degree: float) -> str:
    """Return a degree of smoothing as its S/n."""
    return f"S/n = {number(10.0**degree, 3)}"


def estimator_words(kind: str) -> str:
    """Return the name of a kind of estimator; one of the user keeps its own."""
    return {"consistent": "physically consistent"}.get(kind, kind.replace("_", " "))


def error_words(value: float | None) -> str:
    """Return an error in per cent."""
    return "-" if value is None or value != value else percent(value)


SHARED_SETTINGS: Mapping[str, Callable[[Tuning], str]] = {
    "joints not fitted": lambda tuning: ", ".join(tuning.unfitted) or "none",
    "parallel filter": lambda tuning: "none" if tuning.filter is None else part_text(tuning.filter),
    "estimator": lambda tuning: estimator_words(tuning.estimator),
    "time offset": lambda tuning: f"{number(1e3 * tuning.time_offset, 4)} ms",
}


def _joint_changes(
    quantity: str, before: Sequence[Any], now: Sequence[Any], joints: Sequence[str], words: Any
) -> Iterator[Change]:
    changed_joints = [k for k in range(len(joints)) if before[k] != now[k]]
    pairs = {(words(before[k]), words(now[k])) for k in changed_joints}
    # one line where all joints change alike
    if len(pairs) == 1 and len(changed_joints) == len(joints) > 1:
        yield (f"{quantity} of all joints", *pairs.pop())
        return
    for k in changed_joints:
        yield f"{quantity} of {joints[k]}", words(before[k]), words(now[k])


def _window_changes(before: Tuning, now: Tuning) -> Iterator[Change]:
    for window in before.excluded:
        if window not in now.excluded:
            yield f"samples of {window[0]}", f"without {number(window[1], 4)} to {number(window[2], 4)} s", "used again"
    for window in now.excluded:
        if window not in before.excluded:
            yield f"samples of {window[0]}", "used", f"without {number(window[1], 4)} to {number(window[2], 4)} s"
