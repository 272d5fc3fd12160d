"""The recordings: what is shipped is what the simulation gives, and it is what sensors can tell."""

from __future__ import annotations

import numpy as np
import polars as pl
import pytest

from dynident.apps.demo import demo_files, demo_truth
from dynident.apps.demo.arm import JOINTS
from dynident.apps.demo.files import DAYS, ENCODER_STEP, SEED, TORQUE_STEP, fourier_motion, simulate_log

SOME = 0.4  # s of a recording that a test makes anew


@pytest.fixture(scope="module")
def shipped(tmp_path_factory: pytest.TempPathFactory) -> dict[str, pl.DataFrame]:
    folder = demo_files(tmp_path_factory.mktemp("arm"))
    return {day.name: pl.read_parquet(folder / f"{day.name}.parquet") for day in DAYS}


@pytest.mark.parametrize("k", range(len(DAYS)), ids=[day.name for day in DAYS])
def test_the_shipped_recordings_are_those_of_the_seed(shipped: dict[str, pl.DataFrame], k: int) -> None:
    made = simulate_log(np.random.default_rng([SEED, k]), DAYS[k], SOME)
    there = shipped[DAYS[k].name]
    assert made.schema == there.schema
    assert len(there) == round(DAYS[k].duration / 0.004)
    for name in made.columns:
        step = ENCODER_STEP if "position" in name else TORQUE_STEP if "torque" in name else 1e-6
        np.testing.assert_allclose(made[name], there[name][: len(made)], rtol=0, atol=2.01 * step, err_msg=name)


@pytest.mark.parametrize("day", DAYS, ids=lambda day: day.name)
def test_the_arm_keeps_to_its_limits_and_to_its_reference(shipped: dict[str, pl.DataFrame], day) -> None:
    log = shipped[day.name]
    for joint in JOINTS:
        q, tau, reference = (
            log[f"{joint.name}.{what}"].to_numpy() for what in ("position_rad", "torque_Nm", "reference_rad")
        )
        assert np.abs(q).max() < joint.reach
        assert np.abs(np.diff(q) / 0.004).max() < joint.velocity
        assert np.abs(tau).max() < joint.effort
        assert 1e-3 < np.abs(q - reference).max() < 0.15


@pytest.mark.parametrize("day", DAYS, ids=lambda day: day.name)
def test_the_torque_is_the_true_models_but_late_and_noisy(shipped: dict[str, pl.DataFrame], day) -> None:
    """With the true values, offset and tilt, the residual has the size of the noise; with another offset it is more."""
    from dynident.motion.log import Log
    from dynident.motion.smoothers import Spline, smooth_log

    truth, log = demo_truth(), shipped[day.name].head(1500)
    names = tuple(joint.name for joint in JOINTS)
    q, tau = (log.select(f"{name}.{what}" for name in names).to_numpy() for what in ("position_rad", "torque_Nm"))
    motion = smooth_log(Spline(sigma=2e-6), Log(log["time_s"].to_numpy(), q, tau, names, day.name))

    def residual(offset: float) -> np.ndarray:
        at = motion.shift(offset)
        model = truth.model.torque(at.q, at.dq, at.ddq, truth.value)
        keep = at.mask & (np.abs(at.dq) > 0.05).all(axis=1)
        return np.sqrt(np.mean((at.tau - model)[keep] ** 2, axis=0))

    effort = np.array([joint.effort for joint in JOINTS])
    assert (residual(truth.time_offset) < 0.005 * effort).all()
    least = np.linalg.norm(residual(truth.time_offset))
    for wrong in (0.0, 2 * truth.time_offset):
        assert np.linalg.norm(residual(wrong)) > 1.02 * least


def test_the_fourier_series_has_its_derivatives() -> None:
    t, h = np.linspace(0.0, 3.0, 50), 1e-5
    q, dq, ddq = fourier_motion(np.random.default_rng(1), DAYS[0], t)
    (before, *_), (after, *_) = (fourier_motion(np.random.default_rng(1), DAYS[0], t + x) for x in (-h, h))
    np.testing.assert_allclose((after - before) / (2 * h), dq, atol=1e-6)
    np.testing.assert_allclose((after - 2 * q + before) / h**2, ddq, atol=1e-3)
