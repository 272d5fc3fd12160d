"""A fleet from its files to its table: what is done once, what fails, what is said."""

import os
import shutil
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

import dynident as dy
from dynident.apps.fleets import FleetResult
from dynident.apps.fleets.fit import LogJob, LogResult
from dynident.files import row_store
from dynident.regression import structural_base_parameters
from dynident.runtime import ConfigError, InputError
from dynident.runtime.jobs import JobResult, Status, local_workers, run_jobs
from tests.apps.fleets.made import FLEET, RECIPE, arm, make_fleet, truth, write_log
from tests.kept import check_kept, facts

LOGS = ["logs/arm-1/2026-01-01.csv", "logs/arm-1/2026-01-02.csv", "logs/arm-2/2026-01-01.csv"]
Result = JobResult[LogJob, LogResult]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A fleet of two robots with three logs, and its results."""
    folder = tmp_path_factory.mktemp("fleet")
    dy.fleet(make_fleet(folder), folder / "out")
    return folder


@pytest.fixture
def fleet(made: Path, tmp_path: Path) -> Path:
    """The same, to be changed: file times are kept."""
    return shutil.copytree(made, tmp_path / "fleet") / "fleet.yaml"


@pytest.fixture
def planned(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The logs that would be identified: none is."""
    seen: list[str] = []

    def nothing(work: object, jobs: Iterable[LogJob], *given: object, **how: object) -> Iterator[Result]:
        seen.extend(job.log.log for job in jobs)
        return iter(())

    monkeypatch.setattr(row_store, "run_jobs", nothing)
    return seen


def table(out: Path) -> pl.DataFrame:
    """All but what differs from run to run."""
    return pl.read_parquet(out / "fleet.parquet").drop("seconds").sort("robot", "date")


def test_base_parameters_are_near_the_truth_for_their_information(made: Path, planned: list[str]) -> None:
    test_fleet = dy.fleet(made / "fleet.yaml", made / "out")
    assert planned == []
    assert test_fleet.rows["log"].to_list() == LOGS
    assert test_fleet.rows["status"].to_list() == ["ok"] * 3
    assert [history.robot for history in test_fleet.histories] == ["arm-1", "arm-2"]
    model, history = arm(made), test_fleet.histories[0]
    error = history.value - structural_base_parameters(model).to_base(truth(model))
    assert history.days.tolist() == [0.0, 1.0]
    distance = np.einsum("ki,kij,kj->k", error, history.information, error) / len(test_fleet.base.names)
    assert (distance < 3.0).all()  # of chi-squared with 10 degrees of freedom, over these
    rows = table(made / "out").drop("stamp", "recipe", strict=False).rows(named=True)
    check_kept("fleet_table", "\n".join(line for row in rows for line in facts({**row}, row["log"])))


def identified_again(result: FleetResult, made: Path) -> set[str]:
    """The logs whose time differs from that of the first run."""
    before = pl.read_parquet(made / "out" / "fleet.parquet")["seconds"].to_list()
    return set(result.rows.filter(~pl.col("seconds").is_in(before))["log"])


def test_new_and_changed_logs_are_identified_no_others_and_one_that_is_gone_stays(fleet: Path, made: Path) -> None:
    write_log(fleet.parent, "arm-1", "2026-01-01", 77)
    write_log(fleet.parent, "arm-3", "2025-12-31", 6)
    (fleet.parent / LOGS[2]).unlink()
    test_fleet = dy.fleet(fleet, fleet.parent / "out")
    assert identified_again(test_fleet, made) == {LOGS[0], "logs/arm-3/2025-12-31.csv"}
    assert test_fleet.identified_count == 2
    assert [len(history.logs) for history in test_fleet.histories] == [2, 1, 1]
    assert test_fleet.histories[0].days.tolist() == [1.0, 2.0]  # since the first log of all
    assert test_fleet.warnings == (f"logs that are gone: {LOGS[2]}; what was found of them stays.",)


def test_rerun_identifies_all_again(fleet: Path, planned: list[str]) -> None:
    dy.fleet(fleet, fleet.parent / "out", rerun=True)
    assert planned == LOGS


def test_logs_that_fail_are_rows_and_the_rest_goes_on(fleet: Path) -> None:
    folder = fleet.parent / "logs" / "arm-1"
    (folder / "2026-01-03.csv").write_text("t,q1,q2\n0,1,2\n")
    (folder / "2026-01-04.csv").write_bytes(os.urandom(1000))
    shutil.copy(folder / "2026-01-01.csv", folder / "monday.csv")
    test_fleet = dy.fleet(fleet, fleet.parent / "out")
    rows = {row["log"].rpartition("/")[2]: row for row in test_fleet.rows.to_dicts() if row["robot"] == "arm-1"}
    assert [rows[name]["status"] for name in ("2026-01-03.csv", "2026-01-04.csv", "monday.csv")] == [Status.FAILED] * 3
    assert "'tau1'" in rows["2026-01-03.csv"]["reason"]
    assert "2026-01-04.csv" in rows["2026-01-04.csv"]["reason"]
    assert "the date 'monday' of logs/arm-1/monday.csv cannot be read" in rows["monday.csv"]["reason"]
    assert (rows["2026-01-02.csv"]["status"], len(test_fleet.histories[0].logs)) == (Status.OK, 2)
    assert dy.fleet(fleet, fleet.parent / "out").identified_count == 3  # what failed is tried again


def test_another_recipe_identifies_all_anew_and_the_old_rows_stay_beside(fleet: Path, planned: list[str]) -> None:
    recipe = fleet.with_name("robot.yaml")
    recipe.write_text(RECIPE.replace("offset]", "offset, spring]"))
    assert len(dy.fleet(fleet, fleet.parent / "out").base.names) == 14
    assert planned == LOGS
    planned.clear()
    recipe.write_text(RECIPE)
    assert len(dy.fleet(fleet, fleet.parent / "out").histories) == 2
    assert planned == []


def test_what_is_changed_in_the_explicit_recipe_or_the_robot_file_holds(fleet: Path, planned: list[str]) -> None:
    explicit = fleet.parent / "out" / "recipe.yaml"
    explicit.write_text(explicit.read_text().replace("time_offset: 0.0", "time_offset: 0.001"))
    dy.fleet(fleet, fleet.parent / "out")
    assert planned == LOGS
    assert "time_offset: 0.001" in explicit.read_text()
    robot = fleet.with_name("arm.urdf")
    robot.write_text(robot.read_text().replace("0.4 0 0", "0.41 0 0"))
    with pytest.raises(ConfigError, match=r"recipe.yaml: was written or changed by hand, and would be replaced"):
        dy.fleet(fleet, fleet.parent / "out")
    assert "time_offset: 0.001" in explicit.read_text()
    explicit.unlink()
    dy.fleet(fleet, fleet.parent / "out")
    assert len(planned) == 6
    assert "time_offset: 0.001" not in explicit.read_text()  # chosen anew
    robot.write_text(robot.read_text().replace("0.41 0 0", "0.42 0 0"))
    dy.fleet(fleet, fleet.parent / "out")  # nor asked for, where nothing was changed by hand
    assert len(planned) == 9


def test_a_recipe_of_somebody_else_in_the_folder_stays(fleet: Path) -> None:
    own = fleet.parent / "mine" / "recipe.yaml"
    own.parent.mkdir()
    own.write_text("mine")
    with pytest.raises(ConfigError, match=r"recipe.yaml: was written or changed by hand"):
        dy.fleet(fleet, own.parent)
    assert own.read_text() == "mine"
    assert {path.name for path in own.parent.iterdir()} == {"recipe.yaml"}


def test_logs_that_are_not_what_they_are_taken_for_are_said(fleet: Path) -> None:
    shutil.copy(fleet.parent / LOGS[0], fleet.parent / "logs" / "arm-2" / "2026-01-09.csv")
    (words,) = dy.fleet(fleet, fleet.parent / "out").warnings
    assert "logs/arm-1/2026-01-01.csv (arm-1) = logs/arm-2/2026-01-09.csv (arm-2)" in words


def test_a_fleet_that_stops_goes_on_where_it_stopped(made: Path, tmp_path: Path, monkeypatch: Any) -> None:
    def stopped(*given: object, **how: object) -> Iterator[Result]:
        result = run_jobs(*given, **how)  # type: ignore[arg-type]
        yield next(result)
        yield next(result)
        raise InputError("a worker has died.")

    monkeypatch.setattr(row_store, "run_jobs", stopped)
    with pytest.raises(InputError, match=r"a worker has died\. Finished rows are kept in"):
        dy.fleet(made / "fleet.yaml", tmp_path / "out")
    monkeypatch.setattr(row_store, "run_jobs", run_jobs)
    with local_workers(1) as executor:  # whatever computes it
        assert dy.fleet(made / "fleet.yaml", tmp_path / "out", executor=executor).identified_count == 1
    assert table(tmp_path / "out").equals(table(made / "out"))


def test_gains_and_models_may_differ_by_robot(fleet: Path, made: Path) -> None:
    changes = "robots: { arm-2: { type: old, torque: { elbow: { offset: 2 } }, model: { base_tilt: [0.001, 0] } } }\n"
    fleet.write_text(FLEET + changes)
    test_fleet = dy.fleet(fleet, fleet.parent / "out")
    assert identified_again(test_fleet, made) == {LOGS[2]}
    assert test_fleet.types == {"robot": ("arm-1",), "old": ("arm-2",)}
    offset = test_fleet.base.names.index("offset_elbow")
    assert [history.value[0, offset] for history in test_fleet.histories] == pytest.approx([0.1, 2.1], abs=0.05)


def test_robots_with_other_parameters_cannot_be_compared(fleet: Path) -> None:
    end = '<axis xyz="0 1 0"/></joint></robot>'
    robot = fleet.with_name("arm.urdf").read_text()
    fleet.with_name("turned.urdf").write_text(robot.replace(end, end.replace("0 1 0", "1 0 0")))
    fleet.write_text(FLEET + "robots: { arm-2: { model: turned.urdf } }\n")
    test_fleet = dy.fleet(fleet, fleet.parent / "out")
    (reason,) = test_fleet.rows.filter(pl.col("robot") == "arm-2")["reason"]
    assert reason.startswith("robot arm-2: its model has not the base parameters of the recipe: ")
    assert len(test_fleet.histories) == 1


def test_runs_have_reports_in_folders_of_their_own(made: Path, tmp_path: Path) -> None:
    logs = "ARM/day.csv", "arm/day.csv", "arm/day.txt"
    for log in logs:
        (tmp_path / "logs" / log).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(made / LOGS[0], tmp_path / "logs" / log)
    for name in ("robot.yaml", "arm.urdf"):
        shutil.copy(made / name, tmp_path / name)
    listed = [f"logs/{log},{log.partition('/')[0]},2026-01-01," for log in logs]
    (tmp_path / "runs.csv").write_text("\n".join(["log,robot,date,hold_out", *listed]) + "logs/arm/day.csv")
    (tmp_path / "fleet.yaml").write_text("recipe: robot.yaml\ntable: runs.csv\n")
    out = tmp_path / "out"
    rows = dy.fleet(tmp_path / "fleet.yaml", out).rows.to_dicts()
    assert [row["status"] for row in rows] == ["ok"] * 3
    assert len({row["folder"].casefold() for row in rows}) == 3
    assert sorted((len(row["held_out"]), row["verdict"] is None) for row in rows) == [(0, True), (0, True), (2, False)]
    for row in rows:
        assert (out / row["folder"] / "report.html").read_text(encoding="utf-8").startswith("<!DOCTYPE html>")
        assert dy.load(out / row["folder"] / "result.json").provenance.logs[0].path == str(tmp_path / row["log"])
    again = dy.run(out / rows[0]["folder"] / "config.yaml")
    assert again.validations[0].errors.relative_error == rows[0]["error"]


def test_without_a_folder_nothing_is_written(made: Path, tmp_path: Path, planned: list[str]) -> None:
    shutil.copytree(made, tmp_path / "fleet", ignore=shutil.ignore_patterns("out"))
    before = sorted((tmp_path / "fleet").rglob("*"))
    test_fleet = dy.fleet(tmp_path / "fleet" / "fleet.yaml")
    assert (test_fleet.identified_count, planned) == (3, LOGS)
    assert sorted((tmp_path / "fleet").rglob("*")) == before


@pytest.mark.parametrize(
    ("text", "error", "words"),
    [
        ("recipe: none.yaml\nlogs: logs/{robot}/{date}.csv\n", ConfigError, "none.yaml"),
        ("recipe: robot.yaml\nlogs: nothing/{robot}/{date}.csv\n", InputError, "there is no log"),
        (FLEET + "robots: { arm-1: { torque: { elbow: { gian: 2 } } } }\n", ConfigError, "robots.arm-1: torque.elbow"),
        (FLEET + "robots: { arm-1: { zero: { elbow: x } } }\n", ConfigError, "robots.arm-1.zero.elbow"),
    ],
)
def test_wrong_settings_are_refused_before_the_work(fleet: Path, text: str, error: type[Exception], words: str) -> None:
    fleet.write_text(text)
    with pytest.raises(error, match=words):
        dy.fleet(fleet, fleet.parent / "new")
    assert not (fleet.parent / "new").exists()
