"""`check` and `predict` of servos: what is said of logs before a fit, and rollouts of others after it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from dynident.apps.demo import TRUE_DELAY, servo_files
from dynident.apps.servo.run import load_servos
from dynident.project.project import parse_project
from tests.cli.commands import run


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("servos")
    servo_files(made, 6.0)
    return made


@pytest.fixture
def config(folder, monkeypatch) -> str:
    monkeypatch.chdir(folder)
    assert run("init", "servos.xml", "monday.csv", "tuesday.csv", "-o", "arm.yaml", "--force").exit_code == 0
    return (folder / "arm.yaml").read_text()


def messages(name: str) -> tuple[int, list[tuple[str, str, str | None]]]:
    """Severity, words and joint of what `check` finds, with its exit code."""
    code = run("check", name, "--json", "check.json").exit_code
    with open("check.json", encoding="utf-8") as file:
        findings = json.load(file)[name]["findings"]
    return code, [(finding["severity"], finding["message"], finding["joint"]) for finding in findings]


def test_a_right_log_has_its_rate_and_delay(config, folder) -> None:
    code, found = messages("arm.yaml")
    assert code == 0
    assert [severity for severity, *_ in found] == ["info"]
    assert float(found[0][1].split()[3]) == pytest.approx(1e3 * TRUE_DELAY, abs=4)
    (facts, _) = json.loads((folder / "check.json").read_text())["arm.yaml"]["logs"].values()
    assert (facts["samples"], facts["missing"]) == (600, 0)


def test_what_is_wrong_with_a_log_is_said(config, folder) -> None:
    table = pl.read_csv("monday.csv")
    table[::5].write_csv("slow.csv")
    table.with_columns(pos_elbow=pl.lit(0.3) + 0 * pl.col("pos_elbow")).write_csv("still.csv")
    lone = config.partition("validation:")[0]
    cases = {
        "weak": (lone.replace("limit: 3.35", "limit: 0.5"), "warning", "the servo is at its limit of 0.5"),
        "slow": (config.replace("monday.csv", "slow.csv"), "warning", "20 Hz shows little"),
        "alone": (lone, "warning", "no recording is held out"),
        "still": (lone.replace("monday.csv", "still.csv"), "error", "elbow"),
    }
    for name, (text, severity, words) in cases.items():
        (folder / f"{name}.yaml").write_text(text)
        code, found = messages(f"{name}.yaml")
        assert any(kind == severity and words in text for kind, text, _ in found), (name, found)
        assert code == (severity == "error")


def test_a_rollout_of_another_recording_is_that_of_the_report(config, folder) -> None:
    assert run("identify", "arm.yaml", "--out", "out").exit_code == 0
    done = run("predict", "out/servo.json", "tuesday.csv", "--out", "positions.csv")
    assert done.exit_code == 0, done.output
    table = pl.read_csv("positions.csv")
    result = json.loads((folder / "out" / "servo.json").read_text())
    error = (table["simulated_elbow"] - table["measured_elbow"]).to_numpy()[table["t"].to_numpy() > 0.5]
    assert np.sqrt((error**2).mean()) == pytest.approx(result["rollouts"][1]["whole"][2], rel=0.01)


def test_the_file_is_compared_with_its_own_gains(config) -> None:
    arm = load_servos(parse_project(config, Path("arm.yaml")))
    unsaid = replace(arm, nominal=replace(arm.nominal, kp=np.array([np.nan, 17.8, 17.8])))
    found = replace(arm.nominal, kp=np.array([20.0, 30.0, 17.8]), delay=0.01)
    beside = unsaid.beside(found)
    assert (beside.kp.tolist(), beside.delay) == ([20.0, 17.8, 17.8], 0.01)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"parameters": [{"quantity": "colour", "joint": None, "value": 1.0}]}, "is no result of servos"),
        ({"parameters": [{"quantity": "armature", "joint": "tail", "value": 1.0}]}, "is no result of servos"),
        ({"configuration": {"path": "arm.yaml"}}, "is no result of servos"),
        ({"version": 2}, "is of version 2"),
        ({"joints": ["elbow", "base", "shoulder"]}, "are not the joints of the robot file"),
    ],
)
def test_a_damaged_result_is_refused(config, folder, change, words) -> None:
    right = {
        "format": "dynident servos", "version": 1, "joints": ["base", "shoulder", "elbow"], "parameters": [],
        "configuration": {"path": str(folder / "arm.yaml"), "text": config}, "files": {}, "commands_held": True,
    }  # fmt: skip
    (folder / "torn.json").write_text(json.dumps({**right, **change}))
    done = run("predict", "torn.json", "tuesday.csv")
    assert (done.exit_code, words in " ".join(done.output.split())) == (1, True), done.output
