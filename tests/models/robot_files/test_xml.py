"""Printed angles: which multiples of 15 degrees they stand for, and which they do not."""

import numpy as np
import pytest

from dynident.models.robot_files import RobotJointLimits, exact_angle


@pytest.mark.parametrize(
    ("word", "parts"),
    [
        ("3.14", 12), ("3.142", 12), ("3.141", 12), ("3.1415", 12), ("3.1416", 12), ("3.14159", 12),
        ("-3.14159265", -12),
        ("1.57", 6), ("-1.571", -6), ("1.570800", 6), ("1.5707", 6), ("15.708e-1", 6), ("6.28", 24), ("4.712", 18),
        ("0.785", 3), ("1.0472", 4), ("0.5236", 2), ("0.262", 1),
    ],
)  # fmt: skip
def test_a_printed_angle_stands_for_the_multiple_of_15_degrees_that_rounds_or_cuts_to_it(word: str, parts: int) -> None:
    assert exact_angle(word) == pytest.approx(parts * np.pi / 12, abs=1e-15)


@pytest.mark.parametrize(
    "word", ["0", "0.0", "0.001", "1e-9", "3", "3.1", "0.79", "1.55", "1.5718", "3.14161", "0.3", "1.6"]
)
def test_other_angles_stay(word: str) -> None:
    assert exact_angle(word) == float(word)


@pytest.mark.parametrize(
    ("lower", "upper", "position"), [(None, None, 0.0), (-2.0, 3.0, 0.0), (0.5, None, 0.5), (None, -0.5, -0.5)]
)
def test_the_position_nearest_to_zero_is_within_the_limits(lower, upper, position):
    assert RobotJointLimits(lower=lower, upper=upper).nearest_to_zero == position
