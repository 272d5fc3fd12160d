"""Values of a YAML text are changed, and nothing else is."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynident.files.yaml_edit import REMOVED, edit_yaml, format_path
from dynident.files.yaml_text import load_yaml, to_flow
from dynident.runtime import ConfigError

HERE = Path(__file__).parents[2] / "examples"

CASES = {
    "scalar, comment behind it kept": ("a: 1 # why\nb: 2\n", {("a",): 2}, "a: 2 # why\nb: 2\n"),
    "tabs in a comment": ("a: 1 #\twhy\t!\nb: 2\n", {("a",): "x"}, "a: x #\twhy\t!\nb: 2\n"),
    "no new line at the end": ("a: 1", {("a",): 2, ("b",): [1]}, "a: 2\nb: [1]"),
    "CRLF": ("a: 1 # x\r\nb:\r\n  c: 1\r\n", {("b", "d"): 2, ("a",): 3}, "a: 3 # x\r\nb:\r\n  c: 1\r\n  d: 2\r\n"),
    "BOM": ("\ufeffa: 1\nb: 2", {("a",): REMOVED}, "\ufeffb: 2"),
    "BOM, new key": ("\ufeffa: 1\n", {("c",): 2}, "\ufeffa: 1\nc: 2\n"),
    "empty value": ("a: # nothing yet\nb:\n", {("a",): 1, ("b",): "x"}, "a: 1 # nothing yet\nb: x\n"),
    "to null": ("a: 1 # x\n", {("a",): None}, "a: null # x\n"),
    "quoted keys": ("'a': 1\n\"b\": 2\n", {("a",): 3, ("b",): 4}, "'a': 3\n\"b\": 4\n"),
    "a key that YAML takes for a truth value": ("on: 1\n", {("on",): 2}, "on: 2\n"),
    "a key that is a number": ("m: { 1: 0.1, 2: 0.2 }\n", {("m",): {"1": 0.1, "2": 0.3}}, "m: { 1: 0.1, 2: 0.3 }\n"),
    "document markers": ("%YAML 1.1\n---\na: 1\n...\n", {("b",): 2}, "%YAML 1.1\n---\na: 1\nb: 2\n...\n"),
    "start marker": ("--- # x\na: 1\n", {("a",): REMOVED, ("b",): 2}, "--- # x\nb: 2\n"),
    "flow, at the end": ("a: { b: 1 } # x\n", {("a", "c"): 2}, "a: { b: 1, c: 2 } # x\n"),
    "flow, tight": ("a: {b: 1,c: 2,}\n", {("a", "b"): REMOVED, ("a", "d"): 3}, "a: {c: 2, d: 3,}\n"),
    "flow, last": ("a: { b: 1, c: 2 }\n", {("a", "c"): REMOVED}, "a: { b: 1 }\n"),
    "flow, all": ("a: { b: 1, c: 2 } # x\n", {("a",): {}}, "a: {} # x\n"),
    "flow, empty": ("a: {} # x\nb: [ ]\n", {("a", "c"): 1, ("b",): [1]}, "a: { c: 1 } # x\nb: [1]\n"),
    "flow, key without value": ("a: {b, c: 1}\n", {("a", "b"): 2}, "a: {b: 2, c: 1}\n"),
    "flow, on lines": (
        "a: {\n  b: 1, # one\n  c: 2, # two\n  # last\n}\n",
        {("a", "b"): REMOVED, ("a", "d"): 3},
        "a: {\n  c: 2, d: 3, # two\n  # last\n}\n",
    ),
    "flow, on lines, last": ("a: [\n  b, # one\n  c # two\n]\n", {("a",): ["b"]}, "a: [\n  b, # one\n]\n"),
    "JSON": ('{"a": 1, "b": {"c": [1, 2]}}', {("b", "c"): [1, 3], ("d",): "x"}, '{"a": 1, "b": {"c": [1, 3]}, d: x}'),
    "block, at its end": ("a:\n  b: 1 # x\n  # y\nc: 1\n", {("a", "d"): 2}, "a:\n  b: 1 # x\n  d: 2\n  # y\nc: 1\n"),
    "block, removed": ("a:\n  b: 1 # x\n  # y\n  c: 1\n", {("a", "b"): REMOVED}, "a:\n  # y\n  c: 1\n"),
    "block, deep": ("a:\n    b:\n        c: 1\n", {("a", "b", "d"): 2}, "a:\n    b:\n        c: 1\n        d: 2\n"),
    "block, all": ("a: # x\n  b: 1\nc: 1\n", {("a", "b"): REMOVED}, "a: {} # x\nc: 1\n"),
    "block to scalar": ("a: # x\n  # y\n  b: 1 # z\nc: 1\n", {("a",): 5}, "a: 5 # x\n  # y\nc: 1\n"),
    "mapping in a list": (
        "t:\n  - f: x # one\n    w: [0, 1]\n  - f: y\n",
        {("t", 0, "e"): [[1, 2]], ("t", 1, "e"): [[3, None]]},
        "t:\n  - f: x # one\n    w: [0, 1]\n    e: [[1, 2]]\n  - f: y\n    e: [[3, null]]\n",
    ),
    "first behind a dash": ("t:\n- f: x # c\n  w: 1\n", {("t", 0, "f"): REMOVED}, "t:\n- w: 1\n"),
    "first behind a dash, note": ("t:\n- f: x\n  # c\n  w: 1\n", {("t", 0, "f"): REMOVED}, "t:\n- \n  # c\n  w: 1\n"),
    "list not indented": ("t:\n- x # 1\n- y # 2\nu: 1\n", {("t", 2): "z"}, "t:\n- x # 1\n- y # 2\n- z\nu: 1\n"),
    "list in a list": ("t:\n- - a\n  - b\n", {("t", 0): ["a", "b", "c"]}, "t:\n- - a\n  - b\n  - c\n"),
    "list, entry in the middle": ("t:\n- a # 1\n- b # 2\n- c # 3\n", {("t",): ["a", "c"]}, "t:\n- a # 1\n- c # 3\n"),
    "list, new first": ("t:\n  - a # 1\n  - b\n", {("t",): ["x", "a", "b"]}, "t:\n  - x\n  - a # 1\n  - b\n"),
    "list, flow, new first": ("t: [a, b]\n", {("t",): ["x", "a", "b"]}, "t: [x, a, b]\n"),
    "list, empty entry": ("t:\n-\n- b\n", {("t", 0): 1}, "t:\n- 1\n- b\n"),
    "block text": ("a: |\n  one\n  two\n# x\nb: 1\n", {("a",): "c"}, "a: c\n# x\nb: 1\n"),
    "behind block text": ("a: >-\n  one\n\n  two\n", {("b",): 1}, "a: >-\n  one\n\n  two\nb: 1\n"),
    "text on two lines": ("a: one\n  two # x\nb: 1\n", {("a",): "c"}, "a: c # x\nb: 1\n"),
    "question mark": ("? a\n: 1\n? b\n: 2\n", {("a",): 3, ("b",): REMOVED}, "? a\n: 3\n"),
    "tag and free anchor": ("a: &x !!str 1 # c\nb: 2\n", {("a",): 3}, "a: 3 # c\nb: 2\n"),
    "anchored list": ("a: &x\n  - 1\n  - 2\nb: 2\n", {("a",): [1, 3]}, "a: &x\n  - 1\n  - 3\nb: 2\n"),
    "alias itself": ("a: &x 1\nb: *x # c\n", {("b",): 2}, "a: &x 1\nb: 2 # c\n"),
    "merged key overruled": (
        "d: &d { x: 1 }\na:\n  <<: *d\n",
        {("a", "x"): 2},
        "d: &d { x: 1 }\na:\n  <<: *d\n  x: 2\n",
    ),
    "a file name becomes a mapping": (
        "model: arm.urdf # measured\ntime: 1\n",
        {("model",): {"file": "arm.urdf", "terms": ["viscous"]}},
        "model: { file: arm.urdf, terms: [viscous] } # measured\ntime: 1\n",
    ),
    "what is so already": ("a:   0x10\nb: {x:  1.0}\n", {("a",): 16.0, ("b",): {"x": 1}}, "a:   0x10\nb: {x:  1.0}\n"),
    "truth is no number": ("a: 1\n", {("a",): True}, "a: true\n"),
    "new mapping on the way": ("a: 1\n", {("b", "c", "d"): 2}, "a: 1\nb: { c: { d: 2 } }\n"),
    "nothing to remove": ("a: 1\n", {("b",): REMOVED}, "a: 1\n"),
    "names that act on YAML": (
        "a: 1\n",
        {("m",): {"j: 1 # x": 1, "- y": 2, "]}": "\u202e\n", "\u00e9\U0001f600": "*x"}},
        'a: 1\nm: { \'j: 1 # x\': 1, \'- y\': 2, \']}\': "\\u202E\\n", \u00e9\U0001f600: \'*x\' }\n',
    ),
}  # fmt: skip

REFUSED = {
    "through an alias": ("a: &x { b: 1 }\nc: *x # d\n", {("c", "b"): 2}, "line 2: c is the alias *x"),
    "with an anchor in use": ("a: &x { b: 1 }\nc: *x\n", {("a", "b"): 2}, "line 1: a has the anchor &x"),
    "an anchor inside": ("a: { b: &x 1 }\nc: *x\n", {("a",): 2}, "a has the anchor &x"),
    "an anchor that goes": ("a: &x 1\nc: *x\n", {("a",): REMOVED}, "a has the anchor &x"),
    "merged key": ("d: &d { x: 1, y: 2 }\na:\n  <<: *d\n", {("a", "x"): REMOVED}, "a.x comes from elsewhere by `<<`"),
    "into a text": ("model: a.urdf\n", {("model", "terms"): []}, "model is one value; there is no model.terms"),
    "an index of a mapping": ("a: { b: 1 }\n", {("a", 0): 1}, "a is a mapping"),
    "a key of a list": ("a: [1]\n", {("a", "b"): 1}, "a is a list"),
    "an index too far": ("a: [1]\n", {("a", 3): 1}, "the list has 1 entries"),
    "no mapping": ("- a\n", {("a",): 1}, "holds no settings"),
    "empty": ("# only\n", {("a",): 1}, "holds no settings"),
    "two documents": ("a: 1\n---\nb: 2\n", {("a",): 2}, "the file must be valid YAML"),
    "a pair without braces": ("a: [b: 1]\n", {("a", 0, "c"): 2}, "write it by hand"),
}


@pytest.mark.parametrize("case", CASES)
def test_only_what_is_asked_for_changes(case: str) -> None:
    text, changes, expected = CASES[case]
    assert edit_yaml(text, changes) == expected


@pytest.mark.parametrize("case", REFUSED)
def test_what_would_change_something_else_is_refused_in_words(case: str) -> None:
    text, changes, words = REFUSED[case]
    with pytest.raises(ConfigError) as refused:
        edit_yaml(text, changes, "robot.yaml")
    assert str(refused.value).startswith("robot.yaml: ")
    assert words in str(refused.value)


def test_wide_mappings_have_an_entry_a_line() -> None:
    names = {f"left_arm_joint_{k}": 0.1 for k in range(7)}
    new = edit_yaml(
        "a: x.urdf # why\n", {("a",): {"terms": [names, "b"], "speed": names}, ("b",): {"c": [names, names]}}
    )
    assert new.splitlines()[:4] == ["a: # why", "  terms:", f"    - {to_flow(names)}", "    - b"]
    assert new.splitlines()[5] == "    left_arm_joint_0: 0.1"
    assert load_yaml(new, "") == {"a": {"terms": [names, "b"], "speed": names}, "b": {"c": [names, names]}}


@pytest.mark.parametrize("file", sorted(HERE.glob("*.yaml")), ids=lambda path: path.stem)
def test_lines_of_the_examples_that_are_not_meant_stay(file: Path) -> None:
    text = file.read_text(encoding="utf-8")
    new = edit_yaml(text, {("min_speed",): 0.25, ("smoother", "factor"): 2.5, ("rests",): "keep"})
    gone = [line for line in text.splitlines() if line not in new.splitlines()]
    assert all(line.startswith(("smoother:", "min_speed:")) for line in gone)
    assert [line.partition("#")[2] in new for line in gone] == [True] * len(gone)
    back = {("min_speed",): load_yaml(text, "").get("min_speed", REMOVED), ("rests",): REMOVED}
    before = load_yaml(text, "").get("smoother", REMOVED)
    assert edit_yaml(new, {**back, ("smoother",): before}) == text


def test_a_place_in_words() -> None:
    assert format_path(("train", 0, "window", 1)) == "train[0].window[1]"


# Any content, in any of the styles, with a comment behind each line that can have one.

ODD = ["a", "b", "on", "1", "a b", "#x", "x: y", "'", '"', "&a", "*b", "?", "<<x", "\u00e9", "[", "}"]
NAMES = st.one_of(st.sampled_from(ODD), st.text(min_size=1, max_size=6))
SCALARS = st.one_of(st.none(), st.booleans(), st.integers(-99, 99), st.floats(-1e6, 1e6), NAMES, st.just(""))
VALUES = st.recursive(
    SCALARS,
    lambda inside: st.one_of(st.lists(inside, max_size=3), st.dictionaries(NAMES, inside, max_size=3)),
    max_leaves=6,
)


def written(draw: Any, value: Any, indent: str) -> list[str]:
    """Return the lines of a mapping or list as a person may write it."""
    comment = draw(st.sampled_from(["", " # why", " #\t\u00e4"]))
    lines = []
    pairs = value.items() if isinstance(value, dict) else [(None, one) for one in value]
    for key, one in pairs:
        head = f"{indent}{to_flow(key)}:" if isinstance(value, dict) else f"{indent}-"
        if draw(st.booleans()):
            lines.append(f"{indent}# above")
        if isinstance(one, dict | list) and one and draw(st.booleans()):
            lines += [f"{head}{comment}", *written(draw, one, indent + "  ")]
        else:
            blank = draw(st.sampled_from(["", " "])) if one is None else ""
            lines.append(f"{head}{blank or ' ' + to_flow(one)}{comment}")
    return lines


@st.composite
def edits(draw: Any) -> tuple[str, dict[str, Any], list[str], str, Any]:
    """Return a text, its content, the part of each key in the text, a key and another value of it."""
    content = draw(st.dictionaries(NAMES, VALUES, min_size=1, max_size=4))
    end = draw(st.sampled_from(["\n", "\r\n"]))
    parts = [end.join([*written(draw, {key: value}, ""), ""]) for key, value in content.items()]
    parts[0] = draw(st.sampled_from(["", "\ufeff"])) + parts[0]
    parts[-1] = parts[-1].removesuffix(draw(st.sampled_from(["", end])))
    return "".join(parts), content, parts, draw(st.one_of(st.sampled_from(sorted(content)), NAMES)), draw(VALUES)


@settings(max_examples=60, deadline=None)
@given(edits())
def test_any_value_of_any_text_can_be_changed(case: tuple[str, dict[str, Any], list[str], str, Any]) -> None:
    text, content, parts, key, value = case
    assert load_yaml(text, "") == content
    assert edit_yaml(text, {(key,): content.get(key, REMOVED)}) == text
    new = edit_yaml(text, {(key,): value})
    assert load_yaml(new, "") == content | {key: value}
    k = list(content).index(key) if key in content else len(parts)
    assert new.startswith("".join(parts[:k]))
    assert new.endswith("".join(parts[k + 1 :]))
    if key not in content or len(content) == 1:
        assert edit_yaml(new, {(key,): content.get(key, REMOVED)}).startswith("".join(parts[:k]))
    else:
        without = edit_yaml(text, {(key,): REMOVED})
        assert load_yaml(without, "") == {name: one for name, one in content.items() if name != key}
        assert without.endswith("".join(parts[k + 1 :]))
