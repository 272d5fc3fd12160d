"""``dynident check`` as a user meets it: what it prints, its exit code, and the file it writes."""

import json
from pathlib import Path

import numpy as np

from tests.cli.commands import configure, refuse, run, succeed, write_log
from tests.robots import ARM, link

SINE = np.sin(6e-3 * np.arange(2000))


def test_every_finding_is_printed_before_the_exit_code(tmp_path: Path) -> None:
    """An error in one log hides neither the warnings nor the other logs."""
    write_log(tmp_path)
    write_log(tmp_path, "torn.csv", time=np.arange(2000) * 0.002 + np.where(np.arange(2000) > 600, 0.5, 0.0))
    write_log(tmp_path, "holes.csv", pos=np.where(np.arange(2000) == 700, np.nan, SINE))
    write_log(tmp_path, "dead.csv", force=np.zeros(2000))
    logs = [{"file": f"{name}.csv"} for name in ("log", "torn", "holes", "dead")]
    done = run("check", configure(tmp_path, train=logs, validation=[]), "-v")
    assert done.exit_code == 1
    assert "Traceback" not in done.output
    for words in ("2 errors and 1 warning", "a gap of", "gaps: split", "line 702", "torque is 0 throughout"):
        assert words in " ".join(done.output.split()), words
    assert "Motion in training" in done.output


def test_robot_files_alone(tmp_path: Path) -> None:
    (tmp_path / "good.urdf").write_text(ARM)
    (tmp_path / "bad.urdf").write_text(ARM.replace(link("base", 4.0), link("base", -4.0)))
    good = succeed("check", tmp_path / "good.urdf", "-v")
    for words in ("Joints, SI", "revolute", "Links", "upper", "wrist", "8.200"):
        assert words in good.output
    refuse("check", tmp_path / "bad.urdf", tmp_path / "good.urdf", says=("negative mass -4", "good.urdf"))


def test_a_file_that_cannot_be_used_does_not_hide_the_next(tmp_path: Path) -> None:
    (tmp_path / "good.urdf").write_text(ARM)
    (tmp_path / "bad.yaml").write_text("model: arm.urdf\nsmother: {}\n")
    refuse(
        "check",
        tmp_path / "missing.urdf",
        tmp_path / "bad.yaml",
        tmp_path / "good.urdf",
        "--json",
        tmp_path / "x",
        says=("cannot be read", "did you mean 'smoother'", "good.urdf: No errors"),
    )
    assert len(json.loads((tmp_path / "x").read_text())) == 3


def test_a_misspelt_file_is_answered_by_the_one_meant(tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text(ARM)
    for name in ("arm.urf", "amr.urdf"):
        refuse("check", tmp_path / name, says="did you mean 'arm.urdf'?")
