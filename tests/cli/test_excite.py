"""``dynident excite``: what it writes, that recordings of it are read and identified, and what it refuses."""

import json
import shutil
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import dynident as dy
from dynident.apps.excitation import LimitError
from dynident.apps.excitation.robot import ExcitationProject
from dynident.apps.excitation.run import refuse_targets
from dynident.apps.excitation.search import Plan, Stage
from dynident.runtime import ConfigError
from tests.apps.excitation.arms import TWO
from tests.cli.commands import refuse, run, succeed

QUICK = ("--duration", 10, "--period", 3, "--harmonics", 2, "--starts", 1, "--workers", 1, "--floor", -2)
FILES = {f"{stem}.{end}" for stem in ("trial", "motion", "validation") for end in ("csv", "npz", "trajectory.yaml")}
FRICTION = {"viscous": 1.0, "coulomb": 0.5, "rotor": 0.05, "": 0.1}


@pytest.fixture(scope="module", autouse=True)
def short_search() -> Iterator[None]:
    """The search of a motion ends after a few steps."""
    stages = (Stage(1.0, 6), Stage(0.1, 6), Stage(0.0, 4))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(import_module("dynident.apps.excitation.design"), "Plan", lambda starts: Plan(starts, stages))
        yield


@pytest.fixture(scope="module")
def designed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("designed")
    (folder / "two.urdf").write_text(TWO)
    done = succeed("excite", folder / "two.urdf", "-o", folder / "out", *QUICK)
    (folder / "printed").write_text(done.output)
    return folder


def record(folder: Path) -> None:
    """Record both motions on the arm of the robot file, with friction and noise of which the file knows nothing."""
    model = dy.read_robot(folder / "two.urdf")
    theta = [FRICTION[parameter.role] if parameter.value is None else parameter.value for parameter in model.parameters]
    rng = np.random.default_rng(0)
    for stem in ("motion", "validation"):
        case = np.load(folder / "out" / f"{stem}.npz")
        tau = model.torque(case["q"], case["dq"], case["ddq"], theta)
        q = case["q"] + 1e-5 * rng.standard_normal(case["q"].shape)
        rows = np.column_stack([case["t"], q, tau + 0.05 * rng.standard_normal(tau.shape)])
        head = "t,q_lift,q_bend,tau_lift,tau_bend"
        np.savetxt(folder / "out" / f"{stem}_recorded.csv", rows, delimiter=",", header=head, comments="")


def test_everything_is_written(designed: Path) -> None:
    out, printed = designed / "out", (designed / "printed").read_text()
    assert {path.name for path in out.iterdir()} == FILES | {
        "play_trajectory.py",
        "identify.yaml",
        "excite.json",
        "report.html",
    }
    for words in ("An optimised motion", "will be known well", "identify.yaml"):
        assert words in printed
    assert len(printed.splitlines()) <= 12
    assert printed.splitlines()[-1].startswith("An optimised motion, ")
    assert "No floor is given" not in printed
    content = json.loads((out / "excite.json").read_text())
    assert content["format"] == "dynident-excite"
    assert content["settings"]["floor"] == -2
    assert content["duration"]["motion"] <= 10
    assert content["noise"]["from"] == "rule"
    assert content["noise"]["sigma"] == pytest.approx({"lift": 0.4, "bend": 0.15})
    for checked in content["checked"].values():
        assert max(max(joints.values()) for joints in checked["share_of_limits"].values()) <= 1 + 1e-6
        assert checked["nearest"]["links"]["distance"] > 0.01
    page = (out / "report.html").read_text()
    assert page.count('class="player"') == 1
    assert "http://" not in page.split("<script>")[0]


def test_the_trial_is_the_motion_slower(designed: Path) -> None:
    trial, motion = (np.load(designed / "out" / f"{stem}.npz") for stem in ("trial", "motion"))
    count = int(3.0 / 0.004)  # of the way and the first period, after which it ends
    np.testing.assert_allclose(trial["q"][: 4 * count : 4], motion["q"][:count], atol=1e-9)
    np.testing.assert_allclose(trial["ddq"][: 4 * count : 4], motion["ddq"][:count] / 16, atol=1e-9)
    np.testing.assert_allclose(trial["q"][-1], motion["q"][-1], atol=1e-9)


def test_a_trial_that_would_need_more_torque_is_left_out(
    designed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def carried(*_: object) -> None:
        raise LimitError("beyond its limit")

    monkeypatch.setattr("dynident.apps.excitation.run.verify", carried)
    (tmp_path / "trial.csv").write_text("of another motion")
    done = succeed("excite", designed / "two.urdf", "-o", tmp_path, *QUICK)
    assert "There is no slower motion for a first run" in done.output
    assert not list(tmp_path.glob("trial.*"))
    assert "There is no slower motion for a first run" in (tmp_path / "report.html").read_text()


def test_recordings_of_it_are_checked_and_identified_and_tell_what_was_announced(designed: Path) -> None:
    record(designed)
    config = designed / "out" / "identify.yaml"
    assert run("check", config).exit_code == 0
    done = succeed("identify", config, "--out", designed / "result", "--workers", 1, "-v")
    assert "To design what to record next" in done.output
    announced = {
        x["name"]: x["std"]
        for x in json.loads((designed / "out" / "excite.json").read_text())["expected"]["parameters"]
    }
    result = dy.load(designed / "result" / "result.json")
    assert result.validations[-1].errors.relative_error < 5
    k = result.estimate.names.index("Fv_bend")
    assert result.estimate.value[k] == pytest.approx(1.0, abs=0.01)
    assert result.errors.std[k] == pytest.approx(announced["Fv_bend"] * 0.05 / 0.15, rel=0.5)  # the noise was less
    again = succeed("excite", designed / "result" / "result.json", "-o", designed / "next", *QUICK, "-v")
    assert "Together with what was recorded before" in again.output
    assert "the residual of the result" in again.output
    draft = (designed / "next" / "identify.yaml").read_text()
    assert "motion_recorded.csv" in draft
    assert "motion_recorded_2.csv" in draft
    robot = (designed / "two.urdf").rename(designed / "away.urdf")
    gone = "the robot file of the result is gone"
    refuse("excite", designed / "result" / "result.json", "-o", designed / "x", *QUICK, says=gone)
    robot.rename(designed / "two.urdf")


def test_a_configuration_changed_by_hand_is_not_replaced(designed: Path, tmp_path: Path) -> None:
    for name in ("play_trajectory.py", "identify.yaml"):
        (tmp_path / name).write_text("mine: 1\n")
        refuse("excite", designed / "two.urdf", "-o", tmp_path, *QUICK, says="was written or changed by hand")
        assert (tmp_path / name).read_text() == "mine: 1\n"
    out = designed / "out"
    refuse("excite", out / "identify.yaml", "-o", out, *QUICK, says="would be replaced, but this run reads it")


def test_what_an_earlier_run_wrote_is_replaced_until_it_is_changed(designed: Path, tmp_path: Path) -> None:
    out = Path(shutil.copytree(designed / "out", tmp_path / "out"))
    refuse_targets(out)
    (out / "identify.yaml").write_text((out / "identify.yaml").read_text() + "# mine\n")
    with pytest.raises(ConfigError, match=r"identify\.yaml: was written or changed by hand"):
        refuse_targets(out)


def test_from_python_nothing_is_written_unless_it_is_asked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "two.urdf").write_text(TWO)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(ExcitationProject, "design", lambda project, *_: project.request.duration)
    assert dy.excite("two.urdf", duration=14) == 14
    assert [path.name for path in tmp_path.iterdir()] == ["two.urdf"]
    with pytest.raises(ConfigError, match="unknown key 'durations'"):
        dy.excite("two.urdf", durations=3)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--noise", "lift=x"), "--noise lift=x: give a number"),
        (("--program", "dance"), "'dance' is not one of"),
        (("--parameter", "nothing"), "nothing"),
        (("--duration", "1"), "duration"),
    ],
)
def test_what_is_wrong_is_said(words: tuple[str, ...], said: str, tmp_path: Path) -> None:
    (tmp_path / "two.urdf").write_text(TWO)
    done = run("excite", tmp_path / "two.urdf", "-o", tmp_path / "out", "--starts", 1, "--workers", 1, *words)
    assert done.exit_code in (1, 2)
    assert said in done.output
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("robot", "settings", "said"),
    [
        (TWO.replace('velocity="2"', ""), {}, "velocity (in rad/s) of lift"),
        (TWO, {"limits": {"lift": {"lower": 3.0}}}, "leave no position in rad"),
        (TWO, {"start": {"lift": 3.0}}, "start: joint 'lift' is at 3, outside"),
        (TWO, {"start": {}, "boxes": [{"name": "crate", "centre": [0.4, 0, 0], "size": [0.2, 0.2, 0.2]}]}, "'crate'"),
    ],
)
def test_limits_and_starts_that_cannot_be_are_refused_before_long_work(
    robot: str, settings: dict[str, Any], said: str, tmp_path: Path
) -> None:
    (tmp_path / "two.urdf").write_text(robot)
    (tmp_path / "cell.yaml").write_text(yaml.safe_dump(settings))
    words = ("-o", tmp_path / "out", "--settings", tmp_path / "cell.yaml", "--workers", 1)
    refuse("excite", tmp_path / "two.urdf", *words, says=said)
    assert not (tmp_path / "out").exists()
