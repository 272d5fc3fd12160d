"""What is true of the demo arm."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.demo.arm import TILT, TIME_OFFSET, true_model, true_values
from dynident.errors import brief
from dynident.models import Model

__all__ = ["DemoTruth", "demo_truth"]


@dataclass(frozen=True, eq=False)
class DemoTruth:
    """The ``model`` of the demo arm on its tilted base, with the parameters that ``dynident identify`` finds for it,
    and their true ``value`` (84); the ``time_offset`` (s) of its recordings, negative as torques are logged late; the
    ``tilt`` (rad) of its base about the x and y axes."""

    model: Model
    value: NDArray[np.float64]
    time_offset: float
    tilt: tuple[float, float]

    __repr__ = brief


def demo_truth() -> DemoTruth:
    """Return what is true of the demo arm.

    >>> truth = demo_truth()
    >>> truth.value[truth.model.names.index("Fv_elbow")].item()
    6.0
    """
    return DemoTruth(true_model(), true_values(), TIME_OFFSET, TILT)
