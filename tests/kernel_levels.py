"""The levels of the compiled kernel that this machine has, and their functions."""

from collections.abc import Callable
from typing import Any

from dynident.runtime import kernel
from dynident.runtime.kernel.build import LEVELS, architecture

LIBRARY = kernel._load_library()[0]
NAMES = [name for name, _, _ in LEVELS[architecture()]]
BEST = [] if LIBRARY is None else NAMES[: LIBRARY.dynident_best() + 1]


def functions_of(level: str) -> Callable[..., Any]:
    """Stand in for ``kernel.function`` with the functions of a level, or without any where it is ``off``."""

    def function(name: str, *types: Any, result: Any = None) -> Any:
        if level == "off":
            return None
        made = getattr(LIBRARY, f"dynident_{name}_{level}")
        made.argtypes, made.restype = types, result
        return made

    return function
