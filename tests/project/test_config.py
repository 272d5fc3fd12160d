"""Configurations: the models they name, and what is warned of."""

import pytest
import yaml

from dynident.files.yaml_text import load_yaml
from dynident.project.config import config_warnings, load_model, parse_config, read_config
from dynident.runtime import ConfigError, ModelError
from tests.project.configurations import FULL, TWO


def test_a_file_of_a_fleet_is_named_as_such_and_a_missing_one_lists_its_neighbours(tmp_path):
    with pytest.raises(ConfigError, match=r"many.yaml: is the file of a fleet, for `dynident fleet`"):
        parse_config("recipe: robot.yaml\nlogs: logs/{robot}/{date}.csv\n", source="many.yaml")
    (tmp_path / "arm.yaml").write_text(FULL)
    with pytest.raises(ConfigError, match=r"no such file.*did you mean 'arm\.yaml'"):
        read_config(tmp_path / "amr.yaml")
    with pytest.raises(ConfigError, match=r"folder .* does not exist"):
        read_config(tmp_path / "lost" / "arm.yaml")


ARM = """
from __future__ import annotations
from dataclasses import dataclass
from dynident.models.lagrangian import pendulum

@dataclass
class Size:
    l: float = 1.0

def arm():
    assert Size().l == 1.0
    return pendulum()
"""


def test_models_are_found_in_the_gallery_and_in_files(tmp_path):
    (tmp_path / "arm.py").write_text(ARM)
    assert [joint.name for joint in load_model("gallery:slider").joints] == ["slider"]
    assert load_model("arm.py:arm", tmp_path).joints == load_model("gallery:pendulum").joints


WRONG_MODELS = {
    "no colon": ("slider", "", ("neither a robot file (.urdf, .xml) nor `gallery:NAME` nor",)),
    "gallery": ("gallery:slidr", "", ("did you mean 'slider'", "'two_link_arm'")),
    "no file": ("amr.py:arm", "", ("there is no such file", "did you mean 'arm.py'")),
    "no function": ("arm.py:amr", "def arm(): ...\n", ("no function 'amr'", "did you mean 'arm'")),
    "raises": ("arm.py:arm", "x = 1\ndef arm():\n    return [][3]\n", ("arm.py:3: IndexError: list index",)),
    "raises at import": ("arm.py:arm", "x = 1\n1 / 0\n", ("arm.py:2: ZeroDivisionError",)),
    "exits": ("arm.py:arm", "raise SystemExit(3)\n", ("arm.py:1: SystemExit: 3",)),
    "syntax": ("arm.py:arm", "x = 1\ndef arm(:\n", ("arm.py:2: SyntaxError",)),
    "returns no model": (
        "arm.py:arm",
        "def arm():\n    return 3\n",
        ("returned a int; it must return a dynident Model",),
    ),
    "needs arguments": ("arm.py:arm", "def arm(x):\n    return x\n", ("TypeError", "missing 1 required")),
}


@pytest.mark.parametrize(("spec", "code", "fragments"), WRONG_MODELS.values(), ids=WRONG_MODELS)
def test_models_that_cannot_be_built(tmp_path, spec, code, fragments):
    (tmp_path / "arm.py").write_text(code)
    with pytest.raises(ModelError) as caught:
        load_model(spec, tmp_path)
    assert all(fragment in str(caught.value) for fragment in fragments), caught.value


def warned(**changes):
    return config_warnings(parse_config(yaml.safe_dump({**TWO, **changes})))


@pytest.mark.parametrize("section", ["position", "torque"])
def test_two_channels_that_read_the_same_are_warned_of(section):
    channel = {"column": "x", "unit": {"position": "rad", "torque": "N m"}[section]}
    (words,) = warned(**{section: {"a": channel, "b": channel}})
    assert f"{section}.a and {section}.b read the same column 'x'" in words


def test_a_torque_that_reads_a_position_is_warned_of():
    torque = {"a": {"sum": {"i1": 1, "q2": 2}, "unit": "N m"}, "b": {"column": "i2", "unit": "N m"}}
    (words,) = warned(torque=torque)
    assert words.startswith("torque.a reads the column 'q2', which is also read by position.b;")


@pytest.mark.parametrize(
    "spec",
    [
        {"file": "one.csv", "window": [4, 9]},
        {"file": "./one.csv", "window": [[7, 9], [None, 1]]},
        {"file": {"q": "zero.csv", "i": "one.csv"}},
    ],
)
def test_a_validation_log_that_was_fitted_is_warned_of(spec):
    (words,) = warned(validation=[{**spec, "name": "test"}])
    assert words.startswith("validation 'test' overlaps in time with train 'one")


def test_keys_are_names_and_values_may_be_truth_values():
    """YAML 1.1 reads the key ``on`` as true."""
    read = load_yaml("{ on: [a], no: yes, off: on, true: 1 }", "text")
    assert read == {"on": ["a"], "no": True, "off": True, "true": 1}
