"""What files, columns, joints and links are called is text: nothing of it runs, and nothing acts on a terminal or a page.

One robot and its recording, all of whose names are hostile, go through all commands.
"""

from __future__ import annotations

import builtins
import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
import polars as pl
import pytest
import yaml

from dynident.cli.terminal import one_line, visible
from dynident.export import Identified, Mjcf, Numpy, Urdf, Yaml, export, random_states
from dynident.io.config_draft import draft_config
from dynident.models import Joint, Model, RigidBodies, Viscous, from_physical
from tests.cli.commands import run
from tests.robots import joint, link, urdf

RUNS = "__import__('builtins').__dict__.update(ran=1)"
NAMES = (
    "b'+'",
    f"a'+str({RUNS})+'",
    f'a"+str({RUNS})+"',
    f"\n{RUNS}\n#",
    f'"""\n{RUNS}\n"""',
    f"\\'+str({RUNS})+\\'",
    "@JOINTS@",
    "@ROWS@",
    "@K@ @MODEL@ @RIGID@",
    "{0} %s $RUNS {RUNS}",
    "</script><script>alert(1)</script><b>&amp;",
    "' onload='alert(1)' x=\"",
    "--> ]]> <!-- <![CDATA[",
    "a\r\nVerdict: Good for simulation\n\tError: none",
    "\u202egnp.exe\u2066",
    "\x9b31m\x85\x90",
    "[red]x[/red][link=https://x.org]y[/link]:bug:",
    "=HYPERLINK(1)",
    "model: /tmp/evil.py:main",
    "- !!python/object/apply:os.system ['x']",
)
SEEN = "\x1b[31mred\x1b]8;;https://x.org\x07link\x08\x7f"  # XML cannot hold these; columns and file names can
ACTS = re.compile("[\x00-\x09\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069]")
BODY = from_physical(1.0, [0.1, 0.0, 0.0], 0.1 * np.eye(3))
KINDS = (Numpy(), Urdf(), Mjcf(), Yaml())


@pytest.fixture(autouse=True)
def nothing_ran(monkeypatch):
    yield
    assert not hasattr(builtins, "ran")


def quoted(name):
    return quoteattr(name, {"\n": "&#10;", "\r": "&#13;", "\t": "&#9;", '"': "&quot;"})[1:-1]


def mjcf(names):
    """The same for MuJoCo."""
    inner = ""
    for name in reversed(names):
        inner = (
            f'<body name="{quoted("link " + name)}" pos="0.2 0 0"><joint name="{quoted(name)}" axis="0 1 0"/>'
            f'<inertial mass="1" pos="0.1 0 0" diaginertia="0.1 0.1 0.1"/>{inner}</body>'
        )
    return f'<mujoco model="x"><compiler angle="radian"/><worldbody>{inner}</worldbody></mujoco>'


def robot(names):
    """A chain of links whose links and joints have the names."""
    parts = [link("base", 1.0)]
    last = "base"
    for name in names:
        inner, outer = quoted(f"link {name}"), quoted(name)
        parts.append(link(inner, 1.0, (0.1, 0, 0), tensor=np.diag([0.1, 0.1, 0.1])))
        parts.append(joint(outer, "revolute", last, inner, (0.2, 0, 0), axis=(0, 1, 0)))
        last = inner
    return urdf(*parts)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.format)
def test_no_export_runs_a_name(kind, name):
    """The law: each format gives back the names that it was given, and its torque is proven, so that it was loaded."""
    names = ("b'+'", name, "@JOINTS@") if name not in ("b'+'", "@JOINTS@") else ("b'+'", "@JOINTS@")
    text = mjcf(names) if isinstance(kind, Mjcf) else robot(names)
    bodies = RigidBodies(text, source=name)
    model = Model((bodies, Viscous(bodies.joints)), name=f"{name} @JOINTS@")
    assert tuple(one.name for one in model.joints) == names
    one = Identified(model, np.concatenate([np.tile(BODY, len(names)), np.ones(len(names))]))
    made = export(one, kind, random_states(len(names), np.random.default_rng(0), 5))
    assert made.ready, made.refusal
    if isinstance(kind, Numpy):
        namespace = {}
        exec(compile(made.written.text, "model.py", "exec"), namespace)
        assert (namespace["JOINTS"], namespace["MODEL"]) == (names, model.name)
    if isinstance(kind, Urdf | Mjcf):
        assert tuple(one.name for one in RigidBodies(made.written.text).joints) == names
    if isinstance(kind, Yaml):
        read = yaml.safe_load(made.written.text)
        assert ([one["name"] for one in read["joints"]], read["model"]) == (list(names), model.name)
        assert [one["name"] for one in read["parameters"]] == list(model.names)


@pytest.mark.parametrize("name", NAMES)
def test_names_and_units_of_parameters(name):
    """Also where there is no robot file: parameters named, and with units and meanings, as the user's term has them."""
    joints = (Joint("b'+'"), Joint(name + " "), Joint("@JOINTS@ @ROWS@"))
    term = Viscous(joints, names=tuple(f"{name}{k}" for k in range(3)))
    one = Identified(Model((term,), name=name), np.ones(3))
    states = random_states(3, np.random.default_rng(0), 5)
    for kind in (Numpy(), Yaml()):
        assert export(one, kind, states).ready
    assert one.model.names == tuple(row["name"] for row in yaml.safe_load(export(one, Yaml(), states).written.text)["parameters"])


@pytest.mark.parametrize("name", (*NAMES, SEEN, "a\udc9bb"))
def test_a_message_only_shows_a_name(name):
    shown = one_line(f"{name}: cannot be read\n  train: is missing")
    assert not ACTS.search(shown)
    assert shown.count("\n") <= 1 + name.count("\n  ")
    shown.encode()  # no half of a surrogate pair is left
    assert visible(shown) == shown
