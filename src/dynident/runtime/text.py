"""Numbers, counts and settings as plain text, as notes and reports say them."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass
from typing import Any

from dynident.runtime.errors import is_changed

MAX_LISTED_ENTRIES = 8  # entries of a setting that are listed
# control characters, and what turns the direction of writing
ACTING_SIGNS = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069]")


def number(value: float | None, digits: int = 4) -> str:
    """Format to ``digits`` significant digits, without an exponent from 1e-4 to 1e5; "-" for None and NaN.

    Digits before the decimal point are never rounded away: 12345.6 becomes "12346".
    """
    if value is None or math.isnan(value):
        return "-"
    if value == 0 or math.isinf(value):
        return "0" if value == 0 else ("∞" if value > 0 else "-∞")
    mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
    if 1e-4 <= abs(value) < 1e5:
        return f"{value:.{max(digits - 1 - int(exponent), 0)}f}"
    return f"{mantissa}e{int(exponent)}"


def short(value: float, digits: int = 3) -> str:
    """Format a number to ``digits`` significant digits: never 190 as "1.9e+02", and 0.5 without trailing zeros."""
    text = f"{value:.{digits}g}"
    return number(value, digits) if "e" in text else text


def percent(value: float, digits: int = 3) -> str:
    """Format a share (%) to ``digits`` significant digits: never "1e+02 %" for 100 %."""
    return f"{short(value, digits)} %"


def rough(value: float) -> str:
    """Format a share (%) to two digits, from 10 % on to whole percents."""
    return percent(value, 2) if value < 10 else f"{value:.0f} %"


def instant(t: float) -> str:
    """Format a time (s) to 0.1 ms, in full also for clocks that began long ago."""
    return f"{round(t, 4):.15g}"


def vector(values: Iterable[float], digits: int = 3) -> str:
    """Format numbers in brackets, to ``digits`` significant digits."""
    return f"({', '.join(short(value, digits) for value in values)})"


def angles(x: float, y: float, decimals: int = 1) -> str:
    """Word rotations (rad) about x and y."""
    return f"{math.degrees(x):z.{decimals}f} deg about x and {math.degrees(y):z.{decimals}f} deg about y"


def count(number_of: int, noun: str) -> str:
    """Word a count, such as "1 log" or "2 logs"."""
    return f"{number_of} {noun}{'' if number_of == 1 else 's'}"


def number_within(value: float, std: float) -> str:
    """Format a number up to the place of the second digit of its standard error: 0.00431 +- 0.026 is "0.004"."""
    if not (value and math.isfinite(value) and 0 < std < math.inf):
        return number(value)
    digits = math.floor(math.log10(abs(value))) - math.floor(math.log10(std)) + 2
    return number(value, digits) if digits > 0 else "0"


def capitalise(text: str) -> str:
    """Return a text with its first letter in upper case, all others as they are."""
    return f"{text[:1].upper()}{text[1:]}"


def escape_acting(text: str) -> str:
    """Return a text with escapes for control characters and signs that turn what follows: HTML escapes neither."""
    return ACTING_SIGNS.sub(lambda sign: sign[0].encode("unicode_escape").decode(), text)


def part_text(part: object) -> str:
    """Return an exchangeable part as text: what it says of itself, else the name of its class and its settings."""
    return str(part) if type(part).__str__ is not object.__str__ else settings_text(type(part).__name__, part)


def settings_text(name: str, part: object, skip: tuple[str, ...] = ()) -> str:
    """Return a name with the settings of a part that differ from their defaults, without those in ``skip``."""
    if not is_dataclass(part):
        return name
    changed = [field for field in fields(part) if field.init and field.name not in skip and is_changed(part, field)]
    return ", ".join([name, *(f"{x.name.replace('_', ' ')} {setting_text(getattr(part, x.name))}" for x in changed)])


def as_number(value: object) -> float:
    """Return a value as a number, nan where it is none; YAML gives ``1e-3`` as a text, and ``yes`` as a truth value."""
    if isinstance(value, int | float | str) and not isinstance(value, bool):
        try:
            return float(value)
        except (ValueError, OverflowError):
            pass
    return math.nan


def setting_text(value: Any) -> str:
    """Return a setting as text: numbers to four digits, lists and mappings in brackets."""
    if isinstance(value, bool) or value is None:
        return {True: "on", False: "off", None: "none"}[value]
    if isinstance(value, Mapping):
        return _list_entries([f"{key} {setting_text(entry)}" for key, entry in value.items()])
    if isinstance(value, tuple | list):
        return _list_entries([setting_text(entry) for entry in value])
    if isinstance(value, int | float):
        return short(float(value), 4)
    return part_text(value) if is_dataclass(value) else f"{value}"


def _list_entries(texts: list[str]) -> str:
    return f"({', '.join(texts[:MAX_LISTED_ENTRIES])}{', ...' * (len(texts) > MAX_LISTED_ENTRIES)})"
