"""The type of an array of numbers, apart because NumPy is slow to import."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
