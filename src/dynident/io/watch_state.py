"""What a watch knows, as bytes: a NumPy archive of its arrays, with all else as JSON that refers to them."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from enum import StrEnum
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynident import online
from dynident.errors import InputError
from dynident.io.npz import opened_npz
from dynident.io.opener import afford, opened
from dynident.regression import GroupKind

__all__ = ["read_state", "state_bytes"]

FORMAT, VERSION = "dynident watch", 1
KNOWN = [getattr(online, name) for name in online.__all__]
NOUNS: Mapping[str, type] = {one.__name__: one for one in KNOWN if isinstance(one, type) and is_dataclass(one)}
KINDS: Mapping[str, type[StrEnum]] = {
    one.__name__: one for one in (*KNOWN, GroupKind) if isinstance(one, type) and issubclass(one, StrEnum)
}


def state_bytes(state: Mapping[str, Any]) -> bytes:
    """Return mappings, sequences, arrays, numbers, texts and nouns of ``dynident.online`` as the content of a file."""
    arrays = list[NDArray[Any]]()
    text = json.dumps({"format": FORMAT, "version": VERSION, "state": _plain(state, arrays)})
    buffer = BytesIO()
    named = {f"array_{k}": one for k, one in enumerate(arrays)}
    np.savez(buffer, state=np.frombuffer(text.encode(), dtype=np.uint8), **named)  # type: ignore[arg-type]
    return buffer.getvalue()


def read_state(path: Path) -> dict[str, Any]:
    """Read what ``state_bytes`` made; InputError where a file is something else, damaged, or of another version."""
    try:
        with opened(path, remember=False) as file, opened_npz(file) as found:
            arrays = dict[str, NDArray[Any]]()
            for name, one in found.items():
                if isinstance(one, str):
                    raise ValueError(f"{name} holds {one}")
                afford(one.cost, f"{path}: to read {name!r} would take")
                arrays[name] = one.read()
        data = json.loads(arrays.pop("state").tobytes())
        if data["format"] != FORMAT or data["version"] != VERSION:
            raise ValueError(f"it is of version {data['version']!r}, and this dynident reads {VERSION}")
        state: dict[str, Any] = _noun(data["state"], arrays)
        return state
    except InputError:
        raise
    except Exception as error:  # whatever a damaged archive leads to
        raise InputError(
            f"{path}: is no state of `dynident watch` that can be read ({error}); delete it, and the watch begins anew."
        ) from error


def _plain(value: Any, arrays: list[NDArray[Any]]) -> Any:
    """Return the value in types of JSON; arrays are added to the others, and referred to."""
    if isinstance(value, np.ndarray):
        arrays.append(value)
        return {"array": len(arrays) - 1}
    if isinstance(value, StrEnum):
        return {"kind": type(value).__name__, "value": value.value}
    if is_dataclass(value) and not isinstance(value, type):
        inside = {one.name: _plain(getattr(value, one.name), arrays) for one in fields(value)}
        return {"noun": type(value).__name__, "fields": inside}
    if isinstance(value, Mapping):
        return {"map": {str(key): _plain(one, arrays) for key, one in value.items()}}
    if isinstance(value, tuple | list):
        return [_plain(one, arrays) for one in value]
    if isinstance(value, np.generic):
        return _plain(value.item(), arrays)
    if isinstance(value, float) and not math.isfinite(value):
        return {"float": str(value)}
    return value


def _noun(value: Any, arrays: Mapping[str, NDArray[Any]]) -> Any:
    """Return what ``_plain`` was given; sequences as tuples."""
    if isinstance(value, Sequence) and not isinstance(value, str):
        return tuple(_noun(one, arrays) for one in value)
    if not isinstance(value, dict):
        return value
    if "array" in value:
        return arrays[f"array_{value['array']}"].copy()
    if "kind" in value:
        return KINDS[value["kind"]](value["value"])
    if "noun" in value:
        return NOUNS[value["noun"]](**{name: _noun(one, arrays) for name, one in value["fields"].items()})
    if "float" in value:
        return float(value["float"])
    return {name: _noun(one, arrays) for name, one in value["map"].items()}
