"""Surfaces and ellipsoids of links, in the frames of their bodies."""

from __future__ import annotations

import numpy as np

from dynident.report import Ellipsoid, centre_marks, ellipsoid_circles, legend_key, lighten_colour, solid_ellipsoids

TURNED = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
ONE = Ellipsoid(2, np.array([1.0, 2, 3]), np.array([0.3, 0.2, 0.1]), TURNED, "#0072b2")
ROD = Ellipsoid(0, np.zeros(3), np.array([0.5, 0.0, 0.0]), np.eye(3), "#e69f00")


def level(points: np.ndarray) -> np.ndarray:
    return np.linalg.norm((points - ONE.centre) @ ONE.axes / ONE.half, axis=1)


def test_an_ellipsoid_is_where_its_axes_are_and_looks_outwards() -> None:
    found = solid_ellipsoids([ONE, ROD], "found")
    mine = found.body == 2
    np.testing.assert_allclose(level(found.points[mine]), 1.0)
    np.testing.assert_allclose(np.ptp(found.points[mine], axis=0), [0.4, 0.6, 0.2])
    faces = np.stack([found.trace[name] for name in "ijk"], axis=1)
    a, b, c = (found.points[faces[:, k]] for k in range(3))
    middle = np.where(faces[:, :1] < mine.sum(), ONE.centre, ROD.centre)
    assert (np.einsum("ij,ij->i", np.cross(b - a, c - a), a - middle) > 0).all()
    assert len(found.trace["facecolor"]) == len(faces)
    assert found.trace["facecolor"][0] == "#0072b2"
    assert found.trace["facecolor"][-1] == "#e69f00"


def test_circles_lie_on_the_ellipsoid_with_gaps_between() -> None:
    found = ellipsoid_circles([ONE], "file")
    gaps = np.isnan(found.points).all(axis=1)
    assert gaps.sum() == 3
    np.testing.assert_allclose(level(found.points[~gaps]), 1.0)


def test_a_rod_is_still_seen() -> None:
    assert np.ptp(solid_ellipsoids([ROD], "found").points, axis=0).min() > 0


def test_marks_and_colours() -> None:
    found = centre_marks({3: np.array([0.1, 0.2, 0.3])}, "centre", "circle")
    assert found.body.tolist() == [3]
    np.testing.assert_allclose(found.points, [[0.1, 0.2, 0.3]])
    assert lighten_colour("#000000") == "#474747"
    assert lighten_colour("#ffffff") == "#ffffff"
    assert legend_key("by", "#ffffff")["x"] == [None]
