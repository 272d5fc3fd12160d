"""Episodes of LeRobot data sets, of both layouts, are recordings."""

import json
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from numpy.typing import NDArray

from dynident.apps.compare_results.config import _digest_of_file
from dynident.apps.fleets.config import FleetSettings, fleet_logs
from dynident.apps.online.recorded import RecordedFile, is_recorded
from dynident.files.lerobot import episode_files, recordings
from dynident.files.opener import real_path
from dynident.files.tables import read_columns
from dynident.project.settings import LogSpec
from dynident.runtime import InputError, budget_scope, set_budget
from tests.cli.commands import succeed
from tests.files.data_sets import write_data_set
from tests.robots import joint, link, urdf

Array = NDArray[np.float64]
MOTORS = ["shoulder.pos", "elbow.pos"]
NAMES = {"action": MOTORS, "observation.state": MOTORS}


def episodes(count: int = 3, rows: int = 6) -> list[dict[str, Array]]:
    rng = np.random.default_rng(0)
    return [
        {name: np.round(rng.normal(size=(rows + k, 2)), 3).astype(np.float32).astype(float) for name in NAMES}
        for k in range(count)
    ]


@pytest.mark.parametrize("version", ["v2.1", "v3.0"])
def test_each_episode_is_a_recording_with_named_columns(version: str, tmp_path: Path) -> None:
    values = episodes()
    folder = write_data_set(tmp_path / "so101", values, NAMES, version)
    for number in range(3):
        table = read_columns(folder / f"#{number}")
        for feature in NAMES:
            for k, motor in enumerate(("shoulder", "elbow")):
                np.testing.assert_array_equal(table.column(f"{feature}.{motor}"), values[number][feature][:, k])
        assert table.column("timestamp")[0] == 0.0
        assert table.units["timestamp"] == "s"
        assert Path(table.source) == episode_files(folder / f"#{number}")[1]
    needed = read_columns(folder / "#1", needed=["action.elbow"])
    assert list(needed.columns) == ["action.shoulder", "action.elbow"]  # a list is read as one
    assert "observation.state.shoulder" in needed.unread
    assert LogSpec.model_validate({"file": str(folder / "#2")}).label == "so101 #2"


@pytest.mark.parametrize(
    ("names", "columns"),
    [
        (None, ["action[0]", "action[1]"]),
        (["dim"], ["action[0]", "action[1]"]),
        ({"motors": ["m0", "m1"]}, ["action.m0", "action.m1"]),
        (["a.pos", "a"], ["action.a.pos", "action.a"]),
        (["a", "a"], ["action[0]", "action[1]"]),
        (["a.pos", "a.vel"], ["action.a", "action.a.vel"]),
    ],
)
def test_names_of_elements(names: Any, columns: list[str], tmp_path: Path) -> None:
    folder = write_data_set(tmp_path, [{"action": np.zeros((3, 2))}], {"action": names})
    table = read_columns(folder)  # the only episode
    assert [name for name in table.columns if name.startswith("action")] == columns


def test_the_calibration_is_a_scalar_for_gains(tmp_path: Path) -> None:
    folder = write_data_set(tmp_path, episodes(), NAMES)
    path = folder / "meta" / "calibration.json"
    path.write_text(json.dumps({"elbow": {"id": 2, "homing_offset": 7, "range_min": 1000, "range_max": 3048}}))
    # half a turn from end to end
    assert read_columns(folder / "#0").constant("calibration.elbow") * 200 == pytest.approx(180)
    for ends in ({"range_min": 5, "range_max": 5}, {"range_min": "a"}, 3):
        path.write_text(json.dumps({"elbow": ends}))
        with pytest.raises(InputError, match=r"calibration\.json: range_min and range_max of 'elbow' are"):
            read_columns(folder / "#0")


def test_what_is_wrong_is_said(tmp_path: Path) -> None:
    folder = write_data_set(tmp_path / "set", episodes(), NAMES)
    with pytest.raises(InputError, match="has no episode 3; its episodes are 0 to 2"):
        read_columns(folder / "#3")
    with pytest.raises(InputError, match="is a data set of 3 episodes, each a recording: name one"):
        read_columns(folder)
    with pytest.raises(InputError, match=r"is no LeRobot data set, as it has no meta/info\.json"):
        read_columns(tmp_path / "#0")
    (folder / "meta" / "episodes" / "chunk-000" / "file-000.parquet").unlink()
    with pytest.raises(InputError, match="no table in meta/episodes says where episode 1 is"):
        read_columns(folder / "#1")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"codebase_version": "v1.6"}, r"codebase_version 'v1\.6' cannot be read"),
        ({"data_path": "../{chunk_index}.parquet"}, "leads out of the data set"),
        ({"data_path": "/{chunk_index}.parquet"}, "leads out of the data set"),
        ({"data_path": "data/{epsode_index}.parquet"}, r"data_path has \{epsode_index\}"),
        ({"data_path": "{chunk_index.__class__}"}, "there is no such file"),
        ({"total_episodes": "many"}, "total_episodes is 'many'; a whole number is expected"),
        ({"features": []}, "features is '\\[\\]'; a mapping is expected"),
    ],
)
def test_a_wrong_description_is_refused(changes: dict[str, Any], words: str, tmp_path: Path) -> None:
    folder = write_data_set(tmp_path, episodes(), NAMES, **changes)
    with pytest.raises(InputError, match=words):
        read_columns(folder / "#0")


def test_lists_of_unlike_lengths_are_faults_of_their_columns(tmp_path: Path) -> None:
    folder = write_data_set(tmp_path, episodes(1), NAMES, "v2.1")
    file = folder / "data" / "chunk-000" / "episode_000000.parquet"
    frame = pl.read_parquet(file)
    uneven = pl.Series("action", [[1.0, 2.0]] * 5 + [[1.0]])
    frame.with_columns(uneven).write_parquet(file)
    with pytest.raises(InputError, match=r"'action\.elbow' holds lists of 1 or 2 elements; all must have the same"):
        read_columns(folder / "#0").column("action.elbow")
    frame.with_columns(pl.Series("action", [[1.0, 2.0, 3.0]] * 6)).write_parquet(file)
    with pytest.raises(InputError, match=r"'action' holds lists of 3 elements, but meta/info\.json says 2"):
        read_columns(folder / "#0")


def test_an_episode_that_is_not_in_one_piece_is_refused(tmp_path: Path) -> None:
    folder = write_data_set(tmp_path, episodes(), NAMES)
    file = folder / "data" / "chunk-000" / "file-000.parquet"
    frame = pl.read_parquet(file)
    frame.sort("frame_index").write_parquet(file)
    with pytest.raises(InputError, match="the rows of episode 0 lie apart"):
        read_columns(folder / "#0")
    frame.filter(pl.col("episode_index") != 0).write_parquet(file)
    with pytest.raises(InputError, match="has no row of episode 0"):
        read_columns(folder / "#0")


def test_an_episode_of_a_large_file_is_within_the_budget(tmp_path: Path) -> None:
    """Of a file beyond the budget, an episode is read; not one that is itself beyond."""
    values = [{"action": np.zeros((rows, 2))} for rows in (10, 40_000)]
    folder = write_data_set(tmp_path, values, {"action": MOTORS})
    with budget_scope():
        set_budget(0.0015)
        assert len(read_columns(folder / "#0", needed=["action.elbow"]).column("action.elbow")) == 10
        with pytest.raises(InputError, match="of memory, more than"):
            read_columns(folder / "#1", needed=["action.elbow"])


@pytest.mark.parametrize("version", ["v2.1", "v3.0"])
def test_a_damaged_description_is_refused_in_a_sentence(version: str, tmp_path: Path) -> None:
    folder = write_data_set(tmp_path, episodes(2), NAMES, version)
    path, rng = folder / "meta" / "info.json", np.random.default_rng(0)
    test_bytes = path.read_bytes()
    for _ in range(150):
        damaged = bytearray(test_bytes)
        start = int(rng.integers(len(test_bytes)))
        damaged[start : start + int(rng.integers(1, 9))] = rng.bytes(int(rng.integers(0, 9)))
        path.write_bytes(bytes(damaged))
        with suppress(InputError):  # anything else fails
            read_columns(folder / "#1")


def test_a_small_file_that_describes_much_is_refused(tmp_path: Path) -> None:
    many = {f"f{k}": {"shape": [10_000_000]} for k in range(1000)}
    folder = write_data_set(tmp_path / "one", episodes(1), NAMES, features=many)
    with pytest.raises(InputError, match="have more than 100000 elements"):
        read_columns(folder / "#0")
    deep = write_data_set(tmp_path / "two", episodes(1), NAMES)
    (deep / "meta" / "info.json").write_text("[" * 200_000)
    with pytest.raises(InputError, match="is no JSON"):
        read_columns(deep / "#0")


def test_results_of_episodes_of_one_file_are_told_apart(tmp_path: Path) -> None:
    folder = write_data_set(tmp_path, episodes(), NAMES)
    hashes = {str(real_path(file)): "abc" for file in episode_files(folder / "#0")}
    digests = [_digest_of_file(folder / f"#{number}", hashes) for number in (0, 1)]
    assert digests == ["abc abc #0", "abc abc #1"]
    assert _digest_of_file(folder / "#0", {}) == ""
    assert _digest_of_file(tmp_path / "gone" / "#0", hashes) == ""


def test_watching_takes_an_episode_for_a_recording(tmp_path: Path) -> None:
    folder = write_data_set(tmp_path, episodes(), NAMES)
    assert is_recorded(f"{folder}/#1")
    lines, is_fresh, _ = RecordedFile(folder / "#1", {"timestamp", "action.elbow"}, "timestamp").read()
    assert is_fresh
    assert len(lines.splitlines()) == 7


def test_a_folder_stands_for_all_of_its_episodes(tmp_path: Path) -> None:
    name = "arm/2026-11-22"
    write_data_set(tmp_path / name, episodes(2), NAMES)
    expected = [f"{name}/#0", f"{name}/#1"]
    assert recordings([name, "other.csv"], tmp_path) == [*expected, "other.csv"]
    (tmp_path / "logs.csv").write_text(f"log,robot,date\n{name}/#0,arm,2026-11-22\n{name}/#1,arm,2026-11-22\n")
    for source in ({"logs": "{robot}/{date}"}, {"table": "logs.csv"}):
        logs, _ = fleet_logs(FleetSettings.model_validate({"recipe": "recipe.yaml", **source}), tmp_path)
        assert [log.log for log in logs] == expected
        assert all(log.stamp and not log.fault for log in logs)


def test_a_folder_of_many_episodes_is_to_be_divided(tmp_path: Path) -> None:
    folder = write_data_set(tmp_path / "set", episodes(2), NAMES, total_episodes=101)
    with pytest.raises(InputError, match="has 101 episodes; name up to 100"):
        recordings([str(folder)])


def test_init_drafts_all_episodes(tmp_path: Path) -> None:
    t = np.arange(400) / 100
    q = np.column_stack([np.sin(3 * t), np.cos(4 * t)])
    values = [{"observation.state": np.rad2deg(q + k), "observation.effort": q} for k in range(2)]
    write_data_set(tmp_path / "set", values, {"observation.state": MOTORS, "observation.effort": ["shoulder", "elbow"]})
    links = [link("base"), link("upper", 2.0, (0.1, 0, 0)), link("lower", 1.0, (0.1, 0, 0))]
    joints = [joint("shoulder", "revolute", "base", "upper"), joint("elbow", "revolute", "upper", "lower")]
    (tmp_path / "arm.urdf").write_text(urdf(*links, *joints))
    draft = tmp_path / "arm.yaml"
    succeed("init", tmp_path / "arm.urdf", tmp_path / "set", "-o", draft)
    text = draft.read_text()
    assert "column: observation.state.shoulder, unit: deg" in text
    assert "set/#0" in text
    assert text.index("set/#0") < text.index("validation:") < text.index("set/#1")
