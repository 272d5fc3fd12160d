"""Units of time, length and angle that rates, speeds and ranges tell."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dynident.checks import channel_notes, check_log
from dynident.checks.stamps import length_unit_findings, radian_findings, thin_regression
from dynident.models.lagrangian import pendulum
from dynident.models.simulation import record, simulate
from dynident.motion.log import Log
from dynident.motion.smoothers import Spline

T = np.arange(3000) * 0.002


def log(t: np.ndarray, q: np.ndarray | None = None) -> Log:
    return Log(t, (np.sin(2 * T) if q is None else q)[:, None], np.cos(3 * T)[:, None], ("elbow",))


@pytest.mark.parametrize(("scale", "factor"), [(1e3, 1e-3), (1e6, 1e-6), (1e9, 1e-9), (1e-3, 1e3), (1e-6, 1e6)])
def test_the_unit_of_time_is_said(scale: float, factor: float) -> None:
    (found,) = check_log(log(scale * T), {"elbow": "revolute"})
    assert isinstance(found.message, channel_notes.WrongTimeUnit)
    assert found.message.factor == factor


@pytest.mark.parametrize("rate", [10.0, 100.0, 5000.0, 20000.0])
def test_usual_rates_are_usual(rate: float) -> None:
    t = np.arange(3000) / rate
    found = check_log(log(t, np.sin(2 * t)), {"elbow": "revolute"})
    assert not any(isinstance(one.message, channel_notes.WrongTimeUnit) for one in found)


def test_a_slow_recording_of_a_fast_motion_is_no_wrong_unit() -> None:
    t = np.arange(3000) / 5.0
    assert check_log(log(t, np.sin(0.5 * t)), {"elbow": "revolute"}) == ()


def test_millimetres_are_said() -> None:
    assert list(length_unit_findings("rail", T, 0.4 * np.sin(3 * T))) == []
    (found,) = length_unit_findings("rail", T, 400 * np.sin(3 * T))
    assert (found.joint, type(found.message)) == ("rail", channel_notes.PerhapsMillimetres)


def test_radians_declared_as_degrees_are_said() -> None:
    arm = pendulum()
    wide, slight = (
        simulate(arm, arm.values, lambda t, a=a, w=w: [a * np.sin(w * t)], np.arange(2000) * 0.005)
        for a, w in ((1.7, 2.3), (0.1, 9.0))
    )
    for seed in range(20):
        one = record(wide, sigma_q=1e-4, sigma_tau=0.02, rng=np.random.default_rng(seed)).log
        right = Spline(sigma=1e-4)(one)
        small = [replace(right, **{name: getattr(right, name) * np.pi / 180 for name in ("q", "dq", "ddq")})]
        assert len(list(radian_findings(thin_regression(arm, small)))) == 1
        assert list(radian_findings(thin_regression(arm, [right]))) == []
        narrow = record(slight, sigma_q=1e-5, sigma_tau=0.02, rng=np.random.default_rng(seed)).log
        assert list(radian_findings(thin_regression(arm, [Spline(sigma=1e-5)(narrow)]))) == []
