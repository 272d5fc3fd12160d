"""Smoothing of columns as a user meets it."""

from pathlib import Path

import numpy as np
import polars as pl
import pytest

from tests.cli.commands import refuse, run, succeed, write_log


class TestSmooth:
    def test_writes_values_and_derivatives(self, tmp_path: Path) -> None:
        log = write_log(tmp_path)
        succeed("smooth", log, "--time", "time", "--column", "pos", "--sigma", "1e-5", "--out", tmp_path / "out")
        table = pl.read_csv(tmp_path / "out" / "smoothed.csv")
        assert table.columns == ["time", "pos", "d_pos", "dd_pos"]
        t = table["time"].to_numpy()
        inner = slice(100, -100)
        assert np.abs(table["d_pos"].to_numpy() - 0.9 * np.cos(3 * t))[inner].max() < 0.01
        assert np.abs(table["dd_pos"].to_numpy() + 2.7 * np.sin(3 * t))[inner].max() < 0.1
        assert "pos" in (tmp_path / "out" / "report.html").read_text()

    @pytest.mark.parametrize(
        ("name", "options", "factor"),
        [
            ("time_ms", (), 1000), ("time_s", (), 1), ("time", (), 1), ("time", ("--time-unit", "ms"), 1000),
            ("time_ms", ("--time-unit", "s"), 1),
        ],
    )  # fmt: skip
    def test_derivatives_are_per_second_whatever_the_unit_of_the_time(
        self, tmp_path: Path, name: str, options: tuple[str, ...], factor: int
    ) -> None:
        log = write_log(tmp_path)
        pl.read_csv(log).with_columns(pl.col("time") * factor).rename({"time": name}).write_csv(log)
        done = succeed("smooth", log, "--time", name, "--column", "pos", *options, "--out", tmp_path / "out")
        assert ("as its name says" in done.output) is (factor > 1 and not options)
        table = pl.read_csv(tmp_path / "out" / "smoothed.csv")
        np.testing.assert_array_equal(table[name], pl.read_csv(log)[name])
        result = table["d_pos"].to_numpy() - 0.9 * np.cos(3 * table[name].to_numpy() / factor)
        assert np.abs(result[100:-100]).max() < 0.01

    def test_dates_are_read_in_seconds(self, tmp_path: Path) -> None:
        log = write_log(tmp_path)
        day = pl.datetime(2024, 5, 1, 12, 0, 0)
        stamps = (
            (day + pl.duration(microseconds=(pl.col("time") * 1e6).round().cast(pl.Int64)))
            .dt.to_string("iso")
            .alias("time")
        )
        pl.read_csv(log).with_columns(stamps).write_csv(log)
        words = ("smooth", log, "--time", "time", "--column", "pos", "--out", tmp_path / "out")
        refuse(*words, "--time-unit", "ms", says="holds dates, times or durations, read in s: not 'ms'")
        assert run(*words).exit_code == 0
        t = pl.read_csv(tmp_path / "out" / "smoothed.csv")["time"].to_numpy()
        assert t[0] == 12 * 3600
        gaps = pl.read_csv(log).with_columns(pos=pl.when(pl.int_range(pl.len()) % 50 > 0).then("pos"))
        gaps.with_columns(none=pl.lit(None, float)).write_csv(log)
        assert f"{-(len(t) // -50)} rows left out" in succeed(*words).output.replace("\n", " ")
        refuse(*words, "--column", "none", says="column 'none' holds no number")
        assert "seconds" not in run(*words, "--time-unit", "h").output

    @pytest.mark.parametrize(
        ("options", "words"),
        [
            (("--time", "tme"), "did you mean 'time'"),
            (("--time", "time", "--column", "poss"), "did you mean 'pos'"),
            (("--time", "time", "--sigma", "-1"), "sigma is -1"),
            (("--time", "pos"), ("log.csv: t[260] = 0.29", "does not exceed t[259] = 0.29")),
            (("--time", "time", "--time-unit", "rad"), "a unit of angle, not of time"),
            (("--time", "time", "--lam", "1", "--rule", "gcv"), "--lam and --rule gcv"),
        ],
    )
    def test_bad_options(self, tmp_path: Path, options: tuple[str, ...], words: str | tuple[str, ...]) -> None:
        refuse("smooth", write_log(tmp_path), *options, "--out", tmp_path / "out", says=words)
        assert not (tmp_path / "out").exists()
