"""Smoothing of columns as a user meets it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import polars as pl
import pytest

from tests.cli.commands import run, write_log


class TestSmooth:
    def test_writes_values_and_derivatives(self, tmp_path: Path) -> None:
        log = write_log(tmp_path)
        done = run("smooth", log, "--time", "time", "--column", "pos", "--sigma", "1e-5", "--out", tmp_path / "out")
        assert done.exit_code == 0, done.output
        table = pl.read_csv(tmp_path / "out" / "smoothed.csv")
        assert table.columns == ["time", "pos", "d_pos", "dd_pos"]
        t = table["time"].to_numpy()
        inner = slice(100, -100)
        assert np.abs(table["d_pos"].to_numpy() - 0.9 * np.cos(3 * t))[inner].max() < 0.01
        assert np.abs(table["dd_pos"].to_numpy() + 2.7 * np.sin(3 * t))[inner].max() < 0.1
        assert "pos" in (tmp_path / "out" / "report.html").read_text()

    @pytest.mark.parametrize(("name", "warned"), [("time_ms", True), ("time_s", False), ("time", False)])
    def test_a_time_named_in_another_unit_is_warned_of(self, tmp_path: Path, name: str, warned: bool) -> None:
        log = write_log(tmp_path)
        pl.read_csv(log).rename({"time": name}).write_csv(log)
        done = run("smooth", log, "--time", name, "--column", "pos", "--out", tmp_path / "out")
        assert done.exit_code == 0, done.output
        assert ("its name says ms" in done.output) is warned

    @pytest.mark.parametrize("rule", ["constraint", "gcv", "reml", "interpolate"])
    def test_rules_on_all_columns(self, tmp_path: Path, rule: str) -> None:
        done = run("smooth", write_log(tmp_path), "--time", "time", "--rule", rule, "--out", tmp_path / "out")
        assert done.exit_code == 0, done.output
        assert len(pl.read_csv(tmp_path / "out" / "smoothed.csv").columns) == 7

    @pytest.mark.parametrize(
        ("options", "words"),
        [
            (("--time", "tme"), "did you mean 'time'"),
            (("--time", "time", "--column", "poss"), "did you mean 'pos'"),
            (("--time", "time", "--sigma", "-1"), "sigma is -1"),
            (("--time", "pos"), "does not exceed"),
            (("--time", "time", "--lam", "1", "--rule", "gcv"), "--lam and --rule gcv"),
        ],
    )
    def test_bad_options(self, tmp_path: Path, options: tuple[str, ...], words: str) -> None:
        done = run("smooth", write_log(tmp_path), *options, "--out", tmp_path / "out")
        assert done.exit_code == 1
        assert words in done.output
        assert not (tmp_path / "out").exists()
