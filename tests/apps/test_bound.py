"""The words of a bound: what limits a parameter, and what the noise is made of."""

from collections.abc import Iterator
from dataclasses import replace
from functools import cache

import numpy as np

from dynident.apps.bound import bound_findings, bound_page, bound_table, limit_figure
from dynident.identification import AccuracyBound, Measure, Origin, accuracy_bound
from dynident.motion.log import Log
from tests.identification.test_accuracy import swing
from tests.kept import check_kept, facts


@cache
def arm_bound() -> AccuracyBound:
    model, log = swing(sigma_q=1e-3)
    return accuracy_bound(model, [log], sigma_q=1e-3, sigma_tau=0.05)


def situations() -> Iterator[tuple[str, AccuracyBound]]:
    """Yield bounds that are limited by one thing or another, with what it is."""
    case = arm_bound()
    now, noise = case.std["now"], replace(case.noise, torques=Origin(Measure.RESIDUAL))
    weak = {name: value * np.array([1.0, 1e3]) for name, value in case.std.items()}
    yield "position noise", replace(case, std={**case.std, "bit": now / 2**0.9})
    yield "torque noise", replace(case, std={**case.std, "bit": now / 2**0.1})
    yield "the motion", replace(case, conditional_std=now / 8)
    yield "nothing is excited", replace(case, std={name: np.full_like(value, np.inf) for name, value in weak.items()})
    yield "of one parameter torque noise", replace(case, std=weak, conditional_std=weak["now"])
    yield "of one parameter the motion", replace(case, std=weak, conditional_std=weak["now"] / 8)
    for factor in (1.0, 10.0, 1e4):
        sensor = replace(noise, sensor=noise.tau / factor)
        yield f"a residual of {factor} times the sensor noise", replace(case, noise=sensor)


def test_what_limits_is_said_in_the_same_words_and_bars() -> None:
    lines = list[str]()
    for name, bound in situations():
        bars, rows = limit_figure(bound).data, bound_table(bound).rows
        lines += [f"{name}: {[(bar['name'], bar['x'], len(bar['y'])) for bar in bars]}", *map(str, rows)]
        lines += [f"    {line}" for line in bound_findings(bound)]
    check_kept("bound_situations", "\n".join(lines))


def test_a_base_parameter_is_led_by_its_own_parameter_whatever_the_formula_says() -> None:
    spaced = replace(arm_bound(), names=("J of the arm + h", "h x"))
    assert spaced.leads == arm_bound().leads == ("J", "h")
    assert limit_figure(spaced).data == limit_figure(arm_bound()).data


def test_names_are_escaped() -> None:
    model, log = swing()
    strange = Log(log.t, log.q, log.tau, log.joints, "<script>alert(1)</script>")
    page = bound_page(accuracy_bound(model, [strange]))
    assert "<script>alert" not in page


def test_the_figures_of_a_bound_stay() -> None:
    check_kept(
        "bound",
        "\n".join((*facts(arm_bound().std), *facts(arm_bound().conditional_std), *facts(arm_bound().noise, "noise"))),
    )
