"""What one log alone says of the base parameters."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dynident.apps.fleets.fit import information_of, pack_triangle, unpack_triangle
from dynident.identification import Recipe, identify
from dynident.models import Model
from dynident.motion.log import Log
from dynident.motion.smoothers import Difference, Spline
from dynident.motion.splines import GCV
from dynident.regression import structural_base_parameters
from tests.apps.fleets.made import arm, recording, truth

RECIPE = Recipe(Spline(GCV()))


def logged(model: Model, seed: int, *, still: bool = False) -> Log:
    """A recording, in which the elbow may stand still."""
    t = recording(model, truth(model), seed, still=still)
    q, tau = t.select("q1", "q2").to_numpy() * [1, not still], t.select("tau1", "tau2").to_numpy()
    return Log(t["t"].to_numpy(), q, tau, ("shoulder", "elbow"), f"log {seed}")


def test_errors_are_as_large_as_the_information_says(tmp_path: Path) -> None:
    model = arm(tmp_path)
    basis = structural_base_parameters(model)
    true, distances = basis.to_base(truth(model)), []
    for seed in range(12):
        found = identify(model, [logged(model, seed)], recipe=RECIPE)
        value, information, residual = information_of(found, basis)
        error = value - true
        distances.append(error @ information @ error)
        np.testing.assert_allclose(residual, list(found.validations[0].errors.rmse.values()), rtol=0.05)
    assert 0.6 < np.mean(distances) / basis.rank < 1.5  # chi-squared with 120 degrees of freedom, over these


def test_what_a_motion_does_not_show_has_no_information(tmp_path: Path) -> None:
    model = arm(tmp_path)
    basis = structural_base_parameters(model)
    found = identify(model, [logged(model, 0, still=True)], recipe=Recipe(Difference("central")))
    _, information, _ = information_of(found, basis)
    names = [basis.names[k] for k in basis.independent]
    viscous = names.index("Fv_elbow")
    assert np.abs(information[viscous]).max() < 1e-9 * np.abs(information).max()
    assert np.linalg.eigvalsh(information).min() > -1e-9 * np.abs(information).max()
    assert information[names.index("Fv_shoulder"), names.index("Fv_shoulder")] > 0


def test_packed_matrices_are_the_same_again() -> None:
    rng = np.random.default_rng(0)
    given = rng.standard_normal((3, 4, 4))
    given = given + given.transpose(0, 2, 1)
    np.testing.assert_array_equal(unpack_triangle(np.array([pack_triangle(one) for one in given]), 4), given)
