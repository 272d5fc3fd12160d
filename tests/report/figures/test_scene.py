"""Solids of a scene look outwards, and what moves is packed as the page reads it."""

import json
from base64 import b64decode

import numpy as np
import pytest

from dynident.report.figures import Mesh, box, cylinder, scene_figure


@pytest.mark.parametrize(
    "mesh",
    [box("b", np.array([1.0, 2, 3]), np.array([0.2, 0.4, 0.6])), cylinder("c", np.array([1.0, 2]), 0.3, -1.0, 2.0)],
)
def test_faces_look_outwards_and_close(mesh: Mesh) -> None:
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    normal, middle = np.cross(b - a, c - a), (a + b + c) / 3
    assert ((normal * (middle - mesh.vertices.mean(axis=0))).sum(axis=1) > 0).all()
    edges = [tuple(sorted((face[i], face[j]))) for face in mesh.faces.tolist() for i, j in ((0, 1), (1, 2), (2, 0))]
    assert set(map(edges.count, edges)) == {2}  # each edge belongs to two faces


def test_what_moves_is_in_the_text_for_the_page() -> None:
    t = np.linspace(0, 1, 5)
    rotations, origins = np.broadcast_to(np.eye(3), (5, 3, 3, 3)), np.zeros((5, 3, 3))
    origins = origins + t[:, None, None]
    mesh = box("<b>", np.zeros(3), np.ones(3))
    figure = scene_figure(t, {0: mesh, 2: mesh}, rotations, origins, [], np.zeros((4, 3)))
    found = json.loads(figure.json())["motion"]
    places = np.frombuffer(b64decode(found["places"]), "<f4").reshape(5, 2, 3, 4)
    np.testing.assert_allclose(places[3, 1], np.column_stack([np.eye(3), np.full(3, 0.75)]))
    np.testing.assert_allclose(np.frombuffer(b64decode(found["vertices"][1]), "<f4").reshape(-1, 3), mesh.vertices)
    assert figure.data[0]["name"] == "&lt;b&gt;"
