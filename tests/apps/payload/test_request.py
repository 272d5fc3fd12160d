"""What may be asked of a payload."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from dynident.apps.payload import DriveGains, PayloadRequest
from dynident.runtime import ConfigError

GAINS = DriveGains(("a",), np.array([1.1]), np.array([[1e-4]]), 2.0)


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"known_mass": 0.0}, "known mass is 0 kg"),
        ({"known_mass": np.inf}, "known mass is inf kg"),
        ({"gain_error": -1.0}, "gain error is -1 %"),
        ({"friction_change": 101.0}, "friction change is 101 %"),
        ({"load_friction": np.nan}, "friction by the load is nan %"),
        ({"known_mass": 1.0, "known_centre": (0.0, 0.0, 50.0)}, "50 m away; give it in m"),
        ({"gains": GAINS, "known_mass": 1.0}, "give one of them"),
        ({"known_centre": (0.0, 0.0, 0.1)}, "known centre of mass needs the known mass"),
        ({"known_mass": 1.0, "known_centre": (0.0, 0.0, np.nan)}, "three numbers in m"),
    ],
)
def test_what_cannot_be_is_refused(settings: dict[str, Any], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        PayloadRequest(**settings)


def test_gains_are_corrected_by_their_inverse() -> None:
    assert GAINS.correction == pytest.approx([1 / 1.1])
    assert GAINS.std == pytest.approx([0.01])
