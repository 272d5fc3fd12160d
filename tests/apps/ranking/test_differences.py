"""Differences and chance, by blocks of time, and the truth that estimates are compared with."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

import dynident as dy
from dynident.apps.ranking import differences as module
from dynident.apps.ranking.differences import _block_length as block_length
from dynident.apps.ranking.differences import differences, joint_errors, mean_error, read_truth, time_blocks
from dynident.motion.log import Log
from dynident.project.settings import RobotSettings, robot_settings
from dynident.runtime import ConfigError, InputError
from tests.apps.ranking.made import make_project
from tests.robots import joint, link, urdf


def test_blocks_are_of_equal_time_and_of_one_log_each() -> None:
    logs = {
        name: Log(t, np.sin(t)[:, None], np.cos(t)[:, None], ("a",), name)
        for name, t in (("long", np.arange(3000) * 0.01), ("short", np.arange(1000) * 0.01))
    }
    blocks = time_blocks(logs)
    assert len(blocks) == 400
    assert np.bincount(blocks.log).tolist() == [300, 100]
    sums = blocks.sums({name: np.ones((len(log), 2)) for name, log in logs.items()})
    assert sums.sum(axis=0).tolist() == [4000.0, 4000.0]
    assert (np.abs(sums - 10.0) <= 1.0).all()
    assert len(time_blocks({"short": logs["short"].rows(slice(0, 7), "short")})) == 3


BLOCKS, JOINTS = 200, 2


def drawn(rng: np.random.Generator, sizes: list[float], memory: float = 0.0) -> np.ndarray:
    """Return sums of squares (R, K, n) of combinations that share most of their error, correlated in time."""

    def noise(shape: tuple[int, ...]) -> np.ndarray:
        white = rng.standard_normal(shape)
        for k in range(1, BLOCKS):
            white[k] = memory * white[k - 1] + np.sqrt(1 - memory**2) * white[k]
        return white

    common = noise((BLOCKS, JOINTS))
    return np.array([size * np.exp(0.5 * common + 0.1 * noise((BLOCKS, JOINTS))) for size in sizes])


def test_errors_are_geometric_means_over_joints_that_have_a_torque() -> None:
    squares, torque = np.array([1.0, 4.0, 9.0]), np.array([100.0, 100.0, 0.0])
    assert joint_errors(squares, torque)[:2] == pytest.approx([10.0, 20.0])
    assert np.isnan(joint_errors(squares, torque)[2])
    assert mean_error(squares, torque) == pytest.approx(200**0.5)


def test_neither_units_nor_a_joint_without_load_change_the_order() -> None:
    """The second joint is all noise (80 %) and tells nothing; the first one is 3 % worse in two of four."""
    rng, torque = np.random.default_rng(5), np.ones((BLOCKS, JOINTS))
    squares = drawn(rng, [1.0] * 4) * [4e-4, 0.64]
    squares[2:, :, 0] *= 1.06
    test_differences = differences(squares, torque, [0] * BLOCKS, np.random.default_rng(0))
    assert (test_differences.p_value[2:] < 0.05).all()
    gain = np.array([1.0, 1e6])
    other = differences(squares * gain, torque * [1.0, 7.0], [0] * BLOCKS, np.random.default_rng(0))
    assert other.p_value == pytest.approx(test_differences.p_value, abs=1e-12)


def test_of_exact_data_rounding_does_not_decide() -> None:
    torque = np.ones(2)
    assert mean_error(np.array([[1e-4, 1e-30], [1e-4, 1e-20]]), torque).tolist() == pytest.approx([1e-2, 1e-2])


@pytest.mark.parametrize("memory", [0.0, 0.7])
def test_the_truly_best_are_seldom_called_worse(monkeypatch: pytest.MonkeyPatch, memory: float) -> None:
    """All are equally good, and each may be called worse in 5 % of cases: of 40 x 4 that is 8, and at most 17 with
    99.9 % where they are independent."""
    monkeypatch.setattr(module, "DRAWS", 400)
    rng, torque = np.random.default_rng(1), np.ones((BLOCKS, JOINTS))
    wrong = told = 0
    for _ in range(40):
        test_differences = differences(drawn(rng, [1.0] * 4, memory), torque, [0] * BLOCKS, rng)
        wrong, told = wrong + int((test_differences.p_value < 0.05).sum()), told + test_differences.has_enough_blocks
    assert told >= 30
    assert wrong <= 17


def test_a_true_difference_is_found_however_many_there_are() -> None:
    rng = np.random.default_rng(2)
    squares = drawn(rng, [1.0, 1.0, *np.linspace(1.3, 3.0, 40)], memory=0.5)
    test_differences = differences(squares, np.ones((BLOCKS, JOINTS)), [0] * 120 + [1] * 80, rng)
    assert (test_differences.p_value[2:] < 0.05).all()
    assert (test_differences.p_value[:2] > 0.05).all()
    assert (test_differences.interval[2:, 0] > 0).all()
    assert test_differences.interval[int(np.argmin(test_differences.error))].tolist() == [0.0, 0.0]


def test_blocks_are_as_long_as_the_correlation() -> None:
    rng = np.random.default_rng(3)
    white = rng.standard_normal(400)
    slow = np.convolve(white, np.ones(12) / 12, mode="same")
    assert block_length(white) <= 4
    assert block_length(slow) >= 10
    assert block_length(np.ones(50)) == 1


def test_too_few_blocks_tell_nothing() -> None:
    rng = np.random.default_rng(4)
    test_differences = differences(drawn(rng, [1.0, 2.0])[:, :8], np.ones((8, JOINTS)), [0] * 8, rng)
    assert not test_differences.has_enough_blocks
    assert np.isnan(test_differences.p_value).all()
    alone = differences(drawn(rng, [1.0]), np.ones((BLOCKS, JOINTS)), [0] * BLOCKS, rng)
    assert alone.p_value.tolist() == [1.0]
    same = drawn(rng, [1.0])
    twins = differences(np.concatenate([same, same]), np.ones((BLOCKS, JOINTS)), [0] * BLOCKS, rng)
    assert twins.p_value.tolist() == [1.0, 1.0]


def test_intervals_of_a_difference_hold_also_of_few_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    """In 95 % of the cases at least: few blocks scatter too little, and as if there were many it would be 92 %."""
    monkeypatch.setattr(module, "DRAWS", 400)
    rng, few, inside = np.random.default_rng(6), 14, []
    true = 100.0 * (np.sqrt(1.2) - 1.0) * np.exp((0.5**2 + 0.1**2) / 4)
    for _ in range(60):
        full = drawn(rng, [1.0, 1.2])
        for part in np.split(full[:, : BLOCKS // few * few], BLOCKS // few, axis=1):
            test_differences = differences(part, np.ones((few, JOINTS)), [0] * few, rng)
            if test_differences.has_enough_blocks:
                low, high = test_differences.interval[1]
                inside.append(low < true < high)
    assert len(inside) > 250
    assert 0.94 < np.mean(inside) < 0.99  # twice as wide, it would be all


ARM = Path(__file__).parents[3] / "src/dynident/apps/demo/files/arm.urdf"


def test_values_are_read_from_yaml_results_and_robot_files(tmp_path: Path) -> None:
    assert read_truth({"M": 5}, tmp_path, "gallery:slider") == {"M": 5.0}
    (tmp_path / "truth.yaml").write_text("M: 5\nFv: 8.0\n")
    assert read_truth("truth.yaml", tmp_path, "gallery:slider") == {"M": 5.0, "Fv": 8.0}
    (tmp_path / "parameters.yaml").write_text("parameters:\n- {name: M, value: 5.5, unit: kg}\n")
    assert read_truth("parameters.yaml", tmp_path, "gallery:slider") == {"M": 5.5}
    outcome = dy.run(make_project(tmp_path))
    outcome.save(tmp_path / "result.json")
    values = read_truth("result.json", tmp_path, "gallery:slider")
    assert values == pytest.approx(dict(zip(outcome.estimate.names, outcome.estimate.value.tolist(), strict=True)))


def test_a_robot_file_has_bodies_friction_and_rotors(tmp_path: Path) -> None:
    text = ARM.read_text().replace('velocity="', 'velocity="', 1)
    (tmp_path / "true.urdf").write_text(text)
    shutil.copytree(ARM.parent / "meshes", tmp_path / "meshes")
    spec = robot_settings(str(ARM), {"folder": ARM.parent})
    assert isinstance(spec, RobotSettings)
    values = read_truth("true.urdf", tmp_path, spec)
    model = dy.read_robot(ARM)
    reference = {parameter.name: parameter.value for parameter in model.parameters if parameter.value is not None}
    assert {name: values[name] for name in reference} == pytest.approx(reference)
    assert all(values[name] or name in reference for name in values), "zeros are no truth of friction"
    with pytest.raises(ConfigError, match="is a robot file, and the model is none"):
        read_truth("true.urdf", tmp_path, "gallery:slider")


@pytest.mark.parametrize(
    "text", ["M: heavy\n", "- 5\n", "M: .nan\n", "parameters: [{name: M}]\n", "parameters: [3]\n", f"M: {10**400}\n"]
)
def test_what_is_no_list_of_values_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "truth.yaml").write_text(text)
    with pytest.raises(ConfigError, match=r"truth\.yaml"):
        read_truth("truth.yaml", tmp_path, "gallery:slider")
    (tmp_path / "truth.json").write_text(json.dumps({"M": 5}))
    with pytest.raises((ConfigError, InputError)):
        read_truth("truth.json", tmp_path, "gallery:slider")


def test_zeros_that_a_file_writes_are_no_truth_of_friction(tmp_path: Path) -> None:
    parts = link("base"), link("upper", 2.0, (0.15, 0, 0.02)), link("fore", 1.0, (0, 0.0, 0.03))
    joints = (
        joint("shoulder", "revolute", "base", "upper", inside='<dynamics damping="0" friction="0.0"/>'),
        joint("elbow", "revolute", "upper", "fore", inside='<dynamics damping="0.5" friction="0"/>'),
    )
    (tmp_path / "true.urdf").write_text(urdf(*parts, *joints))
    spec = robot_settings("true.urdf", {"folder": tmp_path})
    assert isinstance(spec, RobotSettings)
    for terms in (("auto",), ("viscous", "coulomb", "rotor", "offset")):
        values = read_truth("true.urdf", tmp_path, spec.model_copy(update={"terms": terms}))
        assert {name: value for name, value in values.items() if "." not in name} == {"Fv_elbow": 0.5}
        assert values["fore.mx"] == 0.0


@pytest.mark.parametrize(("count", "period", "length"), [(400, 12, 60), (60, 22, 20), (400, 15, 27)])
def test_a_block_is_no_longer_than_a_third_and_three_roots_of_the_series(count: int, period: int, length: int) -> None:
    assert block_length(np.cos(2 * np.pi * np.arange(count) / period)) == length


def test_a_truth_is_numbers_however_they_are_written(tmp_path):
    (tmp_path / "truth.yaml").write_text(f"M: 1e-3\nFv: {-(2**63) - 1}")
    assert read_truth("truth.yaml", tmp_path, "gallery:slider") == {"M": 1e-3, "Fv": float(-(2**63) - 1)}
