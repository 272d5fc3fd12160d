"""What was chosen, written out: the configuration repeats the result, from any folder and with any names."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
import yaml

from dynident.estimators import PhysicallyConsistent, RobustLeastSquares
from dynident.identification import Identification, identify
from dynident.models import Model
from dynident.models.friction import Offset
from dynident.motion.log import Log
from dynident.project.config import read_config
from dynident.project.explicit_config import explicit_config, explicit_settings, part_settings
from dynident.project.project import run
from dynident.project.saved import load
from dynident.project.settings import RobotSettings
from dynident.report.identification.terms import choice_comments
from dynident.runtime import ConfigError
from dynident.runtime.families import ESTIMATORS
from tests.identification.terms import simulated
from tests.identification.terms.simulated import ARM, bodies, recorded

# leaves out what takes most of the time
QUICK = {
    "smoother": {"kind": "difference"},
    "estimator": {"kind": "least_squares"},
    "time_offset": 0.0,
    "train": [{"file": "logs/mon: #day.csv", "window": [0, 8]}],
    "validation": [{"file": "logs/tuesday.csv", "window": [0, 4]}],
}
NAMES = {"j1": "on", "j2": "no: \"#x'", "j3": "épaule"}


def write(folder: Path, terms: Any = None, **changes: Any) -> Path:
    """Write a robot, two recordings and a configuration in a folder; names are as bad as they may be."""
    (folder / "logs").mkdir(parents=True)
    text = ARM
    for old, new in NAMES.items():
        text = text.replace(f'"{old}"', '"' + new.replace('"', "&quot;") + '"')
    (folder / "an arm.urdf").write_text(text, encoding="utf-8")
    for seed, name in ((1, "mon: #day"), (5, "tuesday")):
        motion = recorded(simulated.by_load, seed)
        columns = {"t": motion.t} | {f"q{k}: #": q for k, q in enumerate(motion.q.T)}
        columns |= {f"tau{k}": tau for k, tau in enumerate(motion.tau.T)}
        pl.DataFrame(columns).write_csv(folder / "logs" / f"{name}.csv")
    config = {
        "model": {"file": "an arm.urdf"} | ({} if terms is None else {"terms": terms}),
        "time": {"column": "t", "unit": "s"},
        "position": {name: {"column": f"q{k}: #", "unit": "rad"} for k, name in enumerate(NAMES.values())},
        "torque": {name: {"column": f"tau{k}", "unit": "N m"} for k, name in enumerate(NAMES.values())},
        "train": [{"file": "logs/mon: #day.csv", "window": [None, 18.0]}],
        "validation": [{"file": "logs/tuesday.csv"}],
        **changes,
    }
    path = folder / "robot.yaml"
    path.write_text(yaml.safe_dump(config), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def chosen(tmp_path_factory: pytest.TempPathFactory) -> Identification:
    return run(write(tmp_path_factory.mktemp("made") / "here"))


def written(identification: Identification, path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(
        explicit_config(identification, path, choice_comments(identification, "robot.yaml")), encoding="utf-8"
    )
    return path


def assert_same_torque(identification: Identification, again: Identification) -> None:
    for first, second in zip(identification.validations, again.validations, strict=True):
        assert first.name == second.name
        left = np.linalg.norm(first.predicted_torque - second.predicted_torque, axis=0)
        assert (left <= 1e-6 * np.linalg.norm(first.predicted_torque, axis=0)).all()


def test_it_repeats_the_result_from_another_folder(chosen: Identification, tmp_path: Path) -> None:
    assert any("Load" in type(term).__name__ for term in chosen.model.terms)  # so that the load must come out again
    path = written(chosen, tmp_path / "else where" / "fixed.yaml")
    again = run(path)
    assert again.calibration.terms is None
    np.testing.assert_allclose(again.model.load, chosen.model.load, rtol=1e-9, atol=1e-12)
    assert_same_torque(chosen, again)


def test_nothing_in_it_is_left_to_choose(chosen: Identification, tmp_path: Path) -> None:
    config = read_config(written(chosen, tmp_path / "fixed.yaml"))
    assert isinstance(config.model, RobotSettings)
    assert not config.model.chooses_terms
    assert isinstance(config.time_offset, float)
    assert config.model.base_tilt == "none" or isinstance(config.model.base_tilt, tuple)
    text = (tmp_path / "fixed.yaml").read_text(encoding="utf-8")
    assert "rule: torque" not in text
    assert r"\xE9" not in text  # names stay readable


def test_comments_say_why_and_end_with_their_line(chosen: Identification, tmp_path: Path) -> None:
    evil = {"": ["a\nmodel: 1"], "time_offset": ["b\u2028\x07"], "model.terms": ["c\r- {kind: no}"]}
    path = tmp_path / "fixed.yaml"
    path.write_text(explicit_config(chosen, path, evil), encoding="utf-8")
    read_config(path)
    text = written(chosen, path).read_text(encoding="utf-8")
    choice = chosen.calibration.terms
    entered = [trial for trial in choice.trials if trial.outcome.name == "ENTERED"]
    assert entered
    assert all(f"gain {x.gain:.3g} +- " in text for x in entered if 0.1 < x.gain < 99.9)


def test_settings_of_a_part_inside_another_are_left_out_likewise(tmp_path: Path) -> None:
    within = PhysicallyConsistent(total_mass=12.0, fit=RobustLeastSquares("tukey"))
    wanted = {"kind": "consistent", "total_mass": 12.0, "fit": {"kind": "robust", "loss": "tukey"}}
    assert part_settings(ESTIMATORS, within, tmp_path) == wanted


def test_too_few_samples_leave_the_plain_set(tmp_path: Path) -> None:
    outcome = run(write(tmp_path / "a", **QUICK | {"train": [{"file": "logs/mon: #day.csv", "window": [0, 2.5]}]}))
    choice = outcome.calibration.terms
    assert choice.trials == ()
    assert [type(x).__name__ for x in outcome.model.terms[1:]] == ["RotorInertia", "Viscous", "Coulomb", "Offset"]
    again = load(outcome.save(tmp_path / "result.json"))
    assert again.model.names == outcome.model.names
    assert_same_torque(outcome, run(written(outcome, tmp_path / "b" / "fixed.yaml")))


def test_a_result_from_python_has_no_configuration() -> None:
    motion = recorded(simulated.none, 1)
    log = Log(motion.t, motion.q, motion.tau, motion.joints, "log")
    result = identify(Model((bodies(), Offset(bodies().joints))), [log])
    with pytest.raises(ConfigError, match="made from Python, without a configuration"):
        explicit_config(result, Path("x.yaml"), {})


def test_other_sections_are_kept(tmp_path: Path) -> None:
    path = write(
        tmp_path / "a", ["viscous"], zero={"on": 0.1}, filter={"decimate": 2}, min_speed={"épaule": 0.01}, **QUICK
    )
    data: Mapping[str, Any] = explicit_settings(run(path), tmp_path)
    assert data["zero"] == {"on": 0.1}
    assert data["filter"] == {"decimate": 2}
    assert data["min_speed"] == {"épaule": 0.01}
