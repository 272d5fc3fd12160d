"""A tuning as the query of an address, in words that can be read and typed: only what differs from the start."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING
from urllib.parse import parse_qsl, quote_plus

from dynident.errors import ConfigError, choices
from dynident.regression import ParallelFilter
from dynident.tuning.tuning import Tuning, Window

if TYPE_CHECKING:
    from dynident.tuning.bench import Bench

__all__ = ["of_query", "to_query"]

LONGEST, MOST = 20_000, 1_000  # characters and fields of a query
BY_JOINT = ("degree", "min_speed", "terms")
ALL = (*BY_JOINT, "estimator", "exclude", "unfitted", "filter", "decimate", "cutoff", "order", "time_offset")
NONE = "none"
Fields = list[tuple[str, str]]


def to_query(tuning: Tuning, start: Tuning, joints: Sequence[str]) -> str:
    """Return the query (without ``?``) by which a tuning differs from another, empty where it does not.

    Such as ``degree.elbow=1.2&terms.elbow=viscous,coulomb&exclude=monday:1.5:2``. Numbers are exact.
    """
    found: Fields = []
    for name in BY_JOINT:
        one, other = getattr(tuning, name), getattr(start, name)
        changed = [j for j in range(len(joints)) if one[j] != other[j]]
        if len(changed) == len(joints) > 1 and len(set(one)) == 1:
            found.append((name, _text(one[0])))
        else:
            found += [(f"{name}.{joints[j]}", _text(one[j])) for j in changed]
    if tuning.estimator != start.estimator:
        found.append(("estimator", tuning.estimator))
    if tuning.excluded != start.excluded:
        found += [("exclude", f"{log}:{a!r}:{b!r}") for log, a, b in tuning.excluded] or [("exclude", "")]
    if tuning.unfitted != start.unfitted:
        found += [("unfitted", name) for name in tuning.unfitted] or [("unfitted", "")]
    if tuning.filter != start.filter:
        found += _filter(tuning.filter)
    if tuning.time_offset != start.time_offset:
        found.append(("time_offset", repr(tuning.time_offset)))
    return "&".join(f"{quote_plus(name)}={quote_plus(value, safe=':,')}" for name, value in found)


def of_query(text: str, bench: Bench) -> Tuning:
    """Return the tuning that a query (with or without ``?``) makes of the start of a bench.

    Raises ConfigError, with the field, for anything that it does not understand.
    """
    fields = _fields(text)
    tuning, joints = bench.start, bench.joints
    for name, value in fields:
        key, dot, joint = name.partition(".")
        if key not in ALL or (dot and key not in BY_JOINT):
            raise ConfigError(f"address: there is no field {name!r}; {choices(key, ALL)}")
        if dot and joint not in joints:
            raise ConfigError(f"address: {key}: there is no joint {joint!r}; {choices(joint, joints)}")
        if key in BY_JOINT:
            tuning = _by_joint(tuning, key, value, range(len(joints)) if not dot else [joints.index(joint)])
        elif key == "estimator":
            tuning = replace(tuning, estimator=value)
        elif key == "time_offset":
            tuning = replace(tuning, time_offset=_number(key, value))
    tuning = replace(tuning, filter=_read_filter(dict(fields), bench.start.filter))
    if some := [value for name, value in fields if name == "exclude"]:
        tuning = replace(tuning, excluded=tuple(_window(value) for value in some if value))
    if some := [value for name, value in fields if name == "unfitted"]:
        tuning = replace(tuning, unfitted=tuple(dict.fromkeys(value for value in some if value)))
    bench.check(tuning)
    return tuning


def _fields(text: str) -> Fields:
    text = text.removeprefix("?")
    if len(text) > LONGEST:
        raise ConfigError(f"address: {len(text)} characters are more than the settings can take ({LONGEST}).")
    try:
        return parse_qsl(text, keep_blank_values=True, strict_parsing=bool(text), max_num_fields=MOST, errors="strict")
    except ValueError as error:
        raise ConfigError(f"address: what follows the '?' is no list of settings: {error}.") from None


def _text(value: float | tuple[str, ...]) -> str:
    return ",".join(value) if isinstance(value, tuple) else repr(float(value))


def _filter(value: ParallelFilter | None) -> Fields:
    if value is None:
        return [("filter", NONE)]
    cutoff = [] if value.cutoff is None else [("cutoff", repr(value.cutoff))]
    return [("decimate", str(value.decimate)), *cutoff, ("order", str(value.order))]


def _read_filter(given: dict[str, str], start: ParallelFilter | None) -> ParallelFilter | None:
    if "filter" in given:
        if given["filter"] != NONE:
            raise ConfigError(f"address: filter is {given['filter']!r}; give {NONE!r}, or decimate, cutoff and order.")
        return None
    if not given.keys() & {"decimate", "cutoff", "order"}:
        return start
    cutoff = _number("cutoff", given["cutoff"]) if "cutoff" in given else None
    return ParallelFilter(
        _whole("decimate", given.get("decimate", "1")), cutoff, _whole("order", given.get("order", "4"))
    )


def _by_joint(tuning: Tuning, key: str, value: str, places: Sequence[int]) -> Tuning:
    if key == "terms":
        kinds = _kinds(value)
        return replace(tuning, terms=tuple(kinds if j in places else was for j, was in enumerate(tuning.terms)))
    number = _number(key, value)
    if key == "degree":
        return replace(tuning, degree=tuple(number if j in places else was for j, was in enumerate(tuning.degree)))
    return replace(tuning, min_speed=tuple(number if j in places else was for j, was in enumerate(tuning.min_speed)))


def _kinds(value: str) -> tuple[str, ...]:
    return tuple(dict.fromkeys(kind for kind in value.split(",") if kind))


def _window(value: str) -> Window:
    log, *ends = value.rsplit(":", 2)
    if len(ends) != 2:
        raise ConfigError(f"address: exclude is {value!r}; give LOG:START:STOP, in s.")
    return log, _number("exclude", ends[0]), _number("exclude", ends[1])


def _number(key: str, value: str) -> float:
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise ConfigError(f"address: {key} is {value!r}; give a number.")
    return number


def _whole(key: str, value: str) -> int:
    number = _number(key, value)
    if number != int(number):
        raise ConfigError(f"address: {key} is {value!r}; give a whole number.")
    return int(number)
