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

from dynident.runtime.errors import ConfigError
from dynident.runtime.kernel.build import FILE, LEVELS, RECORD, architecture, digest, record

VARIABLE = "DYNIDENT_KERNEL"
LIBRARY = Path(__file__).with_name(FILE)  # from nowhere else: a library is code


@dataclass(frozen=True)
class Kernel:
    """The way in which results are computed.

    ``level`` is the level of CPU that the compiled code is for, None for NumPy and LAPACK; ``about`` names the
    compiler, or why there is no compiled code.
    """

    level: str | None
    about: str

    def __str__(self) -> str:
        return f"{self.level} ({self.about})" if self.level else f"NumPy and LAPACK ({self.about})"


def kernel() -> Kernel:
    """Return the way that is used, by what is installed and the environment variable ``DYNIDENT_KERNEL``.

    The variable is ``off``, or the name of a level (such as ``avx2``) that is not above the best of this CPU.
    Raises ConfigError where it is anything else.
    """
    return _select_kernel()[1]


@cache
def function(name: str, *types: Any, result: Any = None) -> Callable[..., Any] | None:
    """Return a function of the library with ctypes of its arguments; None where NumPy is to be used.

    Raises ConfigError, as ``kernel``.
    """
    library, selected = _select_kernel()
    if library is None:
        return None
    kernel_function = getattr(library, f"dynident_{name}_{selected.level}")
    kernel_function.argtypes, kernel_function.restype = types, result
    return kernel_function  # type: ignore[no-any-return]


@cache
def _select_kernel() -> tuple[ctypes.CDLL | None, Kernel]:
    requested = os.environ.get(VARIABLE, "").strip().lower()
    if requested == "off":
        return None, Kernel(None, f"{VARIABLE}=off")
    library, about = _load_library()
    if library is None and not requested:
        return None, Kernel(None, about)
    levels = [] if library is None else _levels(library)
    if requested and requested not in levels:
        reason = f"this CPU has {', '.join(levels)}" if levels else f"the kernel is {about}"
        raise ConfigError(f"the environment variable {VARIABLE} is {requested!r}, but {reason}; unset it, or give off.")
    return library, Kernel(requested or levels[-1], about)


def _levels(library: ctypes.CDLL) -> list[str]:
    """Return the levels that this CPU has, the best last."""
    return [name for name, _, _ in LEVELS[architecture()]][: library.dynident_best() + 1]


def _load_library() -> tuple[ctypes.CDLL | None, str]:
    """Return the library and its compiler, or None and why; a file that is cut off would end the process."""
    try:
        content, checksum = LIBRARY.read_bytes(), LIBRARY.with_name(RECORD).read_text("ascii", "replace")
    except OSError:
        return None, "not compiled at installation"
    # never load a library of other sources, nor one that is cut off: both could end the process
    if not checksum.startswith(digest()):
        return None, "out of date: its sources have changed since it was compiled"
    if checksum != record(content):
        return None, "damaged: it is not the file that was compiled"
    try:
        library = ctypes.CDLL(str(LIBRARY))
        library.dynident_compiler.restype = ctypes.c_char_p
        return library, library.dynident_compiler().decode()
    except (OSError, AttributeError) as error:
        return None, f"not to be loaded: {error}"
