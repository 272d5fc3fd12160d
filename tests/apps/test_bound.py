"""The words of a bound: what limits a parameter, and what the noise is made of."""

from dataclasses import replace
from functools import cache

import numpy as np

from dynident.apps.bound import bound_findings, bound_page, bound_table, limit_figure
from dynident.identification import AccuracyBound, Measure, Origin, accuracy_bound
from dynident.motion.log import Log
from tests.identification.test_accuracy import swing
from tests.kept import check_kept, facts


@cache
def found() -> AccuracyBound:
    model, log = swing(sigma_q=1e-3)
    return accuracy_bound(model, [log], sigma_q=1e-3, sigma_tau=0.05)


def limited(position_share: float, **changes) -> str:
    """The findings where halving the position noise shows that share."""
    one = found()
    bit = one.std["now"] / 2**position_share
    return " ".join(bound_findings(replace(one, std={**one.std, "bit": bit}, **changes)))


def test_the_noise_that_limits_is_named() -> None:
    limits = (
        "noise limits the least certain parameters (90 % of the variance). Their least standard errors are h 0.17 %"
    )
    assert f"Position {limits}, J 0.16 %; with one more bit, " in limited(0.9)
    assert f"Torque {limits}" in limited(0.1)


def test_a_motion_that_ties_parameters_is_named() -> None:
    words = limited(0.1, conditional_std=found().std["now"] / 8)
    assert "alone, it would be known 8.0 times better" in words
    assert words.count("The motion limits them too") == 1


def test_a_parameter_not_excited_is_said() -> None:
    one = found()
    std = {name: np.full_like(value, np.inf) for name, value in one.std.items()}
    words = " ".join(bound_findings(replace(one, std=std)))
    assert "This motion does not show J, h at any noise level: excite them." in words
    assert "∞" in {row[4] for row in bound_table(replace(one, std=std)).rows}


def test_each_base_parameter_is_in_the_bar_of_its_joint_by_what_limits_it() -> None:
    one = found()
    (bar,) = limit_figure(one).data
    assert (bar["name"], bar["x"], len(bar["y"])) == ("known to 10 % at best", [2], 1)
    std = {name: value * np.array([1.0, 1e3]) for name, value in one.std.items()}
    weak = replace(one, std=std, conditional_std=std["now"])
    assert [x["name"] for x in limit_figure(weak).data] == ["known to 10 % at best", "limited by torque noise"]
    tied = limit_figure(replace(weak, conditional_std=std["now"] / 8)).data
    assert [(x["name"], x["x"]) for x in tied][1] == ("limited by the motion", [1])


def test_a_base_parameter_is_led_by_its_own_parameter_whatever_the_formula_says() -> None:
    spaced = replace(found(), names=("J of the arm + h", "h x"))
    assert spaced.leads == found().leads == ("J", "h")
    assert limit_figure(spaced).data == limit_figure(found()).data


def test_misfit_is_distinguished_from_the_sensor() -> None:
    noise = replace(found().noise, torques=Origin(Measure.RESIDUAL))
    for factor, words in ((10.0, "model's misfit or slow noise"), (1e4, "filtered before it was logged")):
        one = replace(found(), noise=replace(noise, sensor=noise.tau / factor))
        assert words in " ".join(bound_findings(one))
    assert "misfit" not in " ".join(bound_findings(replace(found(), noise=replace(noise, sensor=noise.tau))))


def test_names_are_escaped() -> None:
    model, log = swing()
    strange = Log(log.t, log.q, log.tau, log.joints, "<script>alert(1)</script>")
    page = bound_page(accuracy_bound(model, [strange]))
    assert "<script>alert" not in page


def test_the_figures_of_a_bound_stay() -> None:
    check_kept(
        "bound", "\n".join((*facts(found().std), *facts(found().conditional_std), *facts(found().noise, "noise")))
    )
