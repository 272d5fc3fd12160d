"""The path of a new user with logs of any format: init, check, identify, export, with nothing changed by hand."""

import datetime as dt
import json
from pathlib import Path

import numpy as np
import polars as pl
import pytest
import yaml

from dynident.project.project import read_project
from tests.cli.commands import succeed
from tests.laws.test_new_user import URDF, T, states, truth

NOISE = 0.05  # N m
START = dt.datetime(2024, 5, 1, 23, 59, 58, tzinfo=dt.UTC)  # midnight is in the log


def recorded(rate):
    """Positions and torques (N, 2) of the new user's arm."""
    arm, theta = truth()
    rng = np.random.default_rng(int(10 * rate))
    q, dq, ddq = states(rate)
    tau = arm.torque(q, dq, ddq, theta)
    return q + 1e-5 * rng.standard_normal(q.shape), tau + NOISE * rng.standard_normal(tau.shape)


def moments():
    return [START + dt.timedelta(microseconds=round(1e6 * t)) for t in T]


def csv_with_dates(path, q, tau):
    rows = {"stamp": [moment.isoformat(" ").replace("+00:00", "Z") for moment in moments()]}
    rows |= {f"q{k + 1}": q[:, k] for k in range(2)} | {f"tau{k + 1}": tau[:, k] for k in range(2)}
    pl.DataFrame(rows).write_csv(path)


def parquet_with_dates(path, q, tau):
    rows = {"time": pl.Series(moments(), dtype=pl.Datetime("ns", "UTC"))}
    rows |= {f"q{k + 1}": q[:, k] for k in range(2)} | {f"tau{k + 1}": tau[:, k] for k in range(2)}
    pl.DataFrame(rows).write_parquet(path)


def parquet_with_lists(path, q, tau):
    rows = {"observation.state": q.tolist(), "action": (q + 0.01).tolist(), "observation.effort": tau.tolist()}
    rows |= {"timestamp": T, "frame_index": range(len(T)), "episode_index": [0] * len(T)}
    pl.DataFrame(rows).write_parquet(path)


def parquet_with_structs(path, q, tau):
    arms = [{"position": x.tolist(), "effort": other.tolist()} for x, other in zip(q, tau, strict=True)]
    pl.DataFrame({"time": pl.Series([dt.timedelta(seconds=t) for t in T]), "arm": arms}).write_parquet(path)


def matlab_struct(path, q, tau):
    h5py = pytest.importorskip("h5py", reason='the extra "hdf5" is not installed')
    with h5py.File(path, "w", userblock_size=512) as file:
        group = file.create_group("log")
        group.attrs["MATLAB_class"] = np.bytes_("struct")
        for name, values in {"t": T[:, None], "q": q, "tau": tau}.items():
            group[name] = values.T
            group[name].attrs["MATLAB_class"] = np.bytes_("double")
    with open(path, "r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\0\2IM")


FORMATS = {
    "csv with dates": (csv_with_dates, "csv"),
    "Parquet with dates": (parquet_with_dates, "parquet"),
    "Parquet with lists": (parquet_with_lists, "parquet"),
    "Parquet with structs": (parquet_with_structs, "parquet"),
    "MATLAB 7.3 struct": (matlab_struct, "mat"),
}


RATES = {"monday": 1.0, "tuesday": 1.3}


def draft(folder: Path, write, suffix) -> Path:
    """The configuration that ``init`` drafts from two recordings of a format."""
    (folder / "arm.urdf").write_text(URDF)
    logs = [folder / f"{name}.{suffix}" for name in RATES]
    for path, rate in zip(logs, RATES.values(), strict=True):
        write(path, *recorded(rate))
    succeed("init", folder / "arm.urdf", *logs, "-o", folder / "identify.yaml")
    return folder / "identify.yaml"


@pytest.mark.parametrize(("write", "suffix"), FORMATS.values(), ids=FORMATS)
def test_any_format_is_read_as_drafted(tmp_path: Path, write, suffix):
    """Whole: from here on, no format differs from another."""
    drafted = draft(tmp_path, write, suffix)
    assert yaml.safe_load(drafted.read_text())["time"]["unit"] == "s"
    read, said = read_project(drafted).logs()
    assert said == ()
    ((_, first),) = read["train"].items()
    ((_, second),) = read["validation"].items()
    for log, rate in zip((first, second), RATES.values(), strict=True):
        q, tau = recorded(rate)
        assert log.joints == ("shoulder", "elbow")
        np.testing.assert_allclose(log.t - log.t[0], T, atol=2e-6)  # microseconds
        np.testing.assert_allclose(log.q, q, rtol=1e-12)
        np.testing.assert_allclose(log.tau, tau, rtol=1e-12)


def test_a_log_is_identified_as_drafted(tmp_path: Path):
    drafted, out = draft(tmp_path, *FORMATS["csv with dates"]), tmp_path / "out"
    succeed("check", drafted)
    succeed("identify", drafted, "--out", out)
    result = json.loads((out / "result.json").read_text())
    held_out = next(x for x in result["validations"] if x["role"] == "validation")
    _, tau = recorded(1.3)
    assert held_out["errors"]["relative_error"] < 1.2 * 100 * NOISE * np.sqrt(tau.size) / np.linalg.norm(tau)
    succeed("export", out / "result.json", "--format", "urdf", "--out", tmp_path / "identified.urdf")


def test_several_episodes_in_a_file_are_said(tmp_path: Path):
    (tmp_path / "arm.urdf").write_text(URDF)
    q, tau = recorded(1.0)
    half = len(T) // 2
    rows = {"observation.state": q.tolist(), "observation.effort": tau.tolist(), "timestamp": [*T[:half], *T[:half]]}
    pl.DataFrame(rows | {"episode_index": [0] * half + [1] * half}).write_parquet(tmp_path / "all.parquet")
    told = succeed("init", tmp_path / "arm.urdf", tmp_path / "all.parquet", "-o", tmp_path / "identify.yaml").output
    assert "several recordings, by 'episode_index'? Then write each to a file of its own" in told
