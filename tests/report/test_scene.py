"""Solids and ellipsoids of a scene look outwards, and what moves is packed as the page reads it."""

import json
from base64 import b64decode

import numpy as np

from dynident.models import Solid, solid_surface
from dynident.models.robot_files import ShapeKind
from dynident.report.scene import Ellipsoid, MovingTrace, Replay, scene_figure, solid, solid_ellipsoids
from tests.report.robots import tree

BODIES = tree()
CUBE = solid_surface(Solid("", 0, ShapeKind.BOX, (0.5, 0.5, 0.5), np.eye(4)))
Q = np.random.default_rng(3).uniform(-1, 1, (6, len(BODIES.joints)))


def numbers(text: str) -> np.ndarray:
    return np.frombuffer(b64decode(text), "<f4")


def poses(result: dict, q: np.ndarray) -> list[np.ndarray]:
    """Do what the page does: each body after its parent, at its position."""
    out = []
    placement, axis = numbers(result["placement"]).reshape(-1, 3, 4), numbers(result["axis"]).reshape(-1, 3)
    for b, parent in enumerate(result["parent"]):
        joint, (x, y, z) = np.eye(4), axis[b]
        if result["slides"][b]:
            joint[:3, 3] = q[b] * axis[b]
        else:
            across = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
            joint[:3, :3] = np.eye(3) + np.sin(q[b]) * across + (1 - np.cos(q[b])) * across @ across
        own = np.vstack([placement[b], [0, 0, 0, 1]]) @ joint
        out.append(own if parent < 0 else out[parent] @ own)
    return out


def test_bodies_follow_each_other_as_those_of_the_robot_do() -> None:
    """A tree with a prismatic joint, a branch, and a joint that mimics another."""
    moving = MovingTrace(solid("<b>", CUBE, "#000000"), CUBE.vertices, np.full(8, 1))
    figure = scene_figure(BODIES, [Replay("one", 0.0, 5.0, Q)], [moving])
    content = json.loads(figure.json())["motion"]
    q = numbers(content["replays"][0]["q"]).reshape(6, len(BODIES.arm.bodies))
    placed = BODIES.placements(Q)
    for k in range(6):
        for b, pose in enumerate(poses(content["bodies"], q[k])):
            np.testing.assert_allclose(pose[:3, :3], placed.rotations[k, b], atol=1e-5)
            np.testing.assert_allclose(pose[:3, 3], placed.origins[k, b], atol=1e-5)
    np.testing.assert_allclose(numbers(content["moving"][0]["points"]).reshape(-1, 3), CUBE.vertices)
    assert content["moving"][0]["body"] == [[1, 8]]
    assert figure.data[0]["name"] == "&lt;b&gt;"
    first = np.stack([figure.data[0][axis] for axis in "xyz"], axis=1)
    np.testing.assert_allclose(first, placed.points([1] * 8, CUBE.vertices)[0], atol=1e-6)


TURNED = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
ONE = Ellipsoid(2, np.array([1.0, 2, 3]), np.array([0.3, 0.2, 0.1]), TURNED, "#0072b2")
ROD = Ellipsoid(0, np.zeros(3), np.array([0.5, 0.0, 0.0]), np.eye(3), "#e69f00")


def level(points: np.ndarray) -> np.ndarray:
    return np.linalg.norm((points - ONE.centre) @ ONE.axes / ONE.half, axis=1)


def test_an_ellipsoid_is_where_its_axes_are_and_looks_outwards() -> None:
    result = solid_ellipsoids([ONE, ROD], "found")
    mine = result.body == 2
    np.testing.assert_allclose(level(result.points[mine]), 1.0)
    np.testing.assert_allclose(np.ptp(result.points[mine], axis=0), [0.4, 0.6, 0.2])
    faces = np.stack([result.trace[name] for name in "ijk"], axis=1)
    a, b, c = (result.points[faces[:, k]] for k in range(3))
    middle = np.where(faces[:, :1] < mine.sum(), ONE.centre, ROD.centre)
    assert (np.einsum("ij,ij->i", np.cross(b - a, c - a), a - middle) > 0).all()
    assert len(result.trace["facecolor"]) == len(faces)
    assert result.trace["facecolor"][0] == "#0072b2"
    assert result.trace["facecolor"][-1] == "#e69f00"
