"""Instrumental variables where least squares is biased: unbiased, consistent, with intervals that hold; and bad input.

All laws are of seeded runs; their limits are 4 standard errors of what is averaged, which chance alone exceeds once in
16 000.
"""

from dataclasses import replace

import numpy as np
import pytest

from dynident.estimators import Estimate, InstrumentalVariables, LeastSquares
from dynident.estimators.instruments import InstrumentKind, InstrumentsUsed, NotSimulated, WeakInstruments
from dynident.estimators.notes import StillMoving
from dynident.identification import Recipe, identify
from dynident.models.lagrangian import slider
from dynident.motion.smoothers import Difference, Spline
from dynident.runtime import ConfigError, InputError, MissingInputError
from tests.estimators.looped import MODEL, TRUTH, driven, loop, posed, recorded

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
    result = runs(kind)
    values = np.array([x.value for x in result])
    error = values.mean(axis=0) - TRUTH
    assert (np.abs(error) < 4 * values.std(axis=0, ddof=1) / np.sqrt(len(values))).all(), error
    inside = np.array([np.abs(x.value - TRUTH) < 1.96 * x.std for x in result]).mean(axis=0)
    assert (inside >= 0.95 - 4 * np.sqrt(0.95 * 0.05 / RUNS)).all(), inside
    assert all(x.information is not None for x in result)


@pytest.mark.parametrize("kind", ["simulated", "lagged"])
def test_is_consistent(kind: str) -> None:
    """Four times the samples: the error of least squares stays, the standard error of instruments halves and holds."""
    loops = (CONTROLLER, LONGER) if kind == "simulated" else (None, None)
    some = [posed(recorded(x, drive, 7, NOISE)) for x, drive in zip((SHORT, LONG), loops, strict=True)]
    short, long = (InstrumentalVariables(kind)(x) for x in some)
    plain = [LeastSquares()(x).value[0] - TRUTH[0] for x in some]
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


def test_weak_instruments_are_said() -> None:
    """Long after a sample, nothing of a motion is left that its own noise exceeds tenfold."""
    result = InstrumentalVariables("lagged", lag=1.5)(posed(recorded(SHORT, None, 1, 1e-4)))
    assert any(isinstance(note, WeakInstruments) and note.parameter == "M" for note in result.notes)


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


def test_nothing_that_moves_and_nothing_that_is_felt() -> None:
    """A joint at rest leaves the rank that there is; without torque all is zero, and exactly known."""
    log, motion = recorded(SHORT, None, 5)
    still = replace(motion, q=0 * motion.q, dq=0 * motion.q, ddq=0 * motion.q)
    assert InstrumentalVariables()(posed((log, still))).determined.rank == 1
    without = InstrumentalVariables()(posed((log, replace(motion, tau=0 * motion.tau))))
    np.testing.assert_allclose(without.value, 0.0, atol=1e-12)
    assert (without.std < 1e-6).all()


def test_a_loop_that_runs_away_is_an_error_or_the_next_kind() -> None:
    log, motion = recorded(SHORT, loop(len(SHORT), kp=-4e4, kd=-100.0), 6)
    with pytest.raises(InputError, match=r"log 6: .*position diverges after .* Check gains"):
        InstrumentalVariables("simulated")(posed((log, motion)))
    result = InstrumentalVariables()(posed((log, motion)))
    assert [type(note) for note in result.notes][:2] == [InstrumentsUsed, NotSimulated]
    assert result.notes[0].kinds == (InstrumentKind.LAGGED,)


def test_a_first_model_that_fails_is_made_consistent() -> None:
    """By torques with 60 N s/m too little, friction drives the mass; that of a slider is none at worst."""
    model = slider(values=(5.0, 8.0, 3.0, 0.5))
    log, motion = recorded(SHORT, loop(len(SHORT), kd=30.0), 8)
    bad = (log, replace(motion, tau=motion.tau - 60.0 * motion.dq))
    assert LeastSquares()(posed(bad, model=model)).value[1] < -30
    result = InstrumentalVariables("simulated", iterations=1)(posed(bad, model=model))
    assert InstrumentKind.SIMULATED in result.notes[0].kinds
    assert not any(isinstance(note, NotSimulated) for note in result.notes)


def test_an_iteration_that_is_cut_short_is_said() -> None:
    result = InstrumentalVariables("simulated", iterations=1)(posed(recorded(SHORT, CONTROLLER, 2, 2e-5)))
    assert [type(note) for note in result.notes] == [InstrumentsUsed, StillMoving]
    assert not result.converged


def test_identify_leaves_its_errors_of_the_motion_alone() -> None:
    """A time offset is undone in the loop of the controller; held for the torque, the motion comes out the same."""
    log, _ = recorded(SHORT, CONTROLLER, 9, 1e-6)
    recipe = Recipe(smoother=Spline(), estimator=InstrumentalVariables(), time_offset=0.0)
    result = identify(MODEL, [log], recipe=recipe)
    assert [type(note) for note in result.warnings if isinstance(note, InstrumentsUsed)] == [InstrumentsUsed]
    assert (np.abs(result.estimate.value - TRUTH) < 4 * result.errors.std_independent + 0.01 * np.abs(TRUTH)).all()
    delayed = replace(log, t=log.t + 0.01, controller=replace(CONTROLLER, t=CONTROLLER.t + 0.01))
    shifted = Difference()(delayed).shift(-0.01)
    used = InstrumentalVariables()(posed((delayed, shifted)))
    assert isinstance(used.notes[0], InstrumentsUsed)
    assert used.notes[0].correlation > 0.95
