"""What a configuration is warned of, and that one mistake is told once."""

import pytest
import yaml

from dynident.errors import ConfigError, ModelError
from dynident.io.config import config_warnings, load_model, parse_config

TWO = {
    "model": "gallery:slider",
    "time": {"rate": 100},
    "position": {"a": {"column": "q1", "unit": "rad"}, "b": {"column": "q2", "unit": "rad"}},
    "torque": {"a": {"column": "i1", "unit": "N m"}, "b": {"column": "i2", "unit": "N m"}},
    "train": [{"file": "one.csv", "window": [0, 5]}],
}


def warned(**changes):
    return config_warnings(parse_config(yaml.safe_dump({**TWO, **changes})))


def test_an_ordinary_configuration_gives_no_warning():
    apart = [{"file": "one.csv", "window": [5, 9]}, {"file": "two.csv", "window": [0, 5]}]
    assert warned(validation=apart) == ()
    scaled = {"a": {"column": "q1", "unit": "rad"}, "b": {"column": "q1", "gain": -1, "unit": "rad"}}
    assert warned(position=scaled) == ()


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


def test_a_wrong_item_is_not_told_again_as_a_list_that_is_too_short():
    with pytest.raises(ConfigError) as caught:
        parse_config(yaml.safe_dump({**TWO, "train": [{"fil": "one.csv"}]}))
    assert "unknown key 'fil'" in str(caught.value)
    assert "at least" not in str(caught.value)


def test_only_functions_of_the_file_itself_are_choices_but_imported_ones_serve(tmp_path):
    source = (
        "from dynident.models.gallery import pendulum\nfrom pathlib import Path\n\ndef arm():\n    return pendulum()\n"
    )
    (tmp_path / "mine.py").write_text(source)
    with pytest.raises(ModelError, match=r"did you mean 'arm'\? Known: 'arm'\.$"):
        load_model("mine.py:amr", tmp_path)
    assert load_model("mine.py:pendulum", tmp_path).names
