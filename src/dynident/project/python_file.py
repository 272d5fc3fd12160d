"""Functions and classes from Python files of the user; errors in them are reported with their line."""

from __future__ import annotations

import hashlib
import importlib.util
import re
import reprlib
import sys
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from operator import attrgetter
from pathlib import Path
from types import ModuleType
from typing import Any

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from dynident.files.opener import content, real_path
from dynident.runtime import ConfigError, DynidentError, choices
from dynident.runtime.jobs.job import REBUILDER

MAX_PLACES = 12  # places in a message
XACRO_CODE = "is a xacro file, which a result does not run; if you trust it, give allow_code=True or --allow-code."
CODE = "is of a Python file, which a result does not run; if you trust the file, give allow_code=True or --allow-code."


def error_text(error: ValidationError, data: Any, source: str) -> str:
    """Return the message to a user for settings ``data`` from ``source``, one line for each place."""
    lines: dict[str, list[str]] = {}
    for details in _without_consequences(error.errors()):
        lines.setdefault(_setting_path(details["loc"], data), []).append(_fault_text(details))
    words = [f"{path}: {' or '.join(parts)}" if path else " or ".join(parts) for path, parts in lines.items()]
    more = [f"and {len(words) - MAX_PLACES} more"] if words[MAX_PLACES:] else []
    return f"{source}: " + "\n  ".join(words[:MAX_PLACES] + more)


def _without_consequences(errors: list[ErrorDetails]) -> list[ErrorDetails]:
    """Leave out errors of lists that are too short only because one of their entries is wrong."""
    above = {details["loc"][:depth] for details in errors for depth in range(len(details["loc"]))}
    return [details for details in errors if details["type"] != "too_short" or details["loc"] not in above]


def _setting_path(loc: Sequence[int | str], data: Any) -> str:
    """Return the place of an error as ``train[0].window``, without the tags that pydantic adds."""
    words = ""
    # follow the data along the path: what is no key of it is a missing one, or a tag of pydantic to leave out
    for part in loc:
        # YAML may have keys that are no texts, which pydantic gives as texts
        keys = {str(key): key for key in data} if isinstance(data, dict) else {}
        if isinstance(data, list) and isinstance(part, int):
            words, data = f"{words}[{part}]", data[part] if part < len(data) else None
        elif str(part) in keys:
            words, data = f"{words}.{part}", data[keys[str(part)]]
        elif part != "[key]" and not str(part).startswith(("function-", "literal[", "dict[")):
            words, data = f"{words}.{part}", None
    return words.removeprefix(".")


def _fault_text(details: ErrorDetails) -> str:
    """Return the message for one error of pydantic."""
    kind, context = details["type"], details.get("ctx", {})
    got = f"; got {reprlib.repr(details['input'])}"
    if kind == "missing":
        return "is missing"
    if kind in ("unknown_key", "words"):
        return details["msg"]
    if kind == "value_error":
        return f"{context['error']}{got}"
    if kind in ("literal_error", "enum"):
        wrong = str(details["input"])
        expected = re.findall(r"'([^']*)'", context["expected"]) or re.split(", | or ", context["expected"])
        return f"{wrong!r} is not a choice; {choices(wrong, expected)}"
    if kind.endswith(("dict_type", "mapping_type", "model_type", "attributes_type")):
        empty = "; if all lines are comments, complete them and delete the # in front"
        return f"a mapping (`key: value` lines) is expected{got}{empty if details['input'] is None else ''}"
    if kind == "too_short":
        return f"needs at least {context['min_length']} entry{got}"
    if kind == "tuple_type":
        return f"a list is expected{got}"
    return details["msg"].replace("Input should", "should") + got


def resolve_file(folder: str | Path, place: str, where: str, error: type[DynidentError]) -> Path:
    """Return the path of a Python file; raises ``error``, led by ``where``, where no file can have that name."""
    return real_path(Path(folder) / place, lambda words: error(f"{where}: {words}"))


def load_from_file(path: Path, name: str, kind: str, where: str, error: type[DynidentError]) -> Any:
    """Import a file and return its public function or class ``name``; ``kind`` is "function" or "class".

    Raises ``error``, led by ``where``, where there is no such file or name, and where the file fails.
    """
    module = _import_file(path, where, error)
    members = {key: value for key, value in vars(module).items() if callable(value) and not key.startswith("_")}
    if name not in members:
        own_names = (key for key, value in members.items() if getattr(value, "__module__", None) == module.__name__)
        raise error(f"{where}: {path} has no {kind} {name!r}; {choices(name, own_names)}")
    return members[name]


@dataclass(frozen=True)
class _FileImporter:
    """Importer of a file in another process, where the file must still have the same text.

    Called with a name, it returns what has this name in the file.
    """

    path: Path
    private: str

    def __call__(self, name: str) -> Any:
        module = _import_file(self.path, str(self.path), ConfigError)
        if module.__name__ != self.private:
            raise ConfigError(f"{self.path} has changed while it is in use; run the same command again.")
        return attrgetter(name)(module)


@dataclass(frozen=True)
class FileFunction:
    """The function ``name`` of a Python file with further keyword arguments; other processes import the file, too."""

    path: Path
    name: str
    settings: Mapping[str, Any] = field(default_factory=dict)

    @property
    def __name__(self) -> str:
        return self.name

    def __call__(self, *arguments: Any) -> Any:
        """Call the function."""
        return _function(self.path, self.name)(*arguments, **self.settings)


@cache
def _function(path: Path, name: str) -> Callable[..., Any]:
    function: Callable[..., Any] = load_from_file(path, name, "function", str(path), ConfigError)
    return function


def run_user_code(
    call: Callable[[], object], action: str, file: Path, where: str, error: type[DynidentError]
) -> object:
    """Call code of the user; an exception becomes an ``error`` that names the line of the file."""
    try:
        return call()
    except (Exception, SystemExit) as wrong:
        # the last frame inside the file of the user is the line to show; deeper ones are in libraries
        frames = [frame for frame in traceback.extract_tb(wrong.__traceback__) if frame.filename == str(file)]
        line = wrong.lineno if isinstance(wrong, SyntaxError) else frames[-1].lineno if frames else None
        place = f" at {file}:{line}" if line is not None else ""
        raise error(f"{where}: {action} failed{place}: {type(wrong).__name__}: {wrong}") from wrong


def _import_file(path: Path, where: str, error: type[DynidentError]) -> ModuleType:
    """Import a file under a private name, and register it in ``sys.modules``, as dataclasses and pickle need."""
    code = content(path, lambda words: error(f"{where}: {words}"), (".py",))
    # the name contains a hash of the text: a changed file is imported anew
    private = f"_dynident_file_{hashlib.sha256(str(path).encode() + code).hexdigest()[:16]}"
    if private in sys.modules:  # the same text: its classes stay the same
        return sys.modules[private]
    spec = importlib.util.spec_from_file_location(private, path)
    if spec is None or (loader := spec.loader) is None:
        raise error(f"{where}: {path} is not a Python file; its name must end in .py.")
    module = importlib.util.module_from_spec(spec)
    setattr(module, REBUILDER, _FileImporter(path, private))
    sys.modules[private] = module
    try:
        run_user_code(lambda: loader.exec_module(module), str(path), path, where, error)
    except error:
        del sys.modules[private]
        raise
    return module
