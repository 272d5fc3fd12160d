"""Any tuning of logs and a model: what is quick agrees with what is whole, and odd logs do no harm."""

from collections.abc import Callable
from dataclasses import replace
from importlib import import_module

import numpy as np
import pytest

from dynident.apps.tuning import Bench, QuickFit, Tuning, curve
from dynident.estimators import LeastSquares, PhysicallyConsistent
from dynident.estimators.notes import MotionCorrected
from dynident.identification import Identification, Recipe, choose_smoother, identify
from dynident.models.lagrangian import slider
from dynident.motion.smoothers import Butterworth, Spline
from dynident.motion.smoothers.spline import NOISE_FACTORS
from dynident.motion.splines import GCV
from dynident.regression import ParallelFilter
from dynident.runtime import ConfigError, InputError
from tests.apps.tuning.arms import JOINTS, MODEL, bench, logs, recording, with_terms


def test_it_is_the_error_by_which_a_smoother_is_chosen(arm: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(curve, "DEGREES", tuple(2 * np.log10(x) for x in NOISE_FACTORS[:6]))
    monkeypatch.setattr(curve, "ROWS", 10_000)
    test_curve = arm.curve(arm.start.with_degree(0.05))
    candidates = [Spline(factor=x) for x in NOISE_FACTORS[:6]]
    choice = choose_smoother(arm.identification.model, list(arm.logs["train"].values()), candidates)
    np.testing.assert_allclose(test_curve.errors, choice.errors, rtol=1e-6)
    assert isinstance(choice.smoother, Spline)
    assert test_curve.marks["torque"] == pytest.approx((2 * np.log10(choice.smoother.factor),) * 3)


def test_a_joint_alone_moves_alone(arm: Bench) -> None:
    tuning = arm.start.with_degree(1.4, 0)
    test_curve = arm.curve(tuning, JOINTS[1])
    assert test_curve.joint == JOINTS[1]
    assert test_curve.marks["torque"][0] == 1.4
    assert test_curve.marks["torque"][2] == tuning.degree[2]
    assert arm.curve(tuning.with_degree(0.9, 1), JOINTS[1]) is test_curve
    assert arm.curve(tuning) is arm.curve(arm.start)
    with pytest.raises(ConfigError, match="there is no joint 'knee'"):
        arm.curve(tuning, "knee")


Change = Callable[[Tuning], Tuning]
CHANGES: dict[str, Change] = {
    "nothing": lambda x: x,
    "one joint": lambda x: x.with_degree(1.0, 1),
    "all joints": lambda x: x.with_degree(0.1),
    "a window": lambda x: x.exclude("log 1", 2.0, 3.5).exclude("log 2", 1.0, 1.2),
    "minimum speed": lambda x: replace(x, min_speed=(0.1, 0.0, 0.3)),
    "a filter": lambda x: replace(x, filter=ParallelFilter(decimate=4)),
    "without a joint": lambda x: replace(x, unfitted=(JOINTS[1],)),
    "fewer terms": lambda x: with_terms(x, 0, ("viscous",)),
    "more terms": lambda x: with_terms(x, 2, (*x.terms[2], "rotor", "stribeck")),
    "terms that remember": lambda x: with_terms(x, 0, ("viscous", "dahl")),
    "terms that see the load": lambda x: with_terms(x, 0, ("viscous", "load_coulomb")),
    "estimator": lambda x: replace(x, estimator="consistent"),
    "time offset": lambda x: replace(x, time_offset=0.002),
}


def differing(quick: QuickFit, value: np.ndarray) -> float:
    """By how many standard errors a base parameter differs at most."""
    return float((np.abs(quick.base.to_base(quick.estimate.value - value)) / quick.base_std).max())


def identified(on: Bench, tuning: Tuning) -> Identification:
    """The whole fit, without the findings of the checks."""
    logs = on._role_logs(tuning).recorded
    return identify(on.model(tuning), logs["train"], logs["validation"], on.recipe(tuning))


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_the_quick_fit_is_the_whole_one_but_for_the_bias_by_the_motion(
    arm: Bench, change: Change, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(import_module("dynident.identification.identify"), "motion_errors", lambda *_, **how: None)
    tuning = change(arm.start)
    quick, identification = arm.fit(tuning), identified(arm, tuning)
    assert quick.estimate.names == identification.estimate.names
    exact = 1e-5 if tuning.estimator == "consistent" else 1e-8  # the conic solver has its own precision
    assert differing(quick, identification.estimate.value) < exact
    assert quick.condition == pytest.approx(_condition(identification), rel=1e-6)
    for validation in identification.validations:
        other = quick.logs[validation.name]
        assert other.error == pytest.approx(validation.errors.relative_error, rel=exact)
        assert other.by_joint == pytest.approx(dict(validation.errors.per_joint), rel=exact)
        assert other.motion.mask.tolist() == validation.motion.mask.tolist()


def _condition(identification: Identification) -> float:
    directions = identification.estimate.determined.directions
    return float(directions.values[0] / directions.values[directions.rank - 1])


def test_the_bias_by_the_motion_is_in_the_whole_fit_alone(arm: Bench) -> None:
    tuning = arm.start.with_degree(1.0, 1)
    result = arm.identify(tuning)
    assert any(isinstance(note, MotionCorrected) for note in result.notes)
    assert differing(arm.fit(tuning), result.estimate.value) > 3.0
    assert arm.identify(tuning) is result


def test_the_start_is_what_was_found(arm: Bench) -> None:
    assert arm.identify(arm.start) is arm.identification
    assert arm.start.degree == pytest.approx((2 * np.log10(1.5),) * 3)
    assert arm.start.terms == (("viscous", "coulomb", "offset"),) * 3
    assert (arm.joints, arm.estimators) == (JOINTS, ("least_squares", "consistent"))
    quick = arm.fit(arm.start)
    assert quick.exact
    assert quick.estimate.determined.rank == len(quick.base.groupings) == arm.identification.estimate.determined.rank
    assert 1.0 < quick.condition < 1e5
    assert {name: log.role for name, log in quick.logs.items()} == {"log 1": "train", "log 2": "validation"}
    assert 0.0 < quick.cross_validated < 10.0


def test_a_window_of_the_configuration_is_part_of_the_start() -> None:
    given = logs(recording(1).exclude([(1.0, 2.0), (3.0, 3.0)]))
    on = bench(given)
    (first, second) = on.start.windows("log 1")
    assert first == (1.0, 2.0)
    assert second[0] == 3.0
    assert on.logs["train"]["log 1"].excluded is None
    assert differing(on.fit(on.start), on.identification.estimate.value) < 0.5


def test_what_does_not_fit_is_said(arm: Bench) -> None:
    start = arm.start
    wrong = {
        "there is no estimator 'magic'": replace(start, estimator="magic"),
        "there is no log 'friday'": start.exclude("friday", 0.0, 1.0),
        "there is no joint 'knee'": replace(start, unfitted=("knee",)),
        "names every joint": replace(start, unfitted=JOINTS),
        "there is no kind of terms 'rust'": with_terms(start, 0, ("rust",)),
        "min_speed has 1 entries": replace(start, min_speed=(0.1,)),
    }
    for words, tuning in wrong.items():
        for ask in (arm.fit, arm.curve, arm.identify):
            with pytest.raises(ConfigError, match=words):
                ask(tuning)
    with pytest.raises(ConfigError, match="there is no log 'friday'"):
        arm.smooth(start, "friday", JOINTS[0])


@pytest.mark.parametrize("smoother", [Butterworth(), Spline(GCV())], ids=["butterworth", "gcv"])
def test_another_smoother_is_used_until_the_degree_changes(smoother: Butterworth | Spline) -> None:
    on = bench(recipe=Recipe(smoother))
    assert not on.has_degree
    assert on.smoother is smoother
    q = on.smooth(on.start, "log 1", JOINTS[0])
    np.testing.assert_array_equal(q.q, smoother(on.logs["train"]["log 1"]).q[:, 0])
    assert q.degree == pytest.approx(on.start.degree[0], abs=0.01)
    assert differing(on.fit(on.start), on.identification.estimate.value) < 3.0
    tuned = on.recipe(on.start.with_degree(0.5, 1)).smoother
    assert isinstance(tuned, Spline)
    assert isinstance(tuned.factor, dict)
    assert tuned.factor[JOINTS[1]] == pytest.approx(10**0.25)


def test_the_noise_that_is_given_stays(arm: Bench) -> None:
    given = Spline(sigma=dict.fromkeys(JOINTS, 0.0002), ends=9.0, factor=2.0)
    on = bench(recipe=Recipe(given))
    assert on.recipe(on.start.with_degree(1.0)).smoother == replace(given, factor=10**0.5)
    assert on.smooth(on.start, "log 1", JOINTS[0]).noise == 2e-4
    assert on.has_degree


def test_a_model_of_the_gallery_has_no_terms_to_switch() -> None:
    model = slider()
    theta = np.array([5.0, 8.0, 3.0, 0.5])
    given = logs(recording(3, 5.0, model=model, theta=theta))
    identification = bench(given, model=model).identification
    on = Bench.of(model, given, identification, switchable=False)
    assert on.switches.kinds == ()
    assert on.start.terms == ((),)
    assert on.fit(on.start.with_degree(0.3)).estimate.names == model.names
    with pytest.raises(ConfigError, match="no kind of terms"):
        on.fit(with_terms(on.start, 0, ("coulomb",)))


def test_a_joint_that_was_never_recorded_and_wrong_samples() -> None:
    given = []
    for seed in (1, 2):
        log = recording(seed)
        tau, q = log.tau.copy(), log.q.copy()
        tau[:, 1] = 0.0
        tau[500, 0] += 80.0
        q[900, 2] += 0.4
        given.append(replace(log, tau=tau, q=q))
    on = bench(logs(given[0], held=(given[1],)))
    quick = on.fit(on.start)
    assert differing(quick, on.identification.estimate.value) < 3.0
    assert quick.factors.rows[1] == 0
    keep = quick.logs["log 1"].motion.keep
    assert not keep[500, 0]
    assert np.isnan(quick.logs["log 2"].by_joint[JOINTS[1]])
    seen = on.smooth(on.start, "log 1", JOINTS[2])
    assert np.abs(seen.residual).max() < 0.01 < abs(seen.measured - seen.q)[900]
    for change in (CHANGES["fewer terms"], CHANGES["more terms"]):
        tuning = change(on.start)
        assert differing(on.fit(tuning), identified(on, tuning).estimate.value) < 3.0


def test_the_consistent_fit_keeps_what_was_chosen_of_it() -> None:
    on = bench(recipe=Recipe(Spline(), PhysicallyConsistent(bounds={"Fv_shoulder": (0.1, 2.0)})))
    assert on.estimators == ("consistent", "least_squares")
    estimator = on.recipe(on.start.with_degree(0.4)).estimator
    assert isinstance(estimator, PhysicallyConsistent)
    assert estimator.strength != "auto"
    assert isinstance(on.recipe(replace(on.start, estimator="least_squares")).estimator, LeastSquares)
    with pytest.raises(ConfigError, match="no parameter 'Fv_shoulder'"):
        on.fit(with_terms(on.start, 0, ("coulomb",)))
    assert MODEL.names == on.fit(on.start).estimate.names


def test_what_cannot_be_smoothed_so_is_said_and_does_no_harm(arm: Bench) -> None:
    on = bench(logs(recording(1), recording(2, 1.0)))
    with pytest.raises(InputError, match=r"log 2: .* too short"):
        on.fit(on.start.with_degree(5.0))
    assert on.fit(on.start).logs.keys() == {"log 1", "log 2"}
    with pytest.raises(InputError, match=r"log 2: no usable sample is left; exclude less"):
        arm.fit(arm.start.exclude("log 2", 0.0, 9.0))
    for stop in (4.9, 9.0):
        with pytest.raises(InputError, match=r"too few for 39 parameters; exclude less"):
            arm.fit(arm.start.exclude("log 1", 0.0, stop))
