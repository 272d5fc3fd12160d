"""Differences and chance by blocks of time, and a ranking in words, tables, figures, and as a page."""

import json
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import dynident as dy
from dynident.apps.ranking import CombinationOutcome, Ranking, ranking_figure
from dynident.apps.ranking import differences as module
from dynident.apps.ranking.differences import _block_length as block_length
from dynident.apps.ranking.differences import differences, joint_errors, mean_error, read_truth
from dynident.apps.ranking.page import ranking_page
from dynident.apps.ranking.report import ranking_dict, ranking_findings, ranking_heading, ranking_tables
from dynident.checks.motion_notes import LoopDiffers
from dynident.project.settings import RobotSettings, robot_settings
from dynident.runtime import ConfigError, Finding, InputError, Remark, Severity
from tests.apps.ranking.made import make_project
from tests.kept import check_kept
from tests.report.rankings import ranking, untold
from tests.robots import joint, link, urdf


def said(result: Ranking) -> list[str]:
    return [ranking_heading(result), *ranking_findings(result)]


def variants() -> Iterator[tuple[str, Ranking]]:
    """Yield rankings in which something is otherwise, with what it is."""
    made = ranking()
    first, second, *others = made.rows
    best = replace(first, eigenvalue=0.1)
    not_own = replace(best, combination=replace(first.combination, is_configured=False))
    own = replace(second, combination=replace(second.combination, is_configured=True))
    near = replace(own, error=3.02, interval=(0.01, 0.029), p_value=0.001, seconds_estimate=0.6)
    fast, quick = replace(second, seconds_estimate=0.05), replace(not_own, seconds_estimate=0.7)
    unsettled = CombinationOutcome.UNSETTLED
    pairs = {
        "an equal is configured": (not_own, replace(own, seconds_estimate=2.0)),
        "an equal is much faster": (not_own, fast),
        "an equal is not much faster": (replace(not_own, seconds_estimate=0.4), fast),
        "the best is configured, and no equal is faster": (best, replace(second, seconds_estimate=2.0)),
        "the faster one is impossible": (best, replace(fast, eigenvalue=-1.0)),
        "the faster one did not converge": (best, replace(fast, outcome=unsettled)),
        "the best did not converge": (replace(best, outcome=unsettled), second),
        "surely less than 1 % worse": (quick, near),
        "perhaps more than 1 % worse": (quick, replace(near, interval=(0.01, 0.031))),
    }
    yield from ((name, replace(made, rows=(*pair, *others))) for name, pair in pairs.items())
    yield "logs are short", untold(replace(made, rows=(quick, near, *others)))
    fourth = replace(others[1], combination=replace(others[1].combination, is_configured=True))
    lost = replace(fourth, error=float("nan"), outcome=CombinationOutcome.FAILED, reason="too short")
    for name, row in (("the configured one is number 4", fourth), ("the configured one has no estimate", lost)):
        yield name, replace(made, rows=(replace(not_own, eigenvalue=None), second, others[0], row, *others[2:]))
    same, crossed = dict.fromkeys(made.joints, 3.0), dict.fromkeys(made.joints, 9.0)
    plain = [replace(row, cross_p_value=1.0, same_motion=same) for row in made.rows]
    for chance in (0.001, 0.05, 0.2):
        doubted = replace(plain[0], cross_validated=crossed, cross_p_value=chance)
        yield f"cross-validation has the best worse by {chance}", replace(made, rows=(doubted, *plain[1:]))
    doubted, worse = replace(doubted, cross_p_value=0.001), replace(plain[1], p_value=0.001)
    yield "cross-validation contradicts, all others are worse", replace(made, rows=(doubted, worse, *plain[2:]))
    reasons = (replace(made.rows[-1], reason=f"reason {k}") for k in range(6))
    yield "many reasons", replace(made, rows=(first, second, *reasons))
    yield "one reason of two", replace(made, absent=(*made.absent, replace(made.absent[0], estimator="others")))
    torque = {**first.held_out, "still": float("nan")}
    yield "a joint has no torque", replace(made, rows=(replace(first, held_out=torque), second, *others))
    yield "a log is repeated", replace(made, repeats=(("tuesday", "monday"),))
    wrong = Finding(Remark("turns <b>the other way</b>"), "elbow", source="monday", severity=Severity.ERROR)
    yield "an error forbids any", replace(made, findings=(wrong,))
    loop = replace(wrong, severity=Severity.WARNING, message=LoopDiffers(0.7))
    yield "the loop differs", replace(made, findings=(loop,))
    yield "nothing is held out, logs are short", untold(ranking(basis="train"))
    yield "none has an estimate", replace(made, rows=made.rows[-1:])


def test_what_to_take_and_why_stays_in_all_situations() -> None:
    lines, usual = list[str](), said(ranking())
    for name, result in variants():
        data = ranking_dict(result)
        marks = [row[-1] for table in ranking_tables(result) for row in table.rows]
        lines.append(f"{name}: take {data['take']}, contradicted by {data['contradicted_by']}, marks {marks}")
        lines += [f"    {line}" for line in said(result) if line not in usual]
    check_kept("ranking_situations", "\n".join(lines))


@pytest.mark.parametrize(("omitted", "words"), [(0, ""), (1, "; 1 more with larger errors")])
def test_a_short_table_says_how_many_are_not_shown(omitted: int, words: str) -> None:
    result = ranking()
    (table,) = ranking_tables(result, len(result.standings) - omitted)
    assert table.caption == f"Ranked by held-out motion{words}"


def test_without_chance_there_are_no_whiskers() -> None:
    figure = ranking_figure(untold(ranking()))
    assert not any("error_x" in x for x in figure.data)
    assert "type" not in figure.layout["xaxis"]


HOSTILE = "<script>alert('x')</script>"


def test_the_badge_tells_what_comes_before_any_ranking_and_names_are_escaped() -> None:
    finding = Finding(Remark(HOSTILE), severity=Severity.ERROR)
    text = ranking_page(replace(ranking(joint=HOSTILE), findings=(finding,)))
    assert "correct first what was found" in text
    assert "yours is among the best" not in text
    assert HOSTILE not in text
    assert "<b>too short</b>" not in text


def test_a_page_without_chance_truth_or_estimates() -> None:
    result = untold(ranking())
    plain = replace(result, rows=tuple(replace(row, truth=None) for row in result.rows), absent=())
    assert "Against the truth" not in ranking_page(plain)
    none = ranking_page(replace(result, rows=result.rows[-1:]))
    assert "By joint" not in none
    assert "no estimate" in none


BLOCKS, JOINTS = 200, 2


def drawn(rng: np.random.Generator, sizes: list[float], memory: float = 0.0) -> np.ndarray:
    """Return sums of squares (R, K, n) of combinations that share most of their error, correlated in time."""

    def noise(shape: tuple[int, ...]) -> np.ndarray:
        white = rng.standard_normal(shape)
        for k in range(1, BLOCKS):
            white[k] = memory * white[k - 1] + np.sqrt(1 - memory**2) * white[k]
        return white

    common = noise((BLOCKS, JOINTS))
    return np.array([size * np.exp(0.5 * common + 0.1 * noise((BLOCKS, JOINTS))) for size in sizes])


def test_errors_are_geometric_means_over_joints_that_have_a_torque() -> None:
    squares, torque = np.array([1.0, 4.0, 9.0]), np.array([100.0, 100.0, 0.0])
    assert joint_errors(squares, torque)[:2] == pytest.approx([10.0, 20.0])
    assert np.isnan(joint_errors(squares, torque)[2])
    assert mean_error(squares, torque) == pytest.approx(200**0.5)


def test_neither_units_nor_a_joint_without_load_change_the_order() -> None:
    """The second joint is all noise (80 %) and tells nothing; the first one is 3 % worse in two of four."""
    rng, torque = np.random.default_rng(5), np.ones((BLOCKS, JOINTS))
    squares = drawn(rng, [1.0] * 4) * [4e-4, 0.64]
    squares[2:, :, 0] *= 1.06
    test_differences = differences(squares, torque, [0] * BLOCKS, np.random.default_rng(0))
    assert (test_differences.p_value[2:] < 0.05).all()
    gain = np.array([1.0, 1e6])
    other = differences(squares * gain, torque * [1.0, 7.0], [0] * BLOCKS, np.random.default_rng(0))
    assert other.p_value == pytest.approx(test_differences.p_value, abs=1e-12)


def test_of_exact_data_rounding_does_not_decide() -> None:
    torque = np.ones(2)
    assert mean_error(np.array([[1e-4, 1e-30], [1e-4, 1e-20]]), torque).tolist() == pytest.approx([1e-2, 1e-2])


@pytest.mark.parametrize("memory", [0.0, 0.7])
def test_the_truly_best_are_seldom_called_worse(monkeypatch: pytest.MonkeyPatch, memory: float) -> None:
    """All are equally good, and each may be called worse in 5 % of cases: of 40 x 4 that is 8, and at most 17 with
    99.9 % where they are independent."""
    monkeypatch.setattr(module, "DRAWS", 400)
    rng, torque = np.random.default_rng(1), np.ones((BLOCKS, JOINTS))
    wrong = told = 0
    for _ in range(40):
        test_differences = differences(drawn(rng, [1.0] * 4, memory), torque, [0] * BLOCKS, rng)
        wrong, told = wrong + int((test_differences.p_value < 0.05).sum()), told + test_differences.has_enough_blocks
    assert told >= 30
    assert wrong <= 17


def test_a_true_difference_is_found_however_many_there_are() -> None:
    rng = np.random.default_rng(2)
    squares = drawn(rng, [1.0, 1.0, *np.linspace(1.3, 3.0, 40)], memory=0.5)
    test_differences = differences(squares, np.ones((BLOCKS, JOINTS)), [0] * 120 + [1] * 80, rng)
    assert (test_differences.p_value[2:] < 0.05).all()
    assert (test_differences.p_value[:2] > 0.05).all()
    assert (test_differences.interval[2:, 0] > 0).all()
    assert test_differences.interval[int(np.argmin(test_differences.error))].tolist() == [0.0, 0.0]


def test_blocks_are_as_long_as_the_correlation() -> None:
    rng = np.random.default_rng(3)
    white = rng.standard_normal(400)
    slow = np.convolve(white, np.ones(12) / 12, mode="same")
    assert block_length(white) <= 4
    assert block_length(slow) >= 10
    assert block_length(np.ones(50)) == 1


def test_too_few_blocks_tell_nothing() -> None:
    rng = np.random.default_rng(4)
    test_differences = differences(drawn(rng, [1.0, 2.0])[:, :8], np.ones((8, JOINTS)), [0] * 8, rng)
    assert not test_differences.has_enough_blocks
    assert np.isnan(test_differences.p_value).all()
    alone = differences(drawn(rng, [1.0]), np.ones((BLOCKS, JOINTS)), [0] * BLOCKS, rng)
    assert alone.p_value.tolist() == [1.0]
    same = drawn(rng, [1.0])
    twins = differences(np.concatenate([same, same]), np.ones((BLOCKS, JOINTS)), [0] * BLOCKS, rng)
    assert twins.p_value.tolist() == [1.0, 1.0]


def test_intervals_of_a_difference_hold_also_of_few_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    """In 95 % of the cases at least: few blocks scatter too little, and as if there were many it would be 92 %."""
    monkeypatch.setattr(module, "DRAWS", 400)
    rng, few, inside = np.random.default_rng(6), 14, []
    true = 100.0 * (np.sqrt(1.2) - 1.0) * np.exp((0.5**2 + 0.1**2) / 4)
    for _ in range(60):
        full = drawn(rng, [1.0, 1.2])
        for part in np.split(full[:, : BLOCKS // few * few], BLOCKS // few, axis=1):
            test_differences = differences(part, np.ones((few, JOINTS)), [0] * few, rng)
            if test_differences.has_enough_blocks:
                low, high = test_differences.interval[1]
                inside.append(low < true < high)
    assert len(inside) > 250
    assert 0.94 < np.mean(inside) < 0.99  # twice as wide, it would be all


ARM = Path(__file__).parents[3] / "src/dynident/apps/demo/files/arm.urdf"


def test_values_are_read_from_yaml_results_and_robot_files(tmp_path: Path) -> None:
    assert read_truth({"M": 5}, tmp_path, "gallery:slider") == {"M": 5.0}
    (tmp_path / "truth.yaml").write_text("M: 5\nFv: 8.0\n")
    assert read_truth("truth.yaml", tmp_path, "gallery:slider") == {"M": 5.0, "Fv": 8.0}
    (tmp_path / "parameters.yaml").write_text("parameters:\n- {name: M, value: 5.5, unit: kg}\n")
    assert read_truth("parameters.yaml", tmp_path, "gallery:slider") == {"M": 5.5}
    outcome = dy.run(make_project(tmp_path))
    outcome.save(tmp_path / "result.json")
    values = read_truth("result.json", tmp_path, "gallery:slider")
    assert values == pytest.approx(dict(zip(outcome.estimate.names, outcome.estimate.value.tolist(), strict=True)))


def test_a_robot_file_has_bodies_friction_and_rotors(tmp_path: Path) -> None:
    text = ARM.read_text().replace('velocity="', 'velocity="', 1)
    (tmp_path / "true.urdf").write_text(text)
    shutil.copytree(ARM.parent / "meshes", tmp_path / "meshes")
    spec = robot_settings(str(ARM), {"folder": ARM.parent})
    assert isinstance(spec, RobotSettings)
    values = read_truth("true.urdf", tmp_path, spec)
    model = dy.read_robot(ARM)
    reference = {parameter.name: parameter.value for parameter in model.parameters if parameter.value is not None}
    assert {name: values[name] for name in reference} == pytest.approx(reference)
    assert all(values[name] or name in reference for name in values), "zeros are no truth of friction"
    with pytest.raises(ConfigError, match="is a robot file, and the model is none"):
        read_truth("true.urdf", tmp_path, "gallery:slider")


@pytest.mark.parametrize(
    "text", ["M: heavy\n", "- 5\n", "M: .nan\n", "parameters: [{name: M}]\n", "parameters: [3]\n", f"M: {10**400}\n"]
)
def test_what_is_no_list_of_values_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "truth.yaml").write_text(text)
    with pytest.raises(ConfigError, match=r"truth\.yaml"):
        read_truth("truth.yaml", tmp_path, "gallery:slider")
    (tmp_path / "truth.json").write_text(json.dumps({"M": 5}))
    with pytest.raises((ConfigError, InputError)):
        read_truth("truth.json", tmp_path, "gallery:slider")


def test_zeros_that_a_file_writes_are_no_truth_of_friction(tmp_path: Path) -> None:
    parts = link("base"), link("upper", 2.0, (0.15, 0, 0.02)), link("fore", 1.0, (0, 0.0, 0.03))
    joints = (
        joint("shoulder", "revolute", "base", "upper", inside='<dynamics damping="0" friction="0.0"/>'),
        joint("elbow", "revolute", "upper", "fore", inside='<dynamics damping="0.5" friction="0"/>'),
    )
    (tmp_path / "true.urdf").write_text(urdf(*parts, *joints))
    spec = robot_settings("true.urdf", {"folder": tmp_path})
    assert isinstance(spec, RobotSettings)
    for terms in (("auto",), ("viscous", "coulomb", "rotor", "offset")):
        values = read_truth("true.urdf", tmp_path, spec.model_copy(update={"terms": terms}))
        assert {name: value for name, value in values.items() if "." not in name} == {"Fv_elbow": 0.5}
        assert values["fore.mx"] == 0.0


def test_a_truth_is_numbers_however_they_are_written(tmp_path):
    (tmp_path / "truth.yaml").write_text(f"M: 1e-3\nFv: {-(2**63) - 1}")
    assert read_truth("truth.yaml", tmp_path, "gallery:slider") == {"M": 1e-3, "Fv": float(-(2**63) - 1)}
