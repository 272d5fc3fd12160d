"""The controller of a recording, as a configuration describes it."""

from __future__ import annotations

import datetime as dt

import numpy as np
import polars as pl
import pytest

from dynident.errors import ConfigError, InputError
from dynident.io.config import parse_config
from dynident.io.logs import read_logs, read_recording
from dynident.io.recipe import build_recipe
from dynident.io.settings import LogSpec
from dynident.models import Joint
from tests.io.files import npz, written

SLIDER = (Joint("slider", "prismatic"),)
CASCADE = """{kind: cascade, joints: {slider: {reference: {column: r, unit: mm}, kp: kp, kv: 3, gain: -2,
                                               saturation: 10, feedforward: {b: extra}}}}"""


def config_of(folder, simulation: str, head: str = ""):
    text = f"""
    model: gallery:slider
    time: {{column: t, unit: s}}
    position: {{slider: {{column: x, unit: m}}}}
    torque: {{slider: {{column: u, unit: N}}}}
    train: [{{file: a.npz}}]
    validation: [{{file: b.npz, window: [[0, 0.4], [0.6, 1]]}}]
    simulation: {simulation}
    {head}
    """
    return parse_config(text, folder)


def recordings(folder, **changes):
    t = np.arange(101) * 0.01
    columns = {"t": t, "x": np.sin(t), "u": np.cos(t), "r": 1000 * np.sin(t), "kp": 20.0, **changes}
    written(folder, "a.npz", npz(**columns))
    written(folder, "b.npz", npz(**columns, extra=np.arange(101.0) / 100))


def test_a_cascade_has_its_gains_and_references_from_the_file(tmp_path):
    recordings(tmp_path)
    config = config_of(tmp_path, CASCADE)
    (log,) = read_logs(config.train[0], config, SLIDER).logs
    drive = log.controller
    assert drive.joints == ("slider",)
    assert drive(0.5, np.array([np.sin(0.5) - 0.01]), np.zeros(1)) == pytest.approx(-2 * 3 * 20 * 0.01)
    assert drive(0.5, np.array([-9.0]), np.zeros(1)) == pytest.approx(-20.0)


def test_feedforward_is_that_of_the_recording_that_has_one_in_all_its_windows(tmp_path):
    recordings(tmp_path)
    config = config_of(tmp_path, CASCADE)
    early, late = read_logs(config.validation[0], config, SLIDER).logs
    for log, t in ((early, 0.2), (late, 0.8)):
        at_rest = log.controller(t, np.array([np.sin(t)]), np.zeros(1))
        assert at_rest == pytest.approx(-2 * t)


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


def test_dates_of_one_file_among_several_are_in_seconds(tmp_path):
    dated(tmp_path, "s")
    table = read_recording(LogSpec(file={"a": tmp_path / "a.parquet", "b": tmp_path / "a.parquet"}))
    assert dict(table.units) == {"a.t": "s", "b.t": "s"}


def test_episodes_in_one_file_are_named_where_the_time_runs_back(tmp_path):
    stamps = np.append(np.arange(51), np.arange(50)) * 0.01
    with pytest.raises(InputError, match=r"several recordings, by 'episode_index'\? Then write each to a file"):
        dated(tmp_path, "s", t=stamps, episode_index=[0] * 51 + [1] * 50)
    with pytest.raises(InputError, match=r"such rows\); sort the rows by time"):
        dated(tmp_path, "s", t=stamps)


def test_a_measured_torque_needs_no_controller(tmp_path):
    recordings(tmp_path)
    config = config_of(tmp_path, "{kind: measured_torque, restart: 0.2}")
    assert read_logs(config.train[0], config, SLIDER).logs[0].controller is None
    assert build_recipe(config).restart == 0.2
    assert build_recipe(config_of(tmp_path, CASCADE)).restart is None


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("slider: {reference", "sledge: {reference", "no joint 'sledge'; did you mean 'slider'"),
        ("unit: mm", "unit: deg", "simulation.joints.slider.reference.unit"),
        ("{b: extra}", "{c: extra}", "there is no recording 'c'"),
        ("saturation: 10", "saturation: -1", "saturation is -1; give a positive number"),
    ],
)
def test_settings_that_do_not_fit(tmp_path, old, new, words):
    recordings(tmp_path)
    config = config_of(tmp_path, CASCADE.replace(old, new))
    with pytest.raises(ConfigError, match=words):
        read_logs(config.train[0], config, SLIDER)


def test_a_controller_behind_gears_is_refused(tmp_path):
    recordings(tmp_path)
    config = config_of(tmp_path, CASCADE, "transmission: {slider: {slider: 5}}")
    with pytest.raises(ConfigError, match="use `kind: measured_torque`"):
        read_logs(config.train[0], config, SLIDER)


@pytest.mark.parametrize(
    ("changes", "old", "new", "words"),
    [
        ({}, "kp: kp", "kp: kq", "simulation.joints.slider.kp: no scalar 'kq'"),
        ({}, "column: r", "column: s", "no column 's'"),
        ({}, "{b: extra}", "extra", "no column 'extra'"),
        ({"r": np.arange(100.0)}, "", "", "the reference of the controller is not one valid number per time stamp"),
        ({"r": np.full(101, np.nan)}, "", "", "the reference of the controller is not one valid number"),
    ],
)
def test_recordings_that_lack_what_the_controller_needs(tmp_path, changes, old, new, words):
    recordings(tmp_path, **changes)
    config = config_of(tmp_path, CASCADE.replace(old, new))
    with pytest.raises(InputError, match=words):
        read_logs(config.train[0], config, SLIDER)


@pytest.mark.parametrize("text", ["{kind: other}", "{restart: 1}", "{kind: measured_torque, restart: 0}"])
def test_kinds_and_values_are_checked(tmp_path, text):
    with pytest.raises(ConfigError, match="simulation"):
        config_of(tmp_path, text)
