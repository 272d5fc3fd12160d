"""The kinds of values that settings hold: numbers, names, files, windows, and units with their factor to SI.

Each reader raises ValueError with a message to be appended to the path of the setting.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    StrictBool,
    ValidationError,
    ValidationInfo,
    WithJsonSchema,
    model_validator,
)
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from dynident.models import Joint
from dynident.motion.smoothers import MAX_TIME_OFFSET
from dynident.project.python_file import error_text
from dynident.regression import HIGHEST_ORDER
from dynident.runtime import ConfigError, as_number, choices

Interval = tuple[float | None, float | None]
MIN_MAGNITUDE, MAX_MAGNITUDE = 1e-15, 1e15  # in size, of settings in SI units and of gains
MAX_COUNT = 1_000_000  # of counts
MAX_LIST_ENTRIES = 100  # of a list of parts

UNITS: Mapping[str, Mapping[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0},
    "angle": {
        "rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180, "rev": 2 * math.pi, "arcmin": math.pi / 10800,
        "arcsec": math.pi / 648000,
    },
    "length": {"m": 1.0, "mm": 1e-3, "um": 1e-6, "cm": 1e-2, "in": 0.0254},
    "torque": {
        "N m": 1.0, "mN m": 1e-3, "N mm": 1e-3, "kN m": 1e3, "N cm": 1e-2, "kgf m": 9.80665, "kgf cm": 9.80665e-2,
        "lbf ft": 4.4482216152605 * 0.3048, "lbf in": 4.4482216152605 * 0.0254,
    },
    "angular velocity": {"rad/s": 1.0, "deg/s": math.pi / 180, "rpm": math.pi / 30, "rev/s": 2 * math.pi},
    "velocity": {"m/s": 1.0, "mm/s": 1e-3, "cm/s": 1e-2},
    "force": {"N": 1.0, "mN": 1e-3, "kN": 1e3, "kgf": 9.80665, "lbf": 4.4482216152605},
}  # fmt: skip

FACTOR = r"\d+(?:[.,]\d+)?(?:e-?\d+)?"  # of a unit

_END_SCHEMA = {"type": ["number", "null"]}
_PAIR_SCHEMA = {"type": "array", "prefixItems": [_END_SCHEMA, _END_SCHEMA], "items": False, "minItems": 2}
_TEXTS_SCHEMA = {"type": "object", "additionalProperties": {"type": "string"}, "minProperties": 1}

POSITIONS = {"revolute": "angle", "prismatic": "length"}
VELOCITIES = {"revolute": "angular velocity", "prismatic": "velocity"}
TORQUES = {"revolute": "torque", "prismatic": "force"}


def unit_factor(unit: str, dimension: str, where: str) -> float:
    """Return the factor from a unit to SI; ``N m``, ``Nm`` and ``N*m`` are one.

    ``dimension`` is one of UNITS; raises ConfigError, led by ``where``, for other units.
    """
    if size := unit_size(unit, dimension):
        return size
    # a known unit of another dimension is the likeliest mistake
    dimensions = [name for name in UNITS if unit_size(unit, name)]
    fault = f"a unit of {dimensions[0]}, not of {dimension}" if dimensions else f"not a unit of {dimension}"
    raise ConfigError(f"{where}: {unit!r} is {fault}; {choices(unit, UNITS[dimension])}")


def unit_size(unit: str, dimension: str) -> float | None:
    """Return a unit in SI units, which may have a factor in front, such as ``0.01 deg``; None for other units."""
    text = re.sub(r"[ *·]", "", unit).replace(",", ".")
    name = re.sub(rf"^{FACTOR}", "", text)
    sizes = {spelling.replace(" ", ""): size for spelling, size in UNITS[dimension].items()}
    return float(text.removesuffix(name) or 1) * sizes[name] if name in sizes else None


def interval_ends(interval: Interval) -> tuple[float, float]:
    """Return the ends of a window, infinite where they are open."""
    start, stop = interval
    return -math.inf if start is None else start, math.inf if stop is None else stop


def interval_words(interval: Interval) -> str:
    """Return a window as text for the name of a log, such as ``0-20 s``."""
    start, stop = interval
    return f"{start or 0:.12g}-{'end' if stop is None else f'{stop:.12g} s'}"


def _read_number(value: object) -> float:
    if math.isfinite(number := as_number(value)):
        return number
    raise ValueError("a finite number is expected")


def bounded_reader(lower: float, upper: float, unit: str = "") -> Callable[[object], float]:
    """Return a reader of numbers from ``lower`` to ``upper``, beyond which a value can only be a mistake."""

    def read(value: object) -> float:
        number = as_number(value) if unit else _read_number(value)
        if not lower <= number <= upper:
            raise ValueError(f"a number from {lower:g} to {upper:g}{unit} is expected")
        return number

    return read


def whole_number_reader(upper: int) -> Callable[[object], int]:
    """Return a reader of whole numbers from 1 to ``upper``."""

    def read(value: object) -> int:
        """Read a whole number; ValueError where it is another, or out of range."""
        number = as_number(value)
        if not (1 <= number <= upper and number == int(number)):
            raise ValueError(f"a whole number from 1 to {upper} is expected")
        return int(number)

    return read


def _check_list_length(value: object) -> object:
    if isinstance(value, list | tuple) and len(value) > MAX_LIST_ENTRIES:
        raise ValueError(f"at most {MAX_LIST_ENTRIES} entries are expected")
    return value


def _read_name(value: object) -> str:
    """Read a name; header-less columns are named by numbers, which need no quotes."""
    if isinstance(value, bool) or not isinstance(value, int | str) or not str(value).strip():
        raise ValueError("a name is expected (in quotes, where YAML reads it as another type)")
    return str(value)


def _read_amount(value: object) -> float | str:
    """Read a number, or the name of a scalar in the file."""
    # a text that is no number is a name, unless it spells a number that is not finite
    if math.isnan(number := as_number(value)):
        if isinstance(value, str) and value.strip().lower().lstrip("+-.") not in ("", "nan", "inf"):
            return value
    elif abs(number) <= MAX_MAGNITUDE:
        return number
    raise ValueError(
        f"a finite number, at most {MAX_MAGNITUDE:g} in size, or the name of a scalar in the file, is expected"
    )


def _read_gain(value: object) -> float | str:
    """Read an amount by which a signal is multiplied: a gain of 0 would leave nothing of it."""
    if isinstance(gain := _read_amount(value), str) or abs(gain) >= MIN_MAGNITUDE:
        return gain
    raise ValueError(f"a gain other than 0 is expected, of at least {MIN_MAGNITUDE:g} in size")


def _by_name_reader(read: Callable[[object], Any]) -> Callable[[object], Any]:
    """Return a reader of either one value or a mapping of names to values."""

    def read_all(value: object) -> Any:
        """Read a value, or each of a mapping's."""
        if value is None:
            return None
        return {_read_name(k): read(v) for k, v in value.items()} if isinstance(value, dict) else read(value)

    return read_all


def _read_positive(value: object) -> float:
    if (number := _read_number(value)) <= 0:
        raise ValueError("a number greater than 0 is expected")
    return bounded_reader(MIN_MAGNITUDE, MAX_MAGNITUDE)(number)


def _read_non_negative(value: object) -> float:
    if (number := _read_number(value)) < 0:
        raise ValueError("a number of at least 0 is expected")
    return bounded_reader(MIN_MAGNITUDE, MAX_MAGNITUDE)(number) if number else 0.0


def _read_windows(value: object) -> tuple[Interval, ...]:
    """Read ``[start, stop]`` or a list of such pairs; an open end is null."""
    if value is None:
        return ()
    # one pair alone stands for a list of one window
    pairs = value if isinstance(value, list | tuple) else [value]
    if pairs and not any(isinstance(pair, list | tuple) for pair in pairs):
        pairs = [pairs]
    windows = [_read_window(pair) for pair in pairs]
    _check_disjoint(windows)
    return tuple(windows)


def _read_window(pair: object) -> Interval:
    if not isinstance(pair, list | tuple) or len(pair) != 2:
        raise ValueError("a window is [start, stop] in s; null leaves an end open")
    start, stop = (None if end is None else _read_number(end) for end in pair)
    if start is not None and stop is not None and start >= stop:
        raise ValueError(f"a window must stop after it starts, but {start:g} >= {stop:g} s")
    return start, stop


def _check_disjoint(windows: list[Interval]) -> None:
    # once they are sorted by start, only neighbours can overlap
    ordered = sorted(windows, key=lambda pair: pair[0] or 0.0)
    for (_, stop), (start, _) in pairwise(ordered):
        if stop is None or stop > (start or 0.0):
            raise ValueError("windows of one file must not overlap: their samples would be used twice")


def _read_files(value: object, info: ValidationInfo) -> dict[str, Path]:
    """Read a file name, or a mapping of short names to them; relative ones start at the configuration's folder."""
    folder = Path((info.context or {}).get("folder", "."))
    files_by_key = {_read_name(k): v for k, v in value.items()} if isinstance(value, dict) else {"": value}
    if not files_by_key or not all(isinstance(v, str | Path) and str(v).strip() for v in files_by_key.values()):
        raise ValueError("a file name, or a mapping of short names to file names, is expected")
    return {key: folder / str(path) for key, path in files_by_key.items()}


@dataclass(frozen=True)
class OneWord:
    """Marks a list that a ``word`` alone may stand for: the list of it."""

    word: str

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_before_validator_function(
            lambda value: [value] if isinstance(value, str) and value == self.word else value, handler(source)
        )

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        return {"anyOf": [{"const": self.word}, handler(schema)]}


def _json_schema(**words: Any) -> WithJsonSchema:
    """Mark a type with the JSON schema of what YAML may give for it, where that is more than the type itself."""
    return WithJsonSchema(words)


SHORT_LIST = BeforeValidator(_check_list_length)
Number = Annotated[float, BeforeValidator(bounded_reader(-MAX_MAGNITUDE, MAX_MAGNITUDE))]
Gravity = Annotated[float, BeforeValidator(bounded_reader(-1e3, 1e3, " m/s^2"))]
Tilt = Annotated[float, BeforeValidator(bounded_reader(-3.2, 3.2, " rad"))]
TimeOffsetValue = Annotated[float, BeforeValidator(bounded_reader(-MAX_TIME_OFFSET, MAX_TIME_OFFSET, " s"))]
DelayValue = Annotated[float, BeforeValidator(bounded_reader(0.0, 1.0, " s"))]
Positive = Annotated[float, BeforeValidator(_read_positive), _json_schema(type="number", exclusiveMinimum=0)]
NonNegative = Annotated[float, BeforeValidator(_read_non_negative), _json_schema(type="number", minimum=0)]
Count = Annotated[
    int, BeforeValidator(whole_number_reader(MAX_COUNT)), _json_schema(type="integer", minimum=1, maximum=MAX_COUNT)
]
CountOrEach = Annotated[
    int | Mapping[str, int] | None, BeforeValidator(_by_name_reader(whole_number_reader(MAX_COUNT)))
]
Order = Annotated[
    int,
    BeforeValidator(whole_number_reader(HIGHEST_ORDER)),
    _json_schema(type="integer", minimum=1, maximum=HIGHEST_ORDER),
]
PositiveOrEach = Annotated[float | Mapping[str, float] | None, BeforeValidator(_by_name_reader(_read_positive))]
Name = Annotated[str, BeforeValidator(_read_name), _json_schema(type=["string", "integer"])]
Gain = Annotated[float | str, BeforeValidator(_read_gain)]
Amount = Annotated[float | str, BeforeValidator(_read_amount)]
Files = Annotated[
    Mapping[str, Path], BeforeValidator(_read_files), _json_schema(anyOf=[{"type": "string"}, _TEXTS_SCHEMA])
]
Windows = Annotated[
    tuple[Interval, ...],
    BeforeValidator(_read_windows),
    _json_schema(anyOf=[{"type": "null"}, _PAIR_SCHEMA, {"type": "array", "items": _PAIR_SCHEMA}]),
]


class Section(BaseModel):
    """A frozen group of settings; an unknown key is an error that lists the known ones."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)

    @model_validator(mode="before")
    @classmethod
    def _check_keys(cls, data: object) -> object:
        for key in data if isinstance(data, dict) else ():
            if key not in cls.model_fields:
                words = f"unknown key {str(key)!r}; {choices(str(key), cls.model_fields)}"
                raise PydanticCustomError("unknown_key", "{words}", {"words": words})
        return data

    @classmethod
    def read(cls, data: Any, source: str, **context: Any) -> Self:
        """Return settings, checked; ConfigError, led by ``source``, that names each place where ``data`` is wrong.

        In the ``context``, ``folder`` is where relative file names start, and ``code`` where those of Python files do:
        without it these are refused.
        """
        try:
            return cls.model_validate(data, context=context)
        except ValidationError as error:
            raise ConfigError(error_text(error, data, source)) from None


class Channel(Section):
    """A signal in ``unit``: gain * (column, or the sum of columns times their coefficients) + offset."""

    column: Name | None = None
    sum: dict[Name, Amount] | None = Field(None, min_length=1)
    gain: Gain = 1.0
    offset: Amount = 0.0
    unit: str

    @model_validator(mode="after")
    def _check_source(self) -> Self:
        if (self.column is None) == (self.sum is None):
            raise ValueError("needs either `column` or `sum` (a mapping of columns to coefficients)")
        return self

    @property
    def terms(self) -> Mapping[str, float | str]:
        """Coefficients by column."""
        return {self.column: 1.0} if self.column is not None else self.sum or {}

    @property
    def scalars(self) -> frozenset[str]:
        """Names of scalars of the file, where gains, the offset or coefficients are such."""
        return frozenset(x for x in (self.gain, self.offset, *self.terms.values()) if isinstance(x, str))


class Angle(Channel):
    """A position as a robot reports it; its columns may wrap around with the period ``wraps``, in the unit of the
    columns.
    """

    wraps: Positive | None = None


class PositionChannel(Angle):
    """A position; with ``multi_turn`` a revolute joint may make any number of turns."""

    multi_turn: StrictBool = False


def check_known_names(section: str, entries: Mapping[str, object], joints: Sequence[Joint]) -> None:
    """Raise ConfigError where one of the names is that of no joint."""
    names = [joint.name for joint in joints]
    for name in entries:
        if name not in names:
            raise ConfigError(f"{section}.{name}: there is no joint {name!r}; {choices(name, names)}")


def check_same_names(section: str, entries: Mapping[str, object], joints: Sequence[Joint]) -> None:
    """Raise ConfigError unless the names are those of the joints."""
    check_known_names(section, entries, joints)
    for name in (joint.name for joint in joints):
        if name not in entries:
            # a joint of the robot file that was not recorded can be locked instead
            lock_hint = (
                " A joint of a robot file that the logs lack can stand still: give its position in `lock` of `model`."
            )
            raise ConfigError(
                f"{section}: joint {name!r} of the model is missing; add a line `{name}: ...` like that of the others."
                + (lock_hint if section in ("position", "torque") else "")
            )
