"""The kinds of values that settings hold: numbers, names, files, windows, and units with their factor to SI.

Each reader raises ValueError with a message to be appended to the path of the setting.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, ClassVar

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    ValidationInfo,
    WithJsonSchema,
    model_validator,
)
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from dynident.errors import ConfigError, choices
from dynident.regression import HIGHEST_ORDER
from dynident.smoothers import LONGEST_OFFSET

__all__ = [
    "FEW",
    "UNITS",
    "Amount",
    "Count",
    "CountOrEach",
    "Delay",
    "Files",
    "Gain",
    "Gravity",
    "Interval",
    "Name",
    "NonNegative",
    "Number",
    "OneWord",
    "Order",
    "Positive",
    "PositiveOrEach",
    "Section",
    "Windows",
    "as_number",
    "by_kind",
    "interval_words",
    "is_deep",
    "unit_factor",
]

Interval = tuple[float | None, float | None]
SMALLEST, LARGEST = 1e-15, 1e15  # in size, of settings in SI units and of gains
MOST = 1_000_000  # of counts
ENTRIES = 100  # of a list of parts
DEEPEST = 50  # levels of lists and mappings

UNITS: Mapping[str, Mapping[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0},
    "angle": {
        "rad": 1.0,
        "mrad": 1e-3,
        "deg": math.pi / 180,
        "rev": 2 * math.pi,
        "arcmin": math.pi / 10800,
        "arcsec": math.pi / 648000,
    },
    "length": {"m": 1.0, "mm": 1e-3, "um": 1e-6, "cm": 1e-2, "in": 0.0254},
    "torque": {
        "N m": 1.0,
        "mN m": 1e-3,
        "kN m": 1e3,
        "N cm": 1e-2,
        "kgf m": 9.80665,
        "kgf cm": 9.80665e-2,
        "lbf ft": 4.4482216152605 * 0.3048,
        "lbf in": 4.4482216152605 * 0.0254,
    },
    "angular velocity": {"rad/s": 1.0, "deg/s": math.pi / 180, "rpm": math.pi / 30, "rev/s": 2 * math.pi},
    "velocity": {"m/s": 1.0, "mm/s": 1e-3, "cm/s": 1e-2},
    "force": {"N": 1.0, "mN": 1e-3, "kN": 1e3, "kgf": 9.80665, "lbf": 4.4482216152605},
}


def unit_factor(unit: str, dimension: str, where: str) -> float:
    """Return the factor from a unit to SI; ``N m``, ``Nm`` and ``N*m`` are one.

    ``dimension`` is one of UNITS; raises ConfigError, led by ``where``, for other units.
    """
    known = UNITS[dimension]
    plain = {name.replace(" ", ""): factor for name, factor in known.items()}
    key = unit.replace(" ", "").replace("*", "").replace("·", "")
    if key in plain:
        return plain[key]
    others = [name for name, units in UNITS.items() if key in {u.replace(" ", "") for u in units}]
    what = f"a unit of {others[0]}, not of {dimension}" if others else f"not a unit of {dimension}"
    raise ConfigError(f"{where}: {unit!r} is {what}; {choices(unit, known)}")


def interval_words(interval: Interval) -> str:
    """Return a window as text for the name of a log, such as ``0-20 s``."""
    start, stop = interval
    return f"{start or 0:.12g}-{'end' if stop is None else f'{stop:.12g} s'}"


def as_number(value: object) -> float:
    """Return a value as a number, nan where it is none; YAML gives ``1e-3`` as a text, and ``yes`` as a truth value."""
    if isinstance(value, int | float | str) and not isinstance(value, bool):
        try:
            return float(value)
        except (ValueError, OverflowError):
            pass
    return math.nan


def is_deep(data: object) -> bool:
    """Whether lists and mappings are nested deeper than any settings or results are, or in a ring."""
    level = {id(data): data}
    for _ in range(DEEPEST):
        level = {id(one): one for part in level.values() for one in _inside(part)}
    return any(isinstance(one, Mapping | list) for one in level.values())


def _inside(value: object) -> Iterable[object]:
    if isinstance(value, Mapping):
        return value.values()
    return value if isinstance(value, list) else ()


def _number(value: object) -> float:
    if math.isfinite(number := as_number(value)):
        return number
    raise ValueError("a finite number is expected")


def _between(least: float, most: float, unit: str = "") -> Callable[[object], float]:
    """Return a reader of numbers from ``least`` to ``most``, beyond which a value can only be a mistake."""

    def read(value: object) -> float:
        if not least <= (number := _number(value)) <= most:
            raise ValueError(f"a number from {least:g} to {most:g}{unit} is expected")
        return number

    return read


def _whole(most: int) -> Callable[[object], int]:
    """Return a reader of whole numbers from 1 to ``most``."""

    def read(value: object) -> int:
        """Read a whole number; ValueError where it is another, or out of range."""
        number = _number(value)
        if number != int(number) or number < 1:
            raise ValueError("a whole number of at least 1 is expected")
        if number > most:
            raise ValueError(f"a whole number from 1 to {most} is expected")
        return int(number)

    return read


def _few(value: object) -> object:
    if isinstance(value, list | tuple) and len(value) > ENTRIES:
        raise ValueError(f"at most {ENTRIES} entries are expected")
    return value


def _name(value: object) -> str:
    """Read a name; header-less columns are named by numbers, which need no quotes."""
    if isinstance(value, bool) or not isinstance(value, int | str) or not str(value).strip():
        raise ValueError("a name is expected (in quotes, where YAML reads it as another type)")
    return str(value)


def _amount(value: object) -> float | str:
    """Read a number, or the name of a scalar in the file."""
    if math.isnan(number := as_number(value)):
        if isinstance(value, str) and value.strip().lower().lstrip("+-.") not in ("", "nan", "inf"):
            return value
    elif abs(number) <= LARGEST:
        return number
    raise ValueError(f"a finite number, at most {LARGEST:g} in size, or the name of a scalar in the file, is expected")


def _gain(value: object) -> float | str:
    """Read an amount by which a signal is multiplied: with 0 nothing of it would be left."""
    if isinstance(gain := _amount(value), str) or abs(gain) >= SMALLEST:
        return gain
    raise ValueError(f"a gain other than 0 is expected, of at least {SMALLEST:g} in size")


def _each(read: Callable[[object], Any]) -> Callable[[object], Any]:
    """Read either one value, or a mapping of names to values."""

    def read_all(value: object) -> Any:
        """Read a value, or each of a mapping's."""
        if value is None:
            return None
        return {_name(k): read(v) for k, v in value.items()} if isinstance(value, dict) else read(value)

    return read_all


def _positive(value: object) -> float:
    if (number := _number(value)) <= 0:
        raise ValueError("a number greater than 0 is expected")
    return _between(SMALLEST, LARGEST)(number)


def _non_negative(value: object) -> float:
    if (number := _number(value)) < 0:
        raise ValueError("a number of at least 0 is expected")
    return _between(SMALLEST, LARGEST)(number) if number else 0.0


def _windows(value: object) -> tuple[Interval, ...]:
    """Read ``[start, stop]`` or a list of such pairs; an open end is null."""
    if value is None:
        return ()
    pairs = value if isinstance(value, list | tuple) else [value]
    if pairs and not any(isinstance(pair, list | tuple) for pair in pairs):
        pairs = [pairs]
    read = [_window(pair) for pair in pairs]
    _check_disjoint(read)
    return tuple(read)


def _window(pair: object) -> Interval:
    if not isinstance(pair, list | tuple) or len(pair) != 2:
        raise ValueError("a window is [start, stop] in s; null leaves an end open")
    start, stop = (None if end is None else _number(end) for end in pair)
    if start is not None and stop is not None and start >= stop:
        raise ValueError(f"a window must stop after it starts, but {start:g} >= {stop:g} s")
    return start, stop


def _check_disjoint(windows: list[Interval]) -> None:
    ordered = sorted(windows, key=lambda pair: pair[0] or 0.0)
    for (_, stop), (start, _) in pairwise(ordered):
        if stop is None or stop > (start or 0.0):
            raise ValueError("windows of one file must not overlap: their samples would be used twice")


def _files(value: object, info: ValidationInfo) -> dict[str, Path]:
    """Read a file name, or a mapping of short names to them; relative ones start at the configuration's folder."""
    folder = Path((info.context or {}).get("folder", "."))
    named = {_name(k): v for k, v in value.items()} if isinstance(value, dict) else {"": value}
    if not named or not all(isinstance(v, str | Path) and str(v).strip() for v in named.values()):
        raise ValueError("a file name, or a mapping of short names to file names, is expected")
    return {key: folder / str(path) for key, path in named.items()}


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


def _schema(**words: Any) -> WithJsonSchema:
    """Mark a type with the JSON schema of what YAML may give for it, where that is more than the type itself."""
    return WithJsonSchema(words)


_END = {"type": ["number", "null"]}
_PAIR = {"type": "array", "prefixItems": [_END, _END], "items": False, "minItems": 2}
_TEXTS = {"type": "object", "additionalProperties": {"type": "string"}, "minProperties": 1}

FEW = BeforeValidator(_few)
Number = Annotated[float, BeforeValidator(_between(-LARGEST, LARGEST))]
Gravity = Annotated[float, BeforeValidator(_between(-1e3, 1e3, " m/s^2"))]
Tilt = Annotated[float, BeforeValidator(_between(-3.2, 3.2, " rad"))]
Delay = Annotated[float, BeforeValidator(_between(-LONGEST_OFFSET, LONGEST_OFFSET, " s"))]
Positive = Annotated[float, BeforeValidator(_positive), _schema(type="number", exclusiveMinimum=0)]
NonNegative = Annotated[float, BeforeValidator(_non_negative), _schema(type="number", minimum=0)]
Count = Annotated[int, BeforeValidator(_whole(MOST)), _schema(type="integer", minimum=1, maximum=MOST)]
CountOrEach = Annotated[int | Mapping[str, int] | None, BeforeValidator(_each(_whole(MOST)))]
Order = Annotated[
    int, BeforeValidator(_whole(HIGHEST_ORDER)), _schema(type="integer", minimum=1, maximum=HIGHEST_ORDER)
]
PositiveOrEach = Annotated[float | Mapping[str, float] | None, BeforeValidator(_each(_positive))]
Name = Annotated[str, BeforeValidator(_name), _schema(type=["string", "integer"])]
Gain = Annotated[float | str, BeforeValidator(_gain)]
Amount = Annotated[float | str, BeforeValidator(_amount)]
Files = Annotated[Mapping[str, Path], BeforeValidator(_files), _schema(anyOf=[{"type": "string"}, _TEXTS])]
Windows = Annotated[
    tuple[Interval, ...],
    BeforeValidator(_windows),
    _schema(anyOf=[{"type": "null"}, _PAIR, {"type": "array", "items": _PAIR}]),
]


class Section(BaseModel):
    """A frozen group of settings; an unknown key is an error that lists the known ones, or says what it became."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
    _former: ClassVar[Mapping[str, str]] = {}

    @model_validator(mode="before")
    @classmethod
    def _known_keys(cls, data: object) -> object:
        for key in data if isinstance(data, dict) else ():
            if key not in cls.model_fields:
                now = cls._former.get(str(key))
                words = f"it is called {now!r} now" if now else choices(str(key), cls.model_fields)
                words = f"unknown key {str(key)!r}; {words}"
                raise PydanticCustomError("unknown_key", "{words}", {"words": words})
        return data


def by_kind(
    sections: Mapping[str, type[Section]], of_file: type[Section] | None = None
) -> Callable[[Any, Any, ValidationInfo], Any]:
    """Return a validator that reads a mapping by its `kind` as one of the sections, whose errors have its place.

    A kind that names something of a Python file is read as ``of_file``, where that is given.
    """
    every = (*sections.values(), *(() if of_file is None else (of_file,)))

    def read(value: Any, _: Any, info: ValidationInfo) -> Any:
        """Read a section by its kind; a section that is already made, or none, is returned unchanged."""
        if value is None or isinstance(value, every):
            return value
        if not isinstance(value, Mapping):
            raise PydanticCustomError("mapping_type", "a mapping")
        kind: Any = value.get("kind")
        if of_file is not None and isinstance(kind, str) and kind.rpartition(":")[0].endswith(".py"):
            return of_file.model_validate(value, context=info.context)
        if not isinstance(kind, str) or kind not in sections:
            words = f"{kind!r} is not a choice; {choices(str(kind), sections)}"
            words = words if "kind" in value else f"needs a `kind`: {', '.join(sections)}"
            raise PydanticCustomError("words", "{words}", {"words": words})
        return sections[kind].model_validate(value, context=info.context)

    return read
