"""Objects that hold data cannot be changed, and those that hold arrays are not compared by these."""

from dataclasses import fields, is_dataclass
from importlib import import_module
from inspect import isclass
from pkgutil import walk_packages
from typing import Any

import dynident

# they gather as they go
WORKERS = {
    *("CommandLog", "Descent", "EventLog", "InstrumentalRun", "JointSearch", "LikelihoodSearch", "LineReader"),
    *("ResultFolder", "SampleReader", "Session", "Watch", "XmlNode", "_Body", "_ConicProgram", "_LikelihoodRun"),
    *("_System", "_TermSelection"),
}


def dataclasses() -> list[Any]:
    """Return those of all modules that can be imported here."""
    kinds = []
    for module in walk_packages(dynident.__path__, "dynident."):
        try:
            contents = [] if module.name.endswith("__main__") else vars(import_module(module.name)).values()
        except ImportError:  # of a package that only an extra needs
            continue
        kinds += [x for x in contents if isclass(x) and x.__module__ == module.name and is_dataclass(x)]
    return [kind for kind in kinds if "__dataclass_params__" in vars(kind)]


def test_data_cannot_be_changed_and_arrays_are_not_compared() -> None:
    kinds = dataclasses()
    assert len(kinds) > 600
    assert {kind.__name__ for kind in kinds if not kind.__dataclass_params__.frozen} <= WORKERS
    compared = [kind for kind in kinds if kind.__dataclass_params__.eq]
    assert [kind for kind in compared if any("Array" in str(field.type) for field in fields(kind))] == []
