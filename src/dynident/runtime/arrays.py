"""Arrays of numbers, apart because NumPy is slow to import."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynident.runtime.errors import InputError

Array = NDArray[np.float64]


def as_numbers(value: ArrayLike, dtype: Any = np.float64) -> NDArray[Any]:
    """Return an array of numbers, nan where a mask hides one; InputError for texts, dates and complex numbers."""
    try:
        array = np.ma.filled(value.astype(float), np.nan) if isinstance(value, np.ma.MaskedArray) else np.asarray(value)
        if array.dtype.kind not in "cmM":
            return np.asarray(array, dtype=dtype)
    except (TypeError, ValueError) as error:
        raise InputError(f"numbers are expected: {error}.") from error
    advice = "its real part" if array.dtype.kind == "c" else "s, such as `(t - t[0]) / np.timedelta64(1, 's')`"
    raise InputError(f"real numbers are expected, not {array.dtype}; give {advice}.")
