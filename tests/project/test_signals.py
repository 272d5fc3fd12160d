"""The channels of a recording: times that are dates, and several recordings in one file."""

import datetime as dt

import numpy as np
import polars as pl
import pytest

from dynident.models import Joint
from dynident.project.config import parse_config
from dynident.project.logs import read_logs
from dynident.project.signals import unwrap
from dynident.runtime import ConfigError, InputError

SLIDER = (Joint("slider", "prismatic"),)


def dated(folder, unit, **columns):
    t = np.arange(101) * 0.01
    stamps = pl.Series([dt.datetime(2024, 5, 1, 23, 59, 59, 500_000) + dt.timedelta(seconds=x) for x in t])
    pl.DataFrame({"t": stamps, "x": np.sin(t), "u": np.cos(t)} | columns).write_parquet(folder / "a.parquet")
    text = f"""
    model: gallery:slider
    time: {{column: t, unit: {unit}}}
    position: {{slider: {{column: x, unit: m}}}}
    torque: {{slider: {{column: u, unit: N}}}}
    train: [{{file: a.parquet}}]
    """
    config = parse_config(text, folder)
    return read_logs(config.train[0], config, SLIDER).logs[0]


def test_dates_are_in_seconds_and_no_other_unit(tmp_path):
    log = dated(tmp_path, "s")
    np.testing.assert_allclose(log.t - log.t[0], np.arange(101) * 0.01, atol=1e-9)
    with pytest.raises(ConfigError, match=r"time\.unit: 'ms', but column 't' of .* holds dates, times or durations"):
        dated(tmp_path, "ms")


def test_episodes_in_one_file_are_named_where_the_time_runs_back(tmp_path):
    stamps = np.append(np.arange(51), np.arange(50)) * 0.01
    with pytest.raises(InputError, match=r"several recordings, by 'episode_index'\? Then write each to a file"):
        dated(tmp_path, "s", t=stamps, episode_index=[0] * 51 + [1] * 50)
    with pytest.raises(InputError, match=r"several recordings, by 'run'\? Then write each to a file"):
        dated(tmp_path, "s", t=stamps, q_set=stamps, run=["train"] * 51 + ["test"] * 50)
    with pytest.raises(InputError, match=r"such row\); the clock was set back there, or another recording"):
        dated(tmp_path, "s", t=stamps)


def test_a_position_that_starts_anew_is_read_as_it_goes_on(tmp_path):
    counts = np.cumsum(np.full(60, 200.0)) + 900
    rows = "\n".join(f"{k / 100},{x % 1000:.0f},{x % 1000:.0f},1" for k, x in enumerate(counts))
    (tmp_path / "a.csv").write_text(f"t,x,r,u\n{rows}\n")
    text = """
    model: gallery:slider
    time: {column: t, unit: s}
    position: {slider: {column: x, wraps: 1000, gain: 0.1, offset: 2, unit: mm}}
    torque: {slider: {column: u, unit: N}}
    train: [{file: a.csv}]
    simulation: {kind: pd, joints: {slider: {reference: {column: r, wraps: 1000, unit: m}, kp: 9, kd: 1}}}
    """
    config = parse_config(text, tmp_path)
    log = read_logs(config.train[0], config, SLIDER).logs[0]
    np.testing.assert_allclose(log.q[:, 0], (0.1 * (counts - 1000) + 2) * 1e-3)
    np.testing.assert_allclose(log.controller.reference[:, 0], counts - 1000)
    with pytest.raises(ConfigError, match=r"torque\.slider: unknown key 'wraps'"):
        parse_config(text.replace("column: u", "column: u, wraps: 5"), tmp_path)


def test_missing_values_do_not_hide_where_a_position_starts_anew():
    values = unwrap(np.array([350.0, np.nan, 5.0, 20.0]), 360.0)
    np.testing.assert_array_equal(values, [350.0, np.nan, 365.0, 380.0])
