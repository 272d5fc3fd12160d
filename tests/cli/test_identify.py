"""The identification as a user meets it: what it prints and writes, and how it says what is wrong."""

import hashlib
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dynident.files.folder import result_folder
from dynident.identification import Identification, SourceFile, Sources
from dynident.project import project
from dynident.project.config import fingerprint
from dynident.project.saved import model_files
from dynident.runtime.jobs import cluster
from dynident.runtime.kernel import kernel
from tests.cli.commands import configure, run, succeed, write_log
from tests.project.test_explicit_config import QUICK
from tests.project.test_explicit_config import write as configuration
from tests.saved_results import errors_by_log


class TestIdentify:
    def test_recovers_a_simulated_slider(self, tmp_path: Path) -> None:
        write_log(tmp_path)
        done = succeed("identify", configure(tmp_path), "--out", tmp_path / "out", "-v")
        result = json.loads((tmp_path / "out" / "result.json").read_text())
        actual = {x["name"]: x for x in result["parameters"]}
        for name, true in {"M": 5.0, "Fv": 8.0, "Fc": 3.0, "offset": 0.5}.items():
            assert abs(actual[name]["value"] - true) < max(6 * actual[name]["std_independent"], 0.02), name
        digest = hashlib.sha256((tmp_path / "log.csv").read_bytes()).hexdigest()
        (file,) = result["provenance"]["logs"]
        assert (file["path"], file["sha256"]) == (str(tmp_path / "log.csv"), digest)
        report = (tmp_path / "out" / "report.html").read_text()
        assert result["provenance"]["versions"]["kernel"] == str(kernel())
        assert f"computed by {kernel()}</footer>" in report
        assert f"Computed by {kernel()}." in done.output
        assert digest in report
        assert "http://" not in report.split("<script>")[0]

    def test_a_model_from_a_file(self, tmp_path: Path) -> None:
        write_log(tmp_path)
        (tmp_path / "mine.py").write_text(
            "from dynident.models import Model\n"
            "from dynident.models.friction import Offset, Viscous\n"
            "from dynident.models import Joint\n"
            "def build():\n"
            "    joints = (Joint('slider', 'prismatic'),)\n"
            "    return Model((Viscous(joints), Offset(joints)), name='mine')\n"
        )
        done = succeed("identify", configure(tmp_path, model="mine.py:build"), "-v")
        assert "Fv_slider" in done.output

    @pytest.mark.parametrize("position", [0.0, 0.7])
    def test_a_joint_that_does_not_move_is_said(self, tmp_path: Path, position: float) -> None:
        write_log(tmp_path, pos=np.full(2000, position))
        done = succeed("identify", configure(tmp_path), "-v")
        assert "slider" in done.output
        assert "never moves" in done.output
        assert "no effect on the torque" in done.output


ALL = {"train": [{"file": "log.csv"}], "validation": []}
BAD = {  # what is written, what is configured, and what is said
    "a NaN": (
        {"pos": np.where(np.arange(2000) == 700, np.nan, 0.1 * np.sin(np.arange(2000)))}, {},
        ["log.csv", "pos", "702", "nan"],
    ),
    "repeated times": ({"time": np.repeat(np.arange(1000), 2) * 0.004}, {}, ["log.csv", "time", "repeat"]),
    "unsorted times": ({"time": np.arange(2000)[::-1] * 0.002}, {}, ["log.csv", "time", "sort"]),
    "a gap": (
        {"time": np.arange(2000) * 0.002 + np.where(np.arange(2000) > 600, 0.5, 0.0)}, {}, ["log.csv", "gap", "split"],
    ),
    "too few samples": ({"n": 12}, ALL, ["log.csv", "samples"]),
    "a missing file": ({"name": "logs.csv"}, {}, ["log.csv", "logs.csv"]),
    "a wrong column": ({}, {"position": {"slider": {"column": "position", "unit": "m"}}}, ["'position'", "pos"]),
    "a wrong unit": ({}, {"position": {"slider": {"column": "pos", "unit": "rad"}}}, ["rad", "mm"]),
    "an unknown key": ({}, {"smother": {"kind": "spline"}}, ["smother", "did you mean 'smoother'"]),
    "an unknown joint": ({}, {"position": {"slyder": {"column": "pos", "unit": "m"}}}, ["slyder", "'slider'"]),
    "an unknown model": ({}, {"model": "gallery:slidr"}, ["slidr", "did you mean 'slider'"]),
}  # fmt: skip


class TestBadInput:
    """Each ends with exit code 1, a message that names the wrong thing, no traceback, and nothing written."""

    def check(self, folder: Path, words: list[str], **changes: Any) -> None:
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

    @pytest.mark.parametrize("what", BAD)
    def test_log_and_configuration(self, tmp_path: Path, what: str) -> None:
        log, changes, words = BAD[what]
        write_log(tmp_path, **log)
        self.check(tmp_path, words, **changes)

    @pytest.mark.parametrize(("size", "words"), [(0, "empty"), (30_000, "line")])
    def test_a_file_that_is_cut_off(self, tmp_path: Path, size: int, words: str) -> None:
        path = write_log(tmp_path)
        path.write_text(path.read_text()[:size].rpartition(",")[0])
        self.check(tmp_path, ["log.csv", words])

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
            "from dynident.models import Joint, Parameter, Term\n"
            "class Broken(Term):\n"
            "    joints = (Joint('slider', 'prismatic'),)\n"
            "    parameters = (Parameter('a', 'kg'),)\n"
            "    def regressor(self, q, dq, ddq):\n"
            "        raise ValueError('the cable is loose')\n"
            f"def build():\n    {body}\n"
        )
        self.check(tmp_path, words, model="mine.py:build")


class TestFolder:
    """Where nothing can be written, a command says so before its long work."""

    def test_a_folder_that_another_run_holds(self, tmp_path: Path) -> None:
        for command in ("identify", "bound", "reproduce"):
            with result_folder(tmp_path / "out"):
                config = [] if command == "reproduce" else [tmp_path / "missing.yaml"]
                done = run(command, *config, "--out", tmp_path / "out")
            assert done.exit_code == 1
            assert f"another run writes here (process {os.getpid()} on" in done.output

    def test_models_of_an_earlier_run_are_removed_and_the_users_own_kept(self, tmp_path: Path) -> None:
        write_log(tmp_path)
        out = tmp_path / "out"
        assert run("identify", configure(tmp_path), "--out", out).exit_code == 0
        files = {path.name for path in out.iterdir()}
        assert files == {"parameters.yaml", "model.py", "result.json", "report.html"}
        result = json.loads((out / "result.json").read_text())
        for name, text in (("arm.urdf", "of the earlier run"), ("edited.urdf", "by hand"), ("thesis.tex", "mine")):
            (out / name).write_text(text)
            told = hashlib.sha256(b"of the earlier run").hexdigest()
            result["report"]["exports"].append({"file": name, "sha256": told if name.endswith("urdf") else None})
        (out / "result.json").write_text(json.dumps(result))
        assert run("identify", configure(tmp_path), "--out", out).exit_code == 0
        assert {path.name for path in out.iterdir()} == files | {"edited.urdf", "thesis.tex"}
        result["report"]["exports"] = [{"file": "../log.csv", "sha256": fingerprint(tmp_path / "log.csv")}]
        (out / "result.json").write_text(json.dumps(result))
        assert model_files(out / "result.json", Sources()) == ()
        result["report"]["exports"] = [{"file": "edited.urdf", "sha256": fingerprint(out / "edited.urdf")}]
        (out / "result.json").write_text(json.dumps(result))
        assert model_files(out / "result.json", Sources()) == ("edited.urdf",)
        assert model_files(out / "result.json", Sources(model=SourceFile(str(out / "edited.urdf"), ""))) == ()

    @pytest.mark.skipif(os.name == "nt", reason="kills as POSIX does")
    def test_a_kill_while_files_are_written(self, tmp_path: Path) -> None:
        """At any moment; tests/files/test_folder.py tries them all."""
        log, out = write_log(tmp_path), tmp_path / "out"
        first = configure(tmp_path, train=[{"file": "log.csv", "window": [0, 2]}])
        assert run("identify", first, "--out", out).exit_code == 0
        old = {path.name: path.read_bytes() for path in out.iterdir()}
        command = [sys.executable, "-m", "dynident", "identify", str(configure(tmp_path)), "--out", str(out)]
        with subprocess.Popen(command, stdout=subprocess.DEVNULL) as process:
            while process.poll() is None and not (out / ".dynident.tmp").exists():
                time.sleep(0.001)
            process.kill()
        assert run("predict", out / "result.json", log).exit_code == 0
        now = {path.name: path.read_bytes() for path in out.iterdir()}
        assert now.keys() == old.keys()
        assert {now[name] == old[name] for name in old} in ({True}, {False})

    def test_a_report_that_fails_leaves_no_result(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        write_log(tmp_path)
        monkeypatch.setattr("dynident.report.identification.report.identification_page", lambda *_: 1 / 0)
        done = run("identify", configure(tmp_path), "--out", tmp_path / "out")
        assert done.exit_code == 70
        assert "ZeroDivisionError" in done.output
        assert not (tmp_path / "out").exists()


class TestWriteConfig:
    def test_it_writes_what_repeats_the_result_and_advises_it(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        path, made = configuration(tmp_path / "arm", **QUICK), list[Identification]()
        fit = project.identify
        monkeypatch.setattr(project, "identify", lambda *given, **how: made.append(fit(*given, **how)) or made[-1])
        done = succeed("identify", path, "--out", tmp_path / "a", "--write-config", tmp_path / "b" / "fixed.yaml", "-v")
        assert "Terms chosen by the training logs" in done.output
        assert f"Configuration: {tmp_path / 'b' / 'fixed.yaml'}" in done.output
        again = succeed("identify", tmp_path / "b" / "fixed.yaml", "--out", tmp_path / "c", "-v")
        assert "Terms chosen" not in again.output
        assert "--write-config" not in again.output
        result = [json.loads((tmp_path / x / "result.json").read_text()) for x in "ac"]
        errors = [errors_by_log(x, "validation") for x in result]
        assert errors[0] == errors[1]
        report = (tmp_path / "a" / "report.html").read_text()
        assert "Friction and other terms" in report
        monkeypatch.setattr(project, "identify", lambda *_, **__: made[0])  # the same again, told without the option
        advised = run("identify", path, "-v")
        assert "To write out the terms that were chosen:" in advised.output
        assert "robot-explicit.yaml" in advised.output

    @pytest.mark.parametrize("name", ["robot.yaml", "logs/tuesday.csv", "other.txt"])
    def test_no_input_is_replaced_and_a_configuration_is_named_so(self, tmp_path: Path, name: str) -> None:
        path = configuration(tmp_path)
        before = {file: file.read_bytes() for file in tmp_path.rglob("*") if file.is_file()}
        done = run("identify", path, "--write-config", tmp_path / name)
        assert done.exit_code == 1
        words = "would be replaced, but this run reads it" if name == "robot.yaml" else "is no name of a configuration"
        assert words in done.output.replace("\n", " "), done.output
        assert {file: file.read_bytes() for file in tmp_path.rglob("*") if file.is_file()} == before


@pytest.mark.parametrize(("rule", "used"), [("constraint", False), ("torque", True)])
def test_a_cluster_is_used_where_there_are_two_smoothers_to_try(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, rule: str, used: bool
) -> None:
    monkeypatch.setattr("dynident.motion.smoothers.spline.NOISE_FACTORS", (1.0, 2.0))
    monkeypatch.setattr(cluster, "ANSWER_SECONDS", 0.2)
    write_log(tmp_path)
    done = run(
        "identify", configure(tmp_path, smoother={"kind": "spline", "rule": rule}), "--cluster", "tcp://127.0.0.1:1"
    )
    assert ("no Dask scheduler answers" in done.output) is used
    assert ("--cluster was not used" in done.output) is not used
