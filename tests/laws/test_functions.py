"""Functions of numbers, texts and arrays return what they returned: each is called with a few usual arguments.

What a function makes of arguments that are not meant for it is left out where it raises. The values say nothing of
whether a function is right, which its own tests do: they say that a change of the code around has not changed it.
"""

from __future__ import annotations

import importlib
import inspect
import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import dynident
from tests.kept import check_kept, told

SOURCE = Path(dynident.__file__).parent
ROOMS = (
    "apps",
    "checks",
    "estimators",
    "identification",
    "models",
    "motion",
    "project",
    "regression",
    "report",
    "validation",
)
SLOW_OR_OUTSIDE = (
    "bind_socket",
    "read_goal",
    "read_source",
    "read_joints",
    "parse",
    "content",
    "servo_recording",
    "stylesheet",
)
N = 60
T = 0.05 * np.arange(N) + 0.002 * np.sin(np.arange(N))
WAVE = np.sin(2.0 * T) + 0.3 * np.cos(7.0 * T) + 0.05 * np.random.default_rng(1).standard_normal(N)
WAVES = np.column_stack([WAVE, 0.5 + 0.4 * np.cos(3.0 * T)])
MATRIX = np.array([[2.0, 0.3, -0.2], [0.3, 1.5, 0.4], [-0.2, 0.4, 1.1]])
ARRAYS = {"series": WAVE, "series of two": WAVES, "matrix": MATRIX, "three": np.array([0.2, 1.3, 0.7])}
MIXED = "series and two"
NUMBERS = {
    "float": (0.7, 12.3), "int": (3, 2), "bool": (True, False), "float | None": (0.7, None),
    "Sequence[float]": ([0.5, 1.0, 2.5],), "list[float]": ([0.5, 1.0, 2.5],), "Sequence[int]": ([0, 2, 1],),
    "tuple[float, float]": ((0.2, 1.7),), "Mapping[str, float]": ({"a": 0.4, "b": 1.6},),
    "str": ("kg m^2", "q_elbow 2"), "Sequence[str]": (("a", "b", "c"), ("shoulder_pan_joint", "b")),
}  # fmt: skip


def functions(room: str) -> Iterator[tuple[str, Callable[..., Any], list[str], list[str]]]:
    """Yield the functions of a room that take only numbers, texts and arrays, and their parameters with their types."""
    for path in sorted((SOURCE / room).rglob("*.py")):
        name = ".".join(("dynident", *path.relative_to(SOURCE).with_suffix("").parts))
        if path.stem.startswith("__") or path.stem in ("player", "compiled") or "demo" in name:
            continue
        for function in own_functions(importlib.import_module(name)):
            parameters = inspect.signature(function).parameters.values()
            kinds = [str(parameter.annotation) for parameter in parameters]
            if kinds and all(kind in NUMBERS or is_array(kind) for kind in kinds):
                yield f"{name}.{function.__name__}", function, [x.name for x in parameters], kinds


def own_functions(module: ModuleType) -> Iterator[Callable[..., Any]]:
    for name, value in vars(module).items():
        is_own = inspect.isfunction(value) and value.__module__ == module.__name__ and name == value.__name__
        if is_own and name not in SLOW_OR_OUTSIDE and not inspect.isgeneratorfunction(value):
            yield value


def is_array(kind: str) -> bool:
    return kind in ("Array", "ArrayLike", "np.ndarray", "NDArray[np.bool_]", "NDArray[np.intp]")


def values_of(place: int, name: str, kind: str, shape: str) -> tuple[Any, ...]:
    """Return what a parameter takes while arrays have a shape; no two of a function are the same."""
    if not is_array(kind):
        return NUMBERS[kind]
    if shape == MIXED:
        shape = "series of two" if place else "series"
    array = ARRAYS[shape]
    if name == "t":
        return T[: len(array)], 500.0 + T[: len(array)], 20.0 + T[: len(array)]
    if name in ("pairs", "count", "counts"):
        return (np.full(array.shape, 200.0),)
    if name in ("correlation", "covariance") and shape == "matrix":
        return (array / np.sqrt(np.outer(np.diag(array), np.diag(array))),)
    if shape == "matrix":
        array = array + 0.3 * place * np.eye(3)
    elif place:
        array = (1.0 + 0.2 * place) * np.roll(array, place, axis=0)
    return {"NDArray[np.bool_]": (array > 0.4,), "NDArray[np.intp]": (np.arange(len(array)) // 2,)}.get(kind, (array,))


@pytest.mark.parametrize("room", ROOMS)
def test_functions_return_what_they_returned(room: str) -> None:
    lines = list[str]()
    for name, function, names, kinds in functions(room):
        for shape in (*ARRAYS, MIXED) if any(map(is_array, kinds)) else ("",):
            choices = [values_of(i, *pair, shape) for i, pair in enumerate(zip(names, kinds, strict=True))]
            for k in range(max(map(len, choices))):
                given = [choice[k % len(choice)] for choice in choices]
                texts = [str(x) for x in given if not isinstance(x, np.ndarray)]
                result = list(told(call(function, names, given), " ", 1))
                if result != [" : None"]:
                    lines += [f"{name} ({', '.join(filter(None, (shape, *texts)))})", *result]
    check_kept(f"functions_{room}", "\n".join(lines))


def call(function: Callable[..., Any], names: Sequence[str], given: Sequence[Any]) -> Any:
    """Return what a function makes of arguments by name; None where they are not meant for it."""
    arguments = {name: np.copy(x) if isinstance(x, np.ndarray) else x for name, x in zip(names, given, strict=True)}
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            return function(**arguments)
    except Exception:  # of any kind, as what is given makes no sense to many
        return None
