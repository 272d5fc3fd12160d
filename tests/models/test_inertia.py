"""Three forms of a body's inertia, and what no body can have."""

import numpy as np
import pinocchio
import pytest

from dynident.models import (
    change_frame,
    consistency_violations,
    from_physical,
    from_pseudo,
    smallest_eigenvalue,
    to_physical,
    to_pseudo,
)
from dynident.runtime import ModelError


def bodies(count=5, seed=0):
    """Clouds of eight point masses: mass, centre, tensor about it, and the cloud (positions, masses)."""
    rng = np.random.default_rng(seed)
    points, masses = rng.normal(size=(count, 8, 3)), rng.uniform(0.1, 1.0, (count, 8))
    mass = masses.sum(axis=1)
    centre = np.einsum("bk,bki->bi", masses, points) / mass[:, None]
    return mass, centre, tensor(points - centre[:, None], masses), points, masses


def tensor(points, masses):
    square = (points**2).sum(axis=-1)[..., None, None] * np.eye(3)
    return np.einsum("bk,bkij->bij", masses, square - points[..., :, None] * points[..., None, :])


def test_pseudo_inertia_is_the_second_moment_of_mass():
    """P = sum m_k [r_k, 1] [r_k, 1]'."""
    mass, centre, about_centre, points, masses = bodies()
    extended = np.concatenate([points, np.ones((*points.shape[:2], 1))], axis=2)
    expected = np.einsum("bk,bki,bkj->bij", masses, extended, extended)
    np.testing.assert_allclose(to_pseudo(from_physical(mass, centre, about_centre)), expected, rtol=1e-10, atol=1e-12)


def test_forms_return_to_themselves():
    mass, centre, about_centre, *_ = bodies()
    theta = from_physical(mass, centre, about_centre)
    for back, there in zip(to_physical(theta), (mass, centre, about_centre), strict=True):
        np.testing.assert_allclose(back, there, rtol=1e-11, atol=1e-12)
    np.testing.assert_allclose(from_pseudo(to_pseudo(theta)), theta, rtol=1e-13, atol=1e-14)


def test_moved_is_that_of_pinocchio():
    mass, centre, about_centre, *_ = bodies(1)
    placement = pinocchio.SE3(pinocchio.utils.rpyToMatrix(0.1, -0.7, 2.0), np.array([0.3, -1.0, 2.0]))
    expected = placement.act(pinocchio.Inertia(mass[0], centre[0], about_centre[0])).toDynamicParameters()
    theta = from_physical(mass[0], centre[0], about_centre[0])
    np.testing.assert_allclose(change_frame(theta, placement.homogeneous), expected, rtol=1e-11)


@pytest.mark.parametrize(
    ("theta", "words"),
    [
        (from_physical(-1.0, np.zeros(3), np.eye(3)), "negative mass -1 kg"),
        (np.array([0.0, 1, 0, 0, 0, 0, 0, 0, 0, 0]), "a first moment without mass"),
        (np.array([0.0, 0, 0, 0, 1, 0, 1, 0, 0, 1]), "an inertia without mass"),
        (from_physical(1.0, np.zeros(3), np.diag([0.1, 0.1, 0.3])), "0.1, 0.1, 0.3 kg m^2 break the triangle"),
        (from_physical(1.0, np.ones(3), np.diag([-0.1, 0.2, 0.2])), "negative principal moment"),
    ],
)
def test_violations_in_words(theta, words):
    (violation,) = consistency_violations(theta)
    assert words in violation
    assert smallest_eigenvalue(theta) <= 0


def test_an_inertia_about_the_wrong_point_is_caught():
    """A tensor about the centre of mass where one about the joint is meant."""
    theta = from_physical(2.0, np.array([0.0, 0.0, 0.4]), np.diag([0.02, 0.02, 0.01]))
    wrong = theta.copy()
    wrong[4:] = [0.02, 0.0, 0.02, 0.0, 0.0, 0.01]
    assert consistency_violations(theta) == ()
    assert "is the tensor about another point?" in consistency_violations(wrong)[0]
    assert smallest_eigenvalue(wrong) < 0 < smallest_eigenvalue(theta)


@pytest.mark.parametrize(("share", "count"), [(0.5, 0), (2.0, 1)])
def test_inequalities_hold_to_within_a_billionth_of_the_inertia(share, count):
    """Of the tensor about the joint, of which the largest entry is 0.3 here."""
    slack = share * 1e-9 * 0.3
    flat = [1.0, 0, 0, 0, 0.1, 0, 0.2, 0, 0, 0.3 + slack]
    thin = [1.0, 0, 0, 0, -slack, 0, 0.3, 0, 0, 0.3]
    assert [len(consistency_violations(theta)) for theta in (flat, thin)] == [count, count]


def test_a_tensor_is_symmetric_to_within_rounding():
    tensor = np.diag([0.1, 0.2, 0.2])
    tensor[0, 1], tensor[1, 0] = 0.01, 0.01 * (1 + 1e-10)
    from_physical(1.0, np.zeros(3), tensor)
    tensor[1, 0] = 0.01 * (1 + 1e-8)
    for wrong in (tensor, np.stack([np.eye(3), tensor])):
        with pytest.raises(ModelError, match="is not symmetric"):
            from_physical(np.ones(wrong.shape[:-2]), np.zeros(wrong.shape[:-1]), wrong)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: to_physical(np.zeros(10), "hand"), "hand has mass 0 and so no centre of mass"),
        (lambda: to_pseudo(np.zeros(9)), r"inertial parameters has shape \(9,\), expected \(..., 10\)"),
        (lambda: from_pseudo(np.eye(3)), r"pseudo-inertia has shape \(3, 3\), expected \(..., 4, 4\)"),
        (lambda: from_physical(1.0, np.zeros(2), np.eye(3)), r"centre of mass has shape \(2,\)"),
        (lambda: from_physical(1.0, np.zeros(3), np.triu(np.ones((3, 3)))), "is not symmetric"),
        (
            lambda: consistency_violations(np.zeros((2, 10))),
            r"expected the ten parameters of one body, got shape \(2, 10\)",
        ),
    ],
)
def test_errors(call, message):
    with pytest.raises(ModelError, match=message):
        call()
