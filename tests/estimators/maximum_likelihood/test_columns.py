"""Which columns of the regressor are multiplied: those from which all others follow."""

import numpy as np

from dynident.apps.demo import demo_truth
from dynident.estimators.maximum_likelihood.equations import RegressorColumns
from dynident.models import Model, RotorInertia
from dynident.models.lagrangian import two_link_arm


def test_columns_of_bodies_follow_from_the_independent_ones(rng: np.random.Generator) -> None:
    """At states that were not used to find them."""
    model = demo_truth().model
    found = RegressorColumns.independent(model)
    Y = model.regressor(*(5.0 * one for one in rng.standard_normal((3, 20, len(model.joints)))))
    assert len(found.indices) < Y.shape[2]
    np.testing.assert_allclose(found.select(Y) @ found.combination, Y, rtol=0, atol=1e-11 * np.abs(Y).max())
    friction = [k for k, one in enumerate(model.parameters) if not one.body]
    assert set(friction) <= set(found.indices)


def test_without_bodies_all_are_kept() -> None:
    arm = two_link_arm()
    model = Model((*arm.terms, RotorInertia(arm.joints)))  # which depends on the inertias
    assert RegressorColumns.independent(model).indices.tolist() == list(range(len(model.parameters)))


def test_none_are_kept_where_only_the_trajectory_is_sought() -> None:
    Y = np.ones((4, 2, 3))
    assert RegressorColumns.none(3).select(Y).shape == (4, 2, 0)
    assert RegressorColumns.all(3).select(Y) is Y
