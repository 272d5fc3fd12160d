"""Smoothing that takes motion away, with known truth: what the test says of it, and how often it errs."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from dynident.motion.log import Log, Motion
from dynident.motion.smoothers import Difference, Spline
from dynident.motion.splines import Fixed, smooth
from dynident.validation import LogValidation, Signals, SmoothedAway, TorqueErrors, follow_tests, smoothing_losses

N, STEP, NOISE = 2000, 0.005, 1e-4
T = STEP * np.arange(N)
RATES, SIZES, PHASES = np.pi * np.array([0.5, 1.1, 2.3, 4.1]), np.array([0.5, 0.3, 0.1, 0.03]), np.arange(4.0)


def position(order: int = 0) -> np.ndarray:
    angle = np.outer(T, RATES) + PHASES + order * np.pi / 2
    return (SIZES * RATES**order * np.sin(angle)).sum(axis=1)


def smoothed(factor: float, seed: int = 0) -> tuple[Motion, Log]:
    noise = NOISE * np.random.default_rng(seed).standard_normal(N)
    log = Log(T, (position() + noise)[:, None], np.ones((N, 1)), ("hinge",))
    return Spline(sigma=factor * NOISE)(log), log


@pytest.mark.parametrize("factor", [1.4, 2.0, 8.0])
def test_the_shares_are_those_of_the_truth(factor: float) -> None:
    """The motion alone, smoothed as much, loses as much."""
    motion, log = smoothed(factor)
    result = follow_tests(motion, log)["hinge"]
    clean = smooth(T, position(), Fixed(lam=motion.smoothing["lam"][0]), sigma=motion.smoothing["sigma"][0])
    rows = motion.mask
    share = np.mean((position() - clean.values)[rows] ** 2) / np.mean((log.q - motion.q)[rows] ** 2)
    lost = np.sqrt(np.mean((position(2) - clean.derivative(2))[rows] ** 2) / np.mean(position(2)[rows] ** 2))
    assert result.is_following
    assert result.share == pytest.approx(100 * share, rel=0.1)
    assert result.lost == pytest.approx(100 * lost, abs=0.25)


@pytest.mark.parametrize("rho", [0.0, 0.9])
def test_noise_alone_is_not_flagged(rho: float) -> None:
    """White and coloured noise over a slow motion: none of 60, where 1 % is stated."""
    rng, lam = np.random.default_rng(1), (5 * STEP) ** 4 / STEP / NOISE**2
    flagged = 0
    for _ in range(60):
        noise = NOISE * lfilter([np.sqrt(1 - rho**2)], [1.0, -rho], rng.standard_normal(N + 300))[300:]
        log = Log(T, (0.02 * np.sin(0.3 * T) + noise)[:, None], np.ones((N, 1)), ("hinge",))
        flagged += follow_tests(Spline(Fixed(lam=lam), sigma=NOISE)(log), log)["hinge"].is_following
    assert flagged == 0


def test_it_is_not_known_of_other_smoothers_and_of_joints_at_rest() -> None:
    motion, log = smoothed(1.0)
    assert follow_tests(Difference("central")(log), log) == {}
    still = Log(T, np.zeros((N, 1)), log.tau, log.joints)
    assert follow_tests(Spline(sigma=NOISE)(still), still) == {}
    assert follow_tests(replace(motion, mask=T < 0.1), log) == {}


def validation(factor: float) -> LogValidation:
    motion, log = smoothed(factor)
    return LogValidation(
        "monday", "train", TorqueErrors(N, 1.0, None, {}, {}), signals=Signals(motion, motion.tau, log)
    )


def test_a_note_is_made_where_acceleration_is_lost() -> None:
    (note,) = smoothing_losses([validation(16.0)])
    assert note == SmoothedAway("monday", ("hinge",), note.share, note.lost)
    assert note.share > 80
    assert 2 < note.lost < 20
    assert list(smoothing_losses([validation(8.0)])) == []  # it follows the motion, but 1.8 % is lost
    assert list(smoothing_losses([replace(validation(16.0), signals=Signals(smoothed(16.0)[0], T[:, None]))])) == []
