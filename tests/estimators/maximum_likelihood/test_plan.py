"""The input of maximum likelihood: knots, thinned logs, and friction with smooth signs."""

from dataclasses import replace

import numpy as np
import pytest

from dynident.estimators import Problem
from dynident.estimators.maximum_likelihood import has_sign, plan_segment, torque_steps, with_smooth_signs
from dynident.estimators.maximum_likelihood.plan import recordings
from dynident.estimators.notes import Averaged
from dynident.models import CoupledMotor, Joint, Model
from dynident.models.friction import Coulomb, Viscous
from dynident.motion.log import Log, Motion
from dynident.regression import Regression, Selection
from dynident.runtime import InputError


class TestPlan:
    def test_outliers_are_no_steps(self, rng: np.random.Generator) -> None:
        t = np.arange(4000) * 0.0025
        tau = np.stack([6 * np.sin(t), np.where(t >= 7.0, 3.0, -1.0)], axis=1) + 0.1 * rng.standard_normal((4000, 2))
        tau[rng.random(tau.shape) < 0.02] += 5.0
        log = Log(t, np.zeros_like(tau), tau, ("a", "b"))
        assert torque_steps(log, np.full(2, 0.1)) == pytest.approx((7.0,), abs=0.01)

    @pytest.mark.parametrize("samples", [80, 250, 400])
    def test_a_fast_torque_has_no_steps(self, samples: int, rng: np.random.Generator) -> None:
        """Of few samples a period, and much larger than the noise, a torque bends more than noise would explain."""
        t = np.linspace(0, 10, samples)
        rate, phase = 2 * np.pi * rng.uniform(0.1, 1.0, (40, 5, 2)), rng.uniform(0, 2 * np.pi, (40, 5, 2))
        for tau in np.sin(rate[:, None] * t[:, None, None] + phase[:, None]).sum(axis=2):
            log = Log(t, np.zeros_like(tau), tau + 1e-3 * rng.standard_normal(tau.shape), ("a", "b"))
            assert torque_steps(log, np.full(2, 1e-3)) == ()

    @pytest.mark.parametrize(("distance", "count"), [(8, 2), (20, 2), (25, 11)])
    def test_finds_steps_near_each_other(self, distance: int, count: int, rng: np.random.Generator) -> None:
        t, steps = np.arange(400.0), 60.0 + distance * np.arange(count)
        tau = 4.0 * (np.searchsorted(steps, t, side="right") % 2)[:, None] + 0.1 * rng.standard_normal((400, 1))
        assert torque_steps(Log(t, 0 * tau, tau, ("a",)), np.array([0.1])) == tuple(steps)

    @pytest.mark.parametrize(("rate", "spacing"), [(0.0, [15]), (3.5, [7]), (8.0, [3]), (16.0, [])])
    def test_torque_knots_are_as_far_apart_as_lines_follow_the_torque(self, rate: float, spacing: list[int]) -> None:
        t, rng = 0.01 * np.arange(400), np.random.default_rng(0)
        curve = np.column_stack([np.sin(rate * t), np.cos(0.8 * rate * t)]) if rate else np.outer(t, [1.0, 2.0])
        log = Log(t, np.zeros((400, 2)), curve + 0.01 * rng.standard_normal((400, 2)), ("a", "b"))
        knots = plan_segment(log, (), 20.0, np.array([0.01, 0.01]), from_rest=True).torque_knots
        assert [np.diff(x)[[0, -1]] for x in knots] == [pytest.approx(0.01 * x) for x in spacing]


MODEL = Model((Viscous((Joint("a"), Joint("b"))),))


def posed(*sizes: int, min_speed: tuple[float, float] | None = None) -> Problem:
    """Random motions at 100 Hz with the logs they were smoothed from."""
    motions = []
    for seed, n in enumerate(sizes):
        q, dq, ddq, tau = np.random.default_rng(seed).normal(size=(4, n, 2)) * np.array([1.0, 30.0])
        motions.append(Motion(np.arange(n) * 0.01, q, dq, ddq, tau, ("a", "b"), np.ones(n, dtype=bool)))
    logs = tuple(Log(motion.t, motion.q, motion.tau, motion.joints) for motion in motions)
    return Problem(
        MODEL, tuple(motions), Regression(MODEL, tuple(motions), selection=Selection(min_speed=min_speed)), logs
    )


@pytest.mark.parametrize(("rate", "group"), [(100.0, 1), (99.0, 2), (34.0, 3), (33.0, 1)])
def test_neighbours_are_averaged_down_to_the_rate_where_twenty_samples_are_left(rate: float, group: int) -> None:
    given = posed(62, 80, min_speed=(0.5, 0.0))
    result, notes = recordings(given, rate, steps=False)
    assert notes == ([] if group == 1 else [Averaged(group)])
    for log, was, motion, used in zip(result.logs, given.logs, given.motions, result.used_torques, strict=True):
        count = len(was) // group
        for name in ("t", "q", "tau"):
            full = getattr(was, name)[: count * group]
            expected = [full[k * group : (k + 1) * group].mean(axis=0) for k in range(count)]
            np.testing.assert_allclose(getattr(log, name), expected, rtol=1e-12)
        fast = (np.abs(motion.dq) >= (0.5, 0.0))[: count * group]
        np.testing.assert_array_equal(used, [fast[k * group : (k + 1) * group].all(axis=0) for k in range(count)])


@pytest.mark.parametrize(("usable", "lengths"), [(20, [20, 28]), (19, [28])])
def test_without_logs_runs_of_twenty_usable_samples_are_recordings(usable: int, lengths: list[int]) -> None:
    (motion,) = posed(60).motions
    mask = np.abs(np.arange(60) - 30) > 1
    mask[usable:30] = False
    given = replace(posed(60), motions=(replace(motion, mask=mask),), logs=())
    logs = recordings(given, None, steps=False)[0].logs
    assert [len(log) for log in logs] == lengths
    np.testing.assert_array_equal(logs[-1].tau, motion.tau[32:])
    none = replace(given, motions=(replace(motion, mask=np.arange(60) < 19),))
    with pytest.raises(InputError, match="a run of at least 20 usable samples"):
        recordings(none, None, steps=False)


class TestFriction:
    def test_soft_signs_keep_the_parameters(self) -> None:
        joints = (Joint("a"), Joint("b"))
        terms = (Viscous(joints), Coulomb(joints, names=("x", "y")), CoupledMotor(joints, {"a": 1.0, "b": -2.0}, "m"))
        sharp = Model(terms)
        soft = with_smooth_signs(sharp, np.array([0.01, 0.02]))
        assert has_sign(sharp)
        assert not has_sign(soft)
        assert soft.names == sharp.names
        fast, slow = np.array([[1.0, -1.0]]), np.array([[0.01, -0.02]])
        zero = np.zeros((1, 2))
        np.testing.assert_allclose(soft.regressor(zero, fast, zero), sharp.regressor(zero, fast, zero))
        part = soft.regressor(zero, slow, zero)[0, :, [2, 3]]
        np.testing.assert_allclose(np.diag(part), np.tanh(1.0) * np.array([1.0, -1.0]))
