"""Constraints in the consistent fit: each is met, contradictions and wrong settings are named."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from dynident.errors import ConfigError
from dynident.estimators import PhysicallyConsistent
from dynident.models import Model, to_pseudo
from tests.estimators.welded import Drag, Welded, problem, random_body, single, turned

Array = NDArray[np.float64]
BODY = random_body(np.random.default_rng(1))


def smallest(theta: Array) -> float:
    return float(np.linalg.eigvalsh(to_pseudo(theta[:10]))[0])


def welded() -> Model:
    """Two bodies welded together, of which data determine only the sum."""
    return Model((Welded((np.eye(4), turned(np.random.default_rng(3))), (None, None)),))


@pytest.mark.parametrize("role", ["viscous", "coulomb", "rotor"])
def test_friction_and_rotor_inertia_are_not_negative_unless_switched_off(role: str) -> None:
    off: dict[str, Any] = {role: False}
    posed = problem(single(None, (role, 3)), np.append(BODY, -0.2), 0.01)
    found, freed = PhysicallyConsistent()(posed), PhysicallyConsistent(**off)(posed)
    assert found.value[10] == 0.0
    assert found.provenance[10] == "bound"
    assert (
        found.consistency.costs[{"rotor": "rotor inertia", "viscous": "viscous friction"}.get(role, "Coulomb friction")]
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
    found = PhysicallyConsistent(**setting)(posed)
    assert met(found.value), found.value
    assert smallest(found.value) > 0
    assert found.consistency.costs["all"] > 0
    assert "bounds" not in setting or found.provenance[0] == "bound"


def test_total_mass_settles_what_the_data_leave_free() -> None:
    model = welded()
    both = np.concatenate((BODY, random_body(np.random.default_rng(2), mass=5.0)))
    posed = problem(model, both, 0.01)
    bounds = {"b2.mass": (4.5, 4.6)}
    found = PhysicallyConsistent(bounds=bounds, prior="none")(posed)
    assert 4.5 <= found.value[10] <= 4.6
    assert found.value[0] + found.value[10] == pytest.approx(7.0, abs=0.01)
    assert found.consistency.costs["all"] < 1e-4


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
    model = welded()
    posed = problem(model, np.concatenate((BODY, BODY)), 0.1)
    with pytest.raises(ConfigError, match="contradict each other") as raised:
        PhysicallyConsistent(**setting)(posed)
    for word in words:
        assert word in str(raised.value)


WRONG: list[tuple[dict[str, Any], str]] = [
    ({"bounds": {"b1.mas": (0, 1)}}, "bounds: model has no parameter 'b1.mas'; did you mean 'b1.mass'"),
    ({"prior": {"b1.mas": 1.0}}, "prior: model has no parameter 'b1.mas'; did you mean 'b1.mass'"),
    ({"prior": "cad"}, "prior = 'cad'; .*Known: 'nominal', 'none'"),
    ({"distance": "euclid"}, "distance = 'euclid'; did you mean 'euclidean'"),
    ({"weights": "joint"}, "weights = 'joint' of the joints; .*Known: 'equal', 'per_joint'"),
    ({"iterations": 0}, "iterations = 0 of the weights"),
    ({"margin": 0.0}, "margin = 0.0; give a number between 0 and 1"),
    ({"threshold": 2.0}, "threshold = 2.0; give a number between 0 and 1"),
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
