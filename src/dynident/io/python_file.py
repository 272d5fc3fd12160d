"""Functions and classes from the user's Python files; errors in them are reported with the line."""

from __future__ import annotations

import hashlib
import importlib.util
import sys
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from operator import attrgetter
from pathlib import Path
from types import ModuleType
from typing import Any

from dynident.errors import ConfigError, DynidentError, choices
from dynident.io.opener import content, real
from dynident.jobs.packed import AGAIN

__all__ = ["CODE", "XACRO_CODE", "FileFunction", "from_file", "guarded", "located"]

XACRO_CODE = "is a xacro file, which a result does not run; if you trust it, give allow_code=True or --allow-code."
CODE = "is of a Python file, which a result does not run; if you trust the file, give allow_code=True or --allow-code."


def located(folder: str | Path, place: str, where: str, error: type[DynidentError]) -> Path:
    """Return the path of a Python file; ``error``, led by ``where``, where no file can have that name."""
    return real(Path(folder) / place, lambda words: error(f"{where}: {words}"))


def from_file(path: Path, name: str, what: str, where: str, error: type[DynidentError]) -> Any:
    """Import a file and return its public function or class ``name``.

    ``what`` is the word for it, "function" or "class". Raises ``error``, led by ``where``, where there is no such
    file or name, and where the file fails.
    """
    module = _import(path, where, error)
    found = {key: value for key, value in vars(module).items() if callable(value) and not key.startswith("_")}
    if name not in found:
        own = (key for key, value in found.items() if getattr(value, "__module__", None) == module.__name__)
        raise error(f"{where}: {path} has no {what} {name!r}; {choices(name, own)}")
    return found[name]


@dataclass(frozen=True)
class _Again:
    """Imports a file in another process, where it must have the same text, for the name of what is in it."""

    path: Path
    private: str

    def __call__(self, name: str) -> Any:
        module = _import(self.path, str(self.path), ConfigError)
        if module.__name__ != self.private:
            raise ConfigError(f"{self.path} has changed while it is in use; run the same command again.")
        return attrgetter(name)(module)


@dataclass(frozen=True)
class FileFunction:
    """The function ``name`` of a Python file with further arguments by name; other processes import the file, too."""

    path: Path
    name: str
    settings: Mapping[str, Any] = field(default_factory=dict)

    @property
    def __name__(self) -> str:
        return self.name

    def __call__(self, *arguments: Any) -> Any:
        """Return what the function does."""
        return _function(self.path, self.name)(*arguments, **self.settings)


@cache
def _function(path: Path, name: str) -> Callable[..., Any]:
    found: Callable[..., Any] = from_file(path, name, "function", str(path), ConfigError)
    return found


def guarded(call: Callable[[], object], what: str, file: Path, where: str, error: type[DynidentError]) -> object:
    """Call the user's code; an exception becomes an ``error`` that names the line of the user's file."""
    try:
        return call()
    except (Exception, SystemExit) as wrong:
        frames = [frame for frame in traceback.extract_tb(wrong.__traceback__) if frame.filename == str(file)]
        line = wrong.lineno if isinstance(wrong, SyntaxError) else frames[-1].lineno if frames else None
        place = f" at {file}:{line}" if line is not None else ""
        raise error(f"{where}: {what} failed{place}: {type(wrong).__name__}: {wrong}") from wrong


def _import(path: Path, where: str, error: type[DynidentError]) -> ModuleType:
    """Import a file under a private name, known to ``sys.modules`` as dataclasses and pickle need it there."""
    code = content(path, lambda words: error(f"{where}: {words}"), (".py",))
    private = f"_dynident_file_{hashlib.sha256(str(path).encode() + code).hexdigest()[:16]}"
    if private in sys.modules:  # the same text: its classes stay the same
        return sys.modules[private]
    spec = importlib.util.spec_from_file_location(private, path)
    if spec is None or (loader := spec.loader) is None:
        raise error(f"{where}: {path} is not a Python file; its name must end in .py.")
    module = importlib.util.module_from_spec(spec)
    setattr(module, AGAIN, _Again(path, private))
    sys.modules[private] = module
    try:
        guarded(lambda: loader.exec_module(module), str(path), path, where, error)
    except error:
        del sys.modules[private]
        raise
    return module
