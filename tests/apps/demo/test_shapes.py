"""Capsules: their meshes are closed and have the volume and the inertia of the capsule."""

from __future__ import annotations

import numpy as np
import pytest

from dynident.apps.demo.arm import FACETS_AROUND, LinkCapsule
from dynident.models import consistency_violations, to_physical

SHAPE = LinkCapsule((0.1, -0.2, 0.05), (0.3, 0.1, 0.25), 0.06)


def facets(stl: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Normals (k, 3) and corners (k, 3, 3) of a binary STL."""
    count = int.from_bytes(stl[80:84], "little")
    assert len(stl) == 84 + 50 * count
    rows = np.frombuffer(stl[84:], dtype=np.dtype([("v", "<f4", (4, 3)), ("attribute", "<u2")]))
    return rows["v"][:, 0].astype(float), rows["v"][:, 1:].astype(float)


def moments(corners: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Volume, centre, and second moments about the origin of the body that triangles enclose, by tetrahedra."""
    volumes = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
    total = corners.sum(axis=1)
    second = np.einsum("kia,kib->kab", corners, corners) + np.einsum("ka,kb->kab", total, total)
    volume = volumes.sum()
    return (
        volume,
        (volumes[:, None] * total / 4).sum(axis=0) / volume,
        (volumes[:, None, None] * second / 20).sum(axis=0),
    )


@pytest.mark.parametrize("shape", [SHAPE, LinkCapsule((0.0, 0.0, 0.0), (0.0, 0.0, 0.4), 0.05)])
def test_a_mesh_is_closed_and_looks_outwards(shape: LinkCapsule) -> None:
    normals, corners = facets(shape.stl())
    edges = [tuple(map(tuple, (a, b))) for c in corners for a, b in zip(c, np.roll(c, -1, axis=0), strict=True)]
    assert len(set(edges)) == len(edges)
    assert {edge[::-1] for edge in edges} == set(edges)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-6)
    middle = np.add(shape.start, shape.end) / 2
    assert (np.einsum("ij,ij->i", normals, corners.mean(axis=1) - middle) > 0).all()


def test_the_inertia_is_that_of_the_mesh() -> None:
    _, corners = facets(SHAPE.stl())
    volume, centre, second = moments(corners)
    length = np.linalg.norm(np.subtract(SHAPE.end, SHAPE.start))
    exact = np.pi * SHAPE.radius**2 * (length + 4 / 3 * SHAPE.radius)
    assert volume == pytest.approx(exact, rel=2 * (np.pi / FACETS_AROUND) ** 2)
    mass, middle, tensor = to_physical(SHAPE.inertia(exact))
    np.testing.assert_allclose(middle, centre, atol=1e-6)
    assert mass == pytest.approx(exact)
    about = second / volume - np.outer(centre, centre)
    np.testing.assert_allclose(
        tensor / mass, np.trace(about) * np.eye(3) - about, atol=0.05 * np.abs(tensor / mass).max()
    )


def test_a_ball_is_a_capsule_without_length() -> None:
    ball = LinkCapsule((0.0, 0.0, 0.1), (0.0, 0.0, 0.1), 0.2)
    _, centre, tensor = to_physical(ball.inertia(3.0))
    np.testing.assert_allclose(tensor, 0.4 * 3.0 * 0.2**2 * np.eye(3))
    np.testing.assert_allclose(centre, (0, 0, 0.1))
    assert not list(consistency_violations(ball.inertia(3.0)))
    assert np.isfinite(facets(ball.stl())[1]).all()
