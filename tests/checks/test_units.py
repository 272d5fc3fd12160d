"""Units of time, length and angle that rates, speeds and ranges tell."""

from dataclasses import replace

import numpy as np
import pytest

from dynident.checks import channel_notes, check_log
from dynident.checks.stamps import length_unit_findings, radian_findings, thin_regression
from dynident.motion.log import Log
from dynident.motion.smoothers import Spline
from tests.checks.moving_arm import arm, motion, truth
from tests.checks.pendulum import PENDULUM, swing

T = np.arange(3000) * 0.002


def log(t: np.ndarray, q: np.ndarray | None = None) -> Log:
    return Log(t, (np.sin(2 * T) if q is None else q)[:, None], np.cos(3 * T)[:, None], ("elbow",))


@pytest.mark.parametrize(("scale", "factor"), [(1e3, 1e-3), (1e6, 1e-6), (1e9, 1e-9), (1e-3, 1e3), (1e-6, 1e6)])
def test_the_unit_of_time_is_said(scale: float, factor: float) -> None:
    (finding,) = check_log(log(scale * T), {"elbow": "revolute"})
    assert isinstance(finding.message, channel_notes.WrongTimeUnit)
    assert finding.message.factor == factor


def test_a_slow_recording_of_a_fast_motion_is_no_wrong_unit() -> None:
    t = np.arange(3000) / 5.0
    assert check_log(log(t, np.sin(0.5 * t)), {"elbow": "revolute"}) == ()


def test_millimetres_are_said() -> None:
    assert list(length_unit_findings("rail", T, 0.4 * np.sin(3 * T))) == []
    (result,) = length_unit_findings("rail", T, 400 * np.sin(3 * T))
    assert (result.joint, type(result.message)) == ("rail", channel_notes.PerhapsMillimetres)


@pytest.mark.parametrize("seed", range(2))
def test_radians_declared_as_degrees_are_said(seed: int) -> None:
    wide, narrow = swing(seed, (1.7, 2.3)), swing(seed, (0.1, 9.0), noise=1e-5)
    right = Spline(sigma=1e-4)(wide)
    small = replace(right, **{name: getattr(right, name) * np.pi / 180 for name in ("q", "dq", "ddq")})
    said = [
        len(list(radian_findings(thin_regression(PENDULUM, [moved]))))
        for moved in (small, right, Spline(sigma=1e-5)(narrow))
    ]
    assert said == [1, 0, 0]


def test_radians_of_one_joint_declared_as_degrees_are_said() -> None:
    right = motion()
    factor = np.array([1.0, np.pi / 180, 1.0])
    wrong = replace(right, q=right.q * factor, dq=right.dq * factor, ddq=right.ddq * factor)
    (result,) = radian_findings(thin_regression(arm(), [wrong]))
    assert (result.joint, result.message.others_move) == ("j2", True)
    assert str(result.message).startswith("this joint moves no more than")
    little = replace(
        right, tau=arm().torque(wrong.q, wrong.dq, wrong.ddq, truth(arm())), q=wrong.q, dq=wrong.dq, ddq=wrong.ddq
    )
    assert list(radian_findings(thin_regression(arm(), [little]))) == []
