"""What the page for tuning shows stays: controls, numbers, tables and figures."""

import json
from dataclasses import replace
from typing import Any

import pytest

from dynident.apps.tuning import Bench, drawings, readout
from tests.kept import check_kept, figure_lines

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
