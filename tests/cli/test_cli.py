"""The commands as a user meets them: what they print and write, and how they say what is wrong."""

from __future__ import annotations

import hashlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
import yaml
from click.testing import CliRunner, Result

from dynident.cli import main
from tests.saved_results import errors_by_log

EMPS = Path(__file__).parents[3] / "shared" / "data" / "emps"
needs_emps = pytest.mark.skipif(not EMPS.exists(), reason="the EMPS logs are not beside the checkout")


def run(*arguments: object) -> Result:
    return CliRunner().invoke(main, [str(word) for word in arguments])


def write_log(folder: Path, name: str = "log.csv", n: int = 2000, **changes: Any) -> Path:
    """A slider of 5 kg with friction, pushed to and fro; ``changes`` replace columns."""
    t = np.arange(n) * 0.002
    x, dx, ddx = 0.3 * np.sin(3 * t), 0.9 * np.cos(3 * t), -2.7 * np.sin(3 * t)
    force = 5.0 * ddx + 8.0 * dx + 3.0 * np.sign(dx) + 0.5
    rng = np.random.default_rng(0)
    columns = {"time": t, "pos": x + 1e-5 * rng.standard_normal(n), "force": force + 0.01 * rng.standard_normal(n)}
    pl.DataFrame({**columns, **changes}).write_csv(folder / name)
    return folder / name


def settings(**changes: Any) -> dict[str, Any]:
    return {
        "model": "gallery:slider",
        "time": {"column": "time", "unit": "s"},
        "position": {"slider": {"column": "pos", "unit": "m"}},
        "torque": {"slider": {"column": "force", "unit": "N"}},
        "train": [{"file": "log.csv", "window": [0, 3]}],
        "validation": [{"file": "log.csv", "window": [3, 4]}],
        **changes,
    }


def configure(folder: Path, **changes: Any) -> Path:
    path = folder / "identify.yaml"
    path.write_text(yaml.safe_dump(settings(**changes)))
    return path


class TestIdentify:
    def test_recovers_a_simulated_slider(self, tmp_path: Path) -> None:
        write_log(tmp_path)
        done = run("identify", configure(tmp_path), "--out", tmp_path / "out")
        assert done.exit_code == 0, done.output
        result = json.loads((tmp_path / "out" / "result.json").read_text())
        found = {one["name"]: one for one in result["parameters"]}
        for name, true in {"M": 5.0, "Fv": 8.0, "Fc": 3.0, "offset": 0.5}.items():
            assert abs(found[name]["value"] - true) < max(6 * found[name]["std"], 0.02), name
        assert result["estimate"]["rank"] == 4
        train, held = errors_by_log(result, "train"), errors_by_log(result, "validation")
        assert len(train) == len(held) == 1
        for errors in (*train.values(), *held.values()):
            assert errors["relative_error"] < 2.0
            assert errors["relative_error_filtered"] is None
            assert errors["per_joint"].keys() == errors["rmse"].keys() == {"slider"}
        digest = hashlib.sha256((tmp_path / "log.csv").read_bytes()).hexdigest()
        (file,) = result["provenance"]["logs"]
        assert (file["path"], file["sha256"]) == (str(tmp_path / "log.csv"), digest)
        report = (tmp_path / "out" / "report.html").read_text()
        assert digest in report
        assert "http://" not in report.split("<script>")[0]
        assert "slider" in report
        for word in ("M", "Fv", "Fc", "kg", "report.html", "result.json"):
            assert word in done.output

    @pytest.mark.parametrize("smoother", [{"kind": "difference"}, {"kind": "butterworth", "cutoffs": [20, 20, 20]}])
    def test_other_smoothers_and_a_parallel_filter(self, tmp_path: Path, smoother: dict[str, Any]) -> None:
        write_log(tmp_path)
        path = configure(tmp_path, smoother=smoother, filter={"decimate": 5}, train=[{"file": "log.csv"}])
        done = run("identify", path, "--out", tmp_path / "out")
        assert done.exit_code == 0, done.output
        (errors,) = errors_by_log(json.loads((tmp_path / "out" / "result.json").read_text()), "train").values()
        assert errors["relative_error_filtered"] < errors["relative_error"]

    def test_a_model_from_a_file(self, tmp_path: Path) -> None:
        write_log(tmp_path)
        (tmp_path / "mine.py").write_text(
            "from dynident.models import Model\n"
            "from dynident.models import Offset, Viscous\n"
            "from dynident.models import Joint\n"
            "def build():\n"
            "    joints = (Joint('slider', 'prismatic'),)\n"
            "    return Model((Viscous(joints), Offset(joints)), name='mine')\n"
        )
        done = run("identify", configure(tmp_path, model="mine.py:build"))
        assert done.exit_code == 0, done.output
        assert "Fv_slider" in done.output

    @pytest.mark.parametrize("position", [0.0, 0.25, 0.7])
    def test_a_joint_that_does_not_move_is_said(self, tmp_path: Path, position: float) -> None:
        write_log(tmp_path, pos=np.full(2000, position))
        done = run("identify", configure(tmp_path))
        assert done.exit_code == 0, done.output
        assert "slider" in done.output
        assert "never moves" in done.output
        assert "no effect on the torque" in done.output


BAD_LOGS = {
    "a NaN": ({"pos": np.where(np.arange(2000) == 700, np.nan, 0.1 * np.sin(np.arange(2000)))}, ["pos", "702", "nan"]),
    "repeated times": ({"time": np.repeat(np.arange(1000), 2) * 0.004}, ["time", "repeat"]),
    "unsorted times": ({"time": np.arange(2000)[::-1] * 0.002}, ["time", "sort"]),
    "a gap": ({"time": np.arange(2000) * 0.002 + np.where(np.arange(2000) > 600, 0.5, 0.0)}, ["gap", "split"]),
}


class TestBadInput:
    """Each ends with exit code 1, a message that names the wrong thing, no traceback, and nothing written."""

    def check(self, folder: Path, words: list[str], **changes: Any) -> str:
        out = folder / "out"
        out.mkdir()
        (out / "result.json").write_text("old")
        done = run("identify", configure(folder, **changes), "--out", out)
        assert done.exit_code == 1, done.output
        assert isinstance(done.exception, SystemExit)
        assert "Traceback" not in done.output
        for word in words:
            assert word.lower() in done.output.lower(), done.output
        assert [path.name for path in out.iterdir()] == ["result.json"]
        assert (out / "result.json").read_text() == "old"
        return done.output

    @pytest.mark.parametrize("what", BAD_LOGS)
    def test_log(self, tmp_path: Path, what: str) -> None:
        columns, words = BAD_LOGS[what]
        write_log(tmp_path, **columns)
        self.check(tmp_path, ["log.csv", *words])

    def test_too_few_samples(self, tmp_path: Path) -> None:
        write_log(tmp_path, n=12)
        self.check(tmp_path, ["log.csv", "samples"], train=[{"file": "log.csv"}], validation=[])

    def test_empty_file(self, tmp_path: Path) -> None:
        (tmp_path / "log.csv").write_text("")
        self.check(tmp_path, ["log.csv", "empty"])

    def test_truncated_row(self, tmp_path: Path) -> None:
        path = write_log(tmp_path)
        path.write_text(path.read_text()[:30_000].rsplit(",", 1)[0])
        self.check(tmp_path, ["log.csv", "line"])

    def test_missing_file(self, tmp_path: Path) -> None:
        write_log(tmp_path, "logs.csv")
        self.check(tmp_path, ["log.csv", "logs.csv"])

    def test_wrong_column(self, tmp_path: Path) -> None:
        write_log(tmp_path)
        self.check(tmp_path, ["'position'", "pos"], position={"slider": {"column": "position", "unit": "m"}})

    def test_wrong_unit(self, tmp_path: Path) -> None:
        write_log(tmp_path)
        self.check(tmp_path, ["rad", "mm"], position={"slider": {"column": "pos", "unit": "rad"}})

    def test_degrees_declared_as_rad(self, tmp_path: Path) -> None:
        write_log(tmp_path, pos=60 * np.sin(3 * np.arange(2000) * 0.002))
        (tmp_path / "arm.py").write_text(
            "from dynident.models.gallery import pendulum\n\ndef build():\n    return pendulum()\n"
        )
        channels = {
            "position": {"pivot": {"column": "pos", "unit": "rad"}},
            "torque": {"pivot": {"column": "force", "unit": "N m"}},
        }
        self.check(tmp_path, ["deg", "pivot"], model="arm.py:build", **channels)
        degrees = {**channels, "position": {"pivot": {"column": "pos", "unit": "deg"}}}
        assert run("identify", configure(tmp_path, model="arm.py:build", **degrees)).exit_code == 0

    def test_unknown_key(self, tmp_path: Path) -> None:
        self.check(tmp_path, ["smother", "did you mean 'smoother'"], smother={"kind": "spline"})

    def test_unknown_joint(self, tmp_path: Path) -> None:
        write_log(tmp_path)
        self.check(tmp_path, ["slyder", "'slider'"], position={"slyder": {"column": "pos", "unit": "m"}})

    def test_unknown_model(self, tmp_path: Path) -> None:
        self.check(tmp_path, ["slidr", "did you mean 'slider'"], model="gallery:slidr")

    @pytest.mark.parametrize(
        ("body", "words"),
        [
            ("raise RuntimeError('no licence')", ["no licence", "mine.py"]),
            ("return 3", ["Model", "int"]),
            ("return Model((Broken(),))", ["Broken", "the cable is loose"]),
        ],
    )
    def test_a_model_that_raises(self, tmp_path: Path, body: str, words: list[str]) -> None:
        write_log(tmp_path)
        (tmp_path / "mine.py").write_text(
            "from dynident.models import Model\n"
            "from dynident.models import Joint, Parameter\n"
            "class Broken:\n"
            "    joints = (Joint('slider', 'prismatic'),)\n"
            "    parameters = (Parameter('a', 'kg'),)\n"
            "    def regressor(self, q, dq, ddq):\n"
            "        raise ValueError('the cable is loose')\n"
            f"def build():\n    {body}\n"
        )
        self.check(tmp_path, words, model="mine.py:build")

    def test_no_configuration(self, tmp_path: Path) -> None:
        done = run("identify", tmp_path / "missing.yaml")
        assert done.exit_code == 1
        assert "missing.yaml" in done.output

    def test_out_is_a_file(self, tmp_path: Path) -> None:
        write_log(tmp_path)
        (tmp_path / "out").write_text("mine")
        done = run("identify", configure(tmp_path), "--out", tmp_path / "out")
        assert done.exit_code != 0
        assert "Traceback" not in done.output
        assert (tmp_path / "out").read_text() == "mine"


@needs_emps
class TestEmps:
    """The first real log: published M 95.11 kg, Fv 203.5, Fc 20.39; 4.083 % and, on the pulses, 5.982 %."""

    def test_example(self, tmp_path: Path) -> None:
        done = run("identify", Path(__file__).parents[2] / "examples" / "emps.yaml", "--out", tmp_path)
        assert done.exit_code == 0, done.output
        result = json.loads((tmp_path / "result.json").read_text())
        found = {one["name"]: one["value"] for one in result["parameters"]}
        assert found["M"] == pytest.approx(95.11, rel=0.005)
        assert found["Fv"] == pytest.approx(203.5, rel=0.015)
        assert found["Fc"] == pytest.approx(20.39, rel=0.015)
        train, pulses = errors_by_log(result, "train")["DATA_EMPS"], errors_by_log(result, "validation")["pulses"]
        assert train["relative_error_filtered"] <= 4.15
        assert pulses["relative_error_filtered"] <= 6.0
        assert train["relative_error"] == pytest.approx(4.4, abs=0.1)
        assert pulses["relative_error"] == pytest.approx(11.3, abs=0.2)


class TestReproduce:
    def test_prints_writes_and_resumes(self, tmp_path: Path) -> None:
        words = ("reproduce", "--runs", 3, "--out", tmp_path, "--json", tmp_path / "deep" / "r.json")
        done = run(*words)
        assert done.exit_code == 0, done.output
        for table in range(2, 8):
            assert f"Table {table}" in done.output
        assert str(tmp_path / "report.html") in done.output.replace("\n", "")
        first = json.loads((tmp_path / "deep" / "r.json").read_text())
        rows = pl.read_parquet(tmp_path / "study.parquet")
        assert len(rows) == 27
        again = run(*words)
        assert again.exit_code == 0
        assert json.loads((tmp_path / "deep" / "r.json").read_text()) == first
        assert pl.read_parquet(tmp_path / "study.parquet")["seconds"].sum() == rows["seconds"].sum()

    def test_chosen_methods(self, tmp_path: Path) -> None:
        done = run("reproduce", "--runs", 2, "--methods", "spline,raw", "--json", tmp_path / "r.json")
        assert done.exit_code == 0, done.output
        cases = json.loads((tmp_path / "r.json").read_text())["cases"]
        assert [case["method"] for case in cases] == ["spline", "raw"] * 3

    def test_maximum_likelihood_beside_the_bound_by_two_workers(self, tmp_path: Path) -> None:
        words = ("reproduce", "--runs", 1, "--scenario", "stated", "--methods", "spline-early,ml", "--out", tmp_path)
        done = run(*words, "--workers", 2, "--json", tmp_path / "r.json")
        assert done.exit_code == 0, done.output
        for word in ("maximum likelihood", "early-cut splines", "Cramér-Rao bound", "not converged", "least"):
            assert word in done.output
        cases = json.loads((tmp_path / "r.json").read_text())["cases"]
        assert {case["method"] for case in cases} == {"spline-early", "ml"}
        assert all(len(case["bound"]) == len(case["coverage"]) == 7 for case in cases)
        rows = pl.read_parquet(tmp_path / "study.parquet")
        assert run(*words, "--json", tmp_path / "again.json").exit_code == 0  # alone, and nothing left to do
        assert pl.read_parquet(tmp_path / "study.parquet").equals(rows)
        assert (tmp_path / "again.json").read_text() == (tmp_path / "r.json").read_text()

    @pytest.mark.parametrize(
        ("options", "words"),
        [
            (("--scenario", "week"), "did you mean 'weak'"),
            (("--methods", "raw,splin"), "did you mean 'spline'"),
            (("--methods", ","), "no method"),
            (("--runs", "0"), "runs is 0"),
        ],
    )
    def test_bad_options(self, options: tuple[str, str], words: str) -> None:
        done = run("reproduce", *options)
        assert done.exit_code == 1
        assert words in done.output

    @pytest.mark.skipif(os.name == "nt", reason="sends a POSIX signal")
    def test_interrupting_loses_nothing(self, tmp_path: Path) -> None:
        command = [sys.executable, "-m", "dynident", "reproduce", "--runs", "4000", "--out", str(tmp_path)]
        with subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
            deadline = time.monotonic() + 60
            while not (tmp_path / "study.parquet").exists() and time.monotonic() < deadline:
                time.sleep(0.1)
            process.send_signal(signal.SIGINT)
            _, told = process.communicate(timeout=60)
        assert process.returncode != 0
        assert "Traceback" not in told
        assert "again" in told  # run the same command again to go on
        assert len(pl.read_parquet(tmp_path / "study.parquet")) > 0


def test_help_and_version() -> None:
    assert "identify" in run("--help").output
    assert run("--version").output.startswith("dynident")
    assert run("identfy").exit_code == 2


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
