"""Recordings that stay in their files: planned by footers and stamps, read a few rows at a time."""

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from dynident.models.lagrangian import pendulum
from dynident.project import long_recordings as long_log
from dynident.project.config import parse_config
from dynident.project.long_recordings import LongLog, long_logs
from dynident.project.settings import Config
from dynident.runtime import InputError

JOINTS = pendulum().joints
NAME = JOINTS[0].name
TEXT = f"""
model: gallery:pendulum
time: {{ TIME }}
position: {{ {NAME}: {{ column: q, unit: deg }} }}
torque: {{ {NAME}: {{ column: f, unit: N m }} }}
train: [{{ file: day/*.parquet, name: day MORE }}]
"""
STEP = 0.01


def times(samples: int = 1000) -> np.ndarray:
    return np.arange(samples) * STEP


def config(folder: Path, time: str = "column: t, unit: s", more: str = "", rest: str = "") -> Config:
    text = TEXT.replace("TIME", time).replace("MORE", more) + rest
    return parse_config(text, folder, str(folder / "robot.yaml"))


def write(folder: Path, t: Any, size: int = 300, **columns: Any) -> Path:
    """Parts of ``size`` rows."""
    (folder / "day").mkdir(exist_ok=True)
    full = pl.DataFrame({"t": t, "q": np.rad2deg(np.sin(np.arange(len(t)) * STEP)), "f": np.arange(len(t)) * 1.0})
    full = full.with_columns(**columns)
    for k, start in enumerate(range(0, len(t), size)):
        full[start : start + size].write_parquet(folder / "day" / f"{k}.parquet", row_group_size=100)
    return folder


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Times are looked at 128 at once."""
    monkeypatch.setattr(long_log, "CHUNK", 128)


def opened(given: Config) -> LongLog:
    (result,) = long_logs(given, JOINTS)
    return result


@pytest.mark.usefixtures("small")
@pytest.mark.parametrize("time", ["column: t, unit: s", "rate: 100"])
def test_rows_of_any_parts_are_those_of_the_recording(tmp_path: Path, time: str) -> None:
    content = pickle.loads(pickle.dumps(opened(config(write(tmp_path, times()), time))))
    (stretch,) = content.stretches
    assert (stretch.start, stretch.stop, len(content), content.step) == (0, 1000, 1000, pytest.approx(STEP))
    assert (stretch.begins, stretch.ends) == (0.0, pytest.approx(9.99))
    for rows in (slice(0, 1000), slice(295, 650), slice(10, 20), slice(899, 901)):
        log, kept = content.read(rows)
        np.testing.assert_allclose(log.t, times()[rows])
        np.testing.assert_allclose(log.q[:, 0], np.sin(times()[rows]), atol=1e-15)
        np.testing.assert_array_equal(log.tau[:, 0], np.arange(1000.0)[rows])
        np.testing.assert_array_equal(kept, np.arange(len(log)))


@pytest.mark.usefixtures("small")
def test_gaps_within_and_between_parts_are_said_and_split(tmp_path: Path) -> None:
    t = times()
    t[300:] += 5.0  # between parts
    t[650:] += 2.0  # within one
    t[980:] += 1.0  # too few samples are left after it
    write(tmp_path, t)
    with pytest.raises(InputError, match=r"day: has 3 gaps, the longest from 2.99 to 8 s .*`gaps: split`"):
        opened(config(tmp_path))
    result = opened(config(tmp_path, rest="gaps: split\n"))
    assert [(stretch.start, stretch.stop) for stretch in result.stretches] == [(0, 300), (300, 650), (650, 980)]
    assert [stretch.begins for stretch in result.stretches] == pytest.approx([0.0, 8.0, 13.5])
    assert "has 3 gaps" in result.notes[0]
    assert "20 samples between gaps are too few" in result.notes[1]


@pytest.mark.usefixtures("small")
def test_windows_choose_rows(tmp_path: Path) -> None:
    given = config(write(tmp_path, times()), more=", window: [[1, 2.5], [2.51, 7.005]]")
    assert [(stretch.start, stretch.stop) for stretch in opened(given).stretches] == [(100, 251), (251, 701)]
    with pytest.raises(InputError, match="nothing of the recording is left"):
        opened(config(tmp_path, more=", window: [20, 30]"))


@pytest.mark.usefixtures("small")
def test_repeated_rows_are_left_out(tmp_path: Path) -> None:
    t = times()
    t[500] = t[499]
    write(tmp_path, t, q=pl.when(pl.int_range(1000) == 500).then(0.0).otherwise(pl.lit(0.0)), f=pl.lit(1.0))
    log, kept = opened(config(tmp_path)).read(slice(450, 550))
    np.testing.assert_array_equal(kept, np.delete(np.arange(100), 50))
    assert len(log) == 99


@pytest.mark.usefixtures("small")
def test_dates_count_from_the_first_of_the_recording(tmp_path: Path) -> None:
    start = pl.datetime(2024, 5, 1, 23, 59, 56)
    t = pl.select(pl.datetime_range(start, start + pl.duration(milliseconds=9990), "10ms")).to_series()
    result = opened(config(write(tmp_path, t)))
    (stretch,) = result.stretches
    assert stretch.ends - stretch.begins == pytest.approx(9.99)
    log, _ = result.read(slice(700, 800))
    np.testing.assert_allclose(log.t - stretch.begins, times()[700:800], atol=1e-6)


@pytest.mark.usefixtures("small")
@pytest.mark.parametrize(
    ("change", "words"),
    [
        ((slice(600, None), -4.0), r"2\.parquet: begins at 2 s, before the end of what precedes it \(5.99 s\)"),
        ((slice(640, None), -0.5), r"2\.parquet: column 't': the time runs backwards at row 41 .*; the clock was"),
        ((slice(650, 651), np.nan), r"2\.parquet: column 't' has no valid time at row 51"),
    ],
    ids=["order", "back", "nan"],
)
def test_times_that_do_not_go_on_are_refused(tmp_path: Path, change: tuple[slice, float], words: str) -> None:
    t = times()
    t[change[0]] += change[1]
    with pytest.raises(InputError, match=words):
        opened(config(write(tmp_path, t)))


def test_other_files_cannot_be_read_in_pieces(tmp_path: Path) -> None:
    given = config(write(tmp_path, times()))
    other = given.train[0].model_copy(update={"file": {"": tmp_path / "night.csv"}, "name": "night"})
    with pytest.raises(
        InputError, match=r"night: .* too long for the memory, and .*night\.csv cannot be read in pieces"
    ):
        long_logs(given.model_copy(update={"train": (*given.train, other)}), JOINTS)
