"""Instruments against dense algebra; instrumental variables where least squares is biased, and bad input.

Limits of seeded runs are 4 standard errors of what is averaged, which chance alone exceeds once in 16 000.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dynident.estimators import Estimate, InstrumentalVariables, LeastSquares
from dynident.estimators.instrument_moments import _add_partner_scores, moments_of, score_information
from dynident.estimators.instruments import (
    InstrumentKind,
    Instruments,
    InstrumentsUsed,
    NotSimulated,
    WeakInstruments,
    cutoff_frequency,
    lag_of,
    lagged_instruments,
)
from dynident.estimators.least_squares import LinearFit, weight_joints
from dynident.estimators.notes import StillMoving
from dynident.identification import Recipe, identify
from dynident.models import Joint, Model
from dynident.models.friction import Offset, Viscous
from dynident.models.lagrangian import slider, two_link_arm
from dynident.motion.filters import butterworth, zero_phase
from dynident.motion.log import Log, Motion
from dynident.motion.smoothers import Difference, Spline
from dynident.regression import ParallelFilter, Regression, Selection
from dynident.regression import linear_problem as module
from dynident.runtime import ConfigError, InputError, MissingInputError
from tests.estimators.looped import MODEL, TRUTH, driven, loop, posed, recorded

ARM = two_link_arm()
NAMES = ("joint1", "joint2")
WEIGHTS = np.array([2.0, 0.5])


def motion(seed: int, samples: int = 300, holes: bool = False) -> Motion:
    rng = np.random.default_rng(seed)
    q, dq, ddq, tau = rng.standard_normal((4, samples, 2))
    mask = np.ones(samples, dtype=bool)
    keep = None
    if holes:
        mask[100:104] = False
        keep = rng.random((samples, 2)) > 0.2
    return Motion(0.01 * np.arange(samples), q, dq, ddq, tau, NAMES, mask, f"run {seed}", keep=keep)


def disturbed(one: Motion, seed: int, size: float = 0.3) -> Motion:
    rng = np.random.default_rng(seed)
    q, dq, ddq = (x + size * rng.standard_normal(x.shape) for x in (one.q, one.dq, one.ddq))
    return replace(one, q=q, dq=dq, ddq=ddq)


def solved(rows: Regression, others: Regression, weights: np.ndarray = WEIGHTS):
    factor, rank = weight_joints(rows.triangular_factors, weights, rows.model.parameters)
    return moments_of(rows, others, LinearFit(factor, rank, rows.triangular_factors.total, weights)), rank


def dense(regression: Regression, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """All rows, weighted, by joint and sample."""
    blocks = list(regression.blocks())
    keep = [np.ones(b.tau.shape) if b.keep is None else b.keep for b in blocks]
    Y = np.concatenate([b.Y * (k * weights)[:, :, None] for b, k in zip(blocks, keep, strict=True)])
    tau = np.concatenate([b.tau * k * weights for b, k in zip(blocks, keep, strict=True)])
    return Y.reshape(-1, Y.shape[2]), tau.ravel()


@pytest.mark.parametrize("low", [None, ParallelFilter(3, 8.0)])
def test_is_the_just_identified_solution_of_dense_matrices(low, monkeypatch: pytest.MonkeyPatch) -> None:
    """(W' D^2 X)^-1 W' D^2 y of all rows at once; with gaps, rows that are left out, and a filter."""
    monkeypatch.setattr(module, "BLOCK", 64)
    some = motion(1, holes=low is None), motion(2, 200)
    rows = Regression(ARM, some, Selection(low))
    others = replace(rows, motions=tuple(disturbed(one, 9) for one in some))
    (X, y), (W, _) = (dense(one, WEIGHTS) for one in (rows, others))
    found, _ = solved(rows, others)
    np.testing.assert_allclose(found.value, np.linalg.solve(W.T @ X, W.T @ y), rtol=1e-9)
    residual = (y - X @ found.value).reshape(-1, 2) / WEIGHTS
    expected = np.square(residual).sum(axis=0) / found.rows
    np.testing.assert_allclose(found.residual(found.to_basis(found.value)), expected, rtol=1e-9)


def test_the_covariance_is_that_of_dense_matrices_where_residuals_are_white() -> None:
    """A^-1 (sum_j w_j^4 s_j^2 W_j' W_j) A^-T, but for what the estimate of a long-run covariance scatters."""
    one = motion(4, 20_000)
    truth = np.array(ARM.values)
    one = replace(one, tau=ARM.torque(one.q, one.dq, one.ddq, truth) + one.tau * (0.1, 3.0))
    rows = Regression(ARM, (one,))
    others = replace(rows, motions=(disturbed(one, 5),))
    found, rank = solved(rows, others)
    given = [Instruments(others.motions[0], InstrumentKind.LAGGED)]
    information, independent = score_information(found, rows, others, given, rank)
    (X, _), (W, _) = (dense(each, WEIGHTS) for each in (rows, others))
    bread = np.linalg.inv(W.T @ X)
    weighted_rows = W * np.tile(WEIGHTS * (0.1, 3.0), len(one))[:, None]
    expected = bread @ (weighted_rows.T @ weighted_rows) @ bread.T
    std = np.sqrt(np.diag(np.linalg.inv(information)))
    np.testing.assert_allclose(std, np.sqrt(np.diag(expected)), rtol=0.25)
    assert 2000 <= independent <= 20_000


def test_strength_is_the_smallest_correlation_and_its_direction() -> None:
    """An instrument of the offset is exact, that of the speed is nearly noise: F = N r^2 / (1 - r^2)."""
    joints = (Joint("joint1"), Joint("joint2"))
    model = Model((Viscous(joints), Offset(joints)))
    one = motion(8, 4000)
    other = replace(one, dq=one.dq * (0.1, 1.0) + np.random.default_rng(1).standard_normal(one.dq.shape) * (1.0, 0.01))
    rows = Regression(model, (one,))
    found, _ = solved(rows, replace(rows, motions=(other,)), np.ones(2))
    strength = found.strength(4000.0)
    r = float(np.sum(one.dq[:, 0] * other.dq[:, 0]) / np.linalg.norm(one.dq[:, 0]) / np.linalg.norm(other.dq[:, 0]))
    assert strength.correlation == pytest.approx(abs(r), rel=0.1)
    assert strength.statistic == pytest.approx(4000 * strength.correlation**2 / (1 - strength.correlation**2))
    assert np.argmax(np.abs(strength.direction)) == 0


MOTION, _ = driven(60)


def instruments(other: int, partner: np.ndarray) -> Instruments:
    return Instruments(MOTION, InstrumentKind.REPEATED, None, other, partner)


def test_paired_samples_are_added_once() -> None:
    """The second recording is 5 samples late, of both each third sample is left; the last ones have no partner."""
    n = 60
    there, back = np.arange(n) + 5, np.arange(n) - 5
    there[there >= n] = -1
    back[back < 0] = -1
    at, places = np.arange(0, n, 3), np.arange(2, n, 3)
    u, v = np.ones((len(at), 1)), np.full((len(places), 1), 10.0)
    _add_partner_scores((at, u), (places, v), instruments(1, there), instruments(0, back))
    assert set(np.unique(u)) <= {1.0, 11.0}
    assert float(u.sum() + v.sum()) == len(at) + 10.0 * len(places)
    assert (u[there[at] >= 0] == 11.0).all()
    assert (u[there[at] < 0] == 1.0).all()


def test_of_a_recording_that_repeats_itself_the_later_pass_is_added_to_the_earlier() -> None:
    partner = np.r_[np.arange(30) + 30, np.arange(30)]
    one = np.arange(60), np.arange(60.0)[:, None]
    _add_partner_scores(one, one, instruments(0, partner), instruments(0, partner))
    np.testing.assert_array_equal(one[1][:30, 0], 2 * np.arange(30) + 30)
    np.testing.assert_array_equal(one[1][30:], 0.0)


STEP = 0.01
T = STEP * np.arange(400)


def polynomial(seed: int = 0) -> Motion:
    p = np.polynomial.Polynomial(np.random.default_rng(seed).standard_normal(6))
    q, dq, ddq = (one(T - 2.0)[:, None] for one in (p, p.deriv(), p.deriv(2)))
    return Motion(T, q, dq, ddq, 0 * q, ("slider",), np.ones(len(T), dtype=bool))


def test_a_polynomial_of_degree_five_is_found_exactly() -> None:
    """At lags of whole samples; the samples within a lag of the ends and of a gap have no instruments."""
    motion = polynomial()
    mask = np.abs(np.arange(len(T)) - 200) > 3
    gapped = Motion(T, motion.q, motion.dq, motion.ddq, motion.tau, motion.joints, mask)
    found = lagged_instruments(slider(), gapped, None, None, 5 * STEP)
    used = found.motion.mask
    for name in ("q", "dq", "ddq"):
        np.testing.assert_allclose(getattr(found.motion, name)[used], getattr(motion, name)[used], rtol=1e-5, atol=1e-4)
    assert found.lag == 5 * STEP
    away = np.abs(np.arange(len(T)) - 200)
    inside = (np.arange(len(T)) >= 6) & (np.arange(len(T)) < len(T) - 6)
    assert used[inside & (away > 9)].all()
    assert not used[(away < 8) & (away > 2)].any()
    assert not used[:5].any()
    assert not used[-5:].any()


@pytest.mark.parametrize("low", [5.0, 12.0])
def test_the_cutoff_is_that_of_a_low_pass(low: float) -> None:
    """Order 1 forward and backward passes half of the amplitude at its cut-off, in the presence of a large motion."""
    rng = np.random.default_rng(1)
    t = STEP * np.arange(20_000)
    before = (np.sin(2 * t) + 1e-4 * rng.standard_normal(len(t)))[:, None]
    after = zero_phase(butterworth(1, low, 1 / STEP), before[:, 0], 100)[:, None]
    assert cutoff_frequency(before, after) * 0.5 / STEP == pytest.approx(low, rel=0.1)
    assert cutoff_frequency(before, before) == 1.0
    assert cutoff_frequency(before[:8], before[:8]) == 1.0


def test_the_lag_grows_with_smoothing_and_filter() -> None:
    rng = np.random.default_rng(2)
    motion = polynomial()
    assert lag_of(motion, None, None) == pytest.approx(3 * STEP)
    slow = lag_of(motion, None, ParallelFilter(cutoff=5.0))
    assert slow > 1.5 * lag_of(motion, None, ParallelFilter(cutoff=10.0)) > 4 * STEP
    disturbed = Log(T, motion.q + 1e-3 * rng.standard_normal(motion.q.shape), motion.tau, motion.joints)
    assert lag_of(motion, disturbed, None) > lag_of(motion, None, None)


NOISE = 5e-6  # m: with it the acceleration has an error of a fifth of itself
RUNS = 20
SHORT, CONTROLLER = driven()
LONG, LONGER = driven(8000)


def runs(kind: str, count: int = RUNS) -> list[Estimate]:
    """Estimates from as many recordings of the same motion, or pairs of them."""
    loops = CONTROLLER if kind == "simulated" else None
    pairs = 2 if kind == "repeated" else 1
    sets = [[recorded(SHORT, loops, seed + 1000 * k, NOISE) for k in range(pairs)] for seed in range(count)]
    return [InstrumentalVariables(kind)(posed(*some)) for some in sets]


@pytest.mark.parametrize("kind", ["simulated", "repeated", "lagged"])
def test_is_not_biased_where_least_squares_is(kind: str) -> None:
    """Noise of the positions takes a sixth of the mass by least squares, and nothing with instruments."""
    plain = LeastSquares()(posed(recorded(SHORT, None, 0, NOISE)))
    assert plain.value[0] - TRUTH[0] < -0.15 * TRUTH[0]
    assert (plain.value[0] - TRUTH[0]) / plain.std[0] < -10
    found = runs(kind)
    values = np.array([one.value for one in found])
    error = values.mean(axis=0) - TRUTH
    assert (np.abs(error) < 4 * values.std(axis=0, ddof=1) / np.sqrt(len(values))).all(), error
    inside = np.array([np.abs(one.value - TRUTH) < 1.96 * one.std for one in found]).mean(axis=0)
    assert (inside >= 0.95 - 4 * np.sqrt(0.95 * 0.05 / RUNS)).all(), inside
    assert all(one.information is not None for one in found)


@pytest.mark.parametrize("kind", ["simulated", "lagged"])
def test_is_consistent(kind: str) -> None:
    """Four times the samples: the error of least squares stays, the standard error of instruments halves and holds."""
    loops = (CONTROLLER, LONGER) if kind == "simulated" else (None, None)
    some = [posed(recorded(one, drive, 7, NOISE)) for one, drive in zip((SHORT, LONG), loops, strict=True)]
    short, long = (InstrumentalVariables(kind)(one) for one in some)
    plain = [LeastSquares()(one).value[0] - TRUTH[0] for one in some]
    assert plain[1] == pytest.approx(plain[0], rel=0.1)
    assert (long.std < 0.75 * short.std).all()
    assert (np.abs(long.value - TRUTH) < 4 * long.std).all()


def test_auto_takes_the_first_kind_that_a_recording_has() -> None:
    first, again = (recorded(SHORT, None, seed, NOISE) for seed in range(2))
    looped = recorded(SHORT, CONTROLLER, 0, NOISE)
    kinds = [
        next(note.kinds for note in InstrumentalVariables()(problem).notes if isinstance(note, InstrumentsUsed))
        for problem in (posed(looped), posed(first, again), posed(first), posed(first, first), posed(looped, again))
    ]
    simulated, repeated, lagged = InstrumentKind
    assert kinds == [(simulated,), (repeated,), (lagged,), (lagged,), (simulated, repeated)]


def test_says_what_was_used_and_what_became_of_least_squares() -> None:
    problem = posed(recorded(SHORT, CONTROLLER, 3, NOISE))
    found = InstrumentalVariables()(problem)
    (used,) = found.notes
    assert isinstance(used, InstrumentsUsed)
    assert (used.parameter, used.lag) == ("M", None)
    assert 0.8 < used.correlation < 1.0
    plain = LeastSquares()(problem)
    assert used.moved == pytest.approx(abs(found.value[0] - plain.value[0]) / found.std[0], rel=1e-6)


def test_weak_instruments_are_said() -> None:
    """Long after a sample, nothing of a motion is left that its own noise exceeds tenfold."""
    found = InstrumentalVariables("lagged", lag=1.5)(posed(recorded(SHORT, None, 1, 1e-4)))
    assert any(isinstance(note, WeakInstruments) and note.parameter == "M" for note in found.notes)


def test_what_is_missing_is_named_with_the_way_to_give_it() -> None:
    problem = posed(recorded(SHORT, None, 5))
    with pytest.raises(MissingInputError, match=r"log 5: .*section `simulation`.*Log.controller"):
        InstrumentalVariables("simulated")(problem)
    with pytest.raises(MissingInputError, match=r"log 5: .*Record it twice"):
        InstrumentalVariables("repeated")(problem)
    with pytest.raises(ConfigError, match=r"lag = 1e-09 s .* shorter than the time between samples, 0.005 s"):
        InstrumentalVariables("lagged", lag=1e-9)(problem)
    with pytest.raises(InputError, match=r"log 5: 0 samples have instruments, .* give a shorter `lag`"):
        InstrumentalVariables("lagged", lag=9.0)(problem)


def test_a_loop_that_runs_away_is_an_error_or_the_next_kind() -> None:
    log, motion = recorded(SHORT, loop(len(SHORT), kp=-4e4, kd=-100.0), 6)
    with pytest.raises(InputError, match=r"log 6: .*position diverges after .* Check gains"):
        InstrumentalVariables("simulated")(posed((log, motion)))
    found = InstrumentalVariables()(posed((log, motion)))
    assert [type(note) for note in found.notes][:2] == [InstrumentsUsed, NotSimulated]
    assert found.notes[0].kinds == (InstrumentKind.LAGGED,)


def test_a_first_model_that_fails_is_made_consistent() -> None:
    """By torques with 60 N s/m too little, friction drives the mass; that of a slider is none at worst."""
    model = slider(values=(5.0, 8.0, 3.0, 0.5))
    log, motion = recorded(SHORT, loop(len(SHORT), kd=30.0), 8)
    bad = (log, replace(motion, tau=motion.tau - 60.0 * motion.dq))
    assert LeastSquares()(posed(bad, model=model)).value[1] < -30
    found = InstrumentalVariables("simulated", iterations=1)(posed(bad, model=model))
    assert InstrumentKind.SIMULATED in found.notes[0].kinds
    assert not any(isinstance(note, NotSimulated) for note in found.notes)


def test_an_iteration_that_is_cut_short_is_said() -> None:
    found = InstrumentalVariables("simulated", iterations=1)(posed(recorded(SHORT, CONTROLLER, 2, 2e-5)))
    assert [type(note) for note in found.notes] == [InstrumentsUsed, StillMoving]
    assert not found.converged


def test_identify_leaves_its_errors_of_the_motion_alone() -> None:
    """A time offset is undone in the loop of the controller; held for the torque, the motion comes out the same."""
    log, _ = recorded(SHORT, CONTROLLER, 9, 1e-6)
    recipe = Recipe(smoother=Spline(), estimator=InstrumentalVariables(), time_offset=0.0)
    found = identify(MODEL, [log], recipe=recipe)
    assert [type(note) for note in found.warnings if isinstance(note, InstrumentsUsed)] == [InstrumentsUsed]
    assert (np.abs(found.estimate.value - TRUTH) < 4 * found.errors.std_independent + 0.01 * np.abs(TRUTH)).all()
    late = replace(log, t=log.t + 0.01, controller=replace(CONTROLLER, t=CONTROLLER.t + 0.01))
    shifted = Difference()(late).shift(-0.01)
    used = InstrumentalVariables()(posed((late, shifted)))
    assert isinstance(used.notes[0], InstrumentsUsed)
    assert used.notes[0].correlation > 0.95
