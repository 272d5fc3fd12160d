"""Real robots, as a user would identify them: the example configurations, judged on held-out motion.

The recordings are not part of the project; without them these tests are skipped.
"""

import json
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import yaml

from dynident.estimators.notes import NotWhite
from dynident.identification import Identification, judge
from dynident.identification import identify as fit
from dynident.identification.verdict_reasons import MassMatrixNotPositive, Repeats
from dynident.project.export import exports
from dynident.project.project import read_project
from dynident.project.saved import load
from dynident.runtime import Severity
from tests.cli.commands import succeed
from tests.laws.real_robots import DATA, ROOT, configured, identify, located
from tests.laws.test_numbers import ROBOTS, check_numbers, numbers_of
from tests.saved_results import errors_by_log, runs_by_log

pytestmark = pytest.mark.skipif(not DATA.exists(), reason="the recordings are not beside the checkout")
CONSISTENT = "estimator: {kind: consistent}"
UNCHOSEN = {"smoother": {"kind": "spline"}}  # what does not depend on the smoothing: trying all of them takes long
UNSIMULATED = "simulation: null"  # likewise, for what is not simulated
PUNCTUAL = "time_offset: 0"  # what the search for one finds of the LWR4 and the Panda anyway


@cache
def fitted(folder: Path, example: str, changes: str) -> Identification:
    """An example with other settings, without the checks and the report of the command."""
    project = read_project(configured(folder, example, changes))
    logs, _ = project.logs()
    return fit(project.model, logs["train"], logs["validation"], project.recipe)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("real")


def level(*more: str) -> str:
    """The LWR4 on a base taken as level, with more terms."""
    model = yaml.safe_load((ROOT / "examples" / "lwr4.yaml").read_text())["model"]
    changes = {"model": model | {"base_tilt": "none", "terms": [*model["terms"], *more]}, "time_offset": 0}
    return yaml.safe_dump(changes)


def short(example: str) -> str:
    """Two seconds of the recording and nothing to choose, with the base as level: for what depends on neither."""
    settings = yaml.safe_load((ROOT / "examples" / f"{example}.yaml").read_text())
    train = [x | {"window": [0, 2]} for x in settings["train"]]
    estimator = {"kind": "consistent", "strength": 0.0}
    model = settings["model"] | {"base_tilt": "none"}
    changes = {"model": model, "estimator": estimator, "train": train, "validation": [], "time_offset": 0.0, **UNCHOSEN}
    return yaml.safe_dump(changes)


def errors(result: dict[str, Any], role: str, kind: str = "relative_error") -> list[float]:
    return [value[kind] for value in errors_by_log(result, role).values()]


def held_out(identification: Identification, kind: str = "relative_error") -> float:
    return max(
        getattr(validation.errors, kind) for validation in identification.validations if validation.role == "validation"
    )


def values(identification: Identification) -> dict[str, float]:
    return dict(zip(identification.estimate.names, identification.estimate.value, strict=True))


@pytest.mark.parametrize("example", ROBOTS)
def test_the_numbers_stay(folder: Path, example: str) -> None:
    check_numbers(example, numbers_of(identify(folder, example)))


def test_lwr4(folder: Path) -> None:
    """Least squares, unfiltered as logged, held out on the repeat: at most 2.2 %, even on a base taken as level."""
    result = identify(folder, "lwr4")
    assert max(errors(result, "validation")) <= 2.1
    assert held_out(fitted(folder, "lwr4", level())) <= 2.2
    assert max(errors(result, "train")) <= 2.0


def test_lwr4_consistent(folder: Path) -> None:
    """With possible bodies and non-negative friction: at most 2.25 % held out; 2.5 % with rotors on a level base."""
    test_fit = fitted(folder, "lwr4", f"{CONSISTENT}\n{PUNCTUAL}")
    assert held_out(test_fit) <= 2.25
    assert held_out(fitted(folder, "lwr4", f"{CONSISTENT}\n{level('rotor')}")) <= 2.5
    masses = [value for name, value in values(test_fit).items() if name.endswith(".mass")]
    assert len(masses) == 7
    assert min(masses) > 0


@pytest.mark.parametrize("example", ["lwr4", "panda", "double_pendulum", "tx40"])
def test_the_model_is_written_and_proven(folder: Path, example: str) -> None:
    """The URDF, read by Pinocchio, and the NumPy module give the identified torque on the logs."""
    made = exports(fitted(folder, example, f"{CONSISTENT}\n{PUNCTUAL}" if example == "lwr4" else short(example)))
    assert [x.format for x in made] == ["urdf", "yaml", "numpy"]
    for case in made:
        assert case.ready, case.refusal
        assert case.proof.agreement <= 1e-8
    assert "Pinocchio" in made[0].proof.readers


def test_panda(folder: Path) -> None:
    """Trained on 70 % of the period of its motion, judged on the rest, which is another motion."""
    assert max(errors(identify(folder, "panda"), "validation")) <= 3.1


def test_panda_held_out_as_published(folder: Path) -> None:
    """70 % of the recording to fit, 30 % to judge; a competent baseline has 2.92 % unfiltered."""
    settings = yaml.safe_load((ROOT / "examples" / "panda.yaml").read_text())
    settings["train"][0]["window"], settings["validation"][0]["window"] = [0, 14.7], [14.7, None]
    logs = yaml.safe_dump({role: settings[role] for role in ("train", "validation")})
    test_fit = fitted(folder, "panda", f"estimator: {{kind: least_squares}}\n{PUNCTUAL}\n{logs}")
    assert held_out(test_fit) <= 2.9
    assert {Repeats, MassMatrixNotPositive} <= {type(reason) for reason in judge(test_fit).reasons}


def test_double_pendulum(folder: Path) -> None:
    result = identify(folder, "double_pendulum")
    (joints,) = (value["per_joint"] for value in errors_by_log(result, "validation").values())
    assert joints["Joint1"] <= 8.0
    assert joints["Joint2"] <= 20.0
    assert max(errors(result, "validation", "relative_error_filtered")) <= 7.5


def test_tx40(folder: Path) -> None:
    result = identify(folder, "tx40")
    assert max(errors(result, "validation", "relative_error_filtered")) <= 7.9
    actual = {x["name"]: x["value"] for x in result["parameters"]}
    for joint, published in zip(range(1, 7), (8.05, 5.53, 1.97, 1.11, 1.86, 0.65), strict=True):
        wrist = actual["Fv_m6"] if joint > 4 else 0.0  # published is the diagonal, which the wrist's motor adds to
        assert actual[f"Fv_joint_{joint}"] + wrist == pytest.approx(published, rel=0.1), joint


def test_emps(folder: Path) -> None:
    """The first real log: published M 95.11 kg, Fv 203.5, Fc 20.39; 4.083 % and, on the pulses, 5.982 %."""
    result = identify(folder, "emps")
    actual = {x["name"]: x["value"] for x in result["parameters"]}
    assert actual["M"] == pytest.approx(95.11, rel=0.005)
    assert actual["Fv"] == pytest.approx(203.5, rel=0.015)
    assert actual["Fc"] == pytest.approx(20.39, rel=0.015)
    train, pulses = errors_by_log(result, "train")["DATA_EMPS"], errors_by_log(result, "validation")["pulses"]
    assert train["relative_error_filtered"] <= 4.15
    assert pulses["relative_error_filtered"] <= 6.0
    assert train["relative_error"] == pytest.approx(4.4, abs=0.1)
    assert pulses["relative_error"] == pytest.approx(11.3, abs=0.2)


def test_emps_with_its_time_offset(folder: Path) -> None:
    """The drive's 0.35 ms, found on the training log, take a fifth off the error on the pulses."""
    plain, test_fit = identify(folder, "emps"), fitted(folder, "emps", f"time_offset: estimate\n{UNSIMULATED}")
    assert held_out(test_fit) < 0.85 * errors(plain, "validation")[0]
    assert held_out(test_fit, "relative_error_filtered") <= 4.9


def test_emps_by_maximum_likelihood(folder: Path) -> None:
    """As good as least squares and no better: the model's friction limits, not noise, and the status says so."""
    test_fit = fitted(folder, "emps", f"estimator: {{kind: maximum_likelihood}}\n{UNSIMULATED}")
    for name, usual, near in (("M", 95.0, 0.2), ("Fv", 204.1, 1.0), ("Fc", 20.34, 0.1), ("offset", -3.18, 0.05)):
        assert values(test_fit)[name] == pytest.approx(usual, abs=near), name
    assert held_out(test_fit, "relative_error_filtered") <= 5.99
    assert any(isinstance(note, NotWhite) for note in test_fit.estimate.notes)


def test_emps_bound_is_what_least_squares_reaches(folder: Path) -> None:
    """All but nothing of the variance is due to positions, so that least squares on all samples is at the bound."""
    plain = f"filter: null\n{UNSIMULATED}"
    test_fit = fitted(folder, "emps", plain)
    reached = dict(zip(test_fit.estimate.names, test_fit.errors.std_independent, strict=True))
    file = folder / "bound.json"
    succeed("bound", configured(folder, "emps", plain), "--json", file)
    for case in json.loads(file.read_text())["parameters"]:
        assert case["position_share"] < 0.01
        assert case["std"]["now"] == pytest.approx(reached[case["name"]], rel=0.05), case["name"]


def test_emps_simulated_in_its_loop(folder: Path) -> None:
    """The published position errors of the forward simulation are 0.0138 and 0.0080 %."""
    result = identify(folder, "emps")
    assert result["report"]["verdict"]["word"] == "good for simulation"
    for name, published in (("DATA_EMPS", 0.0138), ("pulses", 0.0080)):
        assert runs_by_log(result)[name]["relative_error"]["slider"] < published / 2
        assert runs_by_log(result)[name]["torque_error"]["slider"] < 10


def test_emps_standard_errors_are_published_ones_and_larger_where_residuals_correlate(folder: Path) -> None:
    result = {x["name"]: x for x in identify(folder, "emps")["parameters"]}
    for name, published in {"M": 0.1085, "Fv": 1.146, "Fc": 0.1012, "offset": 0.0444}.items():
        assert result[name]["std_independent"] == pytest.approx(published, rel=0.1)
        assert result[name]["std"] > 1.5 * result[name]["std_independent"]


@pytest.mark.parametrize("example", ["lwr4", "panda", "tx40", "double_pendulum"])
def test_verdicts_are_no_better_than_their_reasons(folder: Path, example: str) -> None:
    """A repeat holds nothing out; a mass matrix must be positive; one bad joint is enough; none was simulated."""
    verdict = identify(folder, example)["report"]["verdict"]
    expected = {
        "lwr4": ("do not use", "measurements_2 repeats the motion of measurements_1"),
        "panda": ("good for control", "no free simulation was run"),
        "tx40": ("do not use", "joint_5"),
        "double_pendulum": ("good for control", "no free simulation was run"),
    }
    word, reason = expected[example]
    assert f" %; {word}" in (ROOT / "examples" / f"{example}.yaml").read_text()  # as its first lines say
    assert verdict["word"] == word
    assert any(reason in x for x in verdict["reasons"])


def test_emps_as_a_robot_file_is_its_lagrangian_model(folder: Path) -> None:
    urdf = (
        '<robot name="emps"><link name="base"/><link name="carriage"><inertial><mass value="1"/>'
        '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        '<joint name="slider" type="prismatic"><parent link="base"/><child link="carriage"/><axis xyz="1 0 0"/>'
        '<limit effort="1" velocity="1" lower="0" upper="1"/></joint></robot>'
    )
    (folder / "emps.urdf").write_text(urdf)
    plain = values(fitted(folder, "emps", UNSIMULATED))
    model = f"model: {{file: {folder / 'emps.urdf'}, terms: [viscous, coulomb, offset]}}\n{UNSIMULATED}"
    bodies = values(fitted(folder, "emps", model))
    for name, other in {"M": "carriage.mass", "Fv": "Fv_slider", "Fc": "Fc_slider", "offset": "offset_slider"}.items():
        assert bodies[other] == pytest.approx(plain[name], rel=1e-9)


def check(folder: Path, example: str, *changes: tuple[str, str]) -> dict[str, set[tuple[str, str | None]]]:
    """What ``dynident check`` says of an example, some words of it replaced: topics and places by severity."""
    text = located((ROOT / "examples" / f"{example}.yaml").read_text())
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = folder / f"check-{example}.yaml"
    path.write_text(text)
    succeed("check", path, "--json", folder / "check.json")
    (result,) = json.loads((folder / "check.json").read_text()).values()
    said: dict[str, set[tuple[str, str | None]]] = {"error": set(), "warning": set(), "info": set()}
    for case in result["findings"]:
        said[case["severity"]].add((case["topic"], case["link"] or case["joint"]))
    return said


def warned(folder: Path, example: str) -> set[tuple[str, str | None]]:
    """Topics and places of what the checks beside the identification of an example warn of."""
    identify(folder, example)
    result = [
        finding for finding in load(folder / example / "result.json").findings if finding.severity is not Severity.INFO
    ]
    return {(x.topic, x.link or x.joint) for x in result}


def topics(said: set[tuple[str, str | None]]) -> set[str]:
    return {topic for topic, _ in said}


def test_checks_say_of_the_recordings_what_is_known_of_them(folder: Path) -> None:
    """No false alarm, alone or beside an identification: EMPS and TX40 are sound but for their friction; the stamps of
    the LWR4 are noisy, cables pull at its wrist, and two fifths of what is left of its fourth joint is at reversals,
    which is the limit; the Panda's own sampling jitters. The held-out motion of the LWR4 repeats the training."""
    emps = check(folder, "emps")
    assert (emps["error"], emps["warning"]) == (set(), {("missing term", "slider")})
    assert {topic for topic, _ in emps["info"]} <= {"missing term"}
    other = check(folder, "emps", ("velocity_steps: 2", "velocity_steps: 1"))
    assert other["warning"] == {("missing term", "slider"), ("loop", None)}
    assert topics(warned(folder, "tx40")) == {"missing term"}
    assert warned(folder, "lwr4") - {("unexplained", "lwr_4_joint")} == {
        ("spread", "lwr_7_link"), ("repeat", None), ("missing term", "lwr_6_joint")
    }  # fmt: skip
    assert topics(warned(folder, "panda")) == {"spread", "stale", "gain", "unexplained"}  # at reversals of joint 7
    pendulum = check(folder, "double_pendulum")["warning"]
    assert topics(pendulum) == {"quantised", "spread", "torque spikes", "gain"}


def test_checks_see_the_rest_of_the_tx40_and_turned_signs(folder: Path) -> None:
    plain = "smoother: { kind: spline, rule: torque }", "smoother: { kind: spline }"
    rest = "window: [5, 7.4]", "window: [5, 9]"
    turned = check(folder, "tx40", ("tau.Joint_2, unit", "tau.Joint_2, gain: -1, unit"), rest, plain)
    assert turned["warning"] == {("sign", "joint_2")}
    assert ("rest", None) in turned["info"]
    some = ("window: [0, 9.33]", "window: [0, 4]"), ("window: [9.33, 13.33]", "window: [9.33, 11]")
    swapped = check(folder, "panda", ("tau.1,", "tau.6,"), *some, plain)
    assert ("foreign", "panda_joint2") in swapped["warning"]
    assert {("jitter", None), ("lost", None)} <= swapped["info"]


def test_what_the_sensors_allow(folder: Path) -> None:
    """White noise in % of the torque: the Panda has 0.5; of the LWR4, recorded after a low-pass, it is not known."""
    for example in ("panda", "lwr4"):
        identify(folder, example)
    for log in load(folder / "panda" / "result.json").validations:
        assert 0.3 < log.errors.relative_error / log.errors.all_over_noise < 0.7
    for log in load(folder / "lwr4" / "result.json").validations:
        assert log.errors.sensor_noise == {}
