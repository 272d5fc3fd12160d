"""What is said of a noun, and what is said otherwise with one of its fields changed, at all limits of its code."""

import ast
import dataclasses
import inspect
import itertools
import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from enum import Enum
from functools import cache
from types import ModuleType
from typing import Any

import numpy as np

from dynident.runtime import DynidentError

REFUSED = (DynidentError, ArithmeticError, AttributeError, AssertionError, LookupError, TypeError, ValueError)
TYPICAL, LARGE = 1.2345678, 12345.678  # the first has all digits that may be shown
Show = Callable[[Any], Sequence[str]]


def sweep(noun: Any, show: Show, modules: Sequence[ModuleType] = (), depth: int = 0) -> Iterator[str]:
    """Yield the lines that ``show`` makes of a noun, and which are new with each of its fields changed by itself.

    Numbers take the limits in the source of its class, and the constants of ``modules``. Of the values of a field those
    are told that change the words, not only their figures, against the value before. ``depth`` is how deep fields of
    fields are changed too.
    """
    before = try_to_show(show, noun)
    yield from (f"{type(noun).__name__}: {line}" for line in before)
    told, shapes = dict.fromkeys(before, ""), dict[str, str]()
    extra = frozenset(itertools.chain.from_iterable(map(constants_of, modules)))
    for path, value, changed in variants(noun, extra, depth):
        now = try_to_show(show, changed)
        shape, last = shape_of(now), shapes.get(path, shape_of(before))
        shapes[path] = shape
        if now and now != before and (shape != last or not isinstance(value, int | float) or value == TYPICAL):
            yield f"  {path} = {name_of(value)}: {' / '.join(differences(before, now, told))}"


def differences(before: Sequence[str], now: Sequence[str], told: dict[str, str]) -> Iterator[str]:
    """Yield the lines that are new, each once; of a line that takes the place of another only the words that differ."""
    old, new = [x for x in before if x not in now], [x for x in now if x not in before]
    if not new:
        yield f"{len(old)} fewer" if old else "in another order"
    for line, replaced in itertools.zip_longest(new, old if len(old) == len(new) else []):
        if line is not None and line not in told:
            told[line] = f"({len(told)})"
            yield f"{told[line]} {line if replaced is None else changed_part(replaced, line)}"
        elif line is not None:
            yield told[line]


def try_to_show(show: Show, noun: Any) -> list[str]:
    """Return what is said of a noun; nothing where its figures make no sense."""
    try:
        with np.errstate(all="ignore"):
            return list(show(noun))
    except REFUSED:
        return []


def shape_of(texts: Sequence[str]) -> str:
    """Return texts without their figures."""
    return re.sub(r"[-\u2212\d.,]+(e[-+]?\d+)?", "#", " / ".join(texts))


def changed_part(before: str, now: str) -> str:
    """Return the words that are new, without those at the start and the end that are the same."""
    a, b = before.split(" "), now.split(" ")
    start = sum(1 for _ in itertools.takewhile(lambda pair: pair[0] == pair[1], zip(a, b, strict=False)))
    a, b = a[start:][::-1], b[start:][::-1]
    end = sum(1 for _ in itertools.takewhile(lambda pair: pair[0] == pair[1], zip(a, b, strict=False)))
    return " ".join(b[end:][::-1])


def name_of(value: Any) -> str:
    """Return a value as text that is the same in each run."""
    if isinstance(value, np.ndarray):
        return f"{np.array2string(value, threshold=4, edgeitems=1, precision=4)}".replace("\n", "")
    text = str(value) if isinstance(value, Enum) else re.sub(r"(\d\.\d{7})\d+", r"\1", repr(value))
    return text if len(text) < 60 and " at 0x" not in text else f"{type(value).__name__} changed"


def variants(noun: Any, extra: frozenset[float], depth: int) -> Iterator[tuple[str, Any, Any]]:
    """Yield the name of a field, another value, and the noun with it."""
    for field in dataclasses.fields(noun):
        value = getattr(noun, field.name)
        if not field.init:
            continue
        for place, given, other in variants_inside(noun, value, str(field.type), extra, depth):
            try:
                yield f"{field.name}{place}", given, dataclasses.replace(noun, **{field.name: other})
            except REFUSED:
                continue  # such a noun cannot be


def variants_inside(
    noun: Any, value: Any, kind: str, extra: frozenset[float], depth: int
) -> Iterator[tuple[str, Any, Any]]:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        if depth:
            for place, given, other in variants(value, extra, depth - 1):
                yield f".{place}", given, other
        if "None" in kind:
            yield "", None, None
    elif isinstance(value, tuple) and value and dataclasses.is_dataclass(value[0]):
        yield "", f"{len(value) - 1} of them", value[:-1]
        for k in dict.fromkeys((0, min(1, len(value) - 1), len(value) - 1)) if depth else ():
            for place, given, other in variants(value[k], extra, depth - 1):
                yield f"[{k}].{place}", given, (*value[:k], other, *value[k + 1 :])
    else:
        limits = limits_of(type(noun)) | extra
        for other in plain_variants(value, kind, limits):
            yield "", other, other
        for x in sorted({TYPICAL, *limits}):
            if (other := with_first(value, x)) is not None:
                yield ", the first", x, other


def plain_variants(value: Any, kind: str, limits: frozenset[float]) -> Iterator[Any]:
    """Yield other values of what is no noun."""
    if isinstance(value, bool):
        yield not value
    elif isinstance(value, Enum):
        yield from type(value)
    elif isinstance(value, int):
        yield from sorted({0, 1, 2, 5, *(int(limit) for limit in limits if limit == int(limit) and limit > 0)})
    elif isinstance(value, float) or (value is None and "float" in kind):
        yield from sorted({0.0, TYPICAL, LARGE, *limits})
        if "None" in kind:
            yield None
    elif isinstance(value, str):
        yield from () if "Literal" in kind else ("", "other")
    elif isinstance(value, np.ndarray | Mapping | tuple) and len(value):
        yield from several_variants(value)


def several_variants(values: Any) -> Iterator[Any]:
    """Yield others of a tuple, a mapping or an array."""
    if isinstance(values, np.ndarray):
        if values.dtype == float:
            yield from (TYPICAL * values, 0.0 * values, np.full_like(values, np.nan), np.full_like(values, np.inf))
    elif isinstance(values, Mapping):
        yield {}
        if all(isinstance(x, float) for x in values.values()):
            yield {key: TYPICAL * x for key, x in values.items()}
    else:
        yield from (values[:1], values * 2, values * 6)
        if all(isinstance(x, float) for x in values):
            yield tuple(TYPICAL * x + 0.5 for x in values)


def with_first(values: Any, x: float) -> Any:
    """Return a tuple, a mapping or an array of numbers with another first one; None where it is none."""
    if isinstance(values, np.ndarray) and values.dtype == float and values.size:
        return np.concatenate([[x], values.flat[1:]]).reshape(values.shape)
    if isinstance(values, Mapping) and values and all(isinstance(value, float) for value in values.values()):
        return {**values, next(iter(values)): x}
    is_numbers = isinstance(values, tuple) and values and all(isinstance(value, float) for value in values)
    return (x, *values[1:]) if is_numbers else None


@cache
def limits_of(kind: type) -> frozenset[float]:
    """Return the numbers in a class, and the constants of its module that it names."""
    limits = set[float]()
    for base in kind.__mro__:
        if base.__module__.startswith("dynident"):
            module = sys.modules[base.__module__]
            for node in ast.walk(classes_in(module)[base.__qualname__]):
                number = node.value if isinstance(node, ast.Constant) else None
                if isinstance(node, ast.Name) and node.id.isupper():
                    number = vars(module).get(node.id)
                if isinstance(number, int | float) and not isinstance(number, bool):
                    limits.add(float(number))
    return frozenset(limits)


@cache
def classes_in(module: ModuleType) -> dict[str, ast.ClassDef]:
    return {node.name: node for node in ast.parse(inspect.getsource(module)).body if isinstance(node, ast.ClassDef)}


@cache
def constants_of(module: ModuleType) -> frozenset[float]:
    """Return the constants of a module that are numbers."""
    return frozenset(
        float(value) for name, value in vars(module).items() if name.isupper() and type(value) in (int, float)
    )
