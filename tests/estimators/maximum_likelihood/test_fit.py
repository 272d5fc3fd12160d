"""Maximum likelihood of eq. (7): against the bound, outliers, colour, time offset, a moving start, bodies, failure."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from dynident.apps.article import SCENARIOS
from dynident.estimators import Estimate, LeastSquares, Problem
from dynident.estimators.maximum_likelihood import MaximumLikelihood, newton
from dynident.estimators.notes import (
    Averaged,
    Failed,
    MovingStart,
    NotAlone,
    NotConverged,
    NotWhite,
    RankDeficient,
    ScatterLarger,
)
from dynident.identification import cramer_rao_bound
from dynident.models import Joint, Model, RigidBodies, RotorInertia
from dynident.models.friction import Coulomb, Offset, Viscous
from dynident.models.lagrangian import two_link_arm
from dynident.motion.log import Log
from dynident.motion.smoothers import Spline, TimeShifted
from dynident.regression import Regression, informed_std, structural_base_parameters
from dynident.testing.estimator import MODELS, make_problem, multisine_motion, truth
from tests.robots import joint, link, urdf

ARM = two_link_arm()
TRUE = np.array(ARM.values)


def recording(name: str, level: float, seed: int) -> Log:
    return SCENARIOS[name].record(level, np.random.default_rng(seed)).log


def posed(log: Log, level: float) -> Problem:
    motions = (Spline(sigma=np.sqrt(level), ends=0.0)(log.window(0.25)),)
    return Problem(ARM, motions, Regression(ARM, motions), (log,))


def estimate(name: str, level: float, seed: int, **settings) -> Estimate:
    return MaximumLikelihood(**settings)(posed(recording(name, level, seed), level))


@pytest.mark.parametrize(("name", "level"), [("stated", 1e-8), ("stated", 1e-4), ("weak", 1e-8), ("weak", 1e-4)])
def test_reaches_the_bound(name: str, level: float) -> None:
    """The mean square error of each parameter in units of the bound, and of four runs of all parameters together,
    which is chi-square with 28 degrees of freedom and exceeds 1.8 times its mean in one of 150 draws."""
    runs = [estimate(name, level, seed, start="rest", profile=None) for seed in range(4)]
    scenario = SCENARIOS[name]
    bound = cramer_rao_bound(ARM, TRUE, scenario.truth, np.sqrt(level), scenario.sigma_tau, rest=True)
    error = np.array([run.value - TRUE for run in runs])
    assert {run.notes for run in runs} == {()}
    assert ((error**2).mean(axis=0) < 3.0 * np.diag(bound)).all()
    assert np.sum(error.T * np.linalg.solve(bound, error.T)) < 1.8 * error.size
    assert min(run.value[1] for run in runs) > 0
    np.testing.assert_allclose(runs[0].residual.sigma, scenario.sigma_tau, rtol=0.05)


def test_huber_bounds_outliers() -> None:
    log, rng = recording("stated", 1e-6, 1).window(stop=5.0), np.random.default_rng(2)
    hit = rng.random(log.tau.shape) < 0.02
    spoilt = replace(log, tau=log.tau + np.where(hit, 5.0, 0.0))
    squares, huber, with_steps = (
        MaximumLikelihood(start="rest", steps=steps, huber=huber, rounds=3)(posed(spoilt, 1e-6)).value / TRUE - 1
        for steps, huber in ((False, None), (False, 1.345), (True, 1.345))
    )
    assert np.abs(huber[3]) < 0.5 * np.abs(squares[3])
    assert np.abs(with_steps[3]) < 0.1  # outliers are not taken for steps
    assert np.abs(with_steps[1]) < 0.5


def test_coloured_torque_noise_is_reported() -> None:
    """A tenth of its power at the neighbour's correlation of 0.95: residuals and standard errors both say so."""
    log, rng = recording("stated", 1e-6, 1), np.random.default_rng(3)
    drift = np.zeros_like(log.tau)
    for k in range(1, len(drift)):
        drift[k] = 0.95 * drift[k - 1] + 0.05 * rng.standard_normal(2)
    result = MaximumLikelihood(start="rest")(posed(replace(log, tau=log.tau + drift), 1e-6))
    assert [type(note) for note in result.notes] == [NotWhite, ScatterLarger]
    assert result.converged


def test_a_fast_recording_is_thinned() -> None:
    log = recording("stated", 1e-6, 1)
    result = MaximumLikelihood(start="free", rate=150.0)(posed(log, 1e-6))
    assert Averaged(3) in result.notes
    assert result.residual.samples == len(log) // 3
    np.testing.assert_allclose(result.value[3:], TRUE[3:], rtol=0.1)


def test_late_positions() -> None:
    """Positions that are stamped two samples late, with the time offset known and without."""
    log = recording("stated", 1e-6, 1).window(0.25)
    test_log = Log(log.t[2:], log.q[:-2], log.tau[2:], log.joints)
    time_offset = float(log.t[2] - log.t[0])
    motions = (TimeShifted(Spline(), time_offset)(test_log),)
    given = Problem(ARM, motions, Regression(ARM, motions), (test_log,), time_offset)
    reference, unknown = MaximumLikelihood()(given), MaximumLikelihood()(replace(given, time_offset=0.0))
    assert (np.abs(reference.value - TRUE) < 4 * reference.std).all()
    assert np.abs(unknown.value - TRUE).max() > np.abs(reference.value - TRUE).max()
    assert not (np.abs(unknown.value - TRUE) < 4 * unknown.std).all()


class TestBodies:
    """An arm of two links from a robot file, with dry friction."""

    def arm(self, width: float) -> Model:
        bodies = RigidBodies(
            urdf(
                link("base"),
                link("upper", 2.0, (0.0, 0.02, 0.2)),
                link("fore", 1.0, (0.01, 0.0, 0.15)),
                joint("shoulder", "revolute", "base", "upper", axis=(0, 1, 0)),
                joint("elbow", "revolute", "upper", "fore", (0, 0, 0.4), axis=(0, 1, 0)),
            )
        )
        dry = Coulomb(bodies.joints, values=(0.4, 0.2), width=width)
        return Model((bodies, Viscous(bodies.joints, values=(0.3, 0.2)), dry))

    def problem(self, width: float = 0.0, factor: float = 1.0, *, still: bool = False, noise=1e-4) -> Problem:
        rng, t = np.random.default_rng(0), np.arange(0, 6, 0.004)
        rate, angle = 2 * np.pi * np.array([0.5, 0.8]), 2 * np.pi * t[:, None] * np.array([0.5, 0.8])
        q, dq, ddq = (
            np.sin(angle) + t[:, None] ** 2 / 40,
            rate * np.cos(angle) + t[:, None] / 20,
            0.05 - rate**2 * np.sin(angle),
        )
        if still:
            for x, value in ((q, 0.5), (dq, 0.0), (ddq, 0.0)):
                x[:, 1] = value
        model = self.arm(width)
        tau = self.arm(0.02).torque(q, dq, ddq, np.asarray(model.values))
        log = Log(
            t, q + noise * rng.standard_normal(q.shape), tau + 0.1 * rng.standard_normal(q.shape), ("shoulder", "elbow")
        )
        motions = (Spline(factor=factor)(log),)
        return Problem(model, motions, Regression(model, motions), (log,))

    @pytest.mark.parametrize("width", [0.0, 0.02])
    def test_base_parameters_are_found(self, width: float) -> None:
        """Those that the motion shows, within four standard errors; the rest is the nominal bodies', and says so."""
        given = self.problem(width)
        result = MaximumLikelihood()(given)
        truth = np.asarray(given.model.values)
        basis = structural_base_parameters(given.model)
        error = basis.combination @ (result.value - truth)
        assert (np.abs(error) < 4 * informed_std(basis, result.information)).all()
        assert not any(
            isinstance(note, ScatterLarger) for note in result.notes
        )  # the residuals are white, whatever the rank
        assert result.determined.rank == basis.rank
        assert not result.residual.correlated
        assert set(result.provenance) == {"data", "prior"}
        assert np.isinf(result.std[np.array(result.provenance) == "prior"]).all()
        assert RankDeficient(basis.rank, len(truth)) in result.notes
        assert min(result.consistency.eigenvalues.values()) > 0
        assert result.value[given.model.names.index("upper.mass")] == pytest.approx(2.0, rel=0.5)


def axes(
    viscous: float, offset: float, amplitudes: Sequence[float] = (1.0,), seed: int = 0, *, short: bool = False
) -> Problem:
    """Axes of 0.5 kg m² that swing with given amplitudes; one of zero stands still, exactly at zero.

    A ``short`` recording is of 50 samples, a third of a period.
    """
    rng, a = np.random.default_rng(seed), np.array(amplitudes)
    joints, t = (
        tuple(Joint(f"axis{k}") for k in range(len(a))),
        np.arange(50)[:, None] / 100 if short else np.arange(0, 2, 0.004)[:, None],
    )
    terms = [(RotorInertia, 0.5), (Viscous, viscous), (Offset, offset)]
    model, rate = Model(tuple(kind(joints, values=(value,) * len(a)) for kind, value in terms)), 2 * np.pi * 0.7
    q, dq, ddq = a * np.sin(rate * t), a * rate * np.cos(rate * t), -a * rate**2 * np.sin(rate * t)
    tau = model.torque(q, dq, ddq, np.array(model.values)) + (0.05 if short else 0.5) * rng.standard_normal(q.shape)
    log = Log(t[:, 0], q + 1e-4 * (a > 0) * rng.standard_normal(q.shape), tau, tuple(x.name for x in joints))
    motions = (Spline()(log),)
    return Problem(model, motions, Regression(model, motions), (log,))


def test_few_samples_do_not_make_wide_knots_look_right() -> None:
    runs = [MaximumLikelihood()(axes(0.3, 1.0, seed=seed, short=True)) for seed in range(10)]
    error = np.array([(run.value - (0.5, 0.3, 1.0)) / run.std for run in runs])
    assert np.mean(np.abs(error) < 2) > 0.75
    assert {run.notes for run in runs} == {()}


@pytest.mark.parametrize(
    ("make", "noise", "spacing"),
    [(MODELS["slider"], 0.0, None), (two_link_arm, 0.0, None), (two_link_arm, 1e-4, 1.25)],
    ids=["slider", "arm", "a trajectory that follows the noise"],
)
def test_the_noise_of_the_torque_is_found(make: Callable[[], Model], noise: float, spacing: float | None) -> None:
    """At 100 Hz, from exact positions and from noisy ones: the noise of 8 runs of 1000 samples, known to 0.8 to 1.6 %,
    is found to 5 %; the errors over the standard errors are chi-square, larger in at most one of 1000 draws."""
    model, level = make(), 0.01
    sigma, error = [], []
    for seed in range(8):
        motion = multisine_motion(model, noise=level, seed=seed, samples=1000)
        q = motion.q + noise * np.random.default_rng(seed).standard_normal(motion.q.shape)
        log = Log(motion.t, q, motion.tau, motion.joints)
        result = MaximumLikelihood(spacing=spacing)(replace(make_problem(model, motion), logs=(log,)))
        sigma += [result.residual.sigma, 1 / result.residual.weights]
        error.append((result.value - truth(model)) / result.std)
    np.testing.assert_allclose(np.sqrt(np.mean(np.square(sigma), axis=0)), level, rtol=0.05)
    assert chi2.sf(np.square(error).sum(), np.size(error)) > 1e-3


@pytest.mark.parametrize(("viscous", "offset", "unsure"), [(0.3, 0.0, 2), (0.003, 1.0, 1)])
def test_intervals_cover_an_offset_and_a_friction_at_the_edge_of_physics(
    viscous: float, offset: float, unsure: int
) -> None:
    hit = []
    for seed in range(20):
        problem = axes(viscous, offset, seed=seed)
        (low, high), true = MaximumLikelihood()(problem).interval[unsure], problem.model.values[unsure]
        hit.append(low <= true <= high)
    assert np.mean(hit) > 0.75


def test_a_moving_start_is_noticed() -> None:
    log = recording("stated", 1e-8, 0)
    given = posed(log.window(3.0), 1e-8)
    moving, free = (MaximumLikelihood(start=start)(given) for start in ("test", "free"))
    (p_value,) = [note.p_value for note in moving.notes if isinstance(note, MovingStart)]
    assert p_value < 0.01
    np.testing.assert_allclose(moving.value, free.value)
    np.testing.assert_allclose(moving.std, free.std)
    assert MaximumLikelihood(start="test")(posed(log, 1e-8)).notes == ()


def test_intervals_are_by_profile_likelihood_where_information_is_weak() -> None:
    result = estimate("weak", 1e-4, 0, start="rest", profile=0.15)
    below, above = result.value - result.interval[:, 0], result.interval[:, 1] - result.value
    assert abs(above[1] - below[1]) > 0.01 * above[1]
    assert result.interval[1, 0] > 0
    np.testing.assert_allclose(above[3:], 1.96 * result.std[3:], rtol=0.25)  # they bend with the others
    np.testing.assert_allclose(above[5:], 1.96 * result.std[5:], rtol=0.1)


def test_a_search_that_is_cut_short_is_not_converged() -> None:
    result = estimate("weak", 1e-4, 0, iterations=1, rounds=1)
    (note,) = [note for note in result.notes if isinstance(note, NotConverged)]
    assert not result.converged
    assert (note.iterations, note.gain > 0) == (1, True)
    assert result.interval is None


def test_failure_returns_the_start_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_) -> None:
        raise np.linalg.LinAlgError("no luck")

    monkeypatch.setattr(newton, "_newton_step", fails)
    result = estimate("stated", 1e-6, 0)
    assert result.notes == (Failed("no luck"),)
    assert not result.converged
    np.testing.assert_allclose(result.value, TRUE, rtol=0.3)
    given = TestBodies().problem(0.02)
    assert not MaximumLikelihood()(given).consistency.costs  # of which nothing is shown


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
    result, start = MaximumLikelihood()(given), LeastSquares()(given)
    undetermined = ("Fc_b", "offset_b") if way else ("Ia_b", "Fv_b", "Fc_b")
    assert result.converged
    assert set(result.notes) == {RankDeficient(8 - (1 if way else 3), 8), NotAlone(undetermined)}
    sure = np.isfinite(result.std)
    assert [name for name, x in zip(model.names, sure, strict=True) if not x] == list(undetermined)
    assert (np.abs(result.value - model.values) < 4 * result.std)[sure].all()
    np.testing.assert_allclose(result.std[sure], start.std[sure], rtol=0.6)
    np.testing.assert_allclose(result.value[~sure], start.value[~sure], atol=0.01)
