"""Pieces of a log with the overlap are smoothed as in the whole log."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pytest

from dynident.motion.log import Log, Motion
from dynident.motion.smoothers import (
    Butterworth,
    Difference,
    KalmanSmoother,
    Smoother,
    Spline,
    TimeShifted,
    decay,
    overlap,
    smooth_log,
)
from dynident.motion.smoothers.smoother import ACCURACY
from dynident.motion.splines import Fixed, Interpolation
from dynident.runtime import ConfigError

STEP = 0.002


def recording(samples: int = 12_000, noise: float = 1e-4) -> Log:
    """Two joints in motion, with noise."""
    t, rng = np.arange(samples) * STEP, np.random.default_rng(0)
    q = np.stack([np.sin(3 * t) + 0.2 * np.sin(17 * t), np.cos(5 * t)], axis=1)
    return Log(t, q + noise * rng.normal(size=q.shape), np.ones(q.shape), ("one", "two"))


def lam(width: float) -> float:
    """The penalty of a spline of this bandwidth (s), for sigma 1e-4."""
    return width**4 / (1e-8 * STEP)


SPLINES: Mapping[str, Smoother] = {
    "narrow": Spline(Fixed(lam=lam(0.5 * STEP)), 1e-4),
    "usual": Spline(Fixed(lam=(lam(0.01), lam(0.02))), 1e-4),
    "wide": Spline(Fixed(lam=lam(0.06)), 1e-4),
    "interpolating": Spline(Interpolation(), 1e-4),
    "shifted": TimeShifted(Spline(Fixed(lam=lam(0.01)), 1e-4), 0.0123),
}
OTHERS: Mapping[str, Smoother] = {
    "butterworth": Butterworth(cutoffs=(20, 15, 10)),
    "difference": Difference("central"),
    "kalman": KalmanSmoother(3, 1e-4, 10.0),
}


def worst(motion: Motion, part: Motion, first: int, inside: slice) -> float:
    """The largest error of a piece relative to the values."""
    there = slice(first + inside.start, first + inside.stop)
    pairs = [(getattr(motion, name)[there], getattr(part, name)[inside]) for name in ("q", "dq", "ddq")]
    return max(float((np.abs(b - a) / np.abs(a).max(axis=0)).max()) for a, b in pairs)


@pytest.mark.parametrize("smoother", [SPLINES["usual"], OTHERS["difference"]], ids=["spline", "difference"])
def test_a_time_shift_needs_as_many_samples_more(smoother: Smoother) -> None:
    log = recording()
    plain, shifted = (overlap(x, log, smooth_log(x, log)) for x in (smoother, TimeShifted(smoother, -0.0123)))
    assert shifted - plain == 9  # of 2 ms, and two in which the motion between samples is sought


@pytest.mark.parametrize("name", [*SPLINES, *OTHERS])
def test_a_piece_with_the_overlap_has_the_motion_of_the_whole(name: str) -> None:
    smoother, log = {**SPLINES, **OTHERS}[name], recording()
    full = smooth_log(smoother, log)
    more = overlap(smoother, log, full)
    first, last = 5000 - more, 5500 + more
    part = smooth_log(smoother, log.rows(slice(first, last), "piece"))
    inside = slice(more, more + 500)
    assert worst(full, part, first, inside) < 1e-9
    assert part.mask[inside].all()


def test_the_roots_are_those_of_a_kernel_and_of_interpolation() -> None:
    assert decay(0.0, STEP) == pytest.approx(2 - np.sqrt(3))
    assert decay(np.inf, STEP) == 1.0
    for width in (10 * STEP, 100 * STEP):
        assert np.log(decay(width, STEP)) == pytest.approx(-STEP / (np.sqrt(2) * width), rel=2e-3)
    widths = np.geomspace(0.5, 100, 50) * STEP
    assert (np.diff([decay(width, STEP) for width in widths]) > 0).all()


@dataclass(frozen=True)
class Straight(Smoother):
    """Every sample counts everywhere."""

    def __call__(self, log: Log) -> Motion:
        q = log.q + np.cumsum(log.q, axis=0)
        return Motion(log.t, q, q, q, log.tau, log.joints, np.ones(len(log), dtype=bool))


def test_what_cannot_be_smoothed_in_pieces_is_refused() -> None:
    log = recording(3000)
    smoother = Spline(Fixed(lam=lam(1.0)), 1e-4, ends=0)
    with pytest.raises(ConfigError, match=r"smooths over 1 s.*smooth less"):
        overlap(smoother, log, smooth_log(smoother, log))
    with pytest.raises(ConfigError, match="Straight makes of a sample"):
        overlap(Straight(), log, Straight()(log))
    assert ACCURACY < 1e-9
