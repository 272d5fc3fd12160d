"""What simulates, in a loop or in segments: errors that hold, what it needs, where it begins."""

from dataclasses import replace

import numpy as np
import pytest

from dynident.estimators import Didim, InstrumentalVariables, OutputError
from dynident.estimators.maximum_likelihood import MaximumLikelihood
from dynident.estimators.notes import FirstModel, StartedElsewhere, StillMoving
from dynident.models import Model
from dynident.models.lagrangian import slider
from dynident.models.simulation import Function, simulate_recording
from dynident.motion.log import Log, Motion
from dynident.runtime import GIGABYTE, InputError, MissingInputError, budget_scope, progress_to, set_budget
from tests.estimators.looped import MODEL, STEP, TRUTH, driven, loop, posed, recorded

RUNS, SAMPLES = 8, 300
MOTION, CONTROLLER = driven(SAMPLES)


def smooth(samples: int = SAMPLES) -> Motion:
    """A mass with a smooth motion, and the exact torque of it."""
    t = STEP * np.arange(samples)
    w, size = np.array([2.0, 5.3, 11.0]), np.array([0.1, 0.05, 0.02])
    a = t[:, None] * w
    q, dq, ddq = (np.sin(a) @ size, np.cos(a) @ (w * size), -np.sin(a) @ (w * w * size))
    q, dq, ddq = (x[:, None] for x in (q, dq, ddq))
    tau = MODEL.torque(q, dq, ddq, TRUTH)
    return Motion(t, q, dq, ddq, tau, ("slider",), np.ones(samples, dtype=bool), "run")


OPEN = smooth()


@pytest.mark.parametrize("estimator", [OutputError(), Didim()], ids=repr)
def test_errors_hold_in_a_loop(estimator: OutputError | Didim) -> None:
    """95 % intervals of white noise, which positions have, too; the limit is 4 standard errors of the share."""
    result = [estimator(posed(recorded(MOTION, CONTROLLER, seed))) for seed in range(RUNS)]
    inside = np.mean([np.abs(x.value - TRUTH) < 1.96 * x.std for x in result])
    assert inside >= 0.95 - 4 * np.sqrt(0.95 * 0.05 / RUNS), inside
    spread = np.std([x.value for x in result], axis=0) / np.mean([x.std for x in result], axis=0)
    assert (spread > 0.4).all(), spread
    assert all(x.residual.correlated and x.information is not None and x.converged for x in result)


def test_errors_hold_in_segments_that_the_torque_drives() -> None:
    """Noise of the torque moves the model: residuals are correlated along a segment, and intervals hold."""
    result = [OutputError(segment=0.3)(posed(recorded(OPEN, None, seed, 2e-5, 0.2))) for seed in range(RUNS)]
    inside = np.mean([np.abs(x.value - TRUTH) < 1.96 * x.std for x in result])
    assert inside >= 0.95 - 4 * np.sqrt(0.95 * 0.05 / RUNS), inside
    spread = np.std([x.value for x in result], axis=0) / np.mean([x.std for x in result], axis=0)
    assert (spread > 0.3).all(), spread


def test_agrees_with_maximum_likelihood() -> None:
    """Of a torque with next to no noise both have the noise of the positions only."""
    log, motion = recorded(OPEN, None, 1, 1e-5, 1e-4)
    result, best = OutputError(segment=0.3)(posed((log, motion))), MaximumLikelihood()(posed((log, motion)))
    both = np.hypot(result.std, best.std)
    assert (np.abs(result.value - best.value) < 4 * both).all(), (result.value - best.value) / both
    assert (np.abs(result.value - TRUTH) < 4 * result.std).all()


def test_a_command_that_is_known_drives_the_model() -> None:
    """The measured torque is wrong by a factor, the commanded one is right."""
    log, motion = recorded(OPEN, None, 0, 1e-6, 0.0)
    log, motion = replace(log, tau=1.1 * log.tau, command=OPEN.tau), replace(motion, tau=1.1 * motion.tau)
    result, wrong = (OutputError(torque=x, segment=0.5)(posed((log, motion))) for x in ("commanded", "measured"))
    np.testing.assert_allclose(result.value, TRUTH, rtol=0.01)
    np.testing.assert_allclose(wrong.value, 1.1 * TRUTH, rtol=0.01)
    with pytest.raises(MissingInputError, match=r"log 0: the commanded torque .*\(Log.command\)"):
        OutputError(torque="commanded")(posed((replace(log, command=None), motion)))


def test_a_torque_stamped_late_drives_the_model_then() -> None:
    """Positions stamped 3 ms late, and the motion corrected for it, as ``identify`` does."""
    long = smooth(600)
    log, motion = recorded(long, None, 0, 0.0, 0.0)
    at = long.shift(-0.003)
    delayed = replace(log, q=at.q)
    shifted = replace(motion, q=at.q, dq=at.dq, ddq=at.ddq).shift(0.003)
    result = OutputError(segment=0.5)(posed((delayed, shifted)))
    np.testing.assert_allclose(result.value, TRUTH, rtol=2e-3)


def test_a_joint_that_rests_stops_nothing() -> None:
    """Held by friction, it shows no mass."""
    model, n = slider(values=(5.0, 8.0, 3.0, 0.5)), 60
    t, zero = STEP * np.arange(n), np.zeros((n, 1))
    motion = Motion(t, zero, zero, zero, zero + 0.5, ("slider",), np.ones(n, dtype=bool), "still")
    log = Log(t, zero, zero + 0.5, ("slider",), "still")
    result = OutputError(segment=0.1)(posed((log, motion), model=model))
    assert np.isfinite(result.value).all()
    assert np.isinf(result.std[0])


def test_needs_what_it_is_told_to_use() -> None:
    log, motion = recorded(MOTION, None, 0)
    with pytest.raises(MissingInputError, match=r"log 0: the closed loop is to be simulated, .* leave `loop` at auto"):
        OutputError(loop="closed")(posed((log, motion)))
    few = replace(motion, mask=np.arange(len(motion)) % 6 > 0)
    with pytest.raises(InputError, match="log 0: too few usable samples in a row to simulate: give at least 10"):
        OutputError()(posed((log, few)))


def test_what_needs_more_memory_than_there_is_is_refused_before_it_is_simulated() -> None:
    """The slider has 3 parameters and 2 states: each sample in a loop takes 20 * 5 bytes."""
    problem = posed(recorded(MOTION, CONTROLLER, 0))
    samples = int(problem.motions[0].mask.sum())
    steps: list[str] = []
    with budget_scope():
        set_budget(20 * samples * 5 / GIGABYTE)
        OutputError(iterations=1)(problem)
        set_budget(20 * samples * 5 / GIGABYTE / 2)
        for estimator in (OutputError(), Didim(), OutputError(loop="open")):
            size = f"{samples} samples of .* would take {samples / 1e4:.3g} MB"
            words = rf"log 0: .*, {size} .* \(50 % of it fit\), .* --memory"
            with pytest.raises(InputError, match=words), progress_to(steps.append):
                estimator(problem)
    assert not steps


def test_needs_a_controller_that_sees_the_positions() -> None:
    log, motion = recorded(MOTION, None, 0)
    with pytest.raises(MissingInputError, match=r"log 0: the closed loop is to be simulated, but .* `simulation`"):
        Didim()(posed((log, motion)))
    ones, still = np.ones(1), np.zeros_like(log.q)
    blind = Function(("slider",), log.t, log.q, lambda t, q, dq, reference: [np.sin(2 * t)], ones, np.inf * ones, still)
    with pytest.raises(MissingInputError, match=r"log 0: no parameter of the model changes .* Use output_error"):
        Didim()(posed((replace(log, controller=blind), motion)))


def test_a_loop_that_runs_away_is_said() -> None:
    """Also where the drive's limit keeps the position finite."""
    log, motion = recorded(MOTION, None, 0)
    wrong = loop(SAMPLES, -4000.0, -80.0)
    limited = replace(wrong, saturation=np.array([300.0]))
    run = simulate_recording(MODEL, TRUTH, motion, limited)
    assert run.failure is None
    assert 30 * np.ptp(motion.q) < np.abs(run.q).max() < 1e4
    for controller in (wrong, limited):
        problem = posed((replace(log, controller=controller), motion))
        for estimator in (Didim(), OutputError(), InstrumentalVariables("simulated")):
            with pytest.raises(InputError, match=r"log 0: .*\(the simulated position diverges after .* s\)"):
                estimator(problem)


def test_begins_elsewhere_where_least_squares_cannot_be_simulated() -> None:
    """Accelerations of the wrong sign: no fit to them has a mass that the loop can move."""
    reference = Model(
        tuple(replace(term, values=(value,)) for term, value in zip(MODEL.terms, (4.0, 5.0, 0.0), strict=True))
    )
    log, motion = recorded(MOTION, CONTROLLER, 0)
    wrong, right = replace(motion, ddq=-motion.ddq), Didim()(posed((log, motion))).value
    for case, start in ((log, FirstModel.SMOOTHED), (replace(log, q=-log.q), FirstModel.NOMINAL)):
        result = Didim()(posed((case, wrong), model=reference))
        assert StartedElsewhere(start) in result.notes
        np.testing.assert_allclose(result.value, right, rtol=1e-3)


def test_says_that_it_has_not_converged() -> None:
    log, motion = recorded(MOTION, CONTROLLER, 0)
    log = replace(log, q=-log.q)  # of which no better start can be made
    result = Didim(iterations=1)(posed((log, replace(motion, ddq=0.2 * motion.ddq, dq=0.2 * motion.dq))))
    (note,) = [note for note in result.notes if isinstance(note, StillMoving)]
    assert note.iterations == 1
    assert not result.converged
