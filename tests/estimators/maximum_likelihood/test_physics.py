"""What physics requires of the parameters of a likelihood, and which of them stay where they are."""

import numpy as np
import pytest

from dynident.apps.article import SCENARIOS
from dynident.estimators import Barrier, LeastSquares, Problem
from dynident.estimators.maximum_likelihood import MaximumLikelihood, psd_constraints
from dynident.estimators.notes import NotAlone, RankDeficient
from dynident.models import Joint, Model, RotorInertia
from dynident.models.friction import Coulomb, Offset, Viscous
from dynident.models.lagrangian import two_link_arm
from dynident.motion.log import Log
from dynident.motion.smoothers import Spline
from dynident.regression import Regression


class TestPhysics:
    def test_the_articles_arm(self) -> None:
        arm = two_link_arm()
        log = SCENARIOS["stated"].record(1e-8, np.random.default_rng(0)).log
        barrier = Barrier(psd_constraints(arm, [log], np.asarray(arm.values)))
        assert barrier.is_inside(np.asarray(arm.values))
        for k, value in ((0, -1e-2), (1, -1e-3), (5, -0.1), (6, -0.1)):
            theta = np.array(arm.values)
            theta[k] = value
            assert not barrier.is_inside(theta), arm.names[k]


@pytest.mark.parametrize("noise", [0.0, 1e-4])
@pytest.mark.parametrize("way", [0.0, 2.0], ids=["at rest", "one way"])
def test_what_the_motion_does_not_show_stays_at_the_start(way: float, noise: float) -> None:
    """Neither the barrier nor the noise moves friction at rest, or shifts it to an offset where dq keeps its sign."""
    rng, t, joints = np.random.default_rng(0), np.arange(0, 2, 0.004)[:, None], (Joint("a"), Joint("b"))
    rate, swing = 2 * np.pi * 0.7, np.array([1.0, 0.05 * way])
    q, dq, ddq = (a * swing * wave(rate * t) for a, wave in ((1, np.sin), (rate, np.cos), (-(rate**2), np.sin)))
    q[:, 1:], dq[:, 1] = q[:, 1:] + way * t, dq[:, 1] + way
    terms = ((RotorInertia, 0.5), (Viscous, 0.3), (Coulomb, 0.4), (Offset, 1.0))
    model = Model(tuple(kind(joints, values=(value, value)) for kind, value in terms))
    tau = model.torque(q, dq, ddq, np.array(model.values)) + 0.05 * rng.standard_normal(q.shape)
    log = Log(t[:, 0], q + noise * rng.standard_normal(q.shape), tau, ("a", "b"))
    motions = (Spline()(log),)
    given = Problem(model, motions, Regression(model, motions), (log,))
    found, start = MaximumLikelihood()(given), LeastSquares()(given)
    undetermined = ("Fc_b", "offset_b") if way else ("Ia_b", "Fv_b", "Fc_b")
    assert found.converged
    assert set(found.notes) == {RankDeficient(8 - (1 if way else 3), 8), NotAlone(undetermined)}
    sure = np.isfinite(found.std)
    assert [name for name, one in zip(model.names, sure, strict=True) if not one] == list(undetermined)
    assert (np.abs(found.value - model.values) < 4 * found.std)[sure].all()
    np.testing.assert_allclose(found.std[sure], start.std[sure], rtol=0.6)
    np.testing.assert_allclose(found.value[~sure], start.value[~sure], atol=0.01)
