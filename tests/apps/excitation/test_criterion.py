"""Criteria of a motion: their values by definition, their derivatives by differences."""

import numpy as np
import pytest

from dynident.apps.excitation import Criterion
from dynident.apps.excitation.criterion import INFORMATION_FLOOR, InformationCriterion, base_information
from dynident.apps.excitation.family import ClampedSpline, Fourier
from dynident.models import Model, RigidBodies, RotorInertia
from dynident.models.friction import Coulomb, Offset, Viscous
from dynident.regression import structural_base_parameters
from tests.robots import ARM, GRIPPER, joint, link, urdf

POINTS = 40
FAMILIES = {"fourier": Fourier(4.0, 3), "bspline": ClampedSpline(4.0, 12)}


def arm(text=ARM, gravity=(1.0, 2.0, -9.0)):
    bodies = RigidBodies(text, gravity=gravity)
    joints = bodies.joints
    return Model((bodies, RotorInertia(joints), Viscous(joints), Coulomb(joints, width=0.2), Offset(joints)))


def criterion_of(model, kind=Criterion.D_OPTIMAL, **more):
    columns = structural_base_parameters(model).independent
    weights = np.linspace(20.0, 50.0, len(model.joints))
    return InformationCriterion(model, columns, **{"weights": weights, "kind": kind} | more)


def motion(model, family=FAMILIES["fourier"], seed=0):
    """Functions (3, N, K) of a family, and coefficients (n, K) of a motion."""
    functions = family.values(np.linspace(0.0, family.duration, POINTS))[:3]
    return functions, np.random.default_rng(seed).normal(size=(len(model.joints), family.size))


def information(criterion, states):
    """The sum of Y' W Y, sample by sample, in SI units."""
    Y = criterion.model.regressor(*states)[:, :, list(criterion.columns)]
    weights = np.broadcast_to(criterion.weights, states[0].shape)
    return sum(rows.T @ np.diag(weight) @ rows for rows, weight in zip(Y, weights, strict=True))


def assert_exact(criterion, functions, x, tolerance=2e-8):
    """The slopes are those of differences of fourth order along random directions of the coefficients."""
    value, slopes = criterion.value_and_gradients(*(functions @ x.T))
    assert value == pytest.approx(criterion.value(*(functions @ x.T)), rel=1e-12)
    gradient, h = np.einsum("din,dik->nk", slopes, functions), 1e-4
    for direction in np.random.default_rng(9).normal(size=(4, *x.shape)):
        steps = [criterion.value(*(functions @ (x + k * h * direction).T)) for k in (-2, -1, 1, 2)]
        slope = (steps[0] - 8 * steps[1] + 8 * steps[2] - steps[3]) / (12 * h)
        size = np.linalg.norm(gradient) * np.linalg.norm(direction)
        assert abs(slope - (gradient * direction).sum()) < tolerance * size


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("kind", Criterion)
@pytest.mark.parametrize("text", [ARM, GRIPPER], ids=["slide", "mimic"])
def test_derivatives_are_exact(kind, family, text):
    model = arm(text)
    assert_exact(criterion_of(model, kind), *motion(model, FAMILIES[family]))


@pytest.mark.parametrize("kind", Criterion)
def test_derivatives_are_exact_with_a_prior_named_rows_and_weights_of_samples(kind):
    model, rng = arm(), np.random.default_rng(4)
    r = len(structural_base_parameters(model).independent)
    half = rng.normal(size=(r, r))
    more = {"prior": half @ half.T, "named": rng.normal(size=(2, r)), "weights": rng.uniform(1, 9, (POINTS, 3))}
    assert_exact(criterion_of(model, kind, **more), *motion(model))


def test_values_are_those_of_the_definitions():
    model = arm()
    functions, x = motion(model)
    states = functions @ x.T
    named = np.random.default_rng(5).normal(size=(2, len(criterion_of(model).columns)))
    own = {kind: criterion_of(model, kind, named=named) for kind in Criterion}
    M = information(own[Criterion.D_OPTIMAL], states)
    scale = own[Criterion.D_OPTIMAL].scale
    log_det = np.linalg.slogdet(M)[1] - 2 * np.log(scale).sum()
    assert own[Criterion.D_OPTIMAL].value(*states) == pytest.approx(-log_det, abs=1e-5)
    variance = np.trace(named @ np.linalg.inv(M) @ named.T)
    assert own[Criterion.A_OPTIMAL].value(*states) == pytest.approx(np.log(variance), abs=1e-6)
    everything = criterion_of(model, Criterion.A_OPTIMAL).value(*states)  # where nothing is named
    assert everything == pytest.approx(np.log((np.diag(np.linalg.inv(M)) * scale**2).sum()), abs=1e-6)
    size = np.sqrt(np.diag(M))
    condition = np.log(np.linalg.cond(M / np.outer(size, size))) / 2
    assert condition <= own[Criterion.CONDITION].value(*states) <= condition + 2 * np.log(len(M)) / 32


@pytest.mark.parametrize("kind", Criterion)
def test_a_joint_that_stands_still_is_no_error(kind):
    """The value says that something is not shown, and its slope how to show it."""
    model = arm()
    functions, x = motion(model)
    criterion = criterion_of(model, kind)
    moving = criterion.value(*(functions @ x.T))
    x[2, 1:] = 0.0
    value, slopes = criterion.value_and_gradients(*(functions @ x.T))
    assert np.isfinite(value)
    assert np.isfinite(slopes).all()
    assert value > moving + np.log(0.1 / INFORMATION_FLOOR) / 4
    x[2, 1:] = 1e-3
    assert criterion.value(*(functions @ x.T)) < value
    none = criterion.value_and_gradients(*np.zeros((3, 5, 3)))
    assert np.isfinite(none[0])
    assert np.isfinite(none[1]).all()


def test_a_prior_on_the_base_parameters_is_the_inverse_of_their_covariance():
    model = arm()
    basis = structural_base_parameters(model)
    p = len(basis.names)
    half = 10.0 ** np.linspace(0, 3, p)[:, None] * np.random.default_rng(2).normal(size=(p, 2 * p))
    B, full = basis.combination, half @ half.T
    np.testing.assert_allclose(base_information(basis, full), np.linalg.inv(B @ np.linalg.inv(full) @ B.T), rtol=1e-7)
    functions, x = motion(model)
    Y = model.regressor(*(functions @ x.T)).reshape(-1, p)
    kept = list(basis.independent)
    np.testing.assert_allclose(base_information(basis, Y.T @ Y), (Y.T @ Y)[np.ix_(kept, kept)], rtol=1e-6, atol=1e-4)
    assert not base_information(basis, np.zeros((p, p))).any()
    alone = structural_base_parameters(Model((Viscous(model.joints),)))
    np.testing.assert_array_equal(base_information(alone, np.diag([1.0, 4.0, 9.0])), np.diag([1.0, 4.0, 9.0]))


def test_rounded_angles_hold_no_information():
    """What a recording says of directions that are free but for the rounding of the file is not used."""
    text = urdf(
        *(link(name, 1.0, (0.1, 0.05, 0.2)) for name in ("base", "one", "two", "three")),
        joint("a", "revolute", "base", "one", rpy=(3.141596, 0, 0)),
        joint("b", "revolute", "one", "two", (0, 0, 0.3), (1.5708, 0, 0)),
        joint("c", "revolute", "two", "three", (0, 0.3, 0), (-1.5708, 0, 0)),
    )
    model = Model((RigidBodies(text),))
    basis, (functions, x) = structural_base_parameters(model), motion(model)
    rows = model.regressor(*(functions @ x.T)).reshape(-1, 30)
    assert np.abs(rows @ basis.null_directions).max() > 1e-7
    kept = list(basis.independent)
    own = (rows.T @ rows)[np.ix_(kept, kept)]
    np.testing.assert_allclose(base_information(basis, rows.T @ rows), own, rtol=1e-12, atol=1e-9)
