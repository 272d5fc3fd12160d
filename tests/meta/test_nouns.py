"""Every noun is a frozen dataclass; those that gather something while they live are listed."""

from __future__ import annotations

import dataclasses
import importlib
import pkgutil

import dynident

GATHER = {
    *("CommandLog", "LineReader", "ResultFolder", "SampleReader", "Session", "Watch"),
    *("Descent", "InstrumentalRun", "JointSearch", "LikelihoodSearch", "_ConicProgram", "_LikelihoodRun"),
    *("XmlNode", "_Body", "_System", "_TermSelection"),
}


def test_dataclasses_are_frozen() -> None:
    found = set()
    for module in pkgutil.walk_packages(dynident.__path__, "dynident."):
        if not module.name.endswith("__main__"):
            held = vars(importlib.import_module(module.name)).values()
            found |= {
                one
                for one in held
                if isinstance(one, type) and one.__module__ == module.name and "__dataclass_params__" in vars(one)
            }
    assert len(found) > 150
    assert all(dataclasses.is_dataclass(one) for one in found)
    assert {one.__name__ for one in found if not vars(one)["__dataclass_params__"].frozen} == GATHER
