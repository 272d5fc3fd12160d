"""The tables of the links, and what is said of their shapes."""

from dataclasses import replace

import numpy as np
import pytest

from dynident.identification.links import BodyInertia, link_inertias
from dynident.models.geometry import build_geometry
from dynident.report.identification import parameters as module
from dynident.report.identification.parameters import drawing_notes, link_section
from dynident.report.page import PageTable
from tests.report.robots import identified, tree


def test_what_is_sure_in_part_is_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    first, *others = link_inertias(identified())
    value = BodyInertia(2.5, np.full(3, np.nan), np.full(3, np.nan), np.eye(3))
    sure = np.arange(7) == 0
    reference = replace(first, identified=value, std=np.full(7, 0.1), sure=sure)
    monkeypatch.setattr(module, "link_inertias", lambda _: (reference, *others))
    (section,) = link_section(identified())
    mass = next(block for block in section.blocks if isinstance(block, PageTable))
    assert mass.rows[0][1:7] == ("4.20", "2.50", "0.10", *mass.rows[0][4:5], "-", "-")
    assert mass.rows[1][2:4] == ("-", "-")
    assert "does not choose" in section.blocks[0]


def test_an_inertia_that_no_body_has_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    first, *others = link_inertias(identified())
    wrong = replace(first, file=BodyInertia(1.0, np.zeros(3), np.array([0.1, 0.2, 1.0]), np.eye(3)))
    monkeypatch.setattr(module, "link_inertias", lambda _: (wrong, *others))
    (section,) = link_section(identified())
    assert section.blocks[-1] == ("No body has this inertia, so that it has no ellipsoid, in the file: turret.",)


def test_shapes_that_are_not_known_are_named() -> None:
    geometry = replace(build_geometry(tree()), missing={"missing.stl": "there is no such file."})
    rods, missing = drawing_notes(geometry)
    assert rods == "Drawn as rods between the joints, as their shapes are not known: slide, <b>hand, finger."
    assert missing == "Meshes that could not be read: missing.stl (there is no such file)."
