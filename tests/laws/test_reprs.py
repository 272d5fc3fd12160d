"""Every noun of a run fits a few lines where it is displayed, alone and inside another."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dynident as dy
from dynident.estimators import Problem
from dynident.identification import normal_matrices
from dynident.models.lagrangian import slider
from dynident.project.export import exports
from dynident.regression import ParallelFilter, Regression, structural_base_parameters
from dynident.runtime import brief
from tests.robots import joint, link, urdf

NAMES = tuple(f"left_arm_joint_{k}" for k in range(1, 8))
LINES, LETTERS = 6, 500


def seven() -> str:
    """A robot of seven joints with long names."""
    parts, parent = [link("base")], "base"
    for k, name in enumerate(NAMES):
        child = f"left_arm_link_{k + 1}"
        axis = (0, 0, 1) if k % 2 == 0 else (0, 1, 0)
        parts += [link(child, 2.0, (0.02, 0.01, 0.1)), joint(name, "revolute", parent, child, (0, 0, 0.2), axis=axis)]
        parent = child
    return urdf(*parts)


def recorded(model: dy.Model, theta: Any, name: str) -> dy.Log:
    t, rng = np.arange(601) * 0.025, np.random.default_rng(0)
    w = 1.0 + 0.37 * np.arange(len(model.joints))
    phase = np.multiply.outer(t, w)
    tau = model.torque(np.sin(phase), w * np.cos(phase), -(w**2) * np.sin(phase), theta)
    q = np.sin(phase) + 1e-5 * rng.standard_normal(phase.shape)
    names = tuple(one.name for one in model.joints)
    return dy.Log(t, q, tau + 0.01 * rng.standard_normal(tau.shape), names, name)


def nouns() -> Iterator[Any]:
    """What a user meets: a robot of seven joints with all that is found about it, and a slider simulated freely."""
    bodies = dy.RigidBodies(seven(), source="arm.urdf")
    extra = tuple(kind(bodies.joints) for kind in (dy.RotorInertia, dy.Viscous, dy.Coulomb, dy.Offset))
    model = dy.Model((bodies, *extra), name="arm")
    theta = [0.1 if one.value is None else one.value for one in model.parameters]
    logs = [recorded(model, theta, name) for name in ("monday", "tuesday")]
    several = tuple(dy.Spline(factor=factor) for factor in (1.0, 2.0, 4.0))
    consistent = dy.PhysicallyConsistent(costs=False)
    recipe = dy.Recipe(several, consistent, ParallelFilter(2), dict.fromkeys(NAMES, 0.01), restart=1.0)
    found = dy.identify(model, logs[0], logs[1], recipe)
    motions = tuple(one.motion for one in found.validations)
    regression = Regression(model, motions)
    yield from (recipe, found, regression, Problem(model, motions, regression, tuple(logs)), bodies.file, bodies.arm)
    yield from (regression.triangular_factors, structural_base_parameters(model), *exports(found))
    yield dy.check(model, logs[0], logs[1], dy.Recipe())
    yield dy.smooth(logs[0].t, logs[0].q)
    yield dy.CoupledMotor(bodies.joints, dict.fromkeys(NAMES, 1.0), "motor")
    yield model.partials(motions[0].q[:5], motions[0].dq[:5], motions[0].ddq[:5], theta)
    plain, values = slider(0.01), [5.0, 8.0, 3.0, 0.5]
    motion = dy.simulate(plain, values, lambda s: [20 * np.sin(3 * s)], np.arange(501) * 0.01)
    recording = dy.record(motion, 1e-5, 0.01, np.random.default_rng(0))
    yield from (
        recording,
        *normal_matrices(plain, np.array(values), motion, np.array([1e-5]), np.array([0.01]), [0, 1]),
    )
    yield dy.accuracy_bound(plain, recording.log, dy.Recipe())
    yield dy.two_link_arm()


def reached(noun: Any, seen: dict[int, Any]) -> None:
    """Add a noun and all that its fields hold."""
    if isinstance(noun, Mapping):
        noun = tuple(noun.values())
    if isinstance(noun, tuple | list):
        for one in noun:
            reached(one, seen)
    elif is_dataclass(noun) and id(noun) not in seen:
        seen[id(noun)] = noun
        for one in fields(noun):
            reached(getattr(noun, one.name), seen)


@pytest.fixture(scope="module")
def displayed() -> dict[str, list[str]]:
    """The texts of all nouns by the names of their classes."""
    seen: dict[int, Any] = {}
    reached(list(nouns()), seen)
    found: dict[str, list[str]] = {}
    for noun in seen.values():
        found.setdefault(type(noun).__name__, []).append(repr(noun))
    return found


def test_nouns_fit_a_few_lines(displayed: dict[str, list[str]]) -> None:
    long = {
        name: max(map(len, texts))
        for name, texts in displayed.items()
        if any(len(text) > LETTERS or text.count("\n") >= LINES for text in texts)
    }
    assert not long
    assert displayed.keys() >= {
        "AccuracyBound", "BaseParameters", "Calibration", "CheckResult", "Estimate", "ExportText", "FreeRun",
        "Identification", "Lagrangian", "Log", "LogValidation", "Model", "Motion", "Recipe", "Recording", "Regression",
        "RigidBodies", "SmootherChoice", "SmoothingSpline", "Sources", "StandardErrors", "TorqueErrors",
        "TriangularFactors",
    }  # fmt: skip


def test_nouns_say_what_they_are(displayed: dict[str, list[str]]) -> None:
    for name, texts in displayed.items():
        assert all(text.removeprefix("<").startswith((name, name.removesuffix("Settings"))) for text in texts), name


def test_large_fields_are_shown_by_size() -> None:
    motion = dy.simulate(slider(0.01), [5.0, 8.0, 3.0, 0.5], lambda _: [1.0], [0.0, 0.1, 0.2])
    recording = dy.record(motion, 0.0, 0.5, np.random.default_rng(0))
    assert repr(recording).endswith(", sigma_q=[0], sigma_tau=[0.5])")
    assert brief(slider().partials([[0.1]], [[0.2]], [[0.3]], [1, 1, 1, 1])) == (
        "Partials(q=array(1, 1, 1), dq=array(1, 1, 1), ddq=array(1, 1, 1))"
    )


def test_the_default_recipe_of_a_robot_is_short(tmp_path: Path) -> None:
    from dynident.project.shortcuts import default_recipe

    text = repr(default_recipe(dy.two_link_arm()))
    assert text.startswith("Recipe(smoother=(Spline(")
    assert text.endswith(" and 8 more), time_offset='estimate')")
    assert repr(dy.Recipe(estimator=dy.PhysicallyConsistent(costs=False))) == (
        "Recipe(estimator=PhysicallyConsistent(costs=False))"
    )
