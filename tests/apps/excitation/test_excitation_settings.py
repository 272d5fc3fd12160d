"""Settings of a designed motion: what is refused, and where it is said to be."""

from typing import Any

import pytest

from dynident.apps.excitation.config import excitation_settings, settings_in
from dynident.project.config import parse_config
from dynident.runtime import ConfigError
from tests.project.configurations import changed

BOX = {"name": "table", "centre": [0, 0, 0], "size": [1, 1, 1]}


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"duratoin": 3}, "unknown key 'duratoin'; did you mean 'duration'"),
        ({"duration": 0}, "duration: a number from 0.1 to 3600 s"),
        ({"harmonics": 1e6}, "harmonics: a whole number from 1 to 50"),
        ({"starts": 1.5}, "starts: a whole number from 1 to 1000"),
        ({"file_rate": "fast"}, "file_rate: a number from 1 to 20000 Hz"),
        ({"program": "dance"}, "program: 'dance' is not a choice"),
        ({"parameters": ["m"]}, "`parameters`, those that matter, go with `criterion: a`"),
        ({"margin": 0.95}, "margin: a share from 0 to 0.9"),
        ({"seed": -1}, "seed: a whole number of at least 0"),
        ({"noise": {"j": 0}}, "noise: a number greater than 0"),
        ({"limits": {"j": {"lower": 1, "upper": -1}}}, "limits.j: `lower` must be below `upper`, but 1 >= -1"),
        ({"limits": {"j": {"speed": 1}}}, "limits.j: unknown key 'speed'"),
        ({"boxes": [{**BOX, "size": [1, 1, 0]}]}, "boxes[0].size[2]: a number greater than 0"),
        ({"boxes": [BOX, BOX]}, "two of `boxes` and `cylinders` have the name 'table'"),
        (
            {"cylinders": [{"name": "post", "centre": [0, 0], "radius": 1, "bottom": 2, "top": 1}]},
            "`bottom` must be below `top`",
        ),
    ],
)
def test_a_wrong_setting_is_named(given: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError) as caught:
        excitation_settings(given, "arm.yaml: excitation")
    assert str(caught.value).startswith("arm.yaml: excitation: ")
    assert words in str(caught.value)


def test_the_section_of_a_file() -> None:
    assert settings_in({"excitation": {"duration": 3}}, "x", alone=True) == {"duration": 3}
    assert settings_in({"duration": 3}, "x", alone=True) == {"duration": 3}
    assert settings_in({"model": "a.urdf"}, "x", alone=False) == {}
    assert settings_in({"model": "a.urdf", "excitation": None}, "x", alone=False) == {}
    with pytest.raises(ConfigError, match="a mapping of settings"):
        settings_in({"excitation": [1]}, "x", alone=False)
    with pytest.raises(ConfigError, match="a mapping of settings"):
        settings_in([1], "x", alone=True)


def test_a_configuration_may_hold_them() -> None:
    config = parse_config(changed(excitation={"duration": 12, "limits": {"slider": {"velocity": 0.2}}}))
    assert config.excitation is not None
    assert config.excitation.duration == 12
    assert config.excitation.limits["slider"].velocity == 0.2
    with pytest.raises(ConfigError, match=r"excitation.duration: a number from 0.1"):
        parse_config(changed(excitation={"duration": -1}))
