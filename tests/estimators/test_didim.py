"""DIDIM: the torque of the simulated loop; its errors, what it needs, and where it begins."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dynident.estimators import Didim, InstrumentalVariables, OutputError
from dynident.estimators.notes import FirstModel, StartedElsewhere, StillSimulating
from dynident.models import Model
from dynident.models.lagrangian import two_link_arm
from dynident.models.simulation import PID, Function, simulate_recording
from dynident.runtime import InputError, MissingInputError
from dynident.testing.estimator import close_loops, multisine_motion
from dynident.testing.estimator import make_problem as plain
from tests.estimators.looped import MODEL, TRUTH, driven, loop, posed, recorded

RUNS = 20
MOTION, CONTROLLER = driven(600)


def test_errors_hold() -> None:
    """95 % intervals of white noise, which positions have, too; the limit is 4 standard errors of the share."""
    found = [Didim()(posed(recorded(MOTION, CONTROLLER, seed))) for seed in range(RUNS)]
    inside = np.mean([np.abs(one.value - TRUTH) < 1.96 * one.std for one in found])
    assert inside >= 0.95 - 4 * np.sqrt(0.95 * 0.05 / RUNS), inside
    spread = np.std([one.value for one in found], axis=0) / np.mean([one.std for one in found], axis=0)
    assert (spread > 0.4).all(), spread
    assert all(one.residual.correlated and one.information is not None and one.converged for one in found)


def test_an_arm_is_found_in_a_loop() -> None:
    model = two_link_arm()
    found = Didim()(
        close_loops(plain(model, multisine_motion(model, noise=0.01, samples=400).select_between(stop=2.5)))
    )
    assert (np.abs(found.value - model.values) < 4 * found.std).all()
    assert found.converged


def test_a_torque_that_is_stamped_earlier_is_compared_then() -> None:
    """With the right time offset an exact recording is fitted exactly."""
    log, motion = recorded(MOTION, CONTROLLER, 0, 0.0, 0.0)
    tau = np.vstack((log.tau[1:], log.tau[-1:]))  # stamped one sample too early
    step = float(log.t[1] - log.t[0])
    late = replace(motion, tau=tau).shift(step)
    problem = posed((replace(log, tau=tau), late))
    right, wrong = Didim()(problem), Didim()(posed((replace(log, tau=tau), replace(motion, tau=tau))))
    assert np.abs(right.value - TRUTH).max() < 0.1 * np.abs(wrong.value - TRUTH).max()


def test_equations_that_are_left_out_do_not_count() -> None:
    log, motion = recorded(MOTION, CONTROLLER, 0)
    keep = np.ones(motion.tau.shape, dtype=bool)
    keep[200:300] = False
    spoilt = replace(motion, tau=np.where(keep, motion.tau, 1e3), keep=keep)
    found = [Didim()(posed((log, one))).value for one in (spoilt, replace(motion, keep=keep))]
    np.testing.assert_array_equal(*found)


def test_a_controller_may_have_an_integral() -> None:
    integral = PID(loop(600), np.array([200.0]))
    log, motion = recorded(MOTION, CONTROLLER, 0)
    found = Didim()(posed((replace(log, controller=integral), motion)))
    assert np.isfinite(found.value).all()


def test_needs_a_controller_that_sees_the_positions() -> None:
    log, motion = recorded(MOTION, None, 0)
    with pytest.raises(MissingInputError, match=r"log 0: the closed loop is to be simulated, but .* `simulation`"):
        Didim()(posed((log, motion)))
    one, still = np.ones(1), np.zeros_like(log.q)
    blind = Function(("slider",), log.t, log.q, lambda t, q, dq, reference: [np.sin(2 * t)], one, np.inf * one, still)
    with pytest.raises(MissingInputError, match=r"log 0: no parameter of the model changes .* Use output_error"):
        Didim()(posed((replace(log, controller=blind), motion)))


def test_a_loop_that_runs_away_is_said() -> None:
    """Also where the drive's limit keeps the position finite."""
    log, motion = recorded(MOTION, None, 0)
    wrong = loop(600, -4000.0, -80.0)
    limited = replace(wrong, saturation=np.array([300.0]))
    run = simulate_recording(MODEL, TRUTH, motion, limited)
    assert run.failure is None
    assert 30 * np.ptp(motion.q) < np.abs(run.q).max() < 1e4
    for controller in (wrong, limited):
        problem = posed((replace(log, controller=controller), motion))
        for estimator in (Didim(), OutputError(), InstrumentalVariables("simulated")):
            with pytest.raises(InputError, match=r"log 0: .*\(it runs away after .* s\)"):
                estimator(problem)


def test_begins_elsewhere_where_least_squares_cannot_be_simulated() -> None:
    """Accelerations of the wrong sign: no fit to them has a mass that the loop can move."""
    known = Model(
        tuple(replace(term, values=(value,)) for term, value in zip(MODEL.terms, (4.0, 5.0, 0.0), strict=True))
    )
    log, motion = recorded(MOTION, CONTROLLER, 0)
    wrong, right = replace(motion, ddq=-motion.ddq), Didim()(posed((log, motion))).value
    for one, start in ((log, FirstModel.SMOOTHED), (replace(log, q=-log.q), FirstModel.NOMINAL)):
        found = Didim()(posed((one, wrong), model=known))
        assert StartedElsewhere(start) in found.notes
        np.testing.assert_allclose(found.value, right, rtol=1e-3)


def test_says_that_it_has_not_converged() -> None:
    log, motion = recorded(MOTION, CONTROLLER, 0)
    log = replace(log, q=-log.q)  # of which no better start can be made
    found = Didim(iterations=1)(posed((log, replace(motion, ddq=0.2 * motion.ddq, dq=0.2 * motion.dq))))
    (note,) = [one for one in found.notes if isinstance(one, StillSimulating)]
    assert note.iterations == 1
    assert not found.converged
