"""Results side by side: exact where known, right at a stated rate, read without robot files, in words and as a page."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chi2, norm

from dynident.apps.compare_results import ComparedLog, ComparedResult, ExportRecord, compare_results
from dynident.apps.compare_results.config import compared_names, read_compared
from dynident.apps.compare_results.report import comparison_lines, comparison_page, headline
from dynident.project.saved import load
from dynident.runtime import InputError, Use
from dynident.validation import TorqueErrors
from tests.cli.commands import configure, run, write_log

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


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A slider that was identified into the folder "out"."""
    place = tmp_path_factory.mktemp("compared")
    write_log(place)
    done = run("identify", configure(place), "--out", place / "out")
    assert done.exit_code == 0, done.output
    return place


def test_a_result_is_read_as_it_was_saved(folder: Path) -> None:
    path = folder / "out" / "result.json"
    compared, full = read_compared(path, "slider"), load(path)
    assert compared.names == full.estimate.names
    np.testing.assert_array_equal(compared.value, full.estimate.value)
    np.testing.assert_array_equal(compared.covariance, full.errors.base_covariance)
    assert compared.together
    assert (compared.joints, compared.use is None or compared.use in list(Use)) == (("slider",), True)
    assert {export.file for export in compared.exports} == {"parameters.yaml", "model.py"}
    assert all(export.proven and export.there for export in compared.exports)
    assert [(log.name, log.role) for log in compared.logs] == [("log 0-3 s", "train"), ("log 3-4 s", "validation")]
    recordings = [log.recording for log in compared.logs]
    assert all(recordings)
    assert recordings[0] != recordings[1]  # windows of one file
    same = compare_results(compared, compared)
    assert same.shared_training == ("log 0-3 s",)
    assert (same.differs, same.worse, same.p_value) == (False, False, 1.0)


def test_files_that_are_gone_are_said_and_not_needed(folder: Path, tmp_path: Path) -> None:
    moved = tmp_path / "moved"
    shutil.copytree(folder / "out", moved)
    (moved / "model.py").write_text("changed")
    (moved / "parameters.yaml").unlink()
    data = json.loads((moved / "result.json").read_text())
    data["provenance"]["configuration"]["path"] = str(tmp_path / "nowhere" / "identify.yaml")
    (moved / "result.json").write_text(json.dumps(data))
    test_compared = read_compared(moved / "result.json", "moved")
    assert [export.there for export in test_compared.exports] == [False, False]
    assert [log.recording for log in test_compared.logs] == ["", ""]  # its recordings are called otherwise there
    compared = read_compared(folder / "out" / "result.json", "known")
    assert [log.is_same_recording for log in compare_results(compared, test_compared).logs] == [None, None]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda data: data.update(version=7), "identify again"),
        (lambda data: data.update(format="another"), "is no result"),
        (lambda data: data["errors"].update(base_covariance=[[1.0]]), r"errors\.base_covariance: has not the shape"),
        (lambda data: data.update(parameters=3), "parameters"),
        (lambda data: data["parameters"][0].update(value=1e308), "a parameter of 1e"),
    ],
)
def test_what_is_no_result_is_refused(folder: Path, tmp_path: Path, change: Any, words: str) -> None:
    data = json.loads((folder / "out" / "result.json").read_text())
    change(data)
    wrong = tmp_path / "result.json"
    wrong.write_text(json.dumps(data))
    with pytest.raises(InputError, match=words):
        read_compared(wrong, "wrong")


def test_names_are_as_short_as_they_can_be() -> None:
    assert compared_names((Path("/a/monday/result.json"), Path("/a/tuesday/result.json"))) == ("monday", "tuesday")
    assert compared_names((Path("/a/x/result.json"), Path("/b/x/result.json"))) == ("a/x", "b/x")
    assert compared_names((Path("/a/one.json"), Path("/a/two.json"))) == ("one", "two")
    assert compared_names((Path("/a/one.json"), Path("/a/one.json"))) == ("/a/one.json", "/a/one.json")
