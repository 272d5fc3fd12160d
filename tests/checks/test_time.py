"""The time axis: stamps or sampling at fault, lost samples, with known truth."""

import numpy as np
import pytest

from dynident.checks import channel_notes, check_log_fully, respace, timing
from dynident.motion.log import Log
from dynident.runtime import Note, Severity

N, STEP = 4000, 0.005
EVEN = np.arange(N) * STEP
JITTER = 0.2 * STEP * np.random.default_rng(3).uniform(-1, 1, N)


def log(stamped: np.ndarray, sampled: np.ndarray, noise: float = 1e-6) -> Log:
    """Two joints in motion, sampled at some instants and stamped with others."""
    q = np.column_stack([np.sin(2 * sampled), 0.5 * np.cos(3 * sampled)])
    q = q + noise * np.random.default_rng(4).standard_normal(q.shape)
    return Log(stamped, q, np.cos(q), ("a", "b"), "log")


def topics(case: Log) -> dict[str, tuple[Severity, Note]]:
    kinds = dict.fromkeys(case.joints, "revolute")
    return {finding.topic: (finding.severity, finding.message) for finding in check_log_fully(case, kinds)}


def test_stamps_that_jitter_are_distinguished_from_sampling_that_jitters() -> None:
    noisy, true = log(EVEN + JITTER, EVEN), log(EVEN + JITTER, EVEN + JITTER)
    assert timing(noisy).even < 0.05
    assert timing(true).even > 20
    assert topics(noisy).keys() == {"stamps"}
    rate = pytest.approx(200, rel=1e-5)
    better = channel_notes.StampsJitter(timing(noisy).jitter, 1 / timing(noisy).even, rate, None)
    assert topics(noisy)["stamps"] == ("warning", better)
    assert topics(true).keys() == {"jitter"}
    assert topics(true)["jitter"] == ("info", channel_notes.SamplingJitter(timing(true).jitter, timing(true).even))


@pytest.mark.parametrize(("lost", "severity"), [(13, "info"), (200, "warning")])
def test_lost_samples_are_counted(lost: int, severity: str) -> None:
    drop = np.random.default_rng(5).choice(np.arange(1, N - 1), lost, replace=False)
    kept = np.delete(EVEN, drop)
    test_timing = timing(log(kept, kept))
    assert test_timing.missing == lost
    assert test_timing.rate == pytest.approx(200)
    told = topics(log(kept, kept))["lost"]
    assert told == (
        severity,
        channel_notes.LostSamples(lost, lost / N, pytest.approx(round(test_timing.longest / STEP))),
    )


def test_noisy_stamps_with_lost_samples_are_not_to_be_replaced_by_a_rate() -> None:
    kept = np.delete(np.arange(N), np.arange(50, N, 37))
    told = topics(log(EVEN[kept] + 0.2 * JITTER[kept], EVEN[kept]))
    severity, note = told["stamps"]
    assert isinstance(note, channel_notes.StampsJitter)
    assert (severity, note.rate, note.step) == ("warning", None, pytest.approx(STEP, rel=0.01))


def test_equal_spacing_is_taken_where_the_stamps_jitter_and_only_there() -> None:
    spaced, note = respace(log(EVEN + JITTER + 1e3, EVEN))
    assert (note.jitter, note.lost) == (pytest.approx(timing(log(EVEN + JITTER, EVEN)).jitter), 0)
    assert note.factor == pytest.approx(1 / timing(log(EVEN + JITTER, EVEN)).even, rel=0.01)
    assert note.rate == pytest.approx(200, rel=1e-5)
    np.testing.assert_allclose(np.diff(spaced.t), STEP, rtol=1e-4)
    np.testing.assert_allclose(spaced.t - 1e3, EVEN, atol=0.1 * STEP)
    sound = log(EVEN + JITTER, EVEN + JITTER), log(EVEN + JITTER, EVEN, noise=0.1), log(EVEN, EVEN)
    assert [respace(x) for x in sound] == [(x, None) for x in sound]


@pytest.mark.parametrize("pause", [3.4, 8.0])
def test_true_gaps_are_kept(pause: float) -> None:
    """A recorder that paused, under a busy clock: no equal spacing, though single stamps are off by more."""
    gap = np.where(np.arange(N) > 1500, pause * STEP, 0.0)
    paused = log(EVEN + gap + 0.05 * JITTER, EVEN + gap, noise=1e-3)
    spaced, _ = respace(paused)
    assert np.diff(spaced.t)[1500] > 3 * STEP
    assert not np.allclose(np.diff(spaced.t), STEP, rtol=0.5)
    long = log(EVEN + 10 * gap + JITTER, EVEN + 10 * gap)
    assert respace(long) == (long, None)


def test_a_rate_that_drifts_is_no_equal_spacing() -> None:
    """The stamps follow it, with some jitter; the noise of the positions alone would not show the drift. A joint that
    does not move says nothing of the time."""
    drift = EVEN + 0.02 * np.sin(EVEN / 4)
    drifting = log(drift + 0.01 * JITTER, drift, noise=1e-7)
    assert respace(drifting) == (drifting, None)
    still = Log(EVEN + JITTER, np.zeros((N, 1)), np.cos(EVEN)[:, None], ("a",), "log")
    assert timing(still).even == 1.0
