"""The consistent fit: known answers, and what each constraint does."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from dynident.estimators import LeastSquares, PhysicallyConsistent, Problem
from dynident.models import Model, from_pseudo, to_pseudo
from dynident.runtime import ConfigError
from tests.estimators.welded import Drag, cloud, pair, problem, random_body, single

Array = NDArray[np.float64]
ROD = cloud(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.4]]), np.array([1.0, 1.0]))
BODY = random_body(np.random.default_rng(1))


def smallest(theta: Array) -> float:
    return float(np.linalg.eigvalsh(to_pseudo(theta[:10]))[0])


def error(posed: Problem, theta: Array) -> float:
    """The unweighted squared error on the training data."""
    return float(posed.regression.triangular_factors.residual(theta).sum())


@pytest.mark.parametrize("noise", [0.0, 0.01, 0.03])
def test_equals_least_squares_where_that_is_possible(noise: float) -> None:
    posed = problem(single(None, ("viscous", 5)), np.append(BODY, 0.7), noise)
    plain, result = LeastSquares()(posed), PhysicallyConsistent(fit=LeastSquares())(posed)
    np.testing.assert_allclose(result.value, plain.value, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(result.covariance, plain.covariance, rtol=1e-6, atol=1e-15)
    np.testing.assert_allclose(result.residual.sigma, plain.residual.sigma, rtol=1e-6, atol=1e-12)
    assert result.notes == ()
    assert set(result.provenance) == {"data"}
    assert set(result.consistency.costs.values()) == {0.0}
    assert result.consistency.eigenvalues["b1"] > 1e-3


@pytest.mark.parametrize("noise", [0.0, 0.01, 0.5])
def test_body_on_the_boundary(noise: float) -> None:
    """A rod has no extent across: the truth is singular, and noise makes least squares leave what is possible."""
    posed = problem(single(), ROD, noise)
    result = PhysicallyConsistent()(posed)
    assert smallest(result.value) > 0
    assert result.consistency.eigenvalues["b1"] == pytest.approx(1e-5, rel=1e-2)
    assert set(result.provenance) == {"bound"}
    np.testing.assert_allclose(result.value, ROD, atol=max(1e-6, 4 * result.std.max()))
    if noise:
        assert smallest(LeastSquares()(posed).value) < 0
        assert 0 < result.consistency.costs["pseudo-inertia"] == result.consistency.costs["all"] < 0.1


@given(st.integers(0, 10**6), st.floats(0.0, 2.0), st.booleans())
@settings(max_examples=30, deadline=None, derandomize=True)
def test_no_possible_body_fits_better(seed: int, noise: float, rod: bool) -> None:
    """Optimality by its definition, against the truth, other bodies, and points on the way to them."""
    rng = np.random.default_rng(seed)
    truth = cloud(0.2 * rng.normal(size=(2, 3)), rng.uniform(0.5, 2, 2)) if rod else random_body(rng)
    posed = problem(single(), truth, noise, seed, 40)
    result = PhysicallyConsistent(fit=LeastSquares())(posed)
    assert smallest(result.value) > 0
    assert min(result.consistency.costs.values()) >= 0
    best = error(posed, result.value)
    rest = 1e-10 * np.square(posed.regression.triangular_factors.factors[:, :, -1]).sum()  # margin and solver
    floor = from_pseudo(np.diag([1e-7, 1e-7, 1e-7, 1e-5]))
    for other in (truth, truth + 0.01 * random_body(rng), random_body(rng)):
        for share in (1.0, 0.1):
            rival = (1 - share) * result.value + share * (other + floor)
            assert best <= error(posed, rival) * (1 + 1e-6) + rest


def test_standard_errors_tell_the_spread_where_no_constraint_acts() -> None:
    """No bias, and 95 % intervals that cover, over a hundred and fifty noises."""
    model, truth, runs = single(None, ("viscous", 4)), np.append(BODY, 0.5), 150
    result = [PhysicallyConsistent(costs=False)(problem(model, truth, 0.05, seed)) for seed in range(runs)]
    scores = np.array([(x.value - truth) / x.std for x in result])
    assert (np.abs(scores.mean(axis=0)) < 4 / np.sqrt(runs)).all()
    covered = (np.abs(scores) < 1.96).mean(axis=0)
    assert (np.abs(covered - 0.95) < 4 * np.sqrt(0.95 * 0.05 / runs) + 0.005).all()


@pytest.mark.parametrize("role", ["viscous", "coulomb", "rotor"])
def test_friction_and_rotor_inertia_are_not_negative_unless_switched_off(role: str) -> None:
    off: dict[str, Any] = {role: False}
    posed = problem(single(None, (role, 3)), np.append(BODY, -0.2), 0.01)
    result, freed = PhysicallyConsistent()(posed), PhysicallyConsistent(**off)(posed)
    assert result.value[10] == 0.0
    assert result.provenance[10] == "bound"
    assert (
        result.consistency.costs[
            {"rotor": "rotor inertia", "viscous": "viscous friction"}.get(role, "Coulomb friction")
        ]
        > 0
    )
    assert freed.value[10] == pytest.approx(-0.2, abs=4 * freed.std[10])
    assert set(freed.consistency.costs) == {"pseudo-inertia", "all"}


LIMITS: list[tuple[dict[str, Any], Any]] = [
    ({"total_mass": 3.0}, lambda v: abs(v[0] - 3.0) < 1e-7),
    ({"total_mass": (3.0, None)}, lambda v: abs(v[0] - 3.0) < 1e-7),
    ({"total_mass": (None, 1.5)}, lambda v: abs(v[0] - 1.5) < 1e-7),
    ({"bounds": {"b1.mass": (2.5, 4.0)}}, lambda v: v[0] == 2.5),
    ({"bounds": {"b1.mass": (None, 1.0), "viscous_nx": (0.8, None)}}, lambda v: v[0] == 1.0 and v[10] == 0.8),
    (
        {"centre_of_mass": {"b1": ((0.3, -1, -1), (0.4, 1, 1))}},
        lambda v: 0.3 - 1e-7 <= v[1] / v[0] <= 0.4 + 1e-7 and (np.abs(v[2:4]) <= v[0]).all(),
    ),
]


@pytest.mark.parametrize(("setting", "met"), LIMITS, ids=lambda x: str(x) if isinstance(x, dict) else "")
def test_limits_are_met(setting: dict[str, Any], met: Any) -> None:
    """The truth breaks each of them: 2 kg, its centre at about 0.1 m, viscous friction 0.5."""
    posed = problem(single(None, ("viscous", 3)), np.append(BODY, 0.5), 0.01)
    result = PhysicallyConsistent(**setting)(posed)
    assert met(result.value), result.value
    assert smallest(result.value) > 0
    assert result.consistency.costs["all"] > 0
    assert "bounds" not in setting or result.provenance[0] == "bound"


def test_total_mass_settles_what_the_data_leave_free() -> None:
    model = pair()[0]
    both = np.concatenate((BODY, random_body(np.random.default_rng(2), mass=5.0)))
    posed = problem(model, both, 0.01)
    bounds = {"b2.mass": (4.5, 4.6)}
    result = PhysicallyConsistent(bounds=bounds, prior="none")(posed)
    assert 4.5 <= result.value[10] <= 4.6
    assert result.value[0] + result.value[10] == pytest.approx(7.0, abs=0.01)
    assert result.consistency.costs["all"] < 1e-4


CONFLICTS: list[tuple[dict[str, Any], list[str]]] = [
    ({"total_mass": 1.0, "bounds": {"b1.mass": (5.0, None)}}, ["the total mass = 1", "b1.mass >= 5", "inertia of b2"]),
    ({"bounds": {"b1.mass": (None, -1.0)}}, ["b1.mass <= -1", "inertia of b1"]),
    ({"bounds": {"b1.mass": (None, 1.0), "b1.mx": (3, 3), "b1.Izz": (None, 1)}}, ["b1.mass <= 1", "b1.mx = 3"]),
    (
        {"total_mass": 2.0, "inertia": False, "bounds": {"b1.mass": (1.5, None), "b2.mass": (0.6, None)}},
        ["the total mass = 2", "b1.mass >= 1.5", "b2.mass >= 0.6"],
    ),
    (
        {"centre_of_mass": {"b2": ((0.1, 0, 0), (0.2, 1, 1))}, "bounds": {"b2.mx": (None, -0.1)}},
        ["centre of mass of b2 from 0.1 m along x", "b2.mx <= -0.1"],
    ),
]


@pytest.mark.parametrize(("setting", "words"), CONFLICTS, ids=str)
def test_contradictions_are_named(setting: dict[str, Any], words: list[str]) -> None:
    model = pair()[0]
    posed = problem(model, np.concatenate((BODY, BODY)), 0.1)
    with pytest.raises(ConfigError, match="contradict each other") as raised:
        PhysicallyConsistent(**setting)(posed)
    for word in words:
        assert word in str(raised.value)


WRONG: list[tuple[dict[str, Any], str]] = [
    ({"bounds": {"b1.mas": (0, 1)}}, "bounds: model has no parameter 'b1.mas'; did you mean 'b1.mass'"),
    ({"prior": {"b1.mas": 1.0}}, "prior: model has no parameter 'b1.mas'; did you mean 'b1.mass'"),
    ({"prior": "cad"}, "prior = 'cad'; .*hoose from 'nominal', 'none'"),
    ({"bounds": {"b1.mass": (2, 1)}}, "b1.mass: the lower limit 2 lies above the upper limit 1"),
    ({"bounds": {"b1.mass": (float("nan"), None)}}, "b1.mass: the limits nan and None must be numbers"),
    ({"total_mass": (2, 1)}, "total mass: the lower limit 2 lies above"),
    ({"centre_of_mass": {"b1": ((0, 0, 1), (1, 1, 0))}}, "centre of mass of b1: the lower limit 1 lies above"),
    ({"centre_of_mass": {"b3": ((0, 0, 0), (1, 1, 1))}}, "no body 'b3' with ten inertial parameters; .*'b1'"),
]


@pytest.mark.parametrize(("setting", "words"), WRONG, ids=[words[:30] for _, words in WRONG])
def test_wrong_settings_are_named(setting: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        PhysicallyConsistent(**setting)(problem(single(), BODY))


def test_total_mass_needs_a_body() -> None:
    joints = single().joints
    with pytest.raises(ConfigError, match=r"total mass \(1.0, 1.0\): the model has no body"):
        PhysicallyConsistent(total_mass=1.0)(problem(Model((Drag(joints, "viscous"),)), np.array([1.0])))
