"""Settings that do not fit the joints of the model, and units."""

import math

import pytest

from dynident.project.config import parse_config
from dynident.project.fields import unit_factor
from dynident.project.settings import check_joints
from dynident.runtime import ConfigError
from tests.project.configurations import SLIDER, changed, with_channel

CHANNELS = {
    "unknown joint": (
        changed(position={"slidr": {"column": "q", "unit": "m"}}),
        ("position.slidr", "did you mean 'slider'"),
    ),
    "no torque": (changed(torque={}), ("torque: joint 'slider' of the model is missing",)),
    "wrong dimension": (
        with_channel(unit="rad"),
        ("position.slider.unit: 'rad' is a unit of angle, not of length", "'mm'"),
    ),
    "unknown unit": (with_channel(unit="furlong"), ("'furlong' is not a unit of length", "'cm'")),
    "torque for force": (
        changed(torque={"slider": {"column": "i", "unit": "Nm"}}),
        ("torque.slider.unit: 'Nm'", "'kN'"),
    ),
    "time unit": (changed(time={"column": "t", "unit": "sec"}), ("time.unit: 'sec'", "'ms'")),
    "multi-turn slider": (with_channel(multi_turn=True), ("position.slider.multi_turn", "slides")),
    "sigma": (changed(smoother={"kind": "spline", "sigma": {"x": 1}}), ("smoother.sigma.x: there is no joint",)),
    "factor": (changed(smoother={"kind": "spline", "factor": {"x": 1}}), ("smoother.factor.x: there is no joint",)),
    "unfitted": (changed(unfitted=["slidr"]), ("unfitted.slidr: there is no joint 'slidr'", "did you mean 'slider'")),
    "nothing fitted": (changed(unfitted=["slider"]), ("unfitted: names every joint",)),
}


@pytest.mark.parametrize(("text", "fragments"), CHANNELS.values(), ids=CHANNELS)
def test_channels_that_do_not_fit_the_joints(text, fragments):
    with pytest.raises(ConfigError) as caught:
        check_joints(parse_config(text), SLIDER)
    assert all(fragment in str(caught.value) for fragment in fragments), caught.value


@pytest.mark.parametrize(
    ("terms", "message"),
    [(["auto", "auto"], "`terms` lists 'auto' twice"), ("viscous", r"model.terms: a list"), ("autos", "model.terms")],
    ids=str,
)
def test_terms_that_are_no_list(terms, message):
    with pytest.raises(ConfigError, match=message):
        parse_config(changed(model={"file": "arm.urdf", "terms": terms}))


@pytest.mark.parametrize(
    ("unit", "dimension", "factor"),
    [
        ("ms", "time", 1e-3),
        ("deg", "angle", math.pi / 180),
        ("arcsec", "angle", math.pi / 180 / 3600),
        ("N m", "torque", 1),
        ("0.01 deg", "angle", math.pi / 18000),
        ("1e-4deg", "angle", math.pi / 1.8e6),
        ("4 ms", "time", 0.004),
        ("mN*m", "torque", 1e-3),
        ("kgf cm", "torque", 0.0980665),
        ("lbf ft", "torque", 1.3558179483314004),
        ("lbf", "force", 4.4482216152605),
    ],
)
def test_units(unit, dimension, factor):
    assert unit_factor(unit, dimension, "x") == pytest.approx(factor, rel=1e-14)
