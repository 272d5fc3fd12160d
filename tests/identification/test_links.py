"""Mass, centre and moments of links, with errors where the data determine them."""

from dataclasses import replace

import numpy as np

from dynident.estimators import PhysicallyConsistent
from dynident.identification import Identifiability
from dynident.identification.links import BodyInertia, DeterminedBy, LinkInertia, link_inertias
from dynident.models import Model, RigidBodies, from_physical
from tests.report.robots import identified

THETA = from_physical(3.0, [0.1, -0.2, 0.05], np.diag([0.10, 0.20, 0.25]) + 0.01)
DOOR = """<robot name="door"><link name="wall"/><link name="leaf"><inertial><origin xyz="0.4 0 0"/>
<mass value="20"/><inertia ixx="3" iyy="1" izz="4" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="hinge" type="continuous"><parent link="wall"/><child link="leaf"/><axis xyz="0 1 0"/></joint></robot>"""


def values(theta: np.ndarray) -> np.ndarray:
    """Mass, centre and principal moments, by the pseudo-inertia and not as the module does it."""
    m, h = theta[0], theta[1:4]
    tensor = np.array([[theta[4], theta[5], theta[7]], [theta[5], theta[6], theta[8]], [theta[7], theta[8], theta[9]]])
    c = h / m
    return np.array([m, *c, *np.linalg.eigvalsh(tensor - m * (c @ c * np.eye(3) - np.outer(c, c)))])


def all_known(covariance: np.ndarray) -> LinkInertia:
    """A link whose ten parameters the data determine, with this covariance."""
    identification = identified()
    bodies = RigidBodies(DOOR, source="door.urdf")
    model = Model((bodies,), name="door")
    estimate = replace(identification.estimate, parameters=model.parameters, value=THETA, covariance=covariance)
    std = np.sqrt(np.diag(covariance))
    errors = replace(identification.errors, std=std, base_std=None, base_covariance=covariance)
    (link,) = link_inertias(
        replace(identification, model=model, estimate=estimate, errors=errors, base=Identifiability())
    )
    return link


def test_errors_are_those_of_drawn_parameters() -> None:
    root = np.random.default_rng(0).standard_normal((10, 10)) * np.array([0.1, *[0.02] * 3, *[0.004] * 6])[:, None]
    link = all_known(root @ root.T * 1e-4)
    drawn = THETA + 1e-2 * np.random.default_rng(1).standard_normal((4000, 10)) @ root.T
    np.testing.assert_allclose(link.std, np.std([values(x) for x in drawn], axis=0), rtol=0.05)
    np.testing.assert_allclose(link.identified.values, values(THETA))
    assert link.sure.all()
    assert link.main_source is DeterminedBy.DATA


def test_an_ellipsoid_has_the_inertia_of_its_body() -> None:
    body = all_known(np.eye(10)).identified
    a, b, c = body.ellipsoid
    expected = body.mass / 5 * np.array([b * b + c * c, a * a + c * c, a * a + b * b])
    np.testing.assert_allclose(expected, body.moments)
    assert np.linalg.det(body.axes) > 0
    thin = BodyInertia(1.0, np.zeros(3), np.array([0.0, 1.0, 1.0]), np.eye(3))
    np.testing.assert_allclose(thin.ellipsoid, [np.sqrt(5), 0, 0])
    impossible = BodyInertia(1.0, np.zeros(3), np.array([0.1, 0.2, 1.0]), np.eye(3))
    assert impossible.ellipsoid is None
    assert BodyInertia(-1.0, np.zeros(3), np.ones(3), np.eye(3)).ellipsoid is None


def test_a_consistent_estimate_has_values_and_what_the_data_contribute_to_their_errors() -> None:
    identification = identified(PhysicallyConsistent())
    for case in link_inertias(identification):
        assert np.isfinite(case.identified.values).all()
        assert np.isfinite(case.std).all()
        assert case.identified.ellipsoid is not None
        assert set(case.by) <= {DeterminedBy.DATA, DeterminedBy.PRIOR, DeterminedBy.BOUND}
    own = [k for k, x in enumerate(identification.model.parameters) if x.body == "finger"]
    finger = link_inertias(identification)[3]
    np.testing.assert_allclose(finger.identified.values, values(identification.estimate.value[own]), atol=1e-12)
