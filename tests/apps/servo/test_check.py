"""`check` and `predict` of servos: what is said of logs before a fit, and rollouts of others after it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from dynident.apps.demo import TRUE_DELAY
from dynident.apps.servo.commands import command_findings
from dynident.apps.servo.plant import ServoLog
from dynident.apps.servo.run import load_servos
from dynident.apps.servo.start import smooth_servo_log
from dynident.project.project import parse_project
from tests.cli.commands import refuse, run, succeed


@pytest.fixture
def config(folder) -> str:
    return (folder / "servos.yaml").read_text()


def messages(name: str) -> tuple[int, list[tuple[str, str, str | None]]]:
    """Severity, words and joint of what `check` finds, with its exit code."""
    code = run("check", name, "--json", "check.json").exit_code
    with open("check.json", encoding="utf-8") as file:
        findings = json.load(file)[name]["findings"]
    return code, [(finding["severity"], finding["message"], finding["joint"]) for finding in findings]


def test_a_right_log_has_its_rate_and_delay(folder) -> None:
    code, result = messages("servos.yaml")
    assert code == 0
    assert [severity for severity, *_ in result] == ["info"]
    assert float(result[0][1].split()[6]) == pytest.approx(1e3 * TRUE_DELAY, abs=4)
    (facts, _) = json.loads((folder / "check.json").read_text())["servos.yaml"]["logs"].values()
    assert (facts["samples"], facts["missing"]) == (600, 0)


def test_periodic_motion_is_neither_turned_nor_early() -> None:
    t = np.arange(0.0, 6.0, 0.01)
    q = 0.3 * np.sin(2 * np.pi * np.outer(t, (4.0, 1.0, 0.3)))
    log = ServoLog("sine", t, q, t, 0.3 * np.sin(2 * np.pi * np.outer(t + 0.05, (4.0, 1.0, 0.3))))
    assert not list(command_findings([smooth_servo_log(log)], ("a", "b", "c"), np.zeros(3, dtype=bool)))


def test_what_is_wrong_with_a_log_is_said(config, folder) -> None:
    table, degrees = pl.read_csv("monday.csv"), 180 / np.pi
    later = [pl.col(f"pos_{joint}").shift(-10).forward_fill() for joint in ("base", "shoulder", "elbow")]
    still = pl.lit(0.3) + 0 * pl.col("pos_elbow")
    logs = {
        "swapped": (table.rename({"cmd_base": "cmd_elbow", "cmd_elbow": "cmd_base"}), "it follows that of 'elbow'"),
        "degrees": (table.with_columns(pl.col("cmd_base") * degrees), "the command spans 55.8 times"),
        "turned": (table.with_columns(-pl.col("cmd_base")), "goes against its command"),
        "constant": (table.with_columns(cmd_base=pl.lit(0.1)), "its command hardly changes"),
        "early": (table.with_columns(later), "ms before their commands"),
        "clocks": (table.with_columns(later), "are both stamped by one clock?"),
        "slow": (table[::5], "20 Hz shows little"),
        "missing": (table.drop("cmd_base"), "simulation.joints.base.command: no column 'cmd_base'"),
        "still": (table.with_columns(pos_elbow=still), "elbow"),
    }
    cases = [(name, config.replace("monday.csv", f"{name}.csv"), words) for name, (_, words) in logs.items()]
    for name, (data, _) in logs.items():
        data.write_csv(f"{name}.csv")
    cases.append(("weak", config.replace("limit: 3.35", "limit: 0.5"), "the servo is at its limit of 0.5"))
    cases.append(("alone", config.partition("validation:")[0], "no recording is held out"))
    for name, text, words in cases:
        (folder / "wrong.yaml").write_text(text)
        code, result = messages("wrong.yaml")
        severity = "error" if name in ("missing", "still") else "warning"
        assert any(kind == severity and words in message for kind, message, _ in result), (name, result)
        assert code == (severity == "error")


def test_a_rollout_of_another_recording_is_that_of_the_report(folder) -> None:
    succeed("predict", "servos/servo.json", "tuesday.csv", "--out", "positions.csv")
    table = pl.read_csv("positions.csv")
    result = json.loads((folder / "servos" / "servo.json").read_text())
    error = (table["simulated_elbow"] - table["measured_elbow"]).to_numpy()[table["t"].to_numpy() > 0.5]
    assert np.sqrt((error**2).mean()) == pytest.approx(result["rollouts"][1]["whole"][2], rel=0.01)


def test_the_file_is_compared_with_its_own_gains(config) -> None:
    arm = load_servos(parse_project(config, Path("arm.yaml")))
    unsaid = replace(arm, nominal=replace(arm.nominal, kp=np.array([np.nan, 17.8, 17.8])))
    result = replace(arm.nominal, kp=np.array([20.0, 30.0, 17.8]), delay=0.01)
    beside = unsaid.beside(result)
    assert (beside.kp.tolist(), beside.delay) == ([20.0, 17.8, 17.8], 0.01)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"parameters": [{"quantity": "colour", "joint": None, "value": 1.0}]}, "is no result of servos"),
        ({"parameters": [{"quantity": "armature", "joint": "tail", "value": 1.0}]}, "is no result of servos"),
        ({"parameters": [{"quantity": "damping", "joint": "elbow", "value": "nan"}]}, "not finite"),
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
    refuse("predict", "torn.json", "tuesday.csv", says=words)
