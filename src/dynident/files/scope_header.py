"""Headers of the oscilloscopes of control systems (TwinCAT): each line has one property of all channels.

The name of the property stands before the channels, and again before each group of them that has stamps of its own.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

import numpy as np

from dynident.runtime.arrays import Array

_STEP = re.compile(r"SampleTime\[(\w+)\]")
_STAMPS = re.compile(r"time(_\d+)?( \[\w+\])?")


def scope_names(lines: Iterable[list[str]]) -> tuple[list[str], int]:
    """Return the names of the columns, stamps too, and the number of lines of such a header; 0 where it is none.

    ``lines`` are the cells of the lines above the first row of numbers.
    """
    properties: dict[str, list[str]] = {}
    starts: list[int] = []
    for cells in lines:
        key = next(iter(cells), "")
        places = [k for k, cell in enumerate(cells) if cell == key]
        starts = starts or places
        is_uneven = any(len(cells) != len(others) for others in properties.values())
        if not key or is_uneven or places != starts or key in properties:
            break
        properties[key] = cells
    step = next(filter(None, map(_STEP.fullmatch, properties)), None)
    if "Name" not in properties or not (step or len(starts) > 1):
        return [], 0
    # short names where they tell the channels apart, else the full ones
    names = properties["Name"]
    channels = [names[k] for k in range(len(names)) if k not in starts]
    if len(set(channels)) < len(channels):
        names = properties.get("SymbolName", names)
    units = [unit.removeprefix("None") for unit in properties.get("Unit", [""] * len(names))]
    names = [f"{name} [{unit}]" if unit else name for name, unit in zip(names, units, strict=True)]
    for count, k in enumerate(starts, 1):
        names[k] = "time" + f"_{count}" * (count > 1) + (f" [{step[1]}]" if step else "")
    return names, len(properties)


def merge_stamps(columns: Mapping[str, Array]) -> dict[str, Array]:
    """Return the columns without the stamps of further groups that are those of the first."""
    stamps = [name for name in columns if _STAMPS.fullmatch(name)]
    same = {name for name in stamps[1:] if np.array_equal(columns[name], columns[stamps[0]])}
    return {name: column for name, column in columns.items() if name not in same}
