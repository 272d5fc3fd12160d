"""Configurations: what they hold, and how each mistake is worded."""

from __future__ import annotations

import json
import math
import pickle
import sys
from pathlib import Path

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from dynident.errors import ConfigError, DynidentError, ModelError
from dynident.estimators import LeastSquares
from dynident.io.config import config_warnings, load_model, parse_config, read_config
from dynident.io.fields import unit_factor
from dynident.io.settings import check_joints
from dynident.models import Joint
from dynident.smoothers import Spline

FULL = """
model: gallery:slider
time: {column: t, unit: s}
position:
  slider: {column: qm, unit: m}
torque:
  slider: {column: vir, unit: N, gain: gtau}
train:
  - file: DATA_EMPS.mat
    window: [0, 20]
validation:
  - file: DATA_EMPS_PULSES.mat
    name: pulses
gaps: split
smoother: {kind: spline, rule: constraint, sigma: 1e-6}
estimator: {kind: least_squares, tolerance: 1e-10}
filter: {decimate: 10, cutoff: null, order: 4}
"""
SLIDER = (Joint("slider", "prismatic"),)


def changed(**sections) -> str:
    """The full configuration with some sections replaced, or removed where they are ... ."""
    data = yaml.safe_load(FULL) | sections
    return yaml.safe_dump({key: value for key, value in data.items() if value is not ...}, sort_keys=False)


def with_channel(**keys) -> str:
    return changed(position={"slider": {"column": "qm", "unit": "m"} | keys})


def with_train(**keys) -> str:
    return changed(train=[{"file": "a.mat"} | keys])


def test_a_full_configuration(tmp_path):
    (tmp_path / "emps.yaml").write_text(FULL)
    config = read_config(tmp_path / "emps.yaml")
    check_joints(config, SLIDER)
    assert config.train[0].file == {"": tmp_path / "DATA_EMPS.mat"}
    assert config.train[0].window == ((0, 20),)
    assert [spec.name for spec in (*config.train, *config.validation)] == ["DATA_EMPS", "pulses"]
    assert config.torque["slider"].gain == "gtau"
    assert config.smoother.sigma == 1e-6
    assert config.estimator.tolerance == 1e-10  # PyYAML reads these two as texts
    assert config.filter.decimate == 10
    assert pickle.loads(pickle.dumps(config)) == config


def test_settings_can_be_recorded_as_json():
    record = json.loads(json.dumps(parse_config(FULL, "/data").model_dump(mode="json")))
    assert record["train"] == [
        {"file": {"": str(Path("/data/DATA_EMPS.mat"))}, "width": None, "window": [[0, 20]], "name": "DATA_EMPS"}
    ]
    assert record["torque"]["slider"]["gain"] == "gtau"
    assert record["smoother"]["sigma"] == 1e-6


def test_defaults():
    config = parse_config(changed(gaps=..., smoother=..., estimator=..., filter=..., validation=...))
    assert (config.gaps, config.filter, config.validation) == ("error", None, ())
    assert config.smoother == Spline.Settings(rule="torque")
    assert config.estimator == LeastSquares()


def test_settings_are_frozen():
    with pytest.raises(ValidationError, match="frozen"):
        parse_config(FULL).gaps = "error"


@pytest.mark.parametrize(
    ("smoother", "expected"),
    [
        ({"kind": "difference", "scheme": "central"}, {"scheme": "central"}),
        ({"kind": "butterworth"}, {"orders": (3, 3, 4), "cutoffs": (10, 3, 2), "settle": None}),
        ({"kind": "butterworth", "settle": [1, "5e-1"]}, {"settle": (1, 0.5)}),
        ({"kind": "spline", "rule": "fixed", "lam": "1e-9"}, {"lam": 1e-9, "p": None}),
        ({"kind": "spline", "sigma": {"slider": "1e-5"}}, {"sigma": {"slider": 1e-5}}),
    ],
)
def test_smoothers(smoother, expected):
    config = parse_config(changed(smoother=smoother))
    assert {name: getattr(config.smoother, name) for name in expected} == expected


def test_headerless_columns_need_no_quotes():
    config = parse_config(changed(position={"slider": {"sum": {0: 32, 1: "-4.5e0"}, "unit": "m"}}))
    assert config.position["slider"].terms == {"0": 32, "1": -4.5}


def test_one_file_used_twice_is_named_by_its_windows():
    train = [{"file": "a.mat", "window": [0, 20]}, {"file": "./a.mat", "window": [20, None]}]
    assert [spec.name for spec in parse_config(changed(train=train)).train] == ["a 0-20 s", "a 20-end"]


def test_several_windows_and_files():
    config = parse_config(with_train(file={"q": "q.txt", "i": "i.txt"}, width={"q": 7}, window=[[5, 6], [0, 2.5]]))
    (spec,) = config.train
    assert (spec.name, spec.width, spec.window) == ("q", {"q": 7}, ((5, 6), (0, 2.5)))


MISTAKES = {
    "unknown key": (changed(smother={}), ("unknown key 'smother'", "did you mean 'smoother'")),
    "former key": (changed(parallel={"decimate": 2}), ("unknown key 'parallel'; it is called 'filter' now",)),
    "former key of slow motion": (changed(slow=0.1), ("unknown key 'slow'; it is called 'min_speed' now",)),
    "former key of the base": (
        changed(model={"file": "arm.urdf", "lean": "estimate"}),
        ("model: unknown key 'lean'; it is called 'base_tilt' now",),
    ),
    "unknown inner key": (with_train(windw=[0, 1]), ("train[0]: unknown key 'windw'", "did you mean 'window'")),
    "missing": (changed(time=...), ("time: is missing",)),
    "missing unit": (changed(position={"slider": {"column": "q"}}), ("position.slider.unit: is missing",)),
    "two mistakes": (changed(time=..., gaps="skip"), ("time: is missing", "gaps: 'skip'", "Known: 'error', 'split'")),
    "not a mapping": ("- 1\n- 2\n", ("a mapping (`key: value` lines) is expected",)),
    "empty": ("", ("a mapping", "got None")),
    "no train": (changed(train=[]), ("train: ", "at least 1")),
    "train is no list": (changed(train={"file": "a"}), ("train: a list is expected",)),
    "section is no mapping": (changed(time=3), ("time: a mapping", "got 3")),
    "no time source": (changed(time={}), ("time: needs either `column`",)),
    "both time sources": (changed(time={"column": "t", "unit": "s", "rate": 5}), ("time: needs either",)),
    "time unit": (changed(time={"column": "t"}), ("time: needs the `unit`", "ms")),
    "rate": (changed(time={"rate": 0}), ("time.rate: a number greater than 0", "got 0")),
    "truth value": (with_channel(gain=True), ("position.slider.gain: a finite number", "got True")),
    "not a number": (with_channel(offset=math.nan), ("position.slider.offset", "got nan")),
    "infinite": (with_channel(gain=math.inf), ("position.slider.gain", "got inf")),
    "infinite text": (with_channel(gain="-inf"), ("position.slider.gain", "got '-inf'")),
    "date as a name": (with_channel(column=yaml.safe_load("2020-01-01")), ("position.slider.column: a name",)),
    "column and sum": (with_channel(sum={"a": 1}), ("position.slider: needs either `column` or `sum`",)),
    "empty sum": (changed(position={"slider": {"sum": {}, "unit": "m"}}), ("position.slider.sum", "at least 1")),
    "multi_turn": (with_channel(multi_turn="yes"), ("position.slider.multi_turn", "boolean", "got 'yes'")),
    "torque that turns": (
        changed(torque={"slider": {"column": "i", "unit": "N", "multi_turn": True}}),
        ("torque.slider: unknown key 'multi_turn'",),
    ),
    "window backwards": (with_train(window=[3, 3]), ("train[0].window", "stop after it starts", "3 >= 3 s")),
    "window of one": (with_train(window=[3]), ("train[0].window: a window is [start, stop]", "[3]")),
    "window of text": (with_train(window=["a", 3]), ("train[0].window: a finite number", "['a', 3]")),
    "windows overlap": (with_train(window=[[0, 5], [4, 6]]), ("train[0].window", "must not overlap")),
    "no file": (with_train(file=None), ("train[0].file: a file name", "got None")),
    "width": (with_train(width=2.5), ("train[0].width: a whole number", "got 2.5")),
    "width of no file": (with_train(width={"q": 2}), ("train[0]: `width` names a file 'q'",)),
    "same name": (with_train(name="pulses"), ("2 logs are named 'pulses'", "distinct `name`")),
    "same file": (changed(train=[{"file": "a.mat"}] * 2), ("2 logs are named 'a'",)),
    "smoother kind": (
        changed(smoother={"kind": "splin"}),
        ("smoother: 'splin'", "did you mean 'spline'", "'difference'"),
    ),
    "no kind": (changed(smoother={"rule": "gcv"}), ("smoother: needs a `kind`: spline, difference, butterworth",)),
    "rule": (changed(smoother={"kind": "spline", "rule": "gvc"}), ("smoother.rule: 'gvc'", "did you mean 'gcv'")),
    "fixed": (changed(smoother={"kind": "spline", "rule": "fixed"}), ("smoother: `rule: fixed` needs either",)),
    "idle p": (changed(smoother={"kind": "spline", "p": 1}), ("smoother: `p` is only used by `rule: fixed`",)),
    "idle S": (changed(smoother={"kind": "spline", "rule": "gcv", "S": 1}), ("smoother: `S` is only used",)),
    "sigma": (
        changed(smoother={"kind": "spline", "sigma": {"slider": -1}}),
        ("smoother.sigma.slider: should be greater than 0", "got -1"),
    ),
    "orders": (changed(smoother={"kind": "butterworth", "orders": [3, 3]}), ("smoother.orders[2]: is missing",)),
    "order": (changed(smoother={"kind": "butterworth", "orders": [3, 0, 4]}), ("smoother.orders[1]", "got 0")),
    "tolerance": (
        changed(estimator={"kind": "least_squares", "tolerance": 2}),
        ("estimator.tolerance", "less than or equal to 0.01", "got 2"),
    ),
    "estimator kind": (changed(estimator={"kind": "least_square"}), ("did you mean 'least_squares'",)),
    "decimate": (changed(filter={"decimate": "10.5"}), ("filter.decimate: a whole number", "'10.5'")),
    "doubled key": (FULL + "gaps: error\n", ("line 18", "'gaps' is given twice")),
    "doubled inner key": ("time: {rate: 1, rate: 2}", ("line 1", "'rate' is given twice")),
    "YAML": ("time: {rate: 1\nposition: 2", ("line 2", "valid YAML")),
    "YAML value": ("time: 2022-99-99", ("not valid YAML", "month")),
    "YAML object": ("time: !!python/object:os.system {}", ("valid YAML", "could not determine a constructor")),
}


@pytest.mark.parametrize(("text", "fragments"), MISTAKES.values(), ids=MISTAKES)
def test_mistakes_are_worded_with_their_path(text, fragments):
    with pytest.raises(ConfigError) as caught:
        parse_config(text, source="arm.yaml")
    message = str(caught.value)
    assert message.startswith("arm.yaml: ")
    assert all(fragment in message for fragment in fragments), message
    assert "pydantic" not in message


def test_a_missing_configuration_lists_its_neighbours(tmp_path):
    (tmp_path / "arm.yaml").write_text(FULL)
    with pytest.raises(ConfigError, match=r"no such file.*did you mean 'arm\.yaml'"):
        read_config(tmp_path / "amr.yaml")
    with pytest.raises(ConfigError, match=r"folder .* does not exist"):
        read_config(tmp_path / "lost" / "arm.yaml")


def test_a_configuration_that_is_no_text(tmp_path):
    (tmp_path / "arm.yaml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigError, match="not a UTF-8 text"):
        read_config(tmp_path / "arm.yaml")


CHANNELS = {
    "unknown joint": (
        changed(position={"slidr": {"column": "q", "unit": "m"}}),
        ("position.slidr", "did you mean 'slider'"),
    ),
    "no torque": (changed(torque={}), ("torque: joint 'slider' of the model is missing",)),
    "wrong dimension": (
        with_channel(unit="rad"),
        ("position.slider.unit: 'rad' is a unit of angle, not of length", "'mm'"),
    ),
    "unknown unit": (with_channel(unit="furlong"), ("'furlong' is not a unit of length", "'cm'")),
    "torque for force": (
        changed(torque={"slider": {"column": "i", "unit": "Nm"}}),
        ("torque.slider.unit: 'Nm'", "'kN'"),
    ),
    "time unit": (changed(time={"column": "t", "unit": "sec"}), ("time.unit: 'sec'", "'ms'")),
    "multi-turn slider": (with_channel(multi_turn=True), ("position.slider.multi_turn", "slides")),
    "sigma": (changed(smoother={"kind": "spline", "sigma": {"x": 1}}), ("smoother.sigma.x: there is no joint",)),
}


@pytest.mark.parametrize(("text", "fragments"), CHANNELS.values(), ids=CHANNELS)
def test_channels_that_do_not_fit_the_joints(text, fragments):
    with pytest.raises(ConfigError) as caught:
        check_joints(parse_config(text), SLIDER)
    assert all(fragment in str(caught.value) for fragment in fragments), caught.value


@pytest.mark.parametrize(
    ("unit", "dimension", "factor"),
    [
        ("ms", "time", 1e-3),
        ("min", "time", 60),
        ("deg", "angle", math.pi / 180),
        ("arcsec", "angle", math.pi / 180 / 3600),
        ("in", "length", 0.0254),
        ("N m", "torque", 1),
        ("Nm", "torque", 1),
        ("mN*m", "torque", 1e-3),
        ("kgf cm", "torque", 0.0980665),
        ("lbf ft", "torque", 1.3558179483314004),
        ("lbf", "force", 4.4482216152605),
    ],
)
def test_units(unit, dimension, factor):
    assert unit_factor(unit, dimension, "x") == pytest.approx(factor, rel=1e-14)


ARM = """
from __future__ import annotations
from dataclasses import dataclass
from dynident.models.gallery import pendulum

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


def test_a_file_that_fails_leaves_no_module_behind(tmp_path):
    (tmp_path / "arm.py").write_text("1 / 0\n")
    before = set(sys.modules)
    with pytest.raises(ModelError):
        load_model("arm.py:arm", tmp_path)
    assert not {name for name in set(sys.modules) - before if name.startswith("_dynident")}


VALUES = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=5) | st.dates(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5) | st.integers(), inner, max_size=3),
    max_leaves=5,
)


def parses_or_explains(text: str) -> None:
    try:
        parse_config(text, source="fuzz.yaml")
    except DynidentError as error:
        words = str(error)
    else:
        return
    assert words.startswith("fuzz.yaml: ")


@settings(max_examples=100, deadline=None)
@given(st.text(max_size=100) | st.text(alphabet="ab:-{}[]&*!|>'\"#%, \n\t01.<", max_size=60))
def test_any_text_gives_a_configuration_or_an_explanation(text):
    parses_or_explains(text)


@settings(max_examples=150, deadline=None)
@given(data=st.data(), value=VALUES)
def test_any_value_anywhere_gives_a_configuration_or_an_explanation(data, value):
    config = node = yaml.safe_load(FULL)
    while True:
        key = data.draw(st.sampled_from(list(node) if isinstance(node, dict) else list(range(len(node)))))
        if not isinstance(node[key], dict | list) or data.draw(st.booleans()):
            break
        node = node[key]
    node[key] = value
    parses_or_explains(yaml.safe_dump(config, allow_unicode=True))


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


def test_a_wrong_item_is_not_reported_again_as_a_list_that_is_too_short():
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
