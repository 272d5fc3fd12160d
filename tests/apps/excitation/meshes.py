"""Meshes for tests."""

import numpy as np

from dynident.models import Mesh

CORNERS = np.indices((2, 2, 2)).reshape(3, -1).T.astype(float)
SIDES = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
FACES = np.concatenate((SIDES[:, :3], SIDES[:, [0, 2, 3]]))


def box(low, high):
    """The surface of a box, outwards."""
    return Mesh(np.asarray(low) + CORNERS * np.subtract(high, low), FACES)


def joined(*parts):
    starts = np.cumsum([0, *(len(x.vertices) for x in parts[:-1])])
    return Mesh(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.triangles + start for part, start in zip(parts, starts, strict=True)]),
    )


BENT = joined(box((0, 0, 0), (1.0, 0.1, 0.1)), box((0, 0.1, 0), (0.1, 1.0, 0.1)))
"""Two beams of 1 m at a right angle."""


def volume(mesh):
    case, two, three = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
    return float(np.einsum("ki,ki->", case, np.cross(two, three)) / 6)
