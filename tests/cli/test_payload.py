"""``dynident payload``, from files to files."""

import json
from pathlib import Path
from shutil import copy

import polars as pl
import pytest
import yaml

from dynident.motion.log import Log
from tests.apps.payload.arms import CARRIED, SIX, recorded
from tests.cli.commands import refuse, run, succeed

JOINTS = tuple(f"j{k}" for k in range(1, 7))


def write(folder: Path, log: Log) -> None:
    columns = {"t": log.t} | {f"q{k}": log.q[:, k] for k in range(6)} | {f"tau{k}": log.tau[:, k] for k in range(6)}
    pl.DataFrame(columns).write_csv(folder / f"{log.source}.csv")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An arm identified from drives with wrong gains, and its recordings with payloads."""
    place = tmp_path_factory.mktemp("payload")
    (place / "six.urdf").write_text(SIX)
    for name, payload in (("arm", None), ("unloaded", None), ("weighed", CARRIED), ("next", 0.5 * CARRIED)):
        write(place, recorded(name, payload, 1.04))
    settings = {
        "model": {"file": "six.urdf", "terms": ["viscous", "coulomb", "offset"]},
        "time": {"column": "t", "unit": "s"},
        "position": {name: {"column": f"q{k}", "unit": "rad"} for k, name in enumerate(JOINTS)},
        "torque": {name: {"column": f"tau{k}", "unit": "N m"} for k, name in enumerate(JOINTS)},
        "train": [{"file": "arm.csv"}],
        "smoother": {"kind": "spline"},
        "estimator": {"kind": "least_squares", "weights": "per_joint"},
    }
    (place / "arm.yaml").write_text(yaml.safe_dump(settings))
    succeed("identify", place / "arm.yaml", "--out", place / "out")
    return place


def test_a_weighed_payload_and_then_another(folder: Path) -> None:
    result = folder / "out" / "result.json"
    done = run(
        "payload", result, folder / "weighed.csv", "--known-mass", 3, "--unloaded", folder / "unloaded.csv",
        "--unloaded", folder / "arm.csv", "--out", folder / "weighed",
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    assert done.output.splitlines()[-1].startswith("arm_tool0 carries 3.00000 ± 0.00030 kg")
    assert len(done.output.splitlines()) <= 12
    assert "the result was identified from this recording already" in " ".join(done.output.split())
    assert "--gains" in done.output
    assert {path.name for path in (folder / "weighed").iterdir()} == {
        "payload.json", "report.html", "six_payload.urdf",
    }  # fmt: skip
    done = run("payload", result, folder / "next.csv", "--gains", folder / "weighed" / "payload.json",
               "--out", folder / "next", "--frame", "turn")  # fmt: skip
    assert done.exit_code == 0, done.output
    assert "these gains" not in done.output  # they are not of this payload
    data = json.loads((folder / "next" / "payload.json").read_text())
    assert data["frame"] == "turn"
    assert data["payload"][0]["value"] == pytest.approx(1.5, rel=0.02)


def test_what_is_wrong_is_said(folder: Path) -> None:
    result, log = folder / "out" / "result.json", folder / "next.csv"
    old = json.loads(result.read_text())
    old["errors"]["base_covariance"] = None
    (folder / "old.json").write_text(json.dumps(old))
    for arguments, said in (
        ((result, log, "--frame", "hand"), "'hand' is no link"),
        ((result, folder / "arm.csv"), "arm.csv: the result was made from it"),
        ((result, copy(folder / "arm.csv", folder / "moved.csv")), "moved.csv: the result was made from it"),
        ((result, result), "arm.csv: both results were made from it"),
        ((result, log, "--unloaded", log), "holds the same samples as 'next'"),
        ((result, log, "--out", folder / "out"), "is the report of another command"),
        ((result, folder / "weighed.csv", "--known-mass", "300"), "a payload of 300 kg leaves"),
        ((folder / "old.json", log), "old.json: does not hold the covariance of its base parameters"),
        ((result, log, "--known-mass", "-1"), "the known mass is -1 kg"),
        ((result, log, "--gains", result), "is not a payload.json"),
        ((result, folder / "none.csv"), "none.csv"),
        ((folder / "arm.yaml", log), "is not a result.json"),
        ((result, result, log), "give one result, or recordings alone"),
    ):
        refuse("payload", *arguments, says=said)


def test_torques_are_needed(folder: Path) -> None:
    table = pl.read_csv(folder / "next.csv")
    table.select([name for name in table.columns if "tau" not in name]).write_csv(folder / "bare.csv")
    refuse("payload", folder / "out" / "result.json", folder / "bare.csv", says="has no torques")
