"""What every smoother promises."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from dynident.motion.log import Log
from dynident.motion.smoothers import Smoother
from dynident.runtime import InputError, MissingInputError
from dynident.runtime.arrays import Array
from dynident.runtime.families import SMOOTHERS
from dynident.testing.estimator import builds_itself_from_its_settings, cannot_be_changed

MotionOf = Callable[[Array], tuple[Array, Array, Array]]
PERIOD = 3.7  # s


def check_smoother(smoother: Smoother) -> None:
    """Raise AssertionError unless the smoother keeps all promises of its family, on two joints.

    They are sampled at 200 Hz, or 400 Hz without noise. Their motion holds frequencies up to 0.32 Hz; a smoother that
    misses something in it (MissingInputError) is for motion that repeats, and checked on such, up to 0.54 Hz in periods
    of 3.7 s. Without noise q, dq and ddq must be right within 0.1, 1 and 3 % of their largest value, wherever the mask
    is True.
    """
    for check in SMOOTHER_CHECKS:
        check(smoother)


def two_sines(t: Array) -> tuple[Array, Array, Array]:
    """Return q, dq, ddq (N, 2) of two joints that move slowly enough for the article's 2 Hz filter."""
    q = np.column_stack((np.sin(1.5 * t), 0.5 * np.cos(2 * t) + 0.1 * t))
    dq = np.column_stack((1.5 * np.cos(1.5 * t), -np.sin(2 * t) + 0.1))
    ddq = np.column_stack((-2.25 * np.sin(1.5 * t), -2 * np.cos(2 * t)))
    return q, dq, ddq


def periodic(t: Array) -> tuple[Array, Array, Array]:
    """Return q, dq, ddq (N, 2) of two joints that repeat their motion after 3.7 s."""
    w = 2 * np.pi / PERIOD
    once, twice = w * t, 2 * w * t
    q = np.column_stack((np.sin(once), 0.5 * np.cos(twice) + 0.1 * np.sin(once)))
    dq = w * np.column_stack((np.cos(once), -np.sin(twice) + 0.1 * np.cos(once)))
    ddq = w**2 * np.column_stack((-np.sin(once), -2 * np.cos(twice) - 0.1 * np.sin(once)))
    return q, dq, ddq


def make_log(
    noise: float = 0.0,
    n: int = 4000,
    h: float = 2.5e-3,
    jitter: float = 0.0,
    start: float = 0.0,
    motion: MotionOf = two_sines,
) -> Log:
    """Return a log of n samples of a motion, with white position noise (rad) and jitter (share of the step)."""
    rng = np.random.default_rng(7)
    t = start + np.arange(n) * h + jitter * h * rng.uniform(-0.5, 0.5, n)
    q = motion(t)[0]
    tau = rng.standard_normal(q.shape)
    return Log(t, q + noise * rng.standard_normal(q.shape), tau, ("a", "b"), "made")


_motions: dict[str, MotionOf] = {}  # by the repr of the smoother, which need not be hashable


def motion_for(smoother: Smoother) -> MotionOf:
    """Return the motion that a smoother is checked on: ``two_sines``, ``periodic`` where it misses something there."""
    name = repr(smoother)
    if name not in _motions:
        words = _missed(smoother)
        assert words is None or "made" in words, f"the error does not name the log: {words}"
        _motions[name] = two_sines if words is None else periodic
    return _motions[name]


def _missed(smoother: Smoother) -> str | None:
    """Return what the smoother says that it misses in ``two_sines``; None where it misses nothing."""
    try:
        smoother(make_log(1e-4))
    except MissingInputError as error:
        return str(error)
    return None


def _log_for(smoother: Smoother) -> Log:
    return make_log(1e-4, n=2000, h=5e-3, motion=motion_for(smoother))


def keeps_what_is_not_its_own(smoother: Smoother) -> None:
    """Times, torques, joints and source are those of the log."""
    log = _log_for(smoother)
    motion = smoother(log)
    np.testing.assert_array_equal(motion.t, log.t)
    np.testing.assert_array_equal(motion.tau, log.tau)
    assert (motion.joints, motion.source) == (log.joints, log.source), "joints and source are the log's"
    assert motion.q.shape == motion.dq.shape == motion.ddq.shape == log.q.shape
    assert "method" in motion.smoothing, "`smoothing` says the `method`"


def recovers_a_smooth_motion(smoother: Smoother) -> None:
    """Without noise, the motion and its derivatives are right where the mask is True."""
    motion = smoother(make_log(motion=motion_for(smoother)))
    for name, true, tolerance in zip(
        ("q", "dq", "ddq"), motion_for(smoother)(motion.t), (1e-3, 1e-2, 3e-2), strict=True
    ):
        error = np.abs(getattr(motion, name) - true)[motion.mask].max() / np.abs(true).max()
        assert error < tolerance, f"{name} is wrong by {error:.2g} of its largest value, {tolerance} is allowed"


def ignores_the_zero_of_the_encoder(smoother: Smoother) -> None:
    """Another zero of the encoder changes q by it and nothing else."""
    log = _log_for(smoother)
    shifted = smoother(Log(log.t, log.q + 2.0, log.tau, log.joints))
    motion = smoother(log)
    np.testing.assert_allclose(shifted.q, motion.q + 2.0, atol=1e-8)
    np.testing.assert_allclose(shifted.dq, motion.dq, atol=1e-7 * np.abs(motion.dq).max())
    np.testing.assert_allclose(shifted.ddq, motion.ddq, atol=1e-5 * np.abs(motion.ddq).max())


def takes_time_from_anywhere(smoother: Smoother) -> None:
    """Only differences of times count."""
    log = _log_for(smoother)
    shifted = smoother(Log(log.t + 1024.0, log.q, log.tau, log.joints))
    np.testing.assert_allclose(shifted.ddq, smoother(log).ddq, atol=2e-4 * np.abs(shifted.ddq).max())


def does_not_mix_joints(smoother: Smoother) -> None:
    """A joint is smoothed the same alone; where one period of all joints is looked for, with that."""
    log = _log_for(smoother)
    motion = smoother(log)
    with_period = smoother.of_period(motion)
    np.testing.assert_allclose(with_period(log).ddq, motion.ddq, atol=1e-6 * np.abs(motion.ddq).max())
    alone = with_period(log.select(("b",)))
    np.testing.assert_allclose(alone.ddq[:, 0], motion.ddq[:, 1], atol=1e-6 * np.abs(alone.ddq).max())


def is_linear_as_used(smoother: Smoother) -> None:
    """As it was used for a log it makes the same motion, and of noise and its opposite what cancels."""
    log = _log_for(smoother)
    motion = smoother(log)
    linear_smoother, noise = smoother.as_used(motion), 1e-5 * np.random.default_rng(3).standard_normal(log.q.shape)
    repeated, up, down = (linear_smoother(replace(log, q=log.q + s * noise)) for s in (0.0, 1.0, -1.0))
    for name in ("q", "dq", "ddq"):
        expected, largest = getattr(motion, name), np.abs(getattr(motion, name)).max()
        np.testing.assert_allclose(getattr(repeated, name), expected, atol=1e-6 * largest)
        # the errors by noise and by its opposite cancel where the smoother is linear
        middle = (getattr(up, name) + getattr(down, name)) / 2
        np.testing.assert_allclose(middle, getattr(repeated, name), atol=1e-8 * largest)
    np.testing.assert_array_equal(repeated.mask, motion.mask)


def masks_the_ends(smoother: Smoother) -> None:
    """The middle may be used, the last sample not: nothing is known of what comes after it."""
    motion = smoother(_log_for(smoother))
    usable = np.flatnonzero(motion.mask)
    assert (np.diff(usable) == 1).all(), "the mask is one piece"
    assert len(usable) > len(motion) // 2, "more than half of the samples may be used"
    assert not motion.mask[-1], "the last sample is masked"


def is_frozen_and_repeatable(smoother: Smoother) -> None:
    """The same log gives the same motion, also from a pickled copy; neither part nor motion can be changed."""
    log = _log_for(smoother)
    np.testing.assert_array_equal(smoother(log).ddq, smoother(log).ddq)
    assert pickle.loads(pickle.dumps(smoother)) == smoother
    cannot_be_changed(smoother)
    assert not smoother(log).ddq.flags.writeable, "the arrays of a Motion are read-only"


def refuses_too_few_samples(smoother: Smoother) -> None:
    """Three samples: an InputError, or finite numbers, never a crash or a NaN."""
    try:
        motion = smoother(make_log(n=3))
    except InputError as error:
        words = str(error)
    else:
        words = "samples" if np.isfinite(motion.ddq).all() else "not finite"
    assert "samples" in words or "made" in words, f"the error names neither log nor samples: {words}"


def has_settings(smoother: Smoother) -> None:
    """Its settings, written down, build it again."""
    builds_itself_from_its_settings(SMOOTHERS, smoother)


SMOOTHER_CHECKS: tuple[Callable[[Smoother], None], ...] = (
    keeps_what_is_not_its_own,
    recovers_a_smooth_motion,
    ignores_the_zero_of_the_encoder,
    takes_time_from_anywhere,
    does_not_mix_joints,
    is_linear_as_used,
    masks_the_ends,
    is_frozen_and_repeatable,
    refuses_too_few_samples,
    has_settings,
)
