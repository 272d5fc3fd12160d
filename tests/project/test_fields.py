"""Units and their factors."""

from __future__ import annotations

import math

import pytest

from dynident.project.fields import unit_factor


@pytest.mark.parametrize(
    ("unit", "dimension", "factor"),
    [
        ("ms", "time", 1e-3),
        ("min", "time", 60),
        ("deg", "angle", math.pi / 180),
        ("arcsec", "angle", math.pi / 180 / 3600),
        ("in", "length", 0.0254),
        ("N m", "torque", 1),
        ("Nm", "torque", 1),
        ("mN*m", "torque", 1e-3),
        ("kgf cm", "torque", 0.0980665),
        ("lbf ft", "torque", 1.3558179483314004),
        ("lbf", "force", 4.4482216152605),
    ],
)
def test_units(unit, dimension, factor):
    assert unit_factor(unit, dimension, "x") == pytest.approx(factor, rel=1e-14)
