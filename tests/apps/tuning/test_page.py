"""Answers follow from the address alone, figures keep what matters when they are thinned, and the page stays."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from dynident.apps.tuning import Bench, drawings, readout
from dynident.apps.tuning import answers as module
from dynident.apps.tuning.answers import Page
from dynident.apps.tuning.app import make_app
from dynident.apps.tuning.curve import DegreeCurve
from dynident.apps.tuning.drawings import MAX_COARSE_POINTS, MAX_POINTS, curve_drawing, motion_drawing
from dynident.apps.tuning.session import Session
from tests.kept import check_kept, figure_lines


def test_a_zoom_is_drawn_finely(arm: Bench) -> None:
    motion = arm.smooth(arm.start, "log 1", arm.joints[0])
    fine, coarse = motion_drawing(motion, "rad", ()), motion_drawing(motion, "rad", (), fine=False)
    assert len(coarse.data[4]["x"]) <= MAX_COARSE_POINTS + 8 < len(motion.t) <= MAX_POINTS + 400
    assert np.nanmax(coarse.data[4]["y"]) == np.nanmax(fine.data[4]["y"])
    zoomed = motion_drawing(motion, "rad", (), (2.0, 2.5), fine=False)
    inside = [(trace["x"] >= 2.0) & (trace["x"] <= 2.5) for trace in (zoomed.data[4], coarse.data[4])]
    assert inside[0].sum() > 2 * inside[1].sum()


def test_the_curve_names_its_marks(arm: Bench) -> None:
    figure = curve_drawing(arm.curve(arm.start), 0.0, 0, alone=False)
    assert "torque" in ", ".join(figure.data[1]["text"])
    assert json.loads(figure.json())["data"]


def test_names_of_close_marks_stand_above_each_other() -> None:
    marks = {"REML": (-1.7,), "GCV": (-0.7,), "S = n": (0.0,), "torque": (0.05,), "far": (3.9,)}
    figure = curve_drawing(DegreeCurve(np.linspace(-2, 3, 6), np.ones(6), None, marks), 0.0, 0, alone=True)
    labels = figure.layout["annotations"]
    assert [(label["text"], label["yshift"]) for label in labels] == [
        ("REML", 0), ("GCV", 14), ("S = n, torque", 28), ("far", 0),
    ]  # fmt: skip
    assert labels[-1]["x"] < 3.6, "it stays within the axis"
    assert figure.layout["margin"]["t"] == 4 + 14 * 3


pytest.importorskip("dash")


WRONG = "address: degree is 'x', which is no JSON: expected value at line 1 column 1."


@pytest.fixture
def session(arm: Bench) -> Session:
    return Session(SimpleNamespace(path=Path("arm.yaml")), arm, print)  # type: ignore[arg-type]


def words(component: Any) -> str:
    """Return a component as the page gets it."""
    return json.dumps(component, default=lambda x: x.to_plotly_json(), ensure_ascii=False)


def test_curves_follow_the_degree_and_not_the_setting(session: Session) -> None:
    page = Page(session)
    start = page.curves({"search": "", "fine": True})
    moved = page.curves({"search": "", "degree": 2.0})
    assert start["degree"] == "S/n = 2.25"
    assert moved["degree"] == "S/n = 100"
    assert "S/n = 2.2" in start["words"]
    assert "residual" in start
    assert "residual" not in moved
    assert len(moved["motion"]["data"]) == len(start["motion"]["data"]) == 5
    wrong = page.curves({"search": "?degree=x"})
    assert wrong == {"words": WRONG, "wrong": True}


def test_acts_are_of_the_setting_that_they_are_sent_with(session: Session) -> None:
    page = Page(session)
    first = page.act({"search": "", "control": "reach:one"})
    assert first == {"search": "?only_this_joint=true", "words": ""}
    ends = ",".join(map(repr, page.bench.start.degree[1:]))
    second = page.act({"search": first["search"], "control": "degree", "value": 1.0})
    assert second["search"] == f"?degree=[1.0,{ends}]&only_this_joint=true"
    assert page.act({"search": "", "control": "min_speed", "value": 0.0}) == {"search": "", "words": ""}
    wrong = page.act({"search": "?degree=[1,1,1]", "control": "degree", "value": 99})
    assert wrong["search"] == "?degree=[1,1,1]"
    assert "from -6 to 6" in wrong["words"]
    assert page.act({"search": "?degree=x", "control": "reset"}) == {"search": "", "words": ""}


def test_the_torque_over_velocity_is_that_of_the_friction_and_a_kept_setting_lies_below(session: Session) -> None:
    page = Page(session)
    over_time, loop = page.torque({}, None, "")
    assert [trace["name"] for trace in over_time["data"]] == ["measured", "predicted", "residual"]
    assert [trace["name"] for trace in loop["data"]] == ["measured", "predicted"]
    fit = page.bench.fit(page.bench.start)
    loops = module._friction_loops([fit], "log 1", 0)
    velocity, torque = loops["measured"]
    friction = 0.4 * (velocity + np.sign(velocity) + 1.0)
    assert np.median(np.abs(torque - friction)) < 0.1, "viscous, Coulomb and offset; no body"
    names = ["measured", "other setting", "predicted"]
    last = {"kept": "?degree=[2,2,2]", "now": "", "before": None}
    over_time, loop = page.torque(last, None, "")
    beside = ["measured", *2 * ["other setting"], "predicted", "residual"]
    assert [trace["name"] for trace in over_time["data"]] == beside
    assert [trace["name"] for trace in loop["data"]] == names
    kept, *_ = page.fit("?degree=[1,1,1]", last, "tab")
    assert kept["kept"] == last["kept"], "a change keeps it"


def test_any_other_column_is_drawn_beside(session: Session) -> None:
    t = np.linspace(-1.0, 9.0, 11)
    session.bench = replace(session.bench, read_others=lambda log: (t, {"temp": 20 + t} if log == "log 1" else {}))
    page = Page(session)
    assert "temp" in words(page.sync("")[6])
    said = page.act({"search": "", "control": "column", "value": "tmp"})
    assert "log 1: there is no other column 'tmp'; did you mean 'temp'?" in said["words"]
    search = page.act({"search": "", "control": "column", "value": "temp"})["search"]
    drawn = page.curves({"search": search})["motion"]
    assert [trace["name"] for trace in drawn["data"]][-1] == "temp"
    assert drawn["layout"]["yaxis5"]["title"]["text"] == "temp"
    np.testing.assert_allclose(session.bench.other_column("log 1", "temp", np.array([0.25])), 20.25)
    second = page.act({"search": search, "control": "log:log 2"})["search"]
    assert len(page.curves({"search": second})["motion"]["data"]) == 5, "that log has none"
    assert page.act({"search": search, "control": "column", "value": None})["search"] == ""


def test_the_fit_is_shown_beside_that_of_the_last_setting(session: Session) -> None:
    page = Page(session)
    last, numbers, errors, parameters, wrong = page.fit("", None, "tab")
    assert (last, wrong) == ({"now": "", "before": None}, "")
    assert "held out" in words(errors)
    last, *_ = page.fit("?degree=[2,2,2]", last, "tab")
    assert last == {"now": "?degree=[2,2,2]", "before": ""}
    shown = page.fit("?degree=[2,2,2]", last, "tab")  # after a reload
    assert shown[0] == last
    assert any(sign in words(shown[1]) for sign in "▼▲")
    assert words(parameters) != words(shown[3])
    assert page.fit("?degree=x", last, "tab")[4] == WRONG
    assert "A held-out error by which many settings are chosen becomes too small" in words(numbers)
    assert "faster estimator" not in words(numbers)
    fast = replace(page.bench.fit(page.bench.start), exact=False)
    assert "a faster estimator, in place of the one that is chosen" in words(readout.numbers(fast, None))


def test_a_whole_identification_begins_when_a_person_pauses(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    page = Page(session)
    monkeypatch.setattr(module, "ctx", SimpleNamespace(triggered_id="rested"))
    shown, _, disabled = page.verdict({}, None, "?degree=[0.5,0.5,0.5]", "tab", None)
    assert not disabled
    assert "whole identification runs" in words(shown)
    monkeypatch.setattr(module, "ctx", SimpleNamespace(triggered_id="tick"))
    with session.runs._changed:
        assert session.runs._changed.wait_for(lambda: session.runs._ended, 20)
    shown, parameters, disabled = page.verdict({}, 1, "?degree=[0.5,0.5,0.5]", "tab", None)
    assert disabled
    assert "Verdict" in words(shown)
    assert "value ± 95 %" in words(parameters)


def test_the_application_answers_and_escapes(session: Session) -> None:
    app = make_app(session, "secret")
    client = app.server.test_client()
    index = client.get("/secret/").get_data(as_text=True)
    assert '<html lang="en">' in index
    assert "http://" not in index.replace("http://www.w3.org", "")
    assert "https://" not in index
    assert "--ink" in client.get("/secret/page.css").get_data(as_text=True)
    assert client.get("/secret/alive").status_code == 204
    layout = client.get("/secret/_dash-layout").get_json()
    assert "Degree of smoothing, S/n" in json.dumps(layout)
    test_json = client.post("/secret/act", json={"search": "", "control": "degree", "value": 1.0}).get_json()
    assert test_json == {"search": "?degree=[1.0,1.0,1.0]", "words": ""}
    assert client.post("/secret/act", data="no").status_code == 415
    for nonsense in ("[" * 100_000, "{no"):
        answer = client.post("/secret/act", data=nonsense, content_type="application/json")
        assert answer.status_code in (400, 500)
        assert answer.get_data(as_text=True).endswith(".")
    assert client.post("/secret/_dash-update-component", json={}).status_code == 400
    assert client.get("/secret/_dash-component-suites/dash/../../etc/passwd").status_code != 200
    assert client.post("/secret/act", json=[]).status_code == 400
    assert "there is no control 'None'" in client.post("/secret/act", json={}).get_json()["words"]


ODD_VALUES = ([], {}, [1], [None, {}], {"a": 1}, 1, -1.5, True, "x", "\ud800", 10**400, [[], []], None)
SENT = {"curves": ("search", "degree", "zoom", "fine", "tab", "at"), "act": ("search", "control", "value")}
CONTROLS = ("column", "degree", "mark", "min_speed", "term", "fitted", "filter", "decimate", "cutoff", "estimator",
            "offset", "exclude", "include", "reset", "joint", "log", "reach")  # fmt: skip


def test_whatever_is_posted_no_traceback_is_printed(arm: Bench) -> None:
    faults: list[str] = []
    session = Session(SimpleNamespace(path=Path("arm.yaml")), arm, faults.append)  # type: ignore[arg-type]
    client = make_app(session, "token").server.test_client()
    bodies = [(name, {field: value}) for name, fields in SENT.items() for field in fields for value in ODD_VALUES]
    bodies += [
        ("act", {"search": "", "control": control, "value": value}) for control in CONTROLS for value in ODD_VALUES
    ]
    bodies += [(name, value) for name in (*SENT, "_dash-update-component") for value in ODD_VALUES]
    # what a callback of Dash gets, of another type
    places = (("address", "search"), ("last", "data"), ("tab", "data"), ("zoomed", "data"))
    for component, property_ in places:
        for value in ODD_VALUES:
            inputs = [{"id": component, "property": property_, "value": value}]
            bodies.append(("_dash-update-component", {"output": "x.y", "inputs": inputs, "changedPropIds": []}))
    for name, body in bodies:
        answer = client.post(f"/token/{name}", data=json.dumps(body), content_type="application/json")
        assert answer.status_code in (200, 204, 400), (name, body)
    assert faults == []
    assert client.post("/token/act", data="{", content_type="application/json").status_code == 400
    assert client.post("/token/act", data=b"x", content_type="text/plain").status_code in (400, 415)


pytest.importorskip("dash")


def test_the_page_shows_what_it_showed(arm: Bench) -> None:
    from dynident.apps.tuning.layout import tuning_page

    start, joint = arm.start, arm.joints[0]
    fit, last, log = arm.fit(replace(start, degree=(1.0, *start.degree[1:]))), arm.fit(start), "log 2"
    smoothed = arm.smooth(start, log, joint)
    parts = (
        tuning_page("arm.yaml", arm), readout.numbers(fit, last), readout.errors(fit, last, joint),
        readout.parameter_table(fit, last),
    )  # fmt: skip
    figures = (
        drawings.motion_drawing(smoothed, "rad", ((1.0, 2.0),)), drawings.residual_drawing(smoothed, "rad"),
        drawings.torque_drawing(fit.logs[log], 0, "N m", ((1.0, 2.0),)),
    )  # fmt: skip
    lines = [line for part in parts for line in component_lines(part)]
    lines += [line for figure in figures for line in figure_lines(json.loads(figure.json()))]
    check_kept("page_tuning", "\n".join(lines))


def component_lines(node: Any, depth: int = 0) -> list[str]:
    """Return the components of a page: a line for each with its properties, those inside it indented."""
    if isinstance(node, list | tuple):
        return [line for inner in node for line in component_lines(inner, depth)]
    if not hasattr(node, "to_plotly_json"):
        return [] if node is None else [f"{depth * ' '}{node}"]
    props = dict(node.to_plotly_json()["props"])
    inside = component_lines(props.pop("children", None), depth + 1)
    return [f"{depth * ' '}{type(node).__name__} {props or ''}", *inside]
