"""Whether two results are the same in all that a file holds, to the last bit."""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from dynident.estimators import DataRank, Residual
from dynident.validation import FreeRun, LogValidation

__all__ = ["assert_same"]

LEFT_OUT: Mapping[type, tuple[str, ...]] = {
    LogValidation: ("signals",),
    FreeRun: ("signals",),
    DataRank: ("directions",),
    Residual: ("sample_weights", "slopes"),
}


def assert_same(case: Any, other: Any, where: str = "result") -> None:
    if is_dataclass(case):
        assert type(case) is type(other), where
        for field in fields(case):
            if field.name not in LEFT_OUT.get(type(case), ()):
                assert_same(getattr(case, field.name), getattr(other, field.name), f"{where}.{field.name}")
    elif isinstance(case, Mapping):
        assert case.keys() == other.keys(), where
        for key, value in case.items():
            assert_same(value, other[key], f"{where}[{key!r}]")
    elif isinstance(case, tuple):
        assert len(case) == len(other), where
        for k, value in enumerate(case):
            assert_same(value, other[k], f"{where}[{k}]")
    elif isinstance(case, np.ndarray | float):
        np.testing.assert_array_equal(np.asarray(other), np.asarray(case), err_msg=where)
    else:
        assert case == other, where
