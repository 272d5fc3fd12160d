"""The conic program and the way from inside: where both work they find the same, and where the solver fails."""

import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynident.estimators import (
    Constraints,
    LeastSquares,
    PhysicallyConsistent,
    Problem,
    estimate_sizes,
    interval_limit,
    parameter_scales,
    sign_limits,
)
from dynident.estimators import programs as staged
from dynident.estimators.least_squares import joint_weights, weight_joints
from dynident.estimators.notes import ConstraintsCostly
from dynident.regression import Regression
from dynident.runtime import ConfigError, ModelError
from tests.estimators.arms import arm, error, problem


def program(posed: Problem) -> tuple[staged.Information, Constraints]:
    parameters, factors = posed.model.parameters, posed.regression.triangular_factors
    factor, rank = weight_joints(factors, joint_weights(factors, "per_joint", 3, parameters), parameters)
    bodies, effect = estimate_sizes(parameters, factors), np.linalg.norm(factor, axis=0)
    scale = parameter_scales(parameters, bodies, effect[:-1], float(effect[-1]))
    limits = tuple(sign_limit.scale_rows(scale) for sign_limit in sign_limits(parameters))
    return staged.Information.from_factor(factor, scale, rank, factors.total), Constraints(limits, bodies, 1e-5)


def squared(x: np.ndarray) -> float:
    return float(np.sum(x**2))


@pytest.mark.parametrize("seed", range(3))
def test_both_ways_find_the_same_optimum(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    information, constraints = program(problem(arm(1e-2, 0.3), 1e-2, 0.3, seed=seed, samples=200))
    conic = staged._solve_scaled(information, constraints)
    monkeypatch.setattr(staged, "STEP_UNITS", ())
    path = staged._solve_scaled(information, constraints)
    assert constraints.violation(information.theta(path)) < 0
    assert squared(path) == pytest.approx(squared(conic), rel=1e-3, abs=0.5)


def test_equalities_hold_on_the_way(monkeypatch: pytest.MonkeyPatch) -> None:
    posed = problem(arm(1e-2, 0.3), 1e-2, 0.3, samples=300)
    information, constraints = program(posed)
    index = posed.model.names.index("l5.mass")
    fixed = interval_limit("mass", posed.model.parameters, {index: (4.0, 4.0)}).scale_rows(information.scale)
    monkeypatch.setattr(staged, "STEP_UNITS", ())
    theta = information.theta(
        staged._solve_scaled(information, replace(constraints, limits=(*constraints.limits, fixed)))
    )
    assert theta[index] == pytest.approx(4.0, rel=1e-6)


def test_where_nothing_is_inside_the_error_of_the_conic_solver_stands() -> None:
    posed = problem(arm(1e-2, 0.3), 1e-2, 0.3, samples=300)
    with pytest.raises(ConfigError, match="contradict"):
        PhysicallyConsistent(total_mass=1.0, bounds={"l5.mass": (4.0, None)})(posed)


@pytest.mark.parametrize(("mass", "length"), [(1.0, 1.0), (1e-4, 0.05)])
@pytest.mark.parametrize("inertias", ["none", "zero", "true"])
def test_an_arm_of_any_size_costs_little_whatever_its_file_says(mass: float, length: float, inertias: str) -> None:
    posed = problem(arm(mass, length, inertias), mass, length)
    plain, result = LeastSquares(weights="per_joint")(posed), PhysicallyConsistent()(posed)
    assert error(posed, result.value) < 1.02 * error(posed, plain.value)
    assert not any(isinstance(note, ConstraintsCostly) for note in result.notes)


def test_constraints_that_cost_much_are_said() -> None:
    posed = problem(arm())
    motion = replace(posed.motions[0], tau=-posed.motions[0].tau)  # no possible arm
    wrong = Problem(posed.model, (motion,), Regression(posed.model, (motion,)))
    (note,) = (note for note in PhysicallyConsistent()(wrong).notes if isinstance(note, ConstraintsCostly))
    assert note.family == "pseudo-inertia"
    assert note.error > 10 * note.free


@given(
    st.integers(0, 10**6), st.sampled_from(["none", "true", "light", "heavy"]), st.sampled_from([1e-4, 1e-2, 1.0, 1e3])
)
@settings(max_examples=15, deadline=None, derandomize=True)
def test_no_few_samples_of_any_arm_fail(seed: int, inertias: str, unit: float) -> None:
    """Blocks of few samples, files with masses far off or none, torques in other units: always a possible arm."""
    rng = np.random.default_rng(seed)
    text = arm(inertias="none" if inertias == "none" else "true")
    for name, value in (("light", "1e-3"), ("heavy", "1e5")):
        text = re.sub(r'<mass value="[^"]*"', f'<mass value="{value}"', text) if inertias == name else text
    motion = problem(text, seed=seed, speed=rng.uniform(0.2, 3)).motions[0]
    size = int(np.exp(rng.uniform(np.log(25), np.log(1200))))
    first = int(rng.integers(0, 1201 - size))
    few = motion.shift(0.0, np.arange(first, first + size))
    few = replace(few, tau=unit * few.tau)
    model = problem(text, samples=30).model
    posed = Problem(model, (few,), Regression(model, (few,)))
    try:
        result = PhysicallyConsistent(costs=False)(posed)
    except ModelError as failed:
        pytest.fail(f"{failed}")
    assert min(result.consistency.eigenvalues.values()) > 0
