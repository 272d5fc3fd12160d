"""Equations in a browser: typeset, within the page at any width, and no barrier."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np

from dynident.models import Joint, Model
from dynident.models.friction import Ripple, Stribeck, Viscous
from dynident.report.equations import model_section
from dynident.report.page import render
from tests.browser.browsing import Browsing

JOINTS = Joint("left_arm_shoulder_pan_joint"), Joint("elbow")
TERMS = Viscous(JOINTS), Stribeck(JOINTS, velocity=0.05), Ripple(JOINTS, cycles=(101.25, 202.5, 303.75), delay=0.0021)


def test_equations_wrap_and_are_typeset(browse: Browsing, tmp_path: Path) -> None:
    model = Model(TERMS)
    value = np.linspace(-1.2345, 2.3456, len(model.names))
    estimate = SimpleNamespace(names=model.names, value=value, provenance=())
    result = SimpleNamespace(model=model, estimate=estimate, errors=SimpleNamespace(std=np.ones(len(value))))
    path = tmp_path / "model.html"
    path.write_text(render("Title", "Lead", list(model_section(result))), encoding="utf-8")  # type: ignore[arg-type]
    page = browse(path, width=400, color_scheme="dark")
    assert page.evaluate("document.documentElement.scrollWidth") <= 400
    boxes = page.evaluate("[...document.querySelectorAll('.equations math')].map(one => one.getBoundingClientRect())")
    assert len(boxes) > 20
    assert all(0 < box["width"] < 360 and box["right"] <= 400 for box in boxes)
    assert len({round(box["y"]) for box in boxes}) > 8, "lines end between summands"
    dots = page.evaluate("document.querySelector('mover').getBoundingClientRect().height")
    assert dots > 0
    assert browse.barriers(page) == []
