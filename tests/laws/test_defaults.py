"""All thresholds, limits, tables and defaults of the package, in one list: none changes unseen."""

import ast
from collections.abc import Collection, Iterator, Mapping
from dataclasses import MISSING, fields, is_dataclass
from enum import Enum
from importlib import import_module
from inspect import Parameter, getsource, isclass, isfunction, signature
from pkgutil import walk_packages
from types import ModuleType
from typing import Any

import numpy as np

import dynident
from tests.kept import check_kept


def plain(value: Any) -> str:
    """Return numbers, names, short texts and what holds such as text; "..." for anything else."""
    if isinstance(value, Enum):
        return str(value)
    if value is None or isinstance(value, bool | int | float | complex):
        return repr(value)
    if isinstance(value, str | bytes):
        return repr(value) if len(value) < 40 else "..."
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if is_dataclass(value) and not isclass(value):
        value = {x.name: getattr(value, x.name) for x in fields(value)}
    if isinstance(value, Mapping):
        return f"({', '.join(f'{plain(key)}: {plain(entry)}' for key, entry in value.items())})"
    if isinstance(value, Collection):
        parts = [plain(entry) for entry in value]
        return f"({', '.join(sorted(parts) if isinstance(value, set | frozenset) else parts)})"
    return "..."


def arguments(function: Any) -> Iterator[tuple[str, Any]]:
    try:
        parameters = signature(function).parameters.values()
    except (TypeError, ValueError):
        return
    yield from ((x.name, x.default) for x in parameters if x.default not in (Parameter.empty, None, "", ()))


def defaults(module: ModuleType) -> Iterator[tuple[str, Any]]:
    """Yield names and values of the constants of a module, and of the defaults of its functions and classes."""
    names = set[str]()
    for node in ast.walk(ast.parse(getsource(module))):
        # what is empty at first is a cache
        if isinstance(node, ast.Assign | ast.AnnAssign) and ast.unparse(node.value or node) not in ("{}", "[]"):
            names |= {x.id for x in ast.walk(node) if isinstance(x, ast.Name) and isinstance(x.ctx, ast.Store)}
    yield from ((name, x) for name, x in vars(module).items() if name in names and name.lstrip("_").isupper())
    for name, value in vars(module).items():
        if isfunction(value) and value.__module__ == module.__name__:
            yield from ((f"{name}({key})", default) for key, default in arguments(value))
        elif isclass(value) and value.__module__ == module.__name__:
            if is_dataclass(value):
                yield from ((f"{name}.{x.name}", x.default) for x in fields(value) if x.default is not MISSING)
            for key, member in vars(value).items():
                if isfunction(member):
                    yield from ((f"{name}.{key}({x})", default) for x, default in arguments(member) if key[0] != "_")
                elif not key.startswith("_"):
                    yield f"{name}.{key}", member


def test_no_default_changes_unseen() -> None:
    lines, here = list[str](), dynident.__path__[0]
    for result in walk_packages(dynident.__path__, "dynident."):
        if result.name.endswith("__main__"):
            continue
        try:
            module = import_module(result.name)
        except ImportError:  # of a package that only an extra needs
            continue
        texts = {f"{result.name[9:]} {name} = {plain(value)}" for name, value in defaults(module)}
        lines += sorted(
            text for text in texts if not text.endswith((" = None", " = ''", " = ...")) and here not in text
        )
    check_kept("defaults", "\n".join(lines))
