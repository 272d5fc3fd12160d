"""The tilt of the base: one that was put in is found again, within its standard errors."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter

from dynident.estimators import LeastSquares, PhysicallyConsistent
from dynident.identification import (
    Alignment,
    Recipe,
    SteepBase,
    base_tilt,
    find_base_tilt,
    has_gravity,
    identify,
    tilt_base,
)
from dynident.identification.calibration import Preparation
from dynident.identification.dataset import RoleMotions
from dynident.models import Model, RigidBodies
from dynident.models.friction import Viscous
from dynident.models.lagrangian import two_link_arm
from dynident.motion.log import Log, Motion
from dynident.motion.smoothers import Spline
from dynident.regression import EVERYTHING
from dynident.runtime import ConfigError
from tests.identification.motions import sines
from tests.robots import three_joints

ARM = three_joints()


@cache
def tilted(x: float, y: float) -> tuple[Model, Motion]:
    """An arm of three joints, its motion, and the torque that it needs where its base is tilted."""
    bodies = RigidBodies(ARM)
    model = Model((bodies, Viscous(bodies.joints)))
    rng = np.random.default_rng(5)
    n, t = len(bodies.joints), np.arange(1500) * 0.004
    phase, rate = rng.uniform(0, 6, (3, n)), rng.uniform(2, 7, (3, n))
    q, dq, ddq = sines(t, 0.5, rate, phase)
    truth = np.array([0.3 if p.value is None else p.value for p in model.parameters])
    tau = tilt_base(model, x, y).torque(q, dq, ddq, truth)
    tau = tau + 0.002 * np.abs(tau).max() * rng.standard_normal(tau.shape)
    names = tuple(joint.name for joint in bodies.joints)
    return model, Motion(t, q, dq, ddq, tau, names, np.ones(len(t), bool))


@pytest.mark.parametrize("estimator", [LeastSquares(), PhysicallyConsistent()], ids=["least squares", "consistent"])
def test_a_tilt_is_found_within_its_standard_errors(estimator: LeastSquares | PhysicallyConsistent) -> None:
    model, motion = tilted(0.02, -0.035)
    tilt = find_base_tilt(model, [motion], estimator)
    assert tilt.x == pytest.approx(0.02, abs=4 * tilt.std[0])
    assert tilt.y == pytest.approx(-0.035, abs=4 * tilt.std[1])
    assert max(tilt.std) < 0.003
    assert tilt.after < 0.7 * tilt.before


def test_standard_errors_hold_where_torque_noise_is_correlated() -> None:
    """Compared with the exact ones of least squares, for AR(1) noise whose slow part the parameters take up."""
    model, motion = tilted(0.02, -0.035)
    motion = motion.shift(0.0, np.arange(0, len(motion), 3))
    true_model, rho, size = tilt_base(model, 0.02, -0.035), 0.9, 0.05
    theta = np.array([0.3 if p.value is None else p.value for p in model.parameters])
    Y = true_model.regressor(motion.q, motion.dq, motion.ddq)
    lines = np.concatenate([Y, np.moveaxis(base_tilt.tilt_slopes(true_model, motion, theta), 0, 2)], axis=2)
    inverse = np.linalg.pinv(lines.reshape(-1, lines.shape[2]), rcond=1e-9)[-2:].reshape(2, *motion.q.shape)
    lag = np.abs(np.subtract.outer(range(len(motion)), range(len(motion))))
    exact = size * np.sqrt(np.einsum("atj,ts,asj->a", inverse, rho**lag, inverse, optimize=True))
    torque, stated = true_model.torque(motion.q, motion.dq, motion.ddq, theta), []
    for rng in np.random.default_rng(3).spawn(3):
        fresh = rng.standard_normal((len(motion) + 200, 3)) * np.sqrt(1 - rho**2)
        noise = size * lfilter([1.0], [1.0, -rho], fresh, axis=0)[200:]
        stated.append(find_base_tilt(model, [replace(motion, tau=torque + noise)], LeastSquares()).std)
    np.testing.assert_allclose(np.mean(stated, axis=0), exact, rtol=0.2)


def test_a_tilt_within_its_standard_errors_is_none() -> None:
    """Two of them decide: here the noise is so large that the tilt put in is about one."""
    model, motion = tilted(0.0, -0.035)
    noisy = replace(
        motion, tau=motion.tau + np.abs(motion.tau).max() * np.random.default_rng(1).normal(size=motion.tau.shape)
    )
    tilt = find_base_tilt(model, [noisy], LeastSquares())
    assert (tilt.x, tilt.y) == (0.0, 0.0)
    assert tilt.after == tilt.before
    assert min(tilt.std) > 0.0175


def test_rows_that_are_not_affine_in_gravity_are_made_anew() -> None:
    class Bent(RigidBodies):
        def regressor(self, q: NDArray[np.float64], dq: NDArray[np.float64], ddq: NDArray[np.float64]) -> Any:
            return super().regressor(q, dq, ddq) * (1.0 + np.linalg.norm(self.gravity[:2]) ** 2)

    model, motion = tilted(0.02, -0.035)
    assert base_tilt._affine_entries(tilt_base(model, 0.1, 0.1), (motion,), EVERYTHING) is not None
    bent = replace(model, terms=(Bent(ARM), *model.terms[1:]))
    assert base_tilt._affine_entries(tilt_base(bent, 0.1, 0.1), (motion,), EVERYTHING) is None


def test_a_base_that_lies_on_its_side_is_taken_as_level_with_a_warning() -> None:
    for x, y in ((0.6, 0.0), (0.0, -0.3)):
        model, motion = tilted(x, y)
        tilt = find_base_tilt(model, [motion], LeastSquares())
        assert (tilt.x, tilt.y, tilt.after) == (0.0, 0.0, tilt.before)
        assert tilt.steep == pytest.approx((x, y), abs=0.02)
        assert tilt.gain.sure
    recipe = Recipe(Spline(), base_tilt="estimate")
    result = identify(model, [Log(motion.t, motion.q, motion.tau, motion.joints)], (), recipe)
    assert [type(note) for note in result.warnings if isinstance(note, SteepBase)] == [SteepBase]
    assert result.recipe.base_tilt == (0.0, 0.0)


def test_a_level_base_with_friction_that_the_model_lacks_stays_level() -> None:
    kept = 0
    for seed in range(5):
        model, motion = tilted(0.0, 0.0)
        rng, rms = np.random.default_rng(seed), motion.tau.std(axis=0)
        load = 0.15 * np.abs(motion.tau) * np.sign(motion.dq)
        ripple = 0.1 * rms * np.sin(rng.uniform(3, 15, 3) * motion.q + rng.uniform(0, 6, 3))
        slow = 0.2 * rms * np.exp(-np.abs(motion.dq) / 0.3) * np.sign(motion.dq)
        tilt = find_base_tilt(model, [replace(motion, tau=motion.tau + load + ripple + slow)], LeastSquares())
        kept += bool(tilt.x or tilt.y or tilt.steep)
    assert kept <= 1


def test_only_a_model_with_gravity_has_a_tilt_by_which_gravity_turns_the_other_way() -> None:
    model, _ = tilted(0.0, 0.0)
    assert has_gravity(model)
    assert not has_gravity(model.with_gravity(lambda _: np.zeros(3)))
    assert not has_gravity(two_link_arm())
    turned = tilt_base(model, 0.1, 0.0)
    np.testing.assert_allclose(turned.terms[0].gravity, 9.81 * np.array([0, -np.sin(0.1), -np.cos(0.1)]), atol=1e-12)
    with pytest.raises(ConfigError, match="no term has a gravity"):
        tilt_base(two_link_arm(), 0.1, 0.0)


@pytest.mark.parametrize("mounting", [(0.0, -0.5), (1.0, 0.0)], ids=["y", "over"])
def test_a_base_that_is_mounted_on_a_wall_or_a_ceiling_is_turned(mounting: tuple[float, float]) -> None:
    x, y = np.pi * mounting[0] + 0.03, np.pi * mounting[1]
    model, motion = tilted(float(x), float(y))
    tilt = find_base_tilt(model, [motion], PhysicallyConsistent())
    true, turned = (tilt_base(model, *angles).terms[0].gravity for angles in ((x, y), (tilt.x, tilt.y)))
    assert turned == pytest.approx(true, abs=0.1)
    assert tilt.after < 0.5 * tilt.before
    assert "mounted" in str(tilt)


def test_a_gravity_that_was_set_is_kept() -> None:
    model, motion = tilted(np.pi / 2, 0.0)
    side = model.with_gravity(lambda _: (0.0, 9.81, 0.0))
    tilt = find_base_tilt(side, [motion], PhysicallyConsistent())
    assert max(abs(tilt.x), abs(tilt.y)) < 0.2


def test_joints_that_the_model_explains_well_show_the_tilt() -> None:
    model, motion = tilted(0.05, -0.04)
    wave = 1.5 * np.sin(25.0 * motion.t)[:, None] * [0.0, 0.0, 1.0]  # N m: that the model lacks at the last joint
    tilt = find_base_tilt(model, [replace(motion, tau=motion.tau + wave)], LeastSquares(weights="per_joint"))
    assert (tilt.x, tilt.y) == pytest.approx((0.05, -0.04), abs=3e-3)
    assert max(tilt.std) < 4e-3


def test_a_tilt_alone_makes_a_preparation_better() -> None:
    """Smoothing and time offset stay as they were, as where the tilt was found beside the terms chosen."""
    model, motion = tilted(0.02, -0.035)
    motions, alignment = RoleMotions({"train": {"motion": motion}}), Alignment(Spline())
    level, right = (
        Preparation(tilt_base(model, *angles), LeastSquares(), motions, alignment, angles=angles)
        for angles in ((0.0, 0.0), (0.02, -0.035))
    )
    assert right.is_better(level, model, model)
    assert not level.is_better(right, model, model)
