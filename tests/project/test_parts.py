"""Settings of parts that are classes of the user's files."""

from __future__ import annotations

import json

import pytest

from dynident.motion.smoothers import Butterworth, Difference
from dynident.project.parts import build
from dynident.runtime import ConfigError
from dynident.runtime.families import SMOOTHERS
from tests.project.parts import SAVITZKY

PAIR = """
from dataclasses import dataclass

from dynident.motion.smoothers import Difference, Smoother


@dataclass(frozen=True)
class Pair(Smoother):
    first: Smoother
    second: Smoother | None = None

    def __call__(self, log): ...
"""


@pytest.mark.parametrize("second", [None, {"kind": "difference", "scheme": "central"}])
def test_a_setting_of_the_type_of_a_part_holds_one(tmp_path, second):
    (tmp_path / "pair.py").write_text(PAIR)
    settings = {"kind": "pair.py:Pair", "first": {"kind": "butterworth"}, "second": second}
    part = build(SMOOTHERS, settings, "smoother", tmp_path)
    assert (part.first, part.second) == (Butterworth(), second and Difference("central"))
    assert build(SMOOTHERS, json.loads(json.dumps(SMOOTHERS.describe(part))), "smoother", tmp_path) == part


LAB = """
from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, Annotated

from annotated_types import Gt

from dynident.motion.smoothers import Smoother

if TYPE_CHECKING:
    from fractions import Fraction


class Window(Enum):
    FLAT = "flat"
    HANN = "hann"


@dataclass(frozen=True)
class Many(Smoother):
    window: Window = Window.FLAT
    taps: Sequence[float] = ()
    names: tuple[str, ...] = ()
    bands: tuple[tuple[float, float], ...] = ()  # pairs, but of no mapping
    share: Mapping[str, float] | Annotated[float, Gt(0)] | None = None

    def __post_init__(self):
        if len(self.taps) > 2:
            raise KeyError("taps")

    def __call__(self, log): ...


@dataclass(frozen=True)
class Hidden(Smoother):
    width: Fraction = 1

    def __call__(self, log): ...
"""


def test_settings_of_many_types(tmp_path):
    (tmp_path / "lab.py").write_text(LAB)
    settings = {"kind": "lab.py:Many", "window": "hann", "taps": [1, "2e-1"], "names": ["a"], "share": {"b": 1}}
    settings["bands"] = [[1, 2], [3, 4]]
    part = build(SMOOTHERS, settings, "smoother", tmp_path)
    assert (part.window.value, part.taps, part.names, part.bands) == (
        "hann",
        (1.0, 0.2),
        ("a",),
        ((1.0, 2.0), (3.0, 4.0)),
    )
    assert part.share == {"b": 1.0}
    assert build(SMOOTHERS, json.loads(json.dumps(SMOOTHERS.describe(part))), "smoother", tmp_path) == part
    for change, words in (
        ({"window": "han"}, "window: 'han' is not a choice; did you mean 'hann'"),
        ({"taps": [1, 2, 3]}, "KeyError: 'taps'"),
        ({"share": {"b": "x"}}, "share.b: a number is expected; got 'x'"),
        ({"share": 0}, "share: should be greater than 0; got 0"),
        ({"kind": "lab.py:Hidden"}, "the type of a field is not known: name 'Fraction'"),
    ):
        with pytest.raises(ConfigError) as caught:
            build(SMOOTHERS, {"kind": "lab.py:Many"} | change, "smoother", tmp_path)
        assert words in str(caught.value)


WRONG = {
    "no file": ({"kind": "gs.py:SavitzkyGolay"}, ("there is no such file", "did you mean 'sg.py'")),
    "no class": ({"kind": "sg.py:Savitzky"}, ("has no class 'Savitzky'", "did you mean 'SavitzkyGolay'")),
    "not a dataclass": ({"kind": "sg.py:function"}, ("sg.py: function is no frozen dataclass",)),
    "not frozen": ({"kind": "sg.py:Thawed"}, ("sg.py: Thawed is no frozen dataclass",)),
    "lacks the protocol": ({"kind": "sg.py:Silent"}, ("sg.py: Silent is no smoother: it lacks __call__",)),
    "type": ({"kind": "sg.py:Odd"}, ("Odd.width has the type", "a setting is a number")),
    "key": ({"kind": "sg.py:SavitzkyGolay", "widht": 1}, ("unknown key 'widht'", "did you mean 'width'")),
    "value": ({"kind": "sg.py:SavitzkyGolay", "order": 2.5}, ("smoother: order: a whole number is expected; got 2.5",)),
    "fails": ({"kind": "bad.py:A"}, ("bad.py failed at", "bad.py:2: ZeroDivisionError")),
    "long": ({"kind": "x" * 5000 + ".py:A"}, ("File name too long",)),
    "NUL": ({"kind": "a\0.py:A"}, ("is no name of a file",)),
    "reserved": ({"kind": "sg.py:Reserved"}, ("Reserved.kind: no setting can have this name",)),
    "private": ({"kind": "sg.py:Private"}, ("Private._width: no setting can have this name",)),
    "no name": ({"kind": "sg.py:"}, ("has no class ''",)),
    "kind of no text": ({"kind": ["sg.py"]}, ("is not a choice",)),
    "no kind": ({}, ("needs a `kind`: spline, difference, butterworth",)),
    "no mapping": ("spline", ("smoother: a mapping",)),
    "nested": (
        {"kind": "time_shifted", "time_offset": 0, "smoother": {"kind": "butterworth", "cutoffs": [1, -1, 1]}},
        ("smoother: smoother.cutoffs[1]: should be greater than 0; got -1",),
    ),
}


@pytest.mark.parametrize(("settings", "fragments"), WRONG.values(), ids=WRONG)
def test_parts_that_cannot_be_built_say_why_and_where(tmp_path, settings, fragments):
    (tmp_path / "sg.py").write_text(SAVITZKY)
    (tmp_path / "bad.py").write_text("x = 1\n1 / 0\n")
    with pytest.raises(ConfigError) as caught:
        build(SMOOTHERS, settings, "smoother", tmp_path)
    message = str(caught.value)
    assert message.startswith("smoother")
    assert all(fragment in message for fragment in fragments), message
