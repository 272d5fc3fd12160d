"""From a result to new torques and other formats: what identify writes, and what predict and export make of it."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
import yaml

from dynident.project.export import Yaml
from tests.cli.commands import configure, refuse, run, succeed, write_log
from tests.laws.test_new_user import T, folder, identify
from tests.saved_results import errors_by_log

__all__ = ["folder"]


@pytest.fixture(scope="module")
def slider(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A slider that was identified; the result's path."""
    place = tmp_path_factory.mktemp("slider")
    write_log(place)
    succeed("identify", configure(place), "--out", place / "out")
    return place / "out" / "result.json"


@pytest.fixture(scope="module")
def arm(folder: Path) -> Path:
    """The new user's arm, identified as a consistent model; the folder of its result."""
    identify(folder, estimator={"kind": "consistent"})
    return folder / "out"


class TestIdentify:
    def test_the_robot_file_is_proven_and_written(self, arm: Path) -> None:
        result = json.loads((arm / "result.json").read_text())
        files = {x["file"]: x for x in result["report"]["exports"]}
        assert files.keys() == {"arm.identified.urdf", "parameters.yaml", "model.py"}
        for name, case in files.items():
            assert (arm / name).exists()
            assert case["proven"]
            assert case["agreement"] <= 1e-8
        robot = files["arm.identified.urdf"]
        assert robot["readers"].keys() == {"Pinocchio", "dynident"}
        assert any(words.startswith("offset_elbow") for words in robot["left_out"])
        assert [x["role"] for x in robot["errors"]] == ["train", "validation"]
        assert all(x["file"] > x["model"] for x in robot["errors"])
        assert "arm.identified.urdf" in (arm / "report.html").read_text()

    def test_what_is_impossible_or_not_proven_leaves_no_file(
        self, arm: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """Nor does the file of an earlier run stay."""
        again = shutil.copytree(arm.parent, tmp_path / "user") / "out"
        make = Yaml.write
        monkeypatch.setattr(Yaml, "write", lambda self, x: replace(make(self, x), text="parameters: []"))
        model = {"file": "arm.urdf", "terms": ["viscous", "coulomb", "offset"]}
        result = identify(again.parent, estimator={"kind": "least_squares"}, model=model)
        files = {x["format"]: x for x in result["report"]["exports"]}
        for kind, refusal in (("urdf", "kind: consistent"), ("yaml", "cannot read it")):
            assert not files[kind]["proven"]
            assert refusal in files[kind]["refusal"]
        assert {path.name for path in again.iterdir()} == {"model.py", "report.html", "result.json"}


class TestPredict:
    def test_errors_are_those_of_the_validation(self, arm: Path) -> None:
        table = arm.parent / "torques.csv"
        done = succeed("predict", arm / "result.json", arm.parent / "tuesday.csv", "--out", table)
        frame = pl.read_csv(table)
        result = json.loads((arm / "result.json").read_text())
        (errors,) = errors_by_log(result, "validation").values()
        used = frame.filter(pl.col("used"))
        for joint, expected in errors["rmse"].items():
            difference = used[f"measured_{joint}"] - used[f"predicted_{joint}"]
            assert np.sqrt((difference**2).mean()) == pytest.approx(expected, rel=1e-9)
            assert f"{errors['per_joint'][joint]:.3g}" in done.output
        assert frame.columns[:3] == ["log", "t", "used"]
        assert set(frame["log"]) == {"tuesday"}
        assert frame["t"][1] == pytest.approx(T[1])

    def test_a_recording_without_torques(self, arm: Path) -> None:
        bare = arm.parent / "bare.csv"
        full = pl.read_csv(arm.parent / "tuesday.csv", separator=";")
        full.select([name for name in full.columns if "i_q" not in name]).write_csv(bare)
        for name in (bare, arm.parent / "tuesday.csv"):
            done = succeed("predict", arm / "result.json", name, "--out", arm.parent / f"{name.stem}.parquet")
            assert "Warning" not in done.output
        first, second = (pl.read_parquet(arm.parent / f"{stem}.parquet") for stem in ("bare", "tuesday"))
        assert first["predicted_elbow"].equals(second["predicted_elbow"])
        assert first["measured_elbow"].is_null().all()
        refuse("predict", arm / "result.json", bare, says="--out")

    def test_files_of_one_recording_are_named_by_their_keys(self, tmp_path: Path) -> None:
        frame = pl.read_csv(write_log(tmp_path))
        for name, columns in {"p": ["time", "pos"], "f": ["force"]}.items():
            frame.select(columns).write_csv(tmp_path / f"{name}.csv")
        changes: dict[str, Any] = {
            "time": {"column": "p.time", "unit": "s"},
            "position": {"slider": {"column": "p.pos", "unit": "m"}},
            "torque": {"slider": {"column": "f.force", "unit": "N"}},
            "train": [{"file": {"p": "p.csv", "f": "f.csv"}, "name": "both"}],
            "validation": [],
        }
        assert run("identify", configure(tmp_path, **changes), "--out", tmp_path).exit_code == 0
        result, p, f = tmp_path / "result.json", tmp_path / "p.csv", tmp_path / "f.csv"
        assert run("predict", result, f"p={p},f={f}").exit_code == 0
        assert run("predict", result, f"p={p}", "--out", tmp_path / "t.csv").exit_code == 0
        for wrong, words in ((p, "no file is called"), (f"f={f}", "'p' is missing"), (f"p=,f={f}", "'p' is missing")):
            refuse("predict", result, wrong, says=(words, "f=FILE,p=FILE"))

    def test_a_robot_file_that_changed_is_noticed_and_one_that_is_gone_not_missed(self, arm: Path) -> None:
        robot, tuesday = arm.parent / "arm.urdf", arm.parent / "tuesday.csv"
        text, expected = robot.read_text(), succeed("predict", arm / "result.json", tuesday).output
        robot.write_text(text + "<!-- changed -->")
        refuse("predict", arm / "result.json", tuesday, says="has changed since")
        robot.unlink()
        assert succeed("predict", arm / "result.json", tuesday).output == expected
        robot.write_text(text)

    @pytest.mark.parametrize("text", ["", "[]", "{}", '{"settings": {}, "parameters": []}', "{", "\x00"])
    def test_other_files_are_no_results(self, tmp_path: Path, text: str) -> None:
        (tmp_path / "r.json").write_text(text)
        refuse("predict", tmp_path / "r.json", "log.csv", says="r.json")

    def test_parameters_of_another_model_are_refused(self, slider: Path, tmp_path: Path) -> None:
        data = json.loads(slider.read_text())
        data["parameters"][0]["name"] = "mass"
        (tmp_path / "r.json").write_text(json.dumps(data))
        refuse("predict", tmp_path / "r.json", slider.parents[1] / "log.csv", says="identify again")

    def test_a_wrong_table_is_said_before_the_work(self, tmp_path: Path) -> None:
        refuse("predict", tmp_path / "missing.json", "log.csv", "--out", tmp_path / "t.xls", says=".xls")


class TestExport:
    @pytest.mark.parametrize("kind", ["urdf", "numpy", "yaml"])
    def test_it_writes_what_identify_does(self, arm: Path, kind: str) -> None:
        files = json.loads((arm / "result.json").read_text())["report"]["exports"]
        (name,) = (x["file"] for x in files if x["format"] == kind)
        done = succeed("export", arm / "result.json", "--format", kind, "--out", arm / "again", "-q")
        assert done.output.splitlines() == [f"Model: {(arm / 'again').resolve()}"]
        if kind == "yaml":
            first, second = (yaml.safe_load((arm / file).read_text())["parameters"] for file in ("again", name))
            assert first == second
        else:
            assert (arm / "again").read_bytes() == (arm / name).read_bytes()

    def test_a_reader_that_is_missing_is_said(self, arm: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr("dynident.project.export.proof.FOREIGN", {"Pinocchio": ("no_such_module", "pin")})
        done = succeed("export", arm / "result.json", "--format", "urdf", "--out", arm / "again")
        assert "Pinocchio is not installed" in done.output

    def test_what_cannot_be_written_and_an_unknown_format_are_said(self, slider: Path) -> None:
        words = ("export", slider, "--out", slider.parent / "x.urdf", "--format")
        refuse(*words, "urdf", says="does not come from a robot file")
        assert not (slider.parent / "x.urdf").exists()
        refuse(*words, "udrf", says="did you mean 'urdf'", code=2)


@pytest.mark.parametrize(
    "words",
    [
        "export out/result.json --format yaml --out log.csv",
        "reproduce --json log.csv",
        "smooth smoothed.csv --time time --out .",
        "schema --out identify.yaml",
    ],
)
def test_no_command_replaces_what_it_reads(slider: Path, words: str, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = slider.parents[1]
    monkeypatch.chdir(folder)
    (folder / "smoothed.csv").write_bytes((folder / "log.csv").read_bytes())
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    refuse(*words.split(), says="choose another name")
    assert before == {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
