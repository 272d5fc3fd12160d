"""What a module defines, for the tests."""

from inspect import isclass
from types import ModuleType


def classes_of(module: ModuleType) -> tuple[type, ...]:
    """Return the public classes that the module itself defines."""
    return tuple(
        kind
        for name, kind in vars(module).items()
        if isclass(kind) and kind.__module__ == module.__name__ and not name.startswith("_")
    )
