"""Results side by side: exact where known, right at a stated rate, in words, tables and as a page."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chi2, norm

from dynident.apps.compare_results import ComparedLog, ComparedResult, ExportRecord, compare_results
from dynident.apps.compare_results.report import comparison_lines, comparison_page, headline
from dynident.runtime import Use
from dynident.validation import TorqueErrors

NAMES = ("m1", "h1", "m2", "f")
BASE = np.array([[1.0, 0.0, 0.4, 0.0], [0.0, 1.0, 0.1, 0.0], [0.0, 0.0, 0.0, 1.0]])
COVARIANCE = np.array([[0.04, 0.01, 0.0], [0.01, 0.09, 0.0], [0.0, 0.0, 0.01]])


def result(value: Any, name: str = "one", **changes: Any) -> ComparedResult:
    base, units, scale = ("m1 + 0.4*m2", "h1 + 0.1*m2", "f"), ("kg", "kg m", "N m"), np.array([1.0, 3.0, 0.5, 10.0])
    made = ComparedResult(name, ("a", "b"), NAMES, np.array(value, float), base, units, BASE, scale, COVARIANCE)
    return replace(made, **changes)


def log(error: float, name: str = "tuesday", role: str = "validation", recording: str = "x") -> ComparedLog:
    return ComparedLog(name, role, TorqueErrors(100, error, None, {"a": error}, {"a": error}), recording)


FIRST = result([1.0, 2.0, 0.5, 0.3])


def test_figures_of_a_difference() -> None:
    comparison = compare_results(FIRST, result([1.0, 2.0, 1.5, 0.8], "two"))
    d = np.array([0.4, 0.1, 0.5])
    full = 2 * COVARIANCE
    z = d / np.sqrt(np.diag(full))
    assert [x.name for x in comparison.base] == ["f", "m1 + 0.4*m2", "h1 + 0.1*m2"]
    np.testing.assert_allclose([x.z for x in comparison.base], z[[2, 0, 1]])
    p = 2 * norm.sf(np.abs(z[[2, 0, 1]]))
    holm = np.minimum(np.maximum.accumulate(p * [3, 2, 1]), 1)
    np.testing.assert_allclose([x.p_value for x in comparison.base], holm)
    assert comparison.chi_squared == pytest.approx(d @ np.linalg.solve(full, d))
    assert (comparison.freedom, comparison.alone) == (3, ())
    assert comparison.p_value == pytest.approx(chi2.sf(comparison.chi_squared or 0.0, 3))
    assert (comparison.base[0].first, comparison.base[0].second) == (pytest.approx(0.3), pytest.approx(0.8))
    assert [x.name for x in comparison.significant] == ["f"]
    assert comparison.differs
    assert not comparison.worse


def test_the_same_combinations_under_other_leads_and_orders_are_compared() -> None:
    """Another result may have the parameters in another order, and other ones lead its base parameters."""
    turn = np.array([[2.5, 0.0, 0.0], [-0.25, 1.0, 0.0], [0.0, 0.0, 1.0]])  # b2 = turn b1
    order = [3, 2, 0, 1]
    other = result(
        np.array([1.2, 2.0, 0.5, 0.3])[order],
        "two",
        names=tuple(NAMES[k] for k in order),
        combination=(turn @ BASE)[:, order],
        covariance=turn @ COVARIANCE @ turn.T,
        scale=np.ones(4),
    )
    plain = compare_results(FIRST, result([1.2, 2.0, 0.5, 0.3]))
    comparison = compare_results(FIRST, other)
    for case, reference in zip(comparison.base, plain.base, strict=True):
        assert case.name == reference.name
        assert (case.z, case.second_std) == pytest.approx((reference.z, reference.second_std), abs=1e-12)
    assert comparison.chi_squared == pytest.approx(plain.chi_squared)


def test_what_the_other_does_not_determine_is_left_out() -> None:
    fewer = result(
        [1.0, 2.0, 0.5, 0.3], "two", combination=BASE[1:], base_names=("h", "f"), covariance=COVARIANCE[1:, 1:]
    )
    comparison = compare_results(FIRST, fewer)
    assert {x.name for x in comparison.base} == {"h1 + 0.1*m2", "f"}
    assert comparison.alone == ("m1 + 0.4*m2",)
    assert comparison.freedom == 2
    units = np.array([1.0, 1.0, 1e-9, 1.0])  # of m2, in ng: its share in m1 + 0.4*m2 is as large as before
    without = np.where(np.arange(12).reshape(3, 4) == 2, 0.0, BASE)
    pair = (result(FIRST.value, combination=rows * units, scale=FIRST.scale * units) for rows in (BASE, without))
    assert compare_results(*pair).alone == ("m1 + 0.4*m2",)
    strange = result([1.0, 2.0, 0.5, 0.3], names=("w", "x", "y", "z"))
    nothing = compare_results(FIRST, strange)
    assert (nothing.base, nothing.comparable, nothing.p_value, nothing.differs) == ((), False, None, False)


def test_of_a_single_parameter_chi_squared_is_that_of_its_z() -> None:
    single = {"combination": BASE[2:], "base_names": ("f",), "base_units": ("N m",), "covariance": np.array([[0.01]])}
    comparison = compare_results(*(result([1.0, 2.0, 0.5, f], **single) for f in (0.3, 0.8)))
    assert [parameter.z for parameter in comparison.base] == [pytest.approx(0.5 / 0.02**0.5)]
    assert (comparison.chi_squared, comparison.freedom) == (pytest.approx(12.5), 1)
    assert comparison.p_value == pytest.approx(comparison.base[0].p_value)


def test_errors_that_are_not_known() -> None:
    lost = COVARIANCE.copy()
    lost[2, 2] = np.inf
    comparison = compare_results(FIRST, result([1.0, 2.0, 0.5, 9.0], covariance=lost))
    assert {x.name for x in comparison.base} == {"m1 + 0.4*m2", "h1 + 0.1*m2"}
    assert comparison.chi_squared == pytest.approx(0.0)
    alone = compare_results(FIRST, result([1.0, 2.0, 0.5, 9.0], together=False))
    assert (alone.chi_squared, alone.p_value) == (None, None)
    assert [x.name for x in alone.significant] == ["f"]
    exact = compare_results(*2 * (result(FIRST.value, covariance=0 * COVARIANCE),))
    assert [x.z for x in exact.base] == [0.0, 0.0, 0.0]
    assert not exact.differs


def test_chance_is_called_a_difference_at_the_stated_rate() -> None:
    rng = np.random.default_rng(3)
    half = np.linalg.cholesky(COVARIANCE)
    actual = []
    for _ in range(300):
        noise: list[NDArray[np.float64]] = [half @ rng.standard_normal(3) for _ in range(2)]
        pair = [result([1.0 + b[0], 2.0 + b[1], 0.0, 0.3 + b[2]]) for b in noise]
        actual.append(compare_results(*pair, level=0.2))
    chance = np.mean([x.p_value < 0.2 for x in actual if x.p_value is not None])
    single = np.mean([bool(x.significant) for x in actual])
    assert abs(chance - 0.2) < 0.06
    assert 0.12 < single < 0.24  # Holm is a little on the safe side


def test_worse_is_a_larger_error_on_the_same_held_out_recording() -> None:
    first = replace(FIRST, logs=(log(2.0), log(1.0, "monday", "train", "y")))

    def beside(*logs: ComparedLog) -> Any:
        return compare_results(first, replace(FIRST, name="two", logs=logs), tolerance=5.0)

    assert not beside(log(2.09)).worse
    assert [worse_log.name for worse_log in beside(log(2.11)).worse_logs] == ["tuesday"]
    assert beside(log(2.11)).worse
    assert not beside(log(2.0), log(1.5, "monday", "train", "y")).worse  # held-out errors tell
    assert beside(log(1.5, "monday", "train", "y")).worse  # where there are any
    other = beside(log(9.0, recording="z"))
    assert (other.logs[0].is_same_recording, other.compared_logs, other.worse) == (False, (), False)
    assert beside(log(9.0, recording="")).worse  # as far as is known, it is the same
    others = (log(1.0, "friday", "train", "z"), log(1.0, "later", "validation", "y"))
    assert beside(log(2.0), log(1.0, "monday", "train", "y"), *others).shared_training == ("monday",)
    assert beside(log(2.0, "wednesday")).logs == ()


def test_a_lower_verdict_or_a_lost_proof_is_worse() -> None:
    proven = ExportRecord("arm.urdf", "urdf", "aa", True, 0.0)
    first = replace(FIRST, use=Use.CONTROL, exports=(proven,))
    assert compare_results(first, replace(first, use=Use.DO_NOT_USE)).worse_use
    assert not compare_results(first, replace(first, use=Use.SIMULATION)).worse
    assert not compare_results(first, replace(first, use=None)).worse
    assert compare_results(first, replace(first, exports=(replace(proven, proven=False),))).lost_exports == (
        "arm.urdf",
    )
    assert not compare_results(first, replace(first, exports=())).worse  # it was not exported at all


HOSTILE = "<script>alert('x')</script>"
FIRST_FULL = replace(
    FIRST,
    use=Use.CONTROL,
    logs=(log(2.0), log(1.0, "monday", "train", "y")),
    exports=(ExportRecord("arm.urdf", "urdf", "ab" * 32, True, 0.0, True),),
)
WORSE = replace(
    FIRST_FULL,
    name="two",
    value=result([1.0, 2.0, 1.5, 0.8]).value,
    use=Use.DO_NOT_USE,
    logs=(log(2.4), log(1.0, "monday", "train", "y")),
    exports=(ExportRecord("arm.urdf", "urdf", "cd" * 32, False, None, False),),
)


def test_nothing_in_common() -> None:
    other = replace(FIRST, name="other", names=("w", "x", "y", "z"), joints=("c",))
    nothing = compare_results(FIRST, other)
    assert headline(nothing).endswith(": nothing that can be compared")
    lines = comparison_lines(nothing)
    assert lines[0] == "Joints of one result alone: a, b, c."
    assert lines[1].startswith("No base parameter is determined by both results")
    assert lines[2].startswith("No log has the same name and role in both")


def test_a_held_out_log_judged_on_other_samples_is_not_passed_over() -> None:
    other = replace(FIRST_FULL, logs=(log(0.5, recording="z"), log(1.0, "monday", "train", "y")))
    lines = comparison_lines(compare_results(FIRST_FULL, other))
    assert any(line.startswith("Of tuesday, held out, other recordings or samples were judged") for line in lines)
    assert "Torque error on monday (training): 1 % against 1 %, the same." in lines


def test_the_page_escapes_names() -> None:
    odd = replace(WORSE, name=HOSTILE, base_names=(HOSTILE, "h", "f"))
    comparison = compare_results(replace(FIRST_FULL, base_names=(HOSTILE, "h", "f")), odd)
    page = comparison_page([comparison])
    assert HOSTILE not in page
    assert "&lt;script&gt;alert" in page
