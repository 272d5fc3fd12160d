"""The configuration of a fleet: its logs by pattern and by table, their dates and folders, and its recipe."""

import re
import string
from datetime import date, datetime
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

import dynident as dy
from dynident.apps.fleets.config import (
    FleetLog,
    FleetSettings,
    fleet_logs,
    folder_names,
    parse_date,
    read_fleet_settings,
)
from dynident.apps.fleets.fit import information_of, model_of
from dynident.apps.fleets.recipe import FleetRecipe, fleet_recipe
from dynident.files.yaml_text import load_yaml
from dynident.identification import Recipe, identify, tilt_base
from dynident.models import Model
from dynident.motion.log import Log
from dynident.motion.smoothers import Spline
from dynident.motion.splines import GCV
from dynident.regression import structural_base_parameters
from dynident.runtime import ConfigError, InputError
from tests.apps.fleets.made import FLEET, RECIPE, URDF, arm, make_fleet, recording, truth

ODD = ["con", "NUL.txt", "ö" * 100, "x" * 300, "x" * 299, "a\0b", "\ud800", "a.", " "]
NAMES = ["arm", "ARM", "..", ".", "a/b", "a\\b", "a=2Fb", *ODD]
SAFE = set(string.ascii_letters + string.digits + "._-=")


def test_no_two_names_share_a_folder_and_none_leaves_it() -> None:
    usual = ["arm-07", "UR10e_3", "2026-11-22T10.30"]
    assert folder_names(usual) == dict(zip(usual, usual, strict=True))
    result = folder_names(NAMES)
    assert list(result) == NAMES
    assert len({value.casefold() for value in result.values()}) == len(NAMES)
    for case in result.values():
        assert set(case) <= SAFE
        assert 0 < len(case) <= 80
        assert not case.startswith(".")
        assert not case.endswith(".")


LOGS = "logs: logs/{robot}/{date}.csv\n"


def read(folder: Path, text: str) -> FleetSettings:
    (folder / "fleet.yaml").write_text(text)
    return read_fleet_settings(folder / "fleet.yaml")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (LOGS, "recipe: is missing"),
        ("recipe: r.yaml\n", "either `logs`.*or `table`"),
        (f"recipe: r.yaml\n{LOGS}table: t.csv\n", "either `logs`.*or `table`"),
        (f"recipe: r.yaml\n{LOGS}tabel: t.csv\n", "unknown key 'tabel'; did you mean 'table'"),
        (f"recipe: [1]\n{LOGS}", "recipe: a file name is expected"),
        (f"recipe: r.yaml\n{LOGS}false_alarms: 2\n", "false_alarms: a number from 0.0001 to 0.5"),
        (f"recipe: r.yaml\n{LOGS}robots: {{ a: {{ torqe: {{}} }} }}\n", "robots.a: unknown key 'torqe'; did you mean"),
        (f"recipe: r.yaml\n{LOGS}robots: {{ a: {{ model: {{ terms: auto }} }} }}\n", "robots.a: .*those of the recipe"),
        (f"recipe: r.yaml\n{LOGS}window: [3, 1]\n", "window"),
        ("- 1\n", "a mapping"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        read(tmp_path, text)


DAY = datetime(2026, 11, 22)


def settings(**given: Any) -> FleetSettings:
    return FleetSettings.model_validate({"recipe": "robot.yaml", **given})


def touched(folder: Path, *names: str) -> Path:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text("t,q\n")
    return folder


def listed(folder: Path, **given: Any) -> list[FleetLog]:
    return fleet_logs(settings(**given), folder)[0]


def test_a_pattern_has_fields_may_cross_folders_and_name_the_type_or_a_field_twice(tmp_path: Path) -> None:
    touched(tmp_path, "site/a[1]/2026-11-22.csv", "site/b/2026-11-23.csv", "site/b/x/2026-11-23.csv", "site/b/n.txt")
    result = listed(tmp_path, logs="si?e/{robot}/{date}.csv")
    assert [(x.robot, x.date) for x in result] == [("a[1]", DAY), ("b", datetime(2026, 11, 23))]
    assert all(x.stamp and not x.fault for x in result)
    touched(tmp_path, "x/y/ur10_r1_20261122.csv", "ur5_r2_20261122.csv", "a/a-2026-11-22.csv", "a/b-2026-11-22.csv")
    result = listed(tmp_path, logs="**/{type}_{robot}_{date}.csv")
    assert [(x.type, x.robot) for x in result] == [("ur10", "r1"), ("ur5", "r2")]
    assert [x.log for x in listed(tmp_path, logs="{robot}/{robot}-{date}.csv")] == ["a/a-2026-11-22.csv"]


@pytest.mark.parametrize(
    ("pattern", "words"),
    [("{robt}/{date}.csv", "'robt'; did you mean 'robot'"), ("{robot}.csv", "lacks the field {date}")],
)
def test_wrong_fields_are_named(tmp_path: Path, pattern: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        listed(tmp_path, logs=pattern)


def test_a_table_lists_logs_and_its_unknown_columns_are_named(tmp_path: Path) -> None:
    touched(tmp_path, "one.csv", "two.csv")
    rows = ["log,robot,date,operator,holdout", "one.csv,007,2026-11-22,x,", "two.csv,007,2026-11-23,y,one.csv"]
    (tmp_path / "runs.csv").write_text("\n".join([*rows, "no.csv,8,2026-11-22,,"]))
    result, warnings = fleet_logs(settings(table="runs.csv"), tmp_path)
    assert [(x.robot, x.log, bool(x.stamp)) for x in result] == [
        ("007", "one.csv", True), ("007", "two.csv", True), ("8", "no.csv", False)
    ]  # fmt: skip
    assert result[2].fault == "no.csv: there is no such file"
    assert "'holdout' is not used; did you mean 'hold_out'" in warnings[0]  # what may be misspelt comes first
    assert "'operator' is not used" in warnings[1]


def test_a_table_may_be_parquet_with_dates_and_a_held_out_log(tmp_path: Path) -> None:
    touched(tmp_path, "one.csv")
    row = {"log": ["one.csv"], "robot": [7], "date": [date(2026, 11, 22)], "hold_out": ["two.csv"], "type": ["ur5"]}
    pl.DataFrame(row).write_parquet(tmp_path / "runs.parquet")
    (result,) = listed(tmp_path, table="runs.parquet")
    assert (result.robot, result.date, result.hold_out, result.type) == ("7", DAY, "two.csv", "ur5")


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ("file,robot,date\n", "no column 'log'"),
        ("log,robt,date\n", "no column 'robot'; did you mean 'robt'"),
        ("log,robot,date\na.csv,r,today\n", "no date of 1 logs can be read.*'today'.*date_format"),
    ],
)
def test_a_wrong_table_is_refused(tmp_path: Path, table: str, words: str) -> None:
    touched(tmp_path, "a.csv")
    (tmp_path / "runs.csv").write_text(table)
    with pytest.raises(ConfigError, match=words):
        listed(tmp_path, table="runs.csv")


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ("a.csv,,2026-11-22", "row 2 is left out: it has no robot"),
        (",,2026-11-22", "row 2 is left out: it has no log and no robot"),
        ("a.csv,r,2026-11-23", "row 2 is left out: it lists 'a.csv' of robot 'r' again"),
        ("./a.csv,r,2026-11-23", "row 2 is left out: it lists './a.csv' of robot 'r' again"),
        ("nosuch://b/a.csv,r,2026-11-23", "nosuch://b/a.csv: cannot be opened: .*nosuch"),
        ("memory://none/a.csv,r,2026-11-23", "memory://none/a.csv: there is no such file"),
        ("none.csv,r,2026-11-23", "none.csv: there is no such file"),
        ("a\0.csv,r,2026-11-23", "there is no such file"),
        ("b.csv,r,today", "'today' of b.csv cannot be read"),
    ],
)
def test_a_wrong_row_of_a_table_fails_alone(tmp_path: Path, row: str, words: str) -> None:
    touched(tmp_path, "a.csv", "b.csv")
    (tmp_path / "runs.csv").write_text(f"log,robot,date\na.csv,r,2026-11-22\n{row}\nb.csv,s,2026-11-22\n")
    logs, warnings = fleet_logs(settings(table="runs.csv"), tmp_path)
    assert [log.log for log in logs if not log.fault] == ["a.csv", "b.csv"]
    assert re.search(words, "\n".join([*warnings, *(log.fault for log in logs)]))


@pytest.mark.parametrize(
    ("link", "target"),
    [("loop", "."), ("arm-0/up", ".."), ("again", "arm-1"), ("arm-0/peer", "../arm-1"), ("out", "../.."), ("a", "a")],
)
def test_each_real_folder_is_entered_once_and_by_its_own_name(tmp_path: Path, link: str, target: str) -> None:
    names, folder = [f"logs/arm-{k}/2026-11-22.csv" for k in range(3)], tmp_path / "fleet"
    touched(folder, *names)
    (folder / "logs" / link).symlink_to(target, target_is_directory=True)
    (folder / "logs" / "twin").symlink_to(".", target_is_directory=True)  # two links to one folder: 2^40 names
    for pattern in ("**/{robot}/{date}.csv", "**/{robot}/**/{date}.csv", "logs/{robot}/{date}.csv"):
        logs, warnings = fleet_logs(settings(logs=pattern), folder)
        assert [log.log for log in logs] == names
        assert all("links to folders that are listed already" in warning for warning in warnings)


def test_a_folder_behind_a_link_alone_is_entered(tmp_path: Path) -> None:
    touched(tmp_path, "store/7/2026-11-22.csv")
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs" / "arm").symlink_to("../store/7", target_is_directory=True)
    assert [log.robot for log in listed(tmp_path, logs="logs/**/{robot}/{date}.csv")] == ["arm"]


def test_of_the_folder_of_results_only_the_results_are_no_logs(tmp_path: Path) -> None:
    touched(tmp_path, "logs/arm-1/2026-11-22.csv", "runs/arm-1/2026-11-22.csv", "out/runs/arm-1/2026-11-22.csv")
    for out in (tmp_path, tmp_path / "logs", tmp_path / "logs" / "arm-1"):
        assert len(fleet_logs(settings(logs="logs/{robot}/{date}.csv"), tmp_path, out)[0]) == 1
    result, _ = fleet_logs(settings(logs="**/{robot}/{date}.csv"), tmp_path, tmp_path / "out")
    assert [x.log for x in result] == ["logs/arm-1/2026-11-22.csv", "runs/arm-1/2026-11-22.csv"]
    with pytest.raises(InputError, match="no log but those where results are written"):
        fleet_logs(settings(logs="runs/{robot}/{date}.csv"), tmp_path, tmp_path)


def test_no_log_is_an_error_and_robots_without_one_a_warning(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there is no log"):
        listed(tmp_path, logs="{robot}/{date}.csv")
    touched(tmp_path, "arm-1/2026-11-22.csv")
    _, warnings = fleet_logs(settings(logs="{robot}/{date}.csv", robots={"arm1": {"type": "old"}}), tmp_path)
    assert warnings == ("robots: there is no log of arm1; did you mean 'arm-1'?",)


@pytest.mark.parametrize(
    ("text", "meant"),
    [
        ("2026-11-22", DAY),
        ("20261122", DAY),
        ("2026_11_22", DAY),
        ("2026-11-22T10:30", DAY.replace(hour=10, minute=30)),
        ("2026-11-22_10-30-05", DAY.replace(hour=10, minute=30, second=5)),
        ("20261122-103005", DAY.replace(hour=10, minute=30, second=5)),
        ("2026-11-22T12:30:00+02:00", DAY.replace(hour=10, minute=30)),
        (date(2026, 11, 22), DAY),
        ("22.11.2026", None),
        ("2026-13-22", None),
        ("", None),
        (None, None),
    ],
)
def test_dates(text: object, meant: datetime | None) -> None:
    assert parse_date(text) == meant
    assert parse_date(text, "%d.%m.%Y") == (DAY if text in ("22.11.2026", DAY.date()) else None)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a fleet."""
    return make_fleet(tmp_path_factory.mktemp("fleet")).parent


def recipe_of(folder: Path, fleet: str = FLEET, recipe: str = RECIPE) -> FleetRecipe:
    (folder / "robot.yaml").write_text(recipe)
    (folder / "fleet.yaml").write_text(fleet)
    settings = read_fleet_settings(folder / "fleet.yaml")
    logs, _ = fleet_logs(settings, folder)
    return fleet_recipe(settings, logs, folder, None)


def test_a_recipe_is_another_one_where_settings_or_files_differ(folder: Path) -> None:
    (folder / "other.urdf").write_text(URDF)
    (folder / "longer.urdf").write_text(URDF.replace("0.4 0 0", "0.41 0 0"))
    changes = "robots: { same: { model: other.urdf }, long: { model: longer.urdf }, gain: { time_offset: 0.001 } }\n"
    result = recipe_of(folder, FLEET + changes).digests(["", "arm-1", "same", "long", "gain"])
    assert result[""] == result["arm-1"] == result["same"]  # of a file the content counts, and not its name
    assert len(set(result.values())) == 3
    assert recipe_of(folder, FLEET + "window: [0, 3]\n").digest("") not in result.values()


def test_a_robot_file_alone_may_be_the_model(folder: Path) -> None:
    recipe = RECIPE.replace("{ file: arm.urdf, terms: [viscous, coulomb, offset], base_tilt: none }", "arm.urdf")
    changes = "robots: { arm-1: { model: { gravity: [0, 0, -9.8] } } }\n"
    result = recipe_of(folder, FLEET + changes, recipe.replace("estimator", "min_speed: 0.01\nestimator")).of("arm-1")
    assert (result["model"]["file"], result["model"]["gravity"]) == ("arm.urdf", [0, 0, -9.8])
    assert "auto" not in result["model"]["terms"]


@pytest.mark.parametrize(
    ("recipe", "words"),
    [("- 1", "is no configuration"), (RECIPE.replace("time_offset", "time_ofset"), "unknown key 'time_ofset'")],
)
def test_a_wrong_recipe_is_named(folder: Path, recipe: str, words: str) -> None:
    with pytest.raises(ConfigError, match=f"robot.yaml: .*{words}"):
        recipe_of(folder, recipe=recipe)


def test_a_joint_that_is_not_there_is_named_with_its_robot(folder: Path) -> None:
    with pytest.raises(ConfigError, match=r"robots.arm-1: torque: there is no 'elbw'; did you mean 'elbow'"):
        recipe_of(folder, FLEET + "robots: { arm-1: { torque: { elbw: { gain: 2 } } } }\n")


def test_where_no_log_can_be_read_the_first_reason_is_said(tmp_path: Path) -> None:
    folder = make_fleet(tmp_path).parent
    for log in folder.glob("logs/*/*.csv"):
        log.write_text("t,q1\n0,1\n")
    with pytest.raises(InputError, match=r"no log can be read to choose the recipe: .*2026-01-01"):
        recipe_of(folder)


SHOULDER = '<parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>'


def test_a_tilt_of_any_robot_shows_more_of_all(tmp_path: Path) -> None:
    robot = tmp_path / "arm.urdf"
    robot.write_text(URDF.replace(SHOULDER, SHOULDER.replace("0 1 0", "0 0 1")))
    settings = dict(load_yaml(RECIPE, "recipe"))
    turned = {"model": settings["model"] | {"base_tilt": [0.02, 0.01]}}
    level = model_of(FleetRecipe(settings, tmp_path, {}, {}))[1]
    tilted = model_of(FleetRecipe(settings | turned, tmp_path, {}, {}))[1]
    case = model_of(FleetRecipe(settings, tmp_path, {"arm-2": turned}, {}))[1]
    model = dy.read_robot(robot, terms=["viscous", "coulomb", "offset"])
    assert level.rank == structural_base_parameters(model).rank
    assert tilted.rank == structural_base_parameters(tilt_base(model, 0.02, 0.01)).rank > level.rank
    assert case.independent == tilted.independent


GCV_RECIPE = Recipe(Spline(GCV()))


def logged(model: Model, seed: int, *, still: bool = False) -> Log:
    """A recording, in which the elbow may stand still."""
    t = recording(model, truth(model), seed, still=still)
    q, tau = t.select("q1", "q2").to_numpy() * [1, not still], t.select("tau1", "tau2").to_numpy()
    return Log(t["t"].to_numpy(), q, tau, ("shoulder", "elbow"), f"log {seed}")


def test_errors_are_as_large_as_the_information_says(tmp_path: Path) -> None:
    model = arm(tmp_path)
    basis = structural_base_parameters(model)
    true, distances = basis.to_base(truth(model)), []
    for seed in range(6):
        result = identify(model, [logged(model, seed)], recipe=GCV_RECIPE)
        value, information, residual = information_of(result, basis)
        error = value - true
        distances.append(error @ information @ error)
        np.testing.assert_allclose(residual, list(result.validations[0].errors.rmse.values()), rtol=0.05)
    assert 0.6 < np.mean(distances) / basis.rank < 1.5  # chi-squared with 60 degrees of freedom, over these
