"""The whole method in one call."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from dynident.estimators import LeastSquares
from dynident.estimators.maximum_likelihood import MaximumLikelihood, newton
from dynident.estimators.notes import Failed, NotWhite, RankDeficient, Undetermined
from dynident.identification import (
    Identification,
    NotFitted,
    NotJudged,
    Recipe,
    SubstituteUsed,
    identify,
    substitute_notes,
)
from dynident.models import Model, RigidBodies
from dynident.models.friction import Viscous
from dynident.models.lagrangian import two_link_arm
from dynident.models.simulation import record, simulate
from dynident.motion.log import Log, Motion
from dynident.motion.smoothers import FourierSeries, Spline
from dynident.regression import ParallelFilter, UnexcitedParameters, informed_std
from dynident.runtime import ConfigError, InputError, MissingInputError
from dynident.testing.estimator import multisine_motion
from tests.robots import joint, link, urdf

ARM = two_link_arm()


@pytest.fixture(scope="module")
def log() -> Log:
    """Ten seconds of a multisine at 100 Hz, without noise."""
    return record(multisine_motion(ARM, samples=1001), 0.0, 0.0, np.random.default_rng(0), source="exact").log


@cache
def driven() -> Motion:
    """Four seconds in which given torques drive the arm."""
    t = np.linspace(0, 4, 801)
    return simulate(ARM, ARM.values, lambda s: (1.13 * np.sin(3 * s), 0.78 * np.cos(4 * s)), t, tolerance=1e-9)


def error(identification: Identification) -> float:
    """The largest relative error of a parameter."""
    return float(np.abs(identification.estimate.value / ARM.values - 1).max())


@pytest.mark.parametrize("parallel_filter", [None, ParallelFilter(decimate=4)], ids=repr)
def test_recovers_the_parameters_of_a_simulated_arm(log: Log, parallel_filter: ParallelFilter | None) -> None:
    result = identify(ARM, [log], recipe=Recipe(filter=parallel_filter))
    assert error(result) < 1e-3
    assert result.warnings == ()
    assert result.estimate.notes == ()
    (judged,) = result.validations
    assert (judged.name, judged.role) == ("exact", "train")
    assert judged.errors.relative_error < 0.1
    assert (judged.errors.relative_error_filtered is None) == (parallel_filter is None)
    step = 1 if parallel_filter is None else parallel_filter.decimate
    assert result.estimate.residual.samples == -(-judged.motion.mask.sum() // step)


@pytest.mark.parametrize(
    ("parts", "words"),
    [
        ({"smoother": "spline"}, r"smoother is 'spline'; it must be a smoother, such as Spline\(\)"),
        ({"smoother": (Spline(), "gcv")}, "smoother is .*'gcv'.*; it must be a smoother, .* or a tuple of them"),
        ({"estimator": Spline()}, "estimator is Spline.*; it must be an estimator"),
        ({"estimator": LeastSquares}, "estimator is <class .*; it must be an estimator"),
    ],
)
def test_a_part_is_an_object_not_its_name_or_class(parts: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        Recipe(**parts)


def test_joints_are_matched_by_name(log: Log) -> None:
    turned = log.select(("joint2", "joint1"))
    assert turned.joints != log.joints
    result, straight = identify(ARM, [turned]), identify(ARM, [log])
    np.testing.assert_array_equal(result.estimate.value, straight.estimate.value)
    assert result.validations[0].errors.per_joint == straight.validations[0].errors.per_joint


@pytest.mark.parametrize(
    ("train", "held_out", "error", "words"),
    [
        (lambda log: [log.select(("joint1",))], (), InputError, "exact: no joint 'joint2'; the log has joint1"),
        (lambda log: [log], {"x": "later"}, InputError, "later: no joint 'joint2'"),
        *((lambda log, none=none: none, (), ConfigError, "no training log") for none in ((), [], {})),
    ],
)
def test_logs_that_lack_are_an_error(log: Log, train: Any, held_out: Any, error: type, words: str) -> None:
    held_out = {name: replace(log.select(("joint1",)), source=source) for name, source in dict(held_out).items()}
    with pytest.raises(error, match=words):
        identify(ARM, train(log), held_out)


def test_two_logs_of_the_same_source_need_names(log: Log) -> None:
    early, delayed = log.window(stop=6.0), log.window(start=4.0)
    with pytest.raises(ConfigError, match=r"same source among \['exact', 'exact'\]; give them by name"):
        identify(ARM, [early, delayed])
    result = identify(ARM, {"early": early, "late": delayed})
    assert [judged.name for judged in result.validations] == ["early", "late"]
    assert result.estimate.residual.samples == sum(int(judged.motion.mask.sum()) for judged in result.validations)


def test_validation_logs_are_judged_and_not_fitted(log: Log) -> None:
    early, delayed = log.window(stop=6.0), replace(log.window(start=4.0), source="late")
    result = identify(ARM, [early], {"check": delayed})
    assert [(judged.name, judged.role) for judged in result.validations] == [
        ("exact", "train"),
        ("check", "validation"),
    ]
    np.testing.assert_array_equal(result.estimate.value, identify(ARM, [early]).estimate.value)
    wrong = identify(ARM, [early], {"check": replace(delayed, tau=2 * delayed.tau)})
    np.testing.assert_array_equal(result.estimate.value, wrong.estimate.value)
    assert wrong.validations[1].errors.relative_error == pytest.approx(50.0, rel=1e-2)


@pytest.mark.parametrize("more", [(), (Viscous(ARM.joints, names=("again1", "again2")),)], ids=["full rank", "tied"])
def test_errors_of_a_likelihood_count_those_of_the_motion(more: tuple[Viscous, ...]) -> None:
    """White noise: the robust errors, which take the motion for known, are never told where they are the smaller."""
    noisy = record(driven(), 3e-2, 0.1, np.random.default_rng(0), source="noisy").log
    model = replace(ARM, terms=(*ARM.terms, *more))
    result = identify(model, [noisy], recipe=Recipe(estimator=MaximumLikelihood()))
    information = result.estimate.information
    if more:
        np.testing.assert_array_equal(
            result.errors.base_std_independent, informed_std(result.base.on_data, information)
        )
        least, robust = result.errors.base_std_independent, result.errors.base_std
    else:
        least, robust = result.estimate.std, result.errors.std
    assert (robust >= least).all()
    assert (robust == least).any()  # where the correlated residuals alone tell of smaller ones


@pytest.mark.parametrize("fails", [False, True])
def test_what_a_likelihood_says_of_a_robot_is_a_warning(fails: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """The rank of a robot's parameters is never full, and no news; a failure, or a model that leaves much out, is."""

    def no_luck(*_: object) -> None:
        raise np.linalg.LinAlgError("no luck")

    if fails:
        monkeypatch.setattr(newton, "_newton_step", no_luck)
    bodies = RigidBodies(urdf(link("base"), link("arm", 1.0, (0.0, 0.1, 0.2)), joint("j", "revolute", "base", "arm")))
    model, rng, t = (
        Model((bodies, Viscous(bodies.joints, values=(0.1,)))),
        np.random.default_rng(0),
        np.arange(800) / 200,
    )
    q, dq, ddq = (a * np.sin(3 * t + phase)[:, None] for a, phase in ((1, 0), (3, np.pi / 2), (-9, 0)))
    tau = model.torque(q, dq, ddq, np.asarray(model.values)) + 0.3 * np.sign(dq)  # friction that the model has not
    swing = Log(t, q + 1e-4 * rng.standard_normal(q.shape), tau + 0.01 * rng.standard_normal(q.shape), ("j",), "swing")
    result = identify(model, [swing], recipe=Recipe(estimator=MaximumLikelihood()))
    assert any(isinstance(note, Failed if fails else NotWhite) for note in result.warnings)
    assert not any(isinstance(note, Undetermined) for note in result.warnings)
    assert any(isinstance(note, RankDeficient) for note in result.estimate.notes)


def test_a_joint_that_is_not_fitted_is_predicted_from_the_others(log: Log) -> None:
    spoiled = replace(log, tau=np.column_stack([log.tau[:, 0], log.tau[:, 1] + 5.0 * np.sin(40 * log.t)]))
    (first, second) = spoiled.joints
    result = identify(ARM, [spoiled], recipe=Recipe(unfitted=(second,)))
    alone = identify(ARM, [log], recipe=Recipe(unfitted=(second,)))
    np.testing.assert_allclose(result.estimate.value, alone.estimate.value)
    assert NotFitted((second,)) in result.notes
    assert not any(isinstance(note, UnexcitedParameters) for note in result.notes)  # no motion would show them
    (judged,) = result.validations
    assert judged.errors.per_joint[first] < 1.0 < judged.errors.per_joint[second]
    for wrong, words in ((("knee",), "there is no joint 'knee'"), (spoiled.joints, "names every joint")):
        with pytest.raises(ConfigError, match=words):
            identify(ARM, [log], recipe=Recipe(unfitted=wrong))


def test_excluded_samples_are_neither_fitted_nor_judged(log: Log) -> None:
    gone = (log.t >= 2.0) & (log.t <= 3.0)
    spoiled = replace(log, tau=log.tau + 50.0 * gone[:, None])
    result = identify(ARM, [spoiled.exclude([(2.0, 3.0)])], [spoiled.exclude([(1.9, 3.1)])])
    (note,) = (note for note in result.notes if isinstance(note, NotJudged))  # of the held-out log alone
    assert note.share == pytest.approx(100 * 1.2 / np.ptp(log.t), rel=0.02)
    assert error(result) < 1e-3
    assert [validation.errors.relative_error < 0.1 for validation in result.validations] == [True, True]
    assert result.estimate.residual.samples == result.validations[0].motion.mask.sum()


def test_motion_that_a_smoother_is_not_made_for_is_judged_by_its_substitute(log: Log) -> None:
    """The smoother is for motion that repeats: with a time offset, and without; what is fitted must repeat."""
    t = np.linspace(0, 10, 1001)

    def swing(source: str, *rates: float) -> Log:
        w = np.array(rates)
        q, dq, ddq = np.sin(w * t[:, None]), w * np.cos(w * t[:, None]), -(w**2) * np.sin(w * t[:, None])
        return Log(t, q, ARM.torque(q, dq, ddq, ARM.values), log.joints, source)

    twice, once = swing("twice", 1.5, 3.0), swing("once", 0.9, 0.7).window(0.0, 5.0)
    for delayed in (0.0, 0.005):
        test_result = identify(ARM, [twice], [once], Recipe(FourierSeries(), time_offset=delayed))
        (note,) = (note for note in test_result.notes if isinstance(note, SubstituteUsed))
        assert note == SubstituteUsed("once", "FourierSeries", Spline().method)
        held = test_result.validations[1]
        assert held.errors.relative_error < (5.0 if delayed else 0.1)
        again = test_result.predict(once)
        assert [substitute_note.log for substitute_note in substitute_notes([again])] == ["once"]
        assert again.errors.relative_error == pytest.approx(held.errors.relative_error)
        assert not list(substitute_notes([test_result.predict(twice)]))
    with pytest.raises(MissingInputError, match="once: no two periods"):
        identify(ARM, [once], [twice], Recipe(FourierSeries()))
    result = identify(ARM, [twice], recipe=Recipe(FourierSeries(4 * np.pi / 3)))
    assert result.predict(once.window(0.0, 3.0)).errors.relative_error < 0.1  # less than a period


def test_excluded_torques_do_not_count_in_the_likelihood() -> None:
    noisy = record(driven(), 1e-4, 0.02, np.random.default_rng(0), source="noisy").log
    gone = (noisy.t >= 1.0) & (noisy.t <= 1.5)
    spoiled = replace(noisy, tau=noisy.tau + 50.0 * gone[:, None])
    result, alone = (
        identify(ARM, [x.exclude([(1.0, 1.5)])], recipe=Recipe(estimator=MaximumLikelihood())) for x in (spoiled, noisy)
    )
    np.testing.assert_allclose(result.estimate.value, alone.estimate.value, atol=0.01 * float(alone.estimate.std.min()))
