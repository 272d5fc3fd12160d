"""The command ``dynident fleet``."""

from pathlib import Path
from unittest.mock import Mock

import fsspec
import polars as pl
import pytest

from dynident.files import row_store
from tests.apps.fleets.made import FLEET, make_fleet
from tests.cli.commands import refuse, run, succeed


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The configuration of a fleet."""
    return make_fleet(tmp_path_factory.mktemp("fleet"))


def test_a_fleet_is_identified_reported_and_known_the_next_time(fleet: Path) -> None:
    out = fleet.with_name("out")
    command = ("fleet", fleet, "--out", out, "--workers", 1)
    (fleet.parent / "logs" / "arm-1" / "2026-02-30.csv").write_text("t\n")
    output = succeed(*command).output
    assert output.splitlines()[-1].startswith("fleet: 4 logs of 2 robots")
    assert "the date '2026-02-30' of logs/arm-1/2026-02-30.csv cannot be read" in " ".join(output.split())
    assert {path.name for path in out.iterdir()} == {"fleet.parquet", "report.html", "recipe.yaml", "fleet.json"}
    output = succeed(*command).output
    assert "Logs identified now: 1; known before: 3." in output
    assert len(output.splitlines()) <= 12
    assert "arm-1  " in succeed(*command, "-v").output  # the table of robots


def test_where_no_log_has_a_result_the_exit_code_says_so(fleet: Path, tmp_path: Path) -> None:
    refuse("fleet", fleet, "--out", tmp_path, "--workers", 1, "--time-limit", 0.001, says="no log has a result: ")
    assert (tmp_path / "report.html").is_file()


def test_logs_of_an_object_store_are_read(fleet: Path, tmp_path: Path) -> None:
    store = fsspec.filesystem("memory")
    for path in fleet.parent.glob("logs/*/2026-01-*.csv"):
        store.put_file(str(path), f"/bucket/{path.parent.name}/{path.name}")
    text = FLEET.replace("logs/", "memory://bucket/").replace("robot.yaml", str(fleet.with_name("robot.yaml")))
    (tmp_path / "fleet.yaml").write_text(text)
    try:
        succeed("fleet", tmp_path / "fleet.yaml", "--out", tmp_path / "out", "--workers", 1)
    finally:
        store.rm("/bucket", recursive=True)
    rows = pl.read_parquet(tmp_path / "out" / "fleet.parquet").sort("robot", "date")
    assert rows["status"].to_list() == ["ok"] * 3
    assert rows["log"][0] == "memory:///bucket/arm-1/2026-01-01.csv"


def test_an_interrupted_fleet_says_where_its_logs_are(
    fleet: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(row_store, "run_jobs", Mock(side_effect=KeyboardInterrupt))
    done = run("fleet", fleet, "--out", tmp_path / "out", "--workers", 1)
    assert done.exit_code == 130
    assert "run the same command again" in done.output
