"""What files, columns, joints and links are called is text: nothing of it runs or acts on a terminal or page.

One robot and its recording, all of whose names are hostile, go through all commands.
"""

import builtins
import io
import json
import re
import time
from functools import cache
from html.parser import HTMLParser
from urllib.parse import unquote
from xml.sax.saxutils import quoteattr

import numpy as np
import polars as pl
import pytest
import yaml

from dynident.apps.fleets.report import fleet_page
from dynident.cli.command_log import escape_controls, one_line
from dynident.cli.terminal import status
from dynident.models import Joint, Model, RigidBodies, from_physical
from dynident.models.friction import Viscous
from dynident.project.export import IdentifiedModel, Mjcf, Numpy, Urdf, Yaml, export, random_states
from dynident.project.export.simulators import Drake, IsaacLab, PinocchioFile, read_literals
from dynident.runtime import Step, report_progress
from dynident.runtime.families import EXPORTERS
from tests.cli.commands import run
from tests.report.fleets import fleet
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
    "model: evil.py:main",
    "- !!python/object/apply:os.system ['x']",
)
SEEN = "\x1b[31mred\x1b]8;;https://x.org\x07link\x08\x7f"  # XML cannot hold these; columns and file names can
ACTS = re.compile("[\x00-\x09\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069]")
BODY = from_physical(1.0, [0.1, 0.0, 0.0], 0.1 * np.eye(3))
KINDS = (Numpy(), Urdf(), Mjcf(), Yaml(), Drake(), IsaacLab(), PinocchioFile())


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


@pytest.mark.parametrize("names", [NAMES[k::5] for k in range(5)], ids=range(5))
@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.format)
@pytest.mark.parametrize("is_mjcf", [False, True])
def test_no_export_runs_a_name(kind, names, is_mjcf):
    """The law: each format gives back the names that it was given, and its torque is proven, so that it was loaded."""
    name = " ".join(names)
    bodies = RigidBodies(mjcf(names) if is_mjcf else robot(names), source=name)
    model = Model((bodies, Viscous(bodies.joints)), name=f"{name} @JOINTS@")
    assert tuple(x.name for x in model.joints) == names
    identified_model = IdentifiedModel(model, np.concatenate([np.tile(BODY, len(names)), np.ones(len(names))]))
    made = export(identified_model, kind, random_states(len(names), np.random.default_rng(0), 5))
    assert made.ready, made.refusal
    if isinstance(kind, Numpy):
        namespace = {}
        exec(compile(made.written.text, "model.py", "exec"), namespace)
        assert (namespace["JOINTS"], namespace["MODEL"]) == (names, model.name)
    if isinstance(kind, IsaacLab | PinocchioFile):
        assert tuple(read_literals(made.written.text)["ARMATURE"]) == names
    if isinstance(kind, Urdf | Mjcf | Drake):
        assert tuple(x.name for x in RigidBodies(made.written.text).joints) == names
    if isinstance(kind, Yaml):
        read = yaml.safe_load(made.written.text)
        assert ([x["name"] for x in read["joints"]], read["model"]) == (list(names), model.name)
        assert [x["name"] for x in read["parameters"]] == list(model.names)


@pytest.mark.parametrize("name", NAMES)
def test_names_and_units_of_parameters(name):
    """Also where there is no robot file: parameters named, and with units and meanings, as the user's term has them."""
    joints = (Joint("b'+'"), Joint(name + " "), Joint("@JOINTS@ @ROWS@"))
    term = Viscous(joints, names=tuple(f"{name}{k}" for k in range(3)))
    identified_model = IdentifiedModel(Model((term,), name=name), np.ones(3))
    states = random_states(3, np.random.default_rng(0), 5)
    for kind in (Numpy(), Yaml()):
        assert export(identified_model, kind, states).ready
    assert identified_model.model.names == tuple(
        row["name"] for row in yaml.safe_load(export(identified_model, Yaml(), states).written.text)["parameters"]
    )


@pytest.mark.parametrize("name", [*NAMES, SEEN, "a\udc9bb"])
def test_a_message_only_shows_a_name(name):
    shown = one_line(f"{name}: cannot be read\n  train: is missing")
    assert not ACTS.search(shown)
    assert shown.count("\n") <= 1 + name.count("\n  ")
    shown.encode()  # no half of a surrogate pair is left
    assert escape_controls(shown) == shown


JOINTS = ("b'+'</script><b>\u202e=1+1", "a'+str(1)+'@JOINTS@[red]x\nVerdict: Good")
ODD = "@JOINTS@[red]\x1b[31m\u202e\nVerdict: Good"


class Tags(HTMLParser):
    """The elements of a page, and the attributes that could run."""

    def __init__(self, page):
        super().__init__()
        self.tags, self.running, self.links = [], [], []
        figures = map(json.loads, re.findall(r'<script type="application/json">(.*?)</script>', page, re.DOTALL))
        assert not ACTS.search(page.replace("\t", ""))
        assert not ACTS.search(json.dumps(list(figures), ensure_ascii=False))
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.running += [key for key, _ in attrs if key.startswith("on")]
        self.links += [value for key, value in attrs if key == "href"]


def files(folder, joints, odd):
    """A robot file, a recording and a configuration in which joints, columns, files and logs have the names."""
    folder.mkdir()
    (folder / f"{odd}.urdf").write_text(robot(joints))
    t = np.arange(600) * 0.01
    q = np.column_stack([0.8 * np.sin(2 * t), 0.6 * np.cos(3 * t)])
    bodies = RigidBodies(robot(joints))
    model = Model((bodies, Viscous(bodies.joints)))
    dq, ddq = np.gradient(q, 0.01, axis=0), np.gradient(np.gradient(q, 0.01, axis=0), 0.01, axis=0)
    tau = model.torque(q, dq, ddq, np.concatenate([np.tile(BODY, 2), [1.0, 1.0]]))
    rng = np.random.default_rng(0)
    tau += 0.01 * rng.standard_normal(tau.shape)
    columns = (
        {f"t {odd}": t} | {f"q {odd} {k}": q[:, k] for k in range(2)} | {f"u {odd} {k}": tau[:, k] for k in range(2)}
    )
    pl.DataFrame(columns).write_parquet(folder / f"{odd}.parquet")
    config = {
        "model": {"file": f"{odd}.urdf", "terms": ["viscous"]},
        "time": {"column": f"t {odd}", "unit": "s"},
        "position": {name: {"column": f"q {odd} {k}", "unit": "rad"} for k, name in enumerate(joints)},
        "torque": {name: {"column": f"u {odd} {k}", "unit": "N m"} for k, name in enumerate(joints)},
        "train": [{"file": f"{odd}.parquet", "window": [0, 4], "name": f"train {odd}"}],
        "validation": [{"file": f"{odd}.parquet", "window": [3, 9], "name": f"test {odd}"}],
        "time_offset": 0,
        "estimator": {"kind": "consistent", "costs": False},
    }
    (folder / f"{odd}.yaml").write_text(yaml.safe_dump(config, allow_unicode=True))
    return folder


def commands(folder, odd):
    """Every command that reads a file but ``fleet``; most end well, some in errors that name what they were given."""
    config, log, result = folder / f"{odd}.yaml", folder / f"{odd}.parquet", folder / "out" / "result.json"
    yield 0, ("identify", config, "--out", folder / "out")
    yield 0, ("check", config, folder / f"{odd}.urdf", "--json", folder / "check.json")
    yield 0, ("bound", config, "--out", folder / "out2")
    yield 0, ("predict", result, log, "--out", folder / f"{odd}.csv")
    for kind in EXPORTERS.table:
        yield 0, ("export", result, "--format", kind, "--out", folder / f"new {odd}.{kind}")
    yield 0, ("smooth", log, "--time", f"t {odd}", "--out", folder / "out3")
    yield 0, ("init", folder / f"{odd}.urdf", log, "-o", folder / f"init {odd}.yaml")
    yield 1, ("smooth", log, "--time", odd)
    yield 1, ("identify", folder / f"{odd}{odd}.yaml")
    yield 1, ("check", folder / f"{odd}{odd}.yaml")
    yield 1, ("bound", config, "--sigma-q", odd)
    yield 1, ("excite", folder / f"{odd}.urdf", "-o", folder / "out5", "--noise", f"{odd}=1")
    yield 1, ("excite", config, "-o", folder / "out5", "--parameter", odd)
    yield 1, ("predict", result, folder / odd)
    yield 1, ("predict", config, log)
    yield 1, ("export", folder / odd, "--format", "mjcf", "--out", folder / f"{odd}.xml")
    yield 1, ("init", odd, log)
    yield 1, ("reproduce", "--scenario", odd)
    yield 1, ("reproduce", "--cluster", odd)
    yield 2, ("export", result, "--format", odd, "--out", "x")
    yield 2, ("check", "--" + odd)
    yield 2, ("schema", odd)
    yield 2, (odd,)
    yield 2, ("reproduce", "--runs", odd)
    yield 2, ("identify", config, odd)


def test_every_command_only_shows_names(tmp_path):
    plain = files(tmp_path / "plain", ("one", "two"), "odd")
    for code, words in commands(plain, "odd"):
        if code == 0 and words[0] in ("identify", "bound", "smooth"):  # those that write a page
            assert (done := run(*words)).exit_code == 0, (words, done.output)
    wrong = files(tmp_path / "wrong", JOINTS, ODD)
    for code, words in commands(wrong, ODD):
        done = run(*words)
        assert done.exit_code == code, (words, done.output)
        acting = ACTS.search(done.output)
        assert not acting, (words, acting, done.output)
        assert not re.search(r"^\s*Verdict: Good\b(?! for| enough)", done.output, re.M), (words, done.output)
    for page in ("out/report.html", "out2/report.html", "out3/report.html"):
        mine, usual = Tags((wrong / page).read_text()), Tags((plain / page).read_text())
        assert mine.tags.count("script") == usual.tags.count("script"), page
        assert set(mine.tags) == set(usual.tags), page
        assert mine.running == usual.running, page
    for name in ("out/result.json", "out2/bound.json", "check.json"):
        text = (wrong / name).read_text()
        assert not ACTS.search(text.replace("\n", "")), name
        json.loads(text)
    assert tuple(x["name"] for x in yaml.safe_load((wrong / "out/parameters.yaml").read_text())["joints"]) == JOINTS
    drafted = yaml.safe_load((wrong / f"init {ODD}.yaml").read_text())
    assert drafted["model"]["file"] == f"{ODD}.urdf"


@cache
def fleet_tags(name):
    return Tags(fleet_page(fleet(4, 4, name)))


@pytest.mark.parametrize("name", NAMES)
def test_the_page_of_a_fleet_only_shows_names(name):
    """Of robots, types, joints, parameters, logs, and what errors say of them."""
    mine, usual = fleet_tags(name), fleet_tags("odd")
    assert mine.tags == usual.tags
    assert mine.running == usual.running
    assert [link for link in mine.links if not link.startswith(("./", "#"))] == []


def test_a_fleet_only_shows_names(tmp_path):
    def made(folder, odd):
        files(folder, ("one", "two") if odd == "odd" else JOINTS, odd)
        logs = {"log": [f"{odd}.parquet"] * 3 + [f"{odd}-lost.parquet"], "robot": [f"{odd} {k}" for k in range(4)]}
        dates = ["2026-01-01", "2026-01-02", odd, "2026-01-04"]
        pl.DataFrame({**logs, "date": dates, odd: "x"}).write_csv(folder / f"{odd}.csv")
        (folder / f"fleet {odd}.yaml").write_text(
            yaml.safe_dump({"recipe": f"{odd}.yaml", "table": f"{odd}.csv", "type": odd}, allow_unicode=True)
        )
        return run("fleet", folder / f"fleet {odd}.yaml", "--out", folder / "out", "--workers", "1")

    plain, wrong = made(tmp_path / "plain", "odd"), made(tmp_path / "wrong", ODD)
    assert (plain.exit_code, wrong.exit_code) == (0, 0), (plain.output, wrong.output)
    assert not ACTS.search(wrong.output)
    assert not re.search(r"^\s*Verdict: Good\b", wrong.output, re.M), wrong.output
    mine, usual = (Tags((tmp_path / x / "out" / "report.html").read_text()) for x in ("wrong", "plain"))
    assert mine.tags == usual.tags
    assert mine.running == usual.running
    reports = [link for link in mine.links if not link.startswith("#")]
    assert len(reports) == 2
    assert all((tmp_path / "wrong" / "out" / unquote(link)).is_file() for link in reports)


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_progress_only_shows_names(monkeypatch):
    screen = Terminal()
    monkeypatch.setattr("sys.stderr", screen)
    monkeypatch.setenv("TERM", "xterm")
    name = f"{SEEN}[red]\u202e\nVerdict: Good"
    with status():
        report_progress(f"reading {name}")
        time.sleep(0.3)
        report_progress(Step(name, 1, 2))
        time.sleep(0.3)
    shown = screen.getvalue()
    assert shown.count("[red]\\u202e\\nVerdict") >= 2
    assert not re.search("[\x07\x08\x7f\u202e]|\x1b]8|\x1b\\[31m", shown)
