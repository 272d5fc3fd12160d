"""The settings that are tuned by hand, as one value."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING
from urllib.parse import parse_qsl, quote_plus

from dynident.motion.smoothers import MAX_TIME_OFFSET
from dynident.regression import ParallelFilter
from dynident.runtime import ConfigError, choices

if TYPE_CHECKING:
    from dynident.apps.tuning.bench import Bench

MIN_DEGREE, MAX_DEGREE = -6.0, 6.0  # log10(S/n): beyond, a spline interpolates, or is a straight line
Window = tuple[str, float, float]
MAX_CHARACTERS, MAX_FIELDS = 20_000, 1_000  # characters and fields of a query
BY_JOINT = ("degree", "min_speed", "terms")
ALL = (*BY_JOINT, "estimator", "exclude", "unfitted", "filter", "decimate", "cutoff", "order", "time_offset")
NONE = "none"
Fields = list[tuple[str, str]]


@dataclass(frozen=True)
class Tuning:
    """Everything that can be set by hand, complete: nothing is relative to other settings. Hashable.

    For each of the n joints of the model, in its order: ``degree``, log10(S/n) of the smoothing spline, in terms of the
    noise of the positions; ``terms``, the kinds of terms beside the bodies, such as "coulomb"; ``min_speed`` (rad/s,
    m/s), 0 where all samples are fitted. ``estimator`` is a kind. ``excluded`` are windows (name of a log, start and
    stop in s of its time) that are neither fitted nor judged; ``unfitted`` the joints whose torque equation is not
    fitted. ``filter`` is the parallel filter; ``time_offset`` (s) how much later than the torque the positions are
    stamped. Raises ConfigError for a number out of range.
    """

    degree: tuple[float, ...]
    terms: tuple[tuple[str, ...], ...]
    min_speed: tuple[float, ...]
    estimator: str
    excluded: tuple[Window, ...] = ()
    unfitted: tuple[str, ...] = ()
    filter: ParallelFilter | None = None
    time_offset: float = 0.0

    def __post_init__(self) -> None:
        for number in self.degree:
            if not MIN_DEGREE <= number <= MAX_DEGREE:
                raise ConfigError(
                    f"degree of smoothing, log10(S/n), is {number:g}; give a number from {MIN_DEGREE:g} to "
                    f"{MAX_DEGREE:g}."
                )
        for number in self.min_speed:
            if not 0.0 <= number < math.inf:
                raise ConfigError(f"minimum speed is {number:g}; give a number of at least 0, in rad/s or m/s.")
        if not abs(self.time_offset) <= MAX_TIME_OFFSET:
            raise ConfigError(f"time offset is {self.time_offset:g} s; give at most {MAX_TIME_OFFSET:g} s in size.")
        for name, start, stop in self.excluded:
            if not (math.isfinite(start) and math.isfinite(stop) and start < stop):
                raise ConfigError(
                    f"excluded window of {name!r}: {start:g} to {stop:g} s; it must stop after it starts."
                )

    def with_degree(self, degree: float, joint: int | None = None) -> Tuning:
        """Return the tuning with a degree of smoothing for one joint, by its index, or for all."""
        places = range(len(self.degree)) if joint is None else (joint,)
        return replace(
            self, degree=tuple(degree if j in places else previous for j, previous in enumerate(self.degree))
        )

    def with_terms(self, joint: int, kinds: Sequence[str]) -> Tuning:
        """Return the tuning with the kinds of terms of a joint, by its index."""
        return replace(
            self, terms=tuple(tuple(kinds) if j == joint else previous for j, previous in enumerate(self.terms))
        )

    def exclude(self, log: str, start: float, stop: float) -> Tuning:
        """Return the tuning with another excluded window of a log (s), merged with those that it overlaps."""
        spans = sorted([(a, b) for name, a, b in self.excluded if name == log] + [(start, stop)])
        joined = [spans[0]]
        for a, b in spans[1:]:
            if a <= joined[-1][1]:
                joined[-1] = joined[-1][0], max(b, joined[-1][1])
            else:
                joined.append((a, b))
        other_windows = tuple(window for window in self.excluded if window[0] != log)
        return replace(self, excluded=(*other_windows, *((log, a, b) for a, b in joined)))

    def windows(self, log: str) -> tuple[tuple[float, float], ...]:
        """Return the windows (start, stop; s) of a log that are excluded."""
        return tuple((start, stop) for name, start, stop in self.excluded if name == log)

    def check(
        self, joints: Sequence[str], logs: Sequence[str], kinds: Sequence[str], estimators: Sequence[str]
    ) -> None:
        """Raise ConfigError where the tuning does not fit these joints, logs, kinds of terms and estimators."""
        for name in ("degree", "terms", "min_speed"):
            if len(values := getattr(self, name)) != len(joints):
                raise ConfigError(f"{name} has {len(values)} entries for {len(joints)} joints ({', '.join(joints)}).")
        entries = [
            ("unfitted", "joint", self.unfitted, joints),
            ("estimator", "estimator", (self.estimator,), estimators),
        ]
        entries.append(("excluded", "log", tuple(log for log, _, _ in self.excluded), logs))
        entries.append(
            ("terms", "kind of terms", tuple(kind for joint_kinds in self.terms for kind in joint_kinds), kinds)
        )
        for where, noun, names, allowed in entries:
            for name in names:
                if name not in allowed:
                    raise ConfigError(f"{where}: there is no {noun} {name!r}; {choices(name, allowed)}")
        if set(joints) <= set(self.unfitted):
            raise ConfigError("unfitted: names every joint, so that nothing is left to fit; leave one out.")


def to_query(tuning: Tuning, start: Tuning, joints: Sequence[str]) -> str:
    """Return the query (without ``?``) of the differences of a tuning from the ``start``, empty without any.

    Such as ``degree.elbow=1.2&terms.elbow=viscous,coulomb&exclude=monday:1.5:2``. Numbers are exact.
    """
    fields: Fields = []
    for name in BY_JOINT:
        tuned, initial = getattr(tuning, name), getattr(start, name)
        changed = [j for j in range(len(joints)) if tuned[j] != initial[j]]
        if len(changed) == len(joints) > 1 and len(set(tuned)) == 1:
            fields.append((name, _format_value(tuned[0])))
        else:
            fields += [(f"{name}.{joints[j]}", _format_value(tuned[j])) for j in changed]
    if tuning.estimator != start.estimator:
        fields.append(("estimator", tuning.estimator))
    if tuning.excluded != start.excluded:
        fields += [("exclude", f"{log}:{a!r}:{b!r}") for log, a, b in tuning.excluded] or [("exclude", "")]
    if tuning.unfitted != start.unfitted:
        fields += [("unfitted", name) for name in tuning.unfitted] or [("unfitted", "")]
    if tuning.filter != start.filter:
        fields += _filter_fields(tuning.filter)
    if tuning.time_offset != start.time_offset:
        fields.append(("time_offset", repr(tuning.time_offset)))
    return "&".join(f"{quote_plus(name)}={quote_plus(value, safe=':,')}" for name, value in fields)


def parse_query(text: str, bench: Bench) -> Tuning:
    """Return the tuning of a query (with or without ``?``), applied to the start of a bench.

    Raises ConfigError, with the field, for anything that it does not understand.
    """
    fields = _parse_fields(text)
    tuning, joints = bench.start, bench.joints
    for name, value in fields:
        key, dot, joint = name.partition(".")
        if key not in ALL or (dot and key not in BY_JOINT):
            raise ConfigError(f"address: there is no field {name!r}; {choices(key, ALL)}")
        if dot and joint not in joints:
            raise ConfigError(f"address: {key}: there is no joint {joint!r}; {choices(joint, joints)}")
        if key in BY_JOINT:
            tuning = _set_by_joint(tuning, key, value, range(len(joints)) if not dot else [joints.index(joint)])
        elif key == "estimator":
            tuning = replace(tuning, estimator=value)
        elif key == "time_offset":
            tuning = replace(tuning, time_offset=_parse_number(key, value))
    tuning = replace(tuning, filter=_read_filter(dict(fields), bench.start.filter))
    if values := [value for name, value in fields if name == "exclude"]:
        tuning = replace(tuning, excluded=tuple(_parse_window(value) for value in values if value))
    if values := [value for name, value in fields if name == "unfitted"]:
        tuning = replace(tuning, unfitted=tuple(dict.fromkeys(value for value in values if value)))
    bench.check(tuning)
    return tuning


def _parse_fields(text: str) -> Fields:
    text = text.removeprefix("?")
    if len(text) > MAX_CHARACTERS:
        raise ConfigError(f"address: {len(text)} characters are more than the settings can take ({MAX_CHARACTERS}).")
    try:
        return parse_qsl(
            text, keep_blank_values=True, strict_parsing=bool(text), max_num_fields=MAX_FIELDS, errors="strict"
        )
    except ValueError as error:
        raise ConfigError(f"address: what follows the '?' is no list of settings: {error}.") from None


def _format_value(value: float | tuple[str, ...]) -> str:
    return ",".join(value) if isinstance(value, tuple) else repr(float(value))


def _filter_fields(value: ParallelFilter | None) -> Fields:
    if value is None:
        return [("filter", NONE)]
    cutoff = [] if value.cutoff is None else [("cutoff", repr(value.cutoff))]
    return [("decimate", str(value.decimate)), *cutoff, ("order", str(value.order))]


def _read_filter(fields: dict[str, str], start: ParallelFilter | None) -> ParallelFilter | None:
    if "filter" in fields:
        if fields["filter"] != NONE:
            raise ConfigError(f"address: filter is {fields['filter']!r}; give {NONE!r}, or decimate, cutoff and order.")
        return None
    if not fields.keys() & {"decimate", "cutoff", "order"}:
        return start
    cutoff = _parse_number("cutoff", fields["cutoff"]) if "cutoff" in fields else None
    return ParallelFilter(
        _parse_integer("decimate", fields.get("decimate", "1")),
        cutoff,
        _parse_integer("order", fields.get("order", "4")),
    )


def _set_by_joint(tuning: Tuning, key: str, value: str, places: Sequence[int]) -> Tuning:
    if key == "terms":
        kinds = _parse_kinds(value)
        return replace(
            tuning, terms=tuple(kinds if j in places else previous for j, previous in enumerate(tuning.terms))
        )
    number = _parse_number(key, value)
    if key == "degree":
        return replace(
            tuning, degree=tuple(number if j in places else previous for j, previous in enumerate(tuning.degree))
        )
    return replace(
        tuning, min_speed=tuple(number if j in places else previous for j, previous in enumerate(tuning.min_speed))
    )


def _parse_kinds(value: str) -> tuple[str, ...]:
    return tuple(dict.fromkeys(kind for kind in value.split(",") if kind))


def _parse_window(value: str) -> Window:
    log, *ends = value.rsplit(":", 2)
    if len(ends) != 2:
        raise ConfigError(f"address: exclude is {value!r}; give LOG:START:STOP, in s.")
    return log, _parse_number("exclude", ends[0]), _parse_number("exclude", ends[1])


def _parse_number(key: str, value: str) -> float:
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise ConfigError(f"address: {key} is {value!r}; give a number.")
    return number


def _parse_integer(key: str, value: str) -> int:
    number = _parse_number(key, value)
    if number != int(number):
        raise ConfigError(f"address: {key} is {value!r}; give a whole number.")
    return int(number)
