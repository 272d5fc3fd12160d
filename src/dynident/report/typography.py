"""How units and numbers are typeset in a page: kg m², 1.2 × 10⁻⁵, −3, ±."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from markupsafe import Markup

__all__ = ["cell", "said", "sentence", "unit_text"]

NEGATIVE = re.compile(r"(?:(?<=[ (])|^)-(?=\d)")  # in a sentence; 5-7 is a range
ABOVE = str.maketrans("-0123456789", "\u207b\u2070\u00b9\u00b2\u00b3\u2074\u2075\u2076\u2077\u2078\u2079")
MINUS, HARD = "\u2212", "\u00a0"
UNITS = re.compile(r"\b(N|kg|m|mm|rad|s|Hz)\^(-?\d+)\b(?!\.\d)")
POWER = re.compile(r"(?<![\w.])(-?\d+(?:\.\d+)?)e([-+]?\d+)(?![\w.]\w|\w)")
# in a sentence, where a name may hold 1e5
SAID = re.compile(r"(?<![\w.])([-\u2212]?\d+\.\d+(?=e)|[-\u2212]?\d+(?=e[-+]))e([-+]?\d+)(?!\.?\w)")


def unit_text(text: str) -> str:
    """Return a text with the powers of its units above the line.

    >>> unit_text("N m s/rad"), unit_text("kg m^2")
    ('N m s/rad', 'kg m²')
    """
    return UNITS.sub(lambda found: f"{found[1]}{found[2].translate(ABOVE)}", text)


def cell(text: str) -> str:
    """Return a number with a true minus and a power of ten; a lone hyphen means that there is none, and stays.

    >>> print(cell("-1.20e-5").replace(HARD, " "), cell("-"))
    −1.20 × 10⁻⁵ -
    """
    if len(text) < 2 or hasattr(text, "__html__"):
        return text
    return unit_text(_powers(POWER, text)).replace("-", MINUS)


def sentence(text: str) -> Markup:
    """Return a sentence, escaped, with its `code` set as such, ± for +-, and no line break before %."""
    from markupsafe import Markup, escape

    if hasattr(text, "__html__"):
        return Markup(text)  # noqa: S704 -- it is one already
    parts = re.split(r"`([^`]+)`", text)
    plain = [str(escape(said(part))) for part in parts[::2]]
    codes = [f"<code>{escape(part)}</code>" for part in parts[1::2]]
    return Markup("".join(one for pair in zip(plain, [*codes, ""], strict=True) for one in pair))  # noqa: S704 -- escaped


def said(text: str) -> str:
    """Return a text with ±, typeset units and powers of ten, and no line break before %."""
    plain = _powers(SAID, NEGATIVE.sub(MINUS, text))
    return unit_text(plain.replace("+-", "±").replace(" %", f"{HARD}%"))


def _powers(pattern: re.Pattern[str], text: str) -> str:
    return pattern.sub(lambda found: f"{found[1]}{HARD}×{HARD}10{str(int(found[2])).translate(ABOVE)}", text)
