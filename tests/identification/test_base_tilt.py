"""The tilt of the base: one that was put in is found again, within its standard errors."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter

from dynident.estimators import Estimate, LeastSquares, PhysicallyConsistent, Problem
from dynident.identification import (
    BaseTilt,
    Recipe,
    SteepBase,
    base_tilt,
    find_base_tilt,
    has_gravity,
    identify,
    tilt_base,
)
from dynident.identification.calibration_std import calibration_std
from dynident.identification.uncertainty import covariance_of_calibration
from dynident.models import Model, RigidBodies
from dynident.models.friction import Viscous
from dynident.models.lagrangian import two_link_arm
from dynident.motion.log import Log, Motion
from dynident.motion.smoothers import Spline
from dynident.regression import EVERYTHING, Regression, structural_base_parameters
from dynident.runtime import ConfigError
from tests.identification.motions import sines
from tests.robots import joint, link, urdf

ARM = urdf(
    link("base"),
    link("shoulder", 3.0, (0.1, 0.02, 0.05)),
    link("upper", 2.0, (0.15, 0.0, 0.02)),
    link("fore", 1.0, (0.1, 0.01, 0.0)),
    joint("j1", "revolute", "base", "shoulder", axis=(0, 0, 1)),
    joint("j2", "revolute", "shoulder", "upper", xyz=(0.2, 0, 0.3), axis=(0, 1, 0)),
    joint("j3", "revolute", "upper", "fore", xyz=(0.4, 0, 0), axis=(1, 0, 0)),
)


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


def test_standard_errors_and_errors_of_a_tilt_are_those_of_the_linearised_problem() -> None:
    model, motion = tilted(0.02, -0.035)
    tilt = find_base_tilt(model, [motion], LeastSquares())

    def regressor(x: float, y: float) -> np.ndarray:
        Y = tilt_base(model, x, y).regressor(motion.q, motion.dq, motion.ddq)
        return Y.reshape(-1, Y.shape[-1])

    tau, best = motion.tau.ravel(), regressor(tilt.x, tilt.y)
    value = np.linalg.lstsq(best, tau, rcond=1e-9)[0]
    slopes = [(regressor(tilt.x + a, tilt.y + b) - best) @ value / 1e-4 for a, b in ((1e-4, 0.0), (0.0, 1e-4))]
    J = np.column_stack(slopes)
    J -= best @ np.linalg.lstsq(best, J, rcond=1e-9)[0]
    rest = tau - best @ value
    assert (np.abs(np.linalg.lstsq(J, rest)[0]) < 0.05 * np.array(tilt.std)).all()  # no step is left
    std = np.sqrt(np.diag(np.linalg.inv(J.T @ J)) * (rest @ rest) / len(rest))
    np.testing.assert_allclose(tilt.std, std, rtol=0.1)
    level = regressor(0.0, 0.0)
    before = tau - level @ np.linalg.lstsq(level, tau, rcond=1e-9)[0]
    size = np.linalg.norm(tau) / 100
    assert (tilt.before, tilt.after) == pytest.approx(
        (np.linalg.norm(before) / size, np.linalg.norm(rest) / size), rel=0.01
    )


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


def test_the_parameters_are_as_uncertain_as_fits_with_other_tilts_differ() -> None:
    model, motion = tilted(0.02, -0.035)
    std = (1e-5, 2e-5)
    basis = structural_base_parameters(model)

    def fit(x: float, y: float) -> tuple[Regression, Estimate]:
        regression = Regression(tilt_base(model, x, y), (motion,))
        return regression, LeastSquares()(Problem(regression.model, (motion,), regression))

    regression, estimate = fit(0.02, -0.035)
    tilt = BaseTilt(0.02, -0.035, std, 2.0, 1.0)
    result = covariance_of_calibration(regression.model, regression, estimate, None, tilt)
    others = [fit(0.02 + std[0], -0.035), fit(0.02, -0.035 + std[1])]
    changes = np.array([basis.to_base(other.value - estimate.value) for _, other in others])
    B = basis.combination
    np.testing.assert_allclose(np.sqrt(np.diag(B @ result @ B.T)), np.linalg.norm(changes, axis=0), rtol=0.06)  # noise
    level = covariance_of_calibration(regression.model, regression, estimate, None, replace(tilt, x=0.0, y=0.0))
    assert not level.any()


@pytest.mark.parametrize(("x", "y"), [(0.17, 0.0), (0.0, -0.17)])
def test_a_tilt_of_ten_degrees_is_one(x: float, y: float) -> None:
    model, motion = tilted(x, y)
    tilt = find_base_tilt(model, [motion], LeastSquares())
    assert (tilt.x, tilt.y) == pytest.approx((x, y), abs=5e-3)


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


def test_four_gravities_tell_what_each_trial_would(monkeypatch: pytest.MonkeyPatch) -> None:
    model, motion = tilted(0.02, -0.035)
    quick = find_base_tilt(model, [motion], LeastSquares())
    monkeypatch.setattr(base_tilt, "_affine_entries", lambda *_: None)
    slow = find_base_tilt(model, [motion], LeastSquares())
    for first, second in zip((quick.x, quick.y, *quick.std), (slow.x, slow.y, *slow.std), strict=True):
        assert first == pytest.approx(second, rel=1e-8)


def test_rows_that_are_not_affine_in_gravity_are_made_anew() -> None:
    class Bent(RigidBodies):
        def regressor(self, q: NDArray[np.float64], dq: NDArray[np.float64], ddq: NDArray[np.float64]) -> Any:
            return super().regressor(q, dq, ddq) * (1.0 + np.linalg.norm(self.gravity[:2]) ** 2)

    model, motion = tilted(0.02, -0.035)
    assert base_tilt._affine_entries(tilt_base(model, 0.1, 0.1), (motion,), EVERYTHING) is not None
    bent = replace(model, terms=(Bent(ARM), *model.terms[1:]))
    assert base_tilt._affine_entries(tilt_base(bent, 0.1, 0.1), (motion,), EVERYTHING) is None


def test_torques_that_are_all_zero_show_no_tilt() -> None:
    model, motion = tilted(0.02, 0.0)
    tilt = find_base_tilt(model, [replace(motion, tau=0 * motion.tau)], LeastSquares())
    assert (tilt.before, tilt.after) == (0.0, 0.0)


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


def test_what_imitates_a_tilt_in_few_stretches_is_none() -> None:
    """A tilt that lowers the training error by what noise does, and one that only a single stretch asks for."""
    model, motion = tilted(0.0, 0.0)
    _, leaning = tilted(0.0, 0.02)
    tau = motion.tau.copy()
    tau[1000:1060] = leaning.tau[1000:1060] + 0.5
    tilt = find_base_tilt(model, [replace(motion, tau=tau)], LeastSquares())
    assert (tilt.x, tilt.y, tilt.steep) == (0.0, 0.0, None)


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


def test_an_unknown_that_acts_only_by_rounding_has_no_standard_error() -> None:
    """A base turned about the vertical changes no torque; what is left of it is rounding."""
    model, motion = tilted(0.0, 0.0)
    rng, regression = np.random.default_rng(8), Regression(model, [motion])
    lines, residual = rng.standard_normal((3, 1500, 2)), rng.standard_normal((3, 1500))
    lines[..., 0] = 1e-14 * (lines[..., 0] - lines[..., 1])
    (alone,) = calibration_std([lines[..., 1:]], [residual], regression)
    assert calibration_std([lines], [residual], regression) == pytest.approx([np.inf, alone])
    assert calibration_std([lines[..., :1]], [residual], regression).tolist() == [np.inf]


def test_unknowns_that_act_alike_share_their_standard_error() -> None:
    model, motion = tilted(0.0, 0.0)
    rng, regression = np.random.default_rng(9), Regression(model, [motion])
    line, residual = rng.standard_normal((3, 1500, 1)), rng.standard_normal((3, 1500))
    alike = line * np.array([1.0, 1.0 + 1e-13])
    (alone,) = calibration_std([line], [residual], regression)
    assert calibration_std([alike], [residual], regression) == pytest.approx([alone / 2, alone / 2], rel=1e-6)


def test_joints_that_the_model_explains_well_show_the_tilt() -> None:
    model, motion = tilted(0.05, -0.04)
    wave = 1.5 * np.sin(25.0 * motion.t)[:, None] * [0.0, 0.0, 1.0]  # N m: that the model lacks at the last joint
    tilt = find_base_tilt(model, [replace(motion, tau=motion.tau + wave)], LeastSquares(weights="per_joint"))
    assert (tilt.x, tilt.y) == pytest.approx((0.05, -0.04), abs=3e-3)
    assert max(tilt.std) < 4e-3
