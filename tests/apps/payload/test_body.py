"""Ten parameters as a body: consistent, and with mass, centre and inertia."""

from __future__ import annotations

import numpy as np
import pytest

from dynident.apps.payload import PhysicalBody
from dynident.apps.payload.body import make_consistent, physical_components, physical_jacobian
from dynident.models import smallest_eigenvalue
from tests.apps.payload.arms import CARRIED


def test_a_consistent_payload_stays_as_it_is() -> None:
    assert make_consistent(CARRIED, np.eye(10)) is CARRIED


@pytest.mark.parametrize("k", [4, 6, 9])
def test_another_becomes_consistent_where_it_is_least_known(k: int) -> None:
    phi, information = CARRIED.copy(), np.diag(np.full(10, 1e8))
    phi[k], information[k, k] = -0.01, 1.0
    found = make_consistent(phi, information)
    assert smallest_eigenvalue(found) > 0
    kept = np.arange(10) != k
    np.testing.assert_allclose(found[kept], phi[kept], atol=1e-4)


def test_the_nearest_is_not_moved_further_than_needed() -> None:
    phi = CARRIED.copy()
    phi[4] = -0.01
    found, rng = make_consistent(phi, np.eye(10)), np.random.default_rng(0)
    others = found + 1e-3 * rng.standard_normal((200, 10))
    physical_ones = others[smallest_eigenvalue(others) > 1e-7]
    assert len(physical_ones) > 10
    assert (np.linalg.norm(physical_ones - phi, axis=1) > np.linalg.norm(found - phi) - 1e-6).all()


def test_mass_centre_and_inertia_and_their_derivatives() -> None:
    values = physical_components(CARRIED)
    np.testing.assert_allclose(values, [3.0, 0.02, -0.03, 0.08, 0.012, 0, 0.015, 0, 0, 0.006], atol=1e-15)
    body, J = PhysicalBody(values, np.ones(10)), physical_jacobian(CARRIED)
    assert body.mass == pytest.approx(3.0)
    np.testing.assert_allclose(body.tensor, np.diag([0.012, 0.015, 0.006]), atol=1e-15)
    step = 1e-4 * np.random.default_rng(0).standard_normal(10)
    np.testing.assert_allclose(physical_components(CARRIED + step) - values, J @ step, atol=1e-7)
