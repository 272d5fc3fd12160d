"""What users are shown, as text that is kept beside the tests, and compared line by line.

``DYNIDENT_KEEP=1 python -m pytest ...`` writes the texts anew, where a change is meant to change them. On another
machine (see ``tests/laws/test_numbers.py``) numbers may differ by their rounding.
"""

import json
import os
import re
from base64 import b64decode
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from difflib import unified_diff
from enum import Enum
from functools import cache
from html.parser import HTMLParser
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np

FOLDER = Path(__file__).with_name("snapshots")
NUMBER = re.compile(r"[-\u2212+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
OF_MACHINE = re.compile(r"footer|tr  \| (dynident|kernel|python|numpy|scipy|clarabel|polars|platform) \|")  # of a page
INLINE = ("td", "th", "code", "span", "a", "b", "i", "em", "strong", "abbr", "wbr", "br", "sub", "sup", "button")
SHOWN = ("class", "hidden", "style", "title", "href", "data-at", "data-value", "aria-label")  # attributes


def check_kept(name: str, text: str) -> None:
    """Compare a text with the one that is kept by a name."""
    file = FOLDER / f"{name}.txt"
    if os.environ.get("DYNIDENT_KEEP"):
        file.write_text(text.rstrip("\n") + "\n", encoding="utf-8")
    kept, now = file.read_text("utf-8").splitlines(), text.rstrip("\n").splitlines()
    if not all(a is not None and b is not None and _agree(a, b) for a, b in zip_longest(kept, now)):
        raise AssertionError("\n".join(unified_diff(kept, now, "kept", "now", n=0, lineterm="")))


def _agree(kept: str, now: str) -> bool:
    """Tell whether two lines agree: elsewhere than where they were kept, numbers need to be only nearly the same."""
    if kept == now or _is_same_machine():
        return kept == now
    if NUMBER.sub("#", kept) != NUMBER.sub("#", now):
        return False
    pairs = zip(NUMBER.finditer(kept), NUMBER.finditer(now), strict=True)
    return all(_are_near(*(float(match[0].replace("\u2212", "-")) for match in pair)) for pair in pairs)


def _are_near(a: float, b: float) -> bool:
    return abs(a - b) <= max(0.03 * max(abs(a), abs(b)), 2e-4)


@cache
def _is_same_machine() -> bool:
    from tests.laws.test_numbers import NUMBERS, machine

    return bool(json.loads(NUMBERS.read_text())["machine"] == machine())


def page_text(page: str) -> str:
    """Return what a page shows: an element a line, rows with their cells, and figures trace by trace."""
    reader = _PageReader()
    reader.feed(page)
    lines = map(str.rstrip, "".join(reader.parts).splitlines())
    return "\n".join(line for line in lines if " " in line and not OF_MACHINE.match(line))


class _PageReader(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.parts, self.script = list[str](), ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        if tag in ("style", "script"):
            self.script = given.get("type") or "-"
            return
        look = [] if tag == "td" else [f"{key}={value}" for key, value in given.items() if key in SHOWN]
        mark = " | " if tag in ("td", "th") else "" if tag in INLINE else f"\n{tag} "
        self.parts.append(mark + "".join(f"[{word}]" for word in look))

    def handle_endtag(self, tag: str) -> None:
        self.script = "" if tag in ("style", "script") else self.script
        self.parts.append("" if tag in INLINE else "\n")

    def handle_data(self, data: str) -> None:
        if not self.script:
            self.parts.append(data.replace("\n", " ") if data.strip() else "")
        elif self.script == "application/json":
            self.parts.append("\n" + "\n".join(figure_lines(json.loads(data))) + "\n")


def figure_lines(figure: Mapping[str, Any]) -> Iterator[str]:
    """Yield a figure, as plotly reads it, in short: a line for each trace, and one for each part of its layout."""
    for trace in figure["data"]:
        yield "trace " + _short_value(trace)
    for key, value in figure["layout"].items():
        if key != "template":
            yield f"layout {key} {_short_value(value)}"
    if "motion" in figure:
        yield f"motion {_short_value(figure['motion'])}"


def _short_value(value: Any) -> str:
    if isinstance(value, Mapping):
        if "bdata" in value:
            array = np.frombuffer(b64decode(value["bdata"]), value["dtype"])
            return f"{value.get('shape', '')}{_short_array(array.astype(float))}"
        return "{" + ", ".join(f"{key}: {_short_value(inner)}" for key, inner in value.items()) + "}"
    if isinstance(value, list):
        if len(value) > 8 and all(isinstance(x, int | float) for x in value):
            return _short_array(np.array(value, dtype=float))
        texts = list(map(_short_value, value))
        if len(texts) > 6 and all(isinstance(x, str) for x in value):  # what the pointer shows at each mark
            texts = [texts[0], f"{len(texts)} in all", texts[-1]]
        return "[" + ", ".join(texts) + "]"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _short_array(array: np.ndarray) -> str:
    """Return the count of an array, its ends, extremes and mean, to a thousandth of the largest."""
    finite = array[np.isfinite(array)]
    if not len(finite):
        return f"<{len(array)}>"
    scale = 10.0 ** np.floor(np.log10(np.abs(finite).max() or 1.0) - 2)
    told = (array[0], array[-1], finite.min(), finite.max(), finite.mean())
    return f"<{len(array)}: " + " ".join(f"{np.round(x / scale) * scale + 0.0:.4g}" for x in told) + ">"


FREE = ("vectors", "left_vectors")  # of any sign
PLAIN = (float, int, bool, np.number, np.bool_)
MAX_SHOWN = 12  # numbers of an array, at equal distances


def facts(value: Any, path: str = "", depth: int = 2) -> Iterator[str]:
    """Yield numbers and texts of a noun, with where they are in it."""
    if is_dataclass(value) and not isinstance(value, type):
        yield f"{path}: {type(value).__name__}"
        for field in fields(value) if depth else ():
            if field.name in FREE:
                continue
            yield from facts(getattr(value, field.name), f"{path}.{field.name}", depth - 1)
    elif isinstance(value, Mapping):
        for key, inner in value.items():
            yield from facts(inner, f"{path}.{key}", depth)
    elif isinstance(value, tuple | list) and not all(isinstance(inner, PLAIN) for inner in value):
        for k, inner in enumerate(value):
            yield from facts(inner, f"{path}[{k}]", depth)
    elif isinstance(value, (np.ndarray, tuple, list, *PLAIN)) and not isinstance(value, Enum):
        yield f"{path}: {digits(value)}"
    elif isinstance(value, str | None):
        yield f"{path}: {value}"


def digits(values: Any) -> str:
    """Return numbers with four digits, those that are rounding as zero; of many some."""
    array = np.asarray(values)
    if array.dtype.kind not in "fiub":
        return str(values)
    flat = array.ravel().astype(float)
    flat = flat[:: max(1, len(flat) // MAX_SHOWN)]
    scale = np.abs(flat[np.isfinite(flat)]).max(initial=0.0)
    return " ".join(f"{0.0 if abs(x) < 1e-5 * scale else x:.4g}" for x in flat)
