"""How each mistake in a configuration is worded, and that any text is read or explained."""

import math

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from dynident.project.config import parse_config
from dynident.runtime import ConfigError, DynidentError
from tests.project.configurations import FULL, changed, with_channel, with_train

MISTAKES = {
    "unknown key": (changed(smother={}), ("unknown key 'smother'", "did you mean 'smoother'")),
    "a number that is no choice": (
        changed(smoother={"kind": "kalman", "order": 4}),
        ("smoother.order: '4' is not a choice; choose from '2', '3'",),
    ),
    "truth by name": (changed(compare={"truth": {"M": "x"}}), ("compare.truth.M: a finite number is expected",)),
    "unknown inner key": (with_train(windw=[0, 1]), ("train[0]: unknown key 'windw'", "did you mean 'window'")),
    "missing": (changed(time=...), ("time: is missing",)),
    "missing unit": (changed(position={"slider": {"column": "q"}}), ("position.slider.unit: is missing",)),
    "two mistakes": (
        changed(time=..., gaps="skip"),
        ("time: is missing", "gaps: 'skip'", "hoose from 'error', 'split'"),
    ),
    "not a mapping": ("- 1\n- 2\n", ("a mapping (`key: value` lines) is expected",)),
    "empty": ("", ("a mapping", "got None")),
    "no train": (changed(train=[]), ("train: ", "at least 1")),
    "train is no list": (changed(train={"file": "a"}), ("train: a list is expected",)),
    "section is no mapping": (changed(time=3), ("time: a mapping", "got 3")),
    "no time source": (changed(time={}), ("time: needs either `column`",)),
    "both time sources": (changed(time={"column": "t", "unit": "s", "rate": 5}), ("time: needs either",)),
    "rate": (changed(time={"rate": 0}), ("time.rate: a number greater than 0", "got 0")),
    "truth value": (with_channel(gain=True), ("position.slider.gain: a finite number", "got True")),
    "infinite": (with_channel(gain=math.inf), ("position.slider.gain", "got inf")),
    "date as a name": (with_channel(column=yaml.safe_load("2020-01-01")), ("position.slider.column: a name",)),
    "column and sum": (with_channel(sum={"a": 1}), ("position.slider: needs either `column` or `sum`",)),
    "multi_turn": (with_channel(multi_turn="yes"), ("position.slider.multi_turn", "boolean", "got 'yes'")),
    "torque that turns": (
        changed(torque={"slider": {"column": "i", "unit": "N", "multi_turn": True}}),
        ("torque.slider: unknown key 'multi_turn'",),
    ),
    "window backwards": (with_train(window=[3, 3]), ("train[0].window", "stop after it starts", "3 >= 3 s")),
    "window of text": (with_train(window=["a", 3]), ("train[0].window: a finite number", "['a', 3]")),
    "windows overlap": (with_train(window=[[0, 5], [4, 6]]), ("train[0].window", "must not overlap")),
    "no file": (with_train(file=None), ("train[0].file: a file name", "got None")),
    "width": (with_train(width=2.5), ("train[0].width: a whole number", "got 2.5")),
    "width of no file": (with_train(width={"q": 2}), ("train[0]: `width` names a file 'q'",)),
    "same name": (with_train(name="pulses"), ("2 logs are named 'pulses'", "distinct `name`")),
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
    "decimate": (changed(filter={"decimate": "10.5"}), ("filter.decimate: a whole number", "'10.5'")),
    "doubled key": (FULL + "gaps: error\n", ("line 18", "'gaps' is given twice")),
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
