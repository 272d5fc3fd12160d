"""The compiled kernel where there is one: plain C, loaded by ctypes; README.md beside it explains it.

Who has a faster way in C asks ``function`` for it, and takes NumPy or LAPACK where that is None. Nothing depends on
the kernel: both ways give the same to rounding, which the tests compare.
"""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from dynident.kernel.build import FILE, LEVELS, architecture, digest

__all__ = ["Kernel", "function", "kernel"]

VARIABLE = "DYNIDENT_KERNEL"
LIBRARY = Path(__file__).with_name(FILE)


@dataclass(frozen=True)
class Kernel:
    """The way that results are computed: the ``level`` of CPU that compiled code is used of, None for NumPy and LAPACK,
    and ``about`` it: the compiler, or why there is no compiled code."""

    level: str | None
    about: str

    def __str__(self) -> str:
        return f"{self.level} ({self.about})" if self.level else f"NumPy and LAPACK ({self.about})"


@cache
def kernel() -> Kernel:
    """Return which way is used, by what is installed and the environment variable ``DYNIDENT_KERNEL``.

    The variable is ``off``, or the name of a level (such as ``avx2``) that is not above the best of this CPU.
    """
    return _loaded()[1]


@cache
def function(name: str, *types: Any, result: Any = None) -> Callable[..., Any] | None:
    """Return a function of the library with ctypes of its arguments; None where NumPy is to be used."""
    library, found = _loaded()
    if library is None:
        return None
    made = getattr(library, f"dynident_{name}_{found.level}")
    made.argtypes, made.restype = types, result
    return made  # type: ignore[no-any-return]


@cache
def _loaded() -> tuple[ctypes.CDLL | None, Kernel]:
    asked = os.environ.get(VARIABLE, "").strip().lower()
    if asked == "off":
        return None, Kernel(None, f"{VARIABLE}=off")
    try:
        library = ctypes.CDLL(str(LIBRARY))
        made_of, compiler = library.dynident_sources, library.dynident_compiler
    except (OSError, AttributeError) as error:
        why = f"cannot be loaded: {error}" if LIBRARY.exists() else "not compiled at installation"
        return None, Kernel(None, why)
    made_of.restype = compiler.restype = ctypes.c_char_p
    if made_of() != digest().encode():
        return None, Kernel(None, "out of date: its sources have changed")
    levels = [name for name, _, _ in LEVELS[architecture()]][: library.dynident_best() + 1]
    level = asked if asked in levels else levels[-1]
    return library, Kernel(level, compiler().decode())
