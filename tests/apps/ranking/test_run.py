"""A comparison from a configuration to its ranking: what takes part, what fails, what is kept."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import dynident as dy
from dynident.apps.ranking import CombinationOutcome, Ranking, compare
from dynident.apps.ranking.config import estimator_candidates, smoother_candidates
from dynident.apps.ranking.report import ranking_findings
from dynident.apps.ranking.run import _unfinished_row
from dynident.apps.ranking.task import find_common_samples
from dynident.estimators import LinearEstimator
from dynident.models.lagrangian import slider
from dynident.motion.smoothers import TimeShifted
from dynident.project.config import parse_config
from dynident.project.settings import Config
from dynident.runtime import ConfigError, InputError, Step, progress_to
from dynident.runtime.families import ESTIMATORS, SMOOTHERS
from dynident.runtime.jobs import JobResult, Status
from tests.apps.ranking.made import (
    CONFIG,
    Counting,
    Greedy,
    Halved,
    Lacking,
    OnMonday,
    Raising,
    Stuck,
    Whole,
    make_project,
)
from tests.kept import check_kept, facts

BODIES = dy.read_robot(Path(__file__).parents[3] / "src/dynident/apps/demo/files/arm.urdf")


def config(more: str = "", smoother: str = "{ kind: spline }") -> Config:
    return parse_config(CONFIG.replace("{ kind: spline }", smoother) + more)


def names(arm_ranking: tuple[object, ...]) -> list[str]:
    return [x.name for x in arm_ranking]  # type: ignore[attr-defined]


@pytest.mark.parametrize("status", Status)
def test_the_row_of_a_job_without_a_value_says_what_became_of_it(status: Status) -> None:
    row = _unfinished_row(("log", "s", "e"), JobResult(1, None, status, "why", 2.5))
    assert row["status"] == ("failed" if status is Status.OK else status.value)
    assert (row["reason"], row["seconds"]) == ("why", 2.5)


def test_all_that_need_no_settings_take_part_the_configured_one_first() -> None:
    result = smoother_candidates(config())
    assert result[0].is_configured
    assert result[0].name == "spline (rule constraint)"
    assert set(names(result[1:])) == set(SMOOTHERS.kinds()) - {"time_shifted"}
    usual = smoother_candidates(config(smoother="{ kind: spline, rule: torque }"))
    assert names(usual)[0] == "spline"
    assert len(usual[0].parts) > 1
    assert len(usual) == len(result) - 1
    assert (
        names(smoother_candidates(config(smoother="{ kind: spline, rule: torque, ends: 50 }"), []))[0]
        == "spline (ends 50)"
    )


def test_linear_estimators_are_made_consistent_where_there_are_bodies() -> None:
    result = estimator_candidates(config(), BODIES)
    linear = [x.part for x in result if isinstance(x.part, LinearEstimator)]
    assert "consistent+least_squares" in names(result)
    assert sum(name.startswith("consistent+") for name in names(result)) == len(linear)
    plain = estimator_candidates(config(), slider())
    assert not [name for name in names(plain) if name.startswith("consistent")]
    assert set(names(plain)) == set(ESTIMATORS.kinds()) - {"consistent"}


def test_kinds_parts_and_settings_may_be_given() -> None:
    given = estimator_candidates(
        config(), BODIES, ["consistent+least_squares", "consistent", dy.LeastSquares(weights="per_joint")]
    )
    assert names(given) == [
        "least_squares", "consistent+least_squares", "consistent", "least_squares (weights per_joint)",
    ]  # fmt: skip
    assert names(smoother_candidates(config(), [Greedy(), Greedy()])) == ["spline (rule constraint)", "Greedy"]
    section = "compare: { smoothers: [butterworth, { kind: spline, ends: 9 }], estimators: [maximum_likelihood] }\n"
    assert names(smoother_candidates(config(section)))[1] == "butterworth"
    assert names(estimator_candidates(config(section), BODIES)) == ["least_squares", "maximum_likelihood"]
    assert names(smoother_candidates(config(section), ["difference"]))[1:] == ["difference"]


def test_kinds_that_cannot_be_compared_are_said() -> None:
    with pytest.raises(ConfigError, match="'time_shifted' needs settings; give them in the section `compare`"):
        smoother_candidates(config(), ["time_shifted"])
    with pytest.raises(ConfigError, match="'maximum_likelihood' is not linear in the parameters"):
        estimator_candidates(config(), BODIES, ["consistent+maximum_likelihood"])
    with pytest.raises(ConfigError, match=r"compare.estimators\[0\]"):
        config("compare: { estimators: [nothing] }\n")


TIMES = ("seconds",)
FEW: dict[str, Any] = {"smoothers": [dy.Difference("central")], "estimators": ["least_squares", Halved()], "folds": 2}


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The configuration of a slider."""
    return make_project(tmp_path_factory.mktemp("slider"))


@pytest.fixture(scope="module")
def arm_ranking(project: Path) -> Ranking:
    """A small comparison."""
    return compare(project, **FEW)


def numbers(arm_ranking: Ranking) -> list[tuple[Any, ...]]:
    return arm_ranking.frame().drop(TIMES).rows()


def test_the_combination_of_the_configuration_has_the_errors_of_identify(tmp_path: Path) -> None:
    project = make_project(tmp_path, more="min_speed: 0.5\n")
    ranking = compare(project, smoothers=[], estimators=[], folds=0)
    configured_entry = ranking.configured_entry
    assert ranking.block * ranking.blocks == pytest.approx(8.0, rel=0.01)  # the drawn blocks make up the held-out log
    errors = {validation.role: validation.errors for validation in dy.run(project).validations}
    assert configured_entry.held_out == pytest.approx(errors["validation"].per_joint, rel=1e-12)
    assert configured_entry.same_motion == pytest.approx(errors["validation"].per_joint, rel=1e-12)
    assert configured_entry.training == pytest.approx(errors["train"].per_joint, rel=1e-12)
    assert configured_entry.overall == pytest.approx(errors["validation"].relative_error, rel=1e-12)
    assert configured_entry.cross_validated == {}


def test_a_smoother_is_used_as_it_was_chosen_of_several(tmp_path: Path) -> None:
    path = make_project(tmp_path)
    path.write_text(path.read_text().replace("{ kind: spline }", "{ kind: spline, rule: torque }"))
    chosen, shifted = compare(path, smoothers=[TimeShifted(dy.Spline(), 1e-3)], estimators=[], folds=0).smoothers
    (part,) = chosen.parts
    assert part == dy.run(path).recipe.smoothers[0]
    assert part != smoother_candidates(config(smoother="{ kind: spline, rule: torque }"))[0].parts[0]
    assert shifted.parts == (TimeShifted(dy.Spline(), 1e-3),)


def test_each_smoother_has_its_own_time_offset(tmp_path: Path) -> None:
    """Torques are logged one sample late, and forward differences are half a sample early."""
    path = make_project(tmp_path)
    for day in ("monday", "tuesday"):
        table = np.loadtxt(tmp_path / f"{day}.csv", delimiter=",", skiprows=1)
        table[1:, 2] = table[:-1, 2]
        np.savetxt(tmp_path / f"{day}.csv", table, delimiter=",", header="t,x,f", comments="")
    path.write_text(
        path.read_text().replace("time_offset: 0", "time_offset: estimate").replace("kind: spline", "kind: difference")
    )
    first, second = compare(path, smoothers=[dy.Spline()], estimators=[], folds=0).offsets.values()
    path.write_text(path.read_text().replace("kind: difference", "kind: spline"))
    (own,) = compare(path, smoothers=[], estimators=[], folds=0).offsets.values()
    assert second == own
    assert own == pytest.approx(-0.01, abs=3e-3)
    assert abs(first - own) > 1e-3


def test_a_controller_that_did_not_run_is_said(tmp_path: Path) -> None:
    loop = "simulation: { kind: pd, joints: { slider: { reference: { column: x, unit: m }, kp: 10, kd: 1 } } }\n"
    comparison = compare(make_project(tmp_path, more=loop), smoothers=[], estimators=[], folds=0)
    assert [(finding.source, finding.joint, finding.topic) for finding in comparison.findings] == [
        ("monday", "slider", "loop")
    ]
    assert comparison.forbidding_findings == ()


def test_combinations_are_ranked_and_worse_ones_told(arm_ranking: Ranking) -> None:
    assert arm_ranking.basis == "validation"
    assert arm_ranking.has_enough_blocks
    assert [standing.combination.estimator for standing in arm_ranking.standings] == ["least_squares"] * 2 + [
        "Halved"
    ] * 2
    assert arm_ranking.best is arm_ranking.standings[0]
    assert [x.is_worse for x in arm_ranking.standings[2:]] == [True, True]
    assert all(40.0 < x.error < 60.0 for x in arm_ranking.standings[2:])
    assert arm_ranking.choice in arm_ranking.within_chance
    for standing in arm_ranking.standings:
        assert standing.cross_validated["slider"] == pytest.approx(standing.training["slider"], rel=0.1)
        assert 1.0 <= standing.condition < 10.0
    difference = arm_ranking.standings[-1].error - arm_ranking.standings[0].error
    low, high = arm_ranking.standings[-1].interval
    assert low < difference < high
    check_kept("compared", "\n".join(line for row in numbers(arm_ranking) for line in facts(list(row))))


def test_what_fails_is_a_row_and_what_lacks_something_is_listed(project: Path, arm_ranking: Ranking) -> None:
    more = {**FEW, "estimators": [*FEW["estimators"], Raising(), Lacking(), Whole(700)]}
    more["smoothers"] = [*FEW["smoothers"], Stuck()]
    all_of_them = compare(project, **more)
    assert [
        standing.error
        for standing in all_of_them.standings
        if standing.combination.estimator in ("least_squares", "Halved")
    ] == [standing.error for standing in arm_ranking.standings]
    raising = next(failure for failure in all_of_them.failures if failure.combination.estimator == "Raising")
    assert raising.reason.endswith("ZeroDivisionError: no estimate of slider")
    stuck = [failure for failure in all_of_them.failures if failure.combination.smoother == "Stuck"]
    assert {x.reason for x in stuck} == {"monday: nothing is smooth enough"}
    assert [(x.smoother, x.estimator, x.reason) for x in all_of_them.absent] == [
        ("", "Lacking", "monday: has no controller; give its gains.")
    ]
    full = next(
        standing for standing in all_of_them.standings if standing.combination.estimator == "Whole (samples 700)"
    )
    assert full.reason == "cross-validation: too few samples"


def test_a_smoother_that_leaves_out_nearly_all_takes_nothing_from_the_others(
    project: Path, arm_ranking: Ranking
) -> None:
    more = compare(project, **{**FEW, "smoothers": [*FEW["smoothers"], Greedy()]})
    assert more.shares == arm_ranking.shares
    assert [standing.error for standing in more.standings] == [standing.error for standing in arm_ranking.standings]
    left = [failure for failure in more.failures if failure.combination.smoother == "Greedy"]
    assert {x.outcome for x in left} == {CombinationOutcome.TOO_FEW}
    assert left[0].reason.startswith("monday: keeps 20 samples, where most smoothers keep 7")


def test_a_substitute_of_a_smoother_is_told_and_has_the_same_parameters(project: Path, arm_ranking: Ranking) -> None:
    more = compare(project, smoothers=[OnMonday()], estimators=["least_squares"], folds=0)
    assert arm_ranking.substituted_smoothers == ()
    assert more.substituted_smoothers == ("OnMonday",)
    assert any(
        ranking_finding.startswith("OnMonday does not apply to all motion")
        for ranking_finding in ranking_findings(more)
    )
    case = next(standing for standing in more.standings if standing.combination.smoother == "OnMonday")
    central = arm_ranking.standings[0]
    assert case.same_motion["slider"] == pytest.approx(central.same_motion["slider"], rel=1e-2)
    assert case.error > 1.1 * central.error


def test_without_a_held_out_log_the_training_ranks(tmp_path: Path) -> None:
    config = make_project(tmp_path, held_out=False)
    comparison = compare(config, **FEW)
    assert comparison.basis == "train"
    assert [standing.combination.estimator for standing in comparison.standings] == ["least_squares"] * 2 + [
        "Halved"
    ] * 2
    assert comparison.standings[0].held_out == comparison.standings[0].same_motion == {}
    assert comparison.standings[0].error == pytest.approx(comparison.standings[0].cross_validated["slider"], rel=1e-12)
    with pytest.raises(InputError, match="no log is held out, and without cross-validation there is nothing to rank"):
        compare(config, **{**FEW, "folds": 0})


def test_short_logs_do_not_tell_differences_from_chance(tmp_path: Path) -> None:
    comparison = compare(make_project(tmp_path, seconds=0.3), **{**FEW, "smoothers": [], "folds": 0})
    assert not comparison.has_enough_blocks
    assert comparison.within_chance == comparison.standings[:1]
    assert np.isnan(comparison.standings[1].p_value)


def test_a_log_that_repeats_the_training_is_named(tmp_path: Path) -> None:
    path = make_project(tmp_path, held_out=False, more="validation: [{ file: monday.csv, name: again }]\n")
    assert compare(path, smoothers=[], estimators=[], folds=0).repeats == (("again", "monday"),)


def test_rows_are_kept_and_a_stopped_run_goes_on(project: Path, arm_ranking: Ranking, tmp_path: Path) -> None:
    out = tmp_path / "out"

    def stop(step: str) -> None:
        case = Step.of(step)
        if case.words == "estimating" and case.completed == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt) as stopped, progress_to(stop):
        compare(project, out, **FEW)
    assert "Finished rows are kept in" in stopped.value.__notes__[0]
    again = compare(project, out, **FEW)
    assert again.computed == 1
    assert numbers(again) == numbers(arm_ranking)
    for _ in range(2):  # those that fail are tried again
        more = compare(project, out, **{**FEW, "estimators": ["least_squares", Raising()]})
        assert more.computed == 2
    assert compare(project, out, **FEW, rerun=True).computed == 4


def test_estimators_with_the_same_rows_share_them_and_each_counts_their_seconds(project: Path) -> None:
    plain, consistent = Counting(), dy.PhysicallyConsistent(fit=Counting())
    options: dict[str, Any] = {"smoothers": [], "folds": 2}
    Counting.calls.clear()
    both = compare(project, estimators=[plain, consistent], **options)
    shared_calls = list(Counting.calls)
    assert len(shared_calls) == 3  # all samples, and those of two folds
    alone = [compare(project, estimators=[part], **options) for part in (plain, consistent)]
    assert Counting.calls[3:] == 2 * shared_calls
    columns = ["estimator", "error", "overall", "condition"]
    expected = {row for ranking in alone for row in ranking.frame().select(columns).rows()}
    assert set(both.frame().select(columns).rows()) == expected
    assert all(row.seconds_estimate > 0 and row.seconds_validation > 0 for row in both.standings)


def test_a_folder_with_inputs_or_another_report_is_left_alone(project: Path, tmp_path: Path) -> None:
    (tmp_path / "report.html").write_text("mine")
    with pytest.raises(ConfigError, match="is the report of another command"):
        compare(project, tmp_path, **FEW)
    truth = tmp_path / "compare.json"
    truth.write_text('{"M": 5}')
    with pytest.raises((ConfigError, InputError)):
        compare(project, tmp_path, **FEW, truth=truth)
    assert truth.read_text() == '{"M": 5}'


def test_known_truth_gives_errors_and_coverage(project: Path, tmp_path: Path) -> None:
    truth = tmp_path / "truth.yaml"
    names = dy.run(project).estimate.names
    truth.write_text(f"{names[0]}: 5.0\n{names[1]}: 8.0\n")
    comparison = compare(project, **FEW, truth=truth)
    assert comparison.parameters[:2] == names[:2]
    good, bad = comparison.standings[0].truth, comparison.standings[-1].truth
    assert good.over_bound < 5.0 < 50.0 < bad.over_bound
    assert bad.relative == pytest.approx(50.0, abs=2.0)
    assert good.covered == good.count == 2
    assert bad.covered < 2
    with pytest.raises(ConfigError, match="none of its values is of a parameter of the model"):
        compare(project, **FEW, truth={"nothing": 1.0})


@pytest.mark.parametrize(("kept", "left_out"), [(4, False), (3, True)])
def test_a_smoother_that_keeps_half_of_what_most_do_is_compared(kept: int, left_out: bool) -> None:
    motions = {"train": {"one": SimpleNamespace(mask=np.ones(8, bool))}}
    masks = {name: {"train": {"one": np.arange(8) < size}} for name, size in (("a", 8), ("b", 8), ("c", kept))}
    common = find_common_samples(SimpleNamespace(motions=motions), masks)
    assert set(common.excluded) == ({"c"} if left_out else set())
    assert common.kept_shares == {"a": 100.0, "b": 100.0} | ({} if left_out else {"c": 50.0})
