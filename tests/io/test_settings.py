"""Settings that do not fit the joints of the model."""

from __future__ import annotations

import pytest

from dynident.errors import ConfigError
from dynident.io.config import parse_config
from dynident.io.settings import check_joints
from tests.io.configurations import SLIDER, changed, with_channel

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
}


@pytest.mark.parametrize(("text", "fragments"), CHANNELS.values(), ids=CHANNELS)
def test_channels_that_do_not_fit_the_joints(text, fragments):
    with pytest.raises(ConfigError) as caught:
        check_joints(parse_config(text), SLIDER)
    assert all(fragment in str(caught.value) for fragment in fragments), caught.value
