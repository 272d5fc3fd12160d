"""The words of a bound: what limits a parameter, and what the noise is made of."""

from dataclasses import replace
from functools import cache

import numpy as np

from dynident.apps.bound import bound_findings, bound_page, bound_table
from dynident.identification import AccuracyBound, Measure, Origin, accuracy_bound
from dynident.motion.log import Log
from tests.identification.test_accuracy import swing
from tests.kept import check_kept, told


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
    assert "Position noise limits it (90 % of the variance): one more bit gives" in limited(0.9)
    assert "Torque noise limits it (90 % of the variance): ten times its accuracy gives" in limited(0.1)


def test_a_motion_that_ties_parameters_is_named() -> None:
    words = limited(0.1, conditional_std=found().std["now"] / 8)
    assert "were all others known, it would be 8.0 times smaller" in words


def test_a_parameter_not_excited_is_said() -> None:
    one = found()
    std = {name: np.full_like(value, np.inf) for name, value in one.std.items()}
    words = " ".join(bound_findings(replace(one, std=std)))
    assert "not determined by this motion at any noise level" in words
    assert "∞" in {row[4] for row in bound_table(replace(one, std=std)).rows}


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
    check_kept("bound", "\n".join((*told(found().std), *told(found().conditional_std), *told(found().noise, "noise"))))
