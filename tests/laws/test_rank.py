"""One rank: for files with rounded angles that of the exact file, everywhere; and intervals that hold with it."""

import re
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import binom

from dynident.estimators import Estimator, LeastSquares, PhysicallyConsistent, Problem
from dynident.estimators.notes import HeldByConstraints, RankDeficient
from dynident.identification import Identification, Recipe, identify
from dynident.models import Model, RigidBodies, RotorInertia
from dynident.models.friction import Coulomb, Offset, Viscous
from dynident.motion.log import Log, Motion
from dynident.motion.smoothers import Smoother
from dynident.project.export import IdentifiedModel, Mjcf, Urdf, export, random_states
from dynident.regression import Regression, base_parameters, base_std, structural_base_parameters
from tests.robots import joint, link, urdf

Array = NDArray[np.float64]
SHARED = Path(__file__).parents[3] / "shared" / "data"
DIGITS = (3, 4, 5, 6, 7)
RIGHT, HALF = np.pi / 2, np.pi
Moments = tuple[float, float, float]
MOMENTS: Moments = (1.0, 0.8, 0.5)
Frame = tuple[tuple[float, float, float], tuple[float, float, float]]
ARMS: dict[str, tuple[Frame, ...]] = {
    "2R": (((0.0, 0.0, 0.1), (RIGHT, 0.0, 0.0)), ((0.4, 0.0, 0.0), (HALF, 0.0, 0.0))),
    "wrist": (
        ((0.0, 0.0, 0.67), (0.0, 0.0, 0.0)),
        ((0.0, 0.15, 0.0), (-RIGHT, 0.0, 0.0)),
        ((0.43, 0.0, -0.09), (0.0, 0.0, 0.0)),
        ((0.02, 0.43, 0.0), (-RIGHT, 0.0, 0.0)),
        ((0.0, 0.0, 0.0), (RIGHT, 0.0, 0.0)),
        ((0.0, 0.0, 0.0), (-RIGHT, 0.0, 0.0)),
    ),
    "bent": (
        ((0.0, 0.0, 0.16), (HALF, 0.0, HALF)),
        ((0.0, 0.002, -0.12), (-RIGHT, 0.0, HALF)),
        ((0.0, -0.41, 0.0), (0.0, HALF, 0.0)),
        ((0.0, 0.21, -0.011), (-RIGHT, 0.0, HALF)),
        ((0.0, -0.037, -0.064), (HALF / 3, 0.0, HALF)),
        ((0.0, -0.037, -0.064), (HALF / 3, 0.0, HALF)),
    ),
}
"""Frames (xyz, rpy) of the joints: planar; with offset shoulder and spherical wrist; with a wrist bent by 60 deg."""
SIZES = ((0.75, 0.05), (0.99, 0.12), (0.68, 0.07), (0.43, 0.04), (0.43, 0.04), (0.73, 0.05))  # kg, m


def arm(kind: str, digits: int | None = None, off: float = 0.0, seed: int = 7, moments: Moments = MOMENTS) -> str:
    """The text of a URDF, its angles printed with so many digits, or none of them quite exact; bodies at random."""
    frames = [
        (xyz, tuple(x + off if x else 0.0 for x in rpy))
        if digits is None
        else (xyz, tuple(round(x + off if x else 0.0, digits) for x in rpy))
        for xyz, rpy in ARMS[kind]
    ]
    return made(frames, SIZES, seed, moments)


def made(
    frames: Sequence[tuple[Any, Any]], sizes: Sequence[tuple[float, float]], seed: int = 7, moments: Moments = MOMENTS
) -> str:
    """The text of a URDF of these frames (xyz, rpy) and sizes (kg, m); bodies at random."""
    rng = np.random.default_rng(seed)
    names = ["base", *(f"l{k + 1}" for k in range(len(frames)))]
    parts = [link("base", 1.0)]
    for name, (mass, length) in zip(names[1:], sizes, strict=False):
        turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        tensor = mass * length**2 * turn @ np.diag(moments) @ turn.T
        parts.append(link(name, mass * rng.uniform(0.8, 1.2), tuple(length * rng.uniform(-1, 1, 3)), tensor=tensor))
    for k, (xyz, rpy) in enumerate(frames):
        parts.append(joint(f"j{k + 1}", "continuous", names[k], names[k + 1], xyz, rpy))
    return urdf(*parts)


def driven(text: str, *, nominal: bool = True) -> Model:
    bodies = RigidBodies(text)
    joints, n = bodies.joints, len(bodies.joints)

    def values(*x: float) -> tuple[float, ...] | None:
        return x[:n] if nominal else None

    return Model(
        (
            bodies,
            RotorInertia(joints, values=values(0.3, 0.4, 0.2, 0.05, 0.05, 0.04)),
            Viscous(joints, values=values(1.2, 2.0, 1.0, 0.5, 0.4, 0.4)),
            Coulomb(joints, values=values(0.9, 1.5, 0.8, 0.3, 0.3, 0.3)),
            Offset(joints, values=values(0.1, -0.1, 0.05, 0.02, 0.01, -0.03)),
        )
    )


def moved(model: Model, t: Array) -> Motion:
    """A sum of five sines for each joint, exact, with the torque of the model's nominal values."""
    rng, n = np.random.default_rng(3), len(model.joints)
    q, dq, ddq = np.zeros((3, len(t), n))
    for k in range(1, 6):
        w, (a, b) = 0.2 * np.pi * k, rng.normal(size=(2, n)) * 0.7 / k
        sine, cosine = np.sin(w * t)[:, None], np.cos(w * t)[:, None]
        q, dq, ddq = q + a * sine - b * cosine, dq + w * (a * cosine + b * sine), ddq - w**2 * (a * sine - b * cosine)
    names = tuple(x.name for x in model.joints)
    tau = model.torque(q, dq, ddq, model.values)
    return Motion(t, q, dq, ddq, tau, names, np.ones(len(t), dtype=bool), "simulation")


def recorded(motion: Motion, seed: int, sigma_q: float = 2e-5, share: float = 0.05) -> Log:
    rng = np.random.default_rng(seed)
    q = motion.q + sigma_q * rng.standard_normal(motion.q.shape)
    tau = motion.tau + share * motion.tau.std(axis=0) * rng.standard_normal(motion.q.shape)
    return Log(motion.t, q, tau, motion.joints, f"run {seed}")


@cache
def exact(kind: str) -> int:
    return structural_base_parameters(driven(arm(kind))).rank


def fitted(model: Model, estimator: Estimator) -> Identification:
    log = recorded(moved(model, np.arange(2000) * 0.005), 0)
    return identify(model, [log], recipe=Recipe(estimator=estimator, outliers="keep"))


@pytest.mark.parametrize("angle", ["3.14", "3.1415900001"])
@pytest.mark.parametrize("estimator", [LeastSquares(), PhysicallyConsistent()], ids=lambda x: type(x).__name__)
def test_the_elbow_of_a_planar_arm_may_be_printed_with_any_digits(angle: str, estimator: Estimator) -> None:
    """The other angle is none that a printed one could stand for: 2.7e-6 rad away from pi."""
    text = arm("2R").replace(f'rpy="{HALF!r} 0.0 0.0"', f'rpy="{angle} 0 0"')
    assert angle in text
    fit = fitted(driven(text), estimator)
    rank = exact("2R")
    assert (fit.estimate.determined.rank, fit.base.on_data.rank, fit.base.structural.rank) == (rank, rank, rank)
    assert len(fit.base.on_data.independent) == rank
    said = [(note.rank, note.parameters) for note in fit.estimate.notes if isinstance(note, RankDeficient)]
    assert said == [(rank, len(fit.model.names))]
    assert np.abs(fit.estimate.value).max() < 10
    assert fit.base.unexcited == ()
    assert fit.validations[0].errors.relative_error < 7


@pytest.mark.parametrize("kind", ARMS)
@pytest.mark.parametrize("digits", DIGITS)
def test_files_with_rounded_angles_have_the_rank_of_the_exact_file(kind: str, digits: int) -> None:
    model = driven(arm(kind, digits))
    motion = moved(model, np.arange(1500) * 0.01)
    regression = Regression(model, (motion,))
    on_data = base_parameters(regression.triangular_factors.stack(), model.parameters)
    estimates = [x(Problem(model, (motion,), regression)) for x in (LeastSquares(), PhysicallyConsistent(costs=False))]
    ranks = {
        structural_base_parameters(model).rank,
        on_data.rank,
        *(estimate.determined.rank for estimate in estimates),
    }
    assert ranks == {exact(kind)}
    assert on_data.gap > 1e6


@pytest.mark.parametrize("digits", DIGITS)
@pytest.mark.parametrize(
    "file",
    ["tx40/tx40_mdh_modified.urdf", "double_pendulum/double_pendulum.urdf", "lwr4/kuka_lwr4.urdf", "panda/panda.urdf"],
)
def test_so_have_measured_robots(file: str, digits: int) -> None:
    if not (SHARED / file).exists():
        pytest.skip("the measured robots lie beside the checkout, and are not there")
    text = (SHARED / file).read_text()

    def rounded(match: re.Match[str]) -> str:
        return 'rpy="' + " ".join(repr(round(float(word), digits)) for word in match[1].split()) + '"'

    def rank(xml: str) -> int:
        used = tuple(f"panda_joint{k}" for k in range(1, 8)) if "finger" in xml else None
        movable = RigidBodies(xml, used)
        return structural_base_parameters(Model((movable, RotorInertia(movable.joints)))).rank

    assert rank(re.sub(r'rpy="([^"]*)"', rounded, text)) == rank(text)


def test_a_finger_on_a_palletiser_takes_no_rank_from_it() -> None:
    """The torque of the last joint is a millionth of the first's, and its noise too: weights differ as much."""
    frames = (
        ((0.0, 0.0, 0.8), (0.0, 0.0, 0.0)),
        ((0.35, 0.0, 0.0), (-RIGHT, 0.0, 0.0)),
        ((1.25, 0.0, 0.0), (0.0, 0.0, 0.0)),
        ((0.05, 1.5, 0.0), (-RIGHT, 0.0, 0.0)),
        ((0.0, 0.0, 0.0), (RIGHT, 0.0, 0.0)),
        ((0.0, 0.0, 0.2), (-RIGHT, 0.0, 0.0)),
    )
    sizes = ((1200.0, 1.0), (300.0, 1.2), (400.0, 1.0), (80.0, 0.3), (20.0, 0.2), (0.05, 0.03))
    bodies = RigidBodies(made(frames, sizes))
    model = Model((bodies, RotorInertia(bodies.joints), Viscous(bodies.joints), Offset(bodies.joints)))
    weightless = np.array([x.value or 0.0 for x in model.parameters])
    motion = moved(driven(made(frames, sizes)), np.arange(2000) * 0.01)
    tau = model.torque(motion.q, motion.dq, motion.ddq, weightless)
    tau = tau + 0.02 * tau.std(axis=0) * np.random.default_rng(0).standard_normal(tau.shape)
    motion = replace(motion, tau=tau)
    regression = Regression(model, (motion,))
    structural = structural_base_parameters(model)
    assert structural.rank == structural_base_parameters(model, tolerance=1e-12).rank
    for estimator in (LeastSquares(), LeastSquares(weights="per_joint"), PhysicallyConsistent(costs=False)):
        estimate = estimator(Problem(model, (motion,), regression))
        assert estimate.determined.rank == structural.rank
        basis = base_parameters(estimate.determined.directions, model.parameters)
        std = base_std(basis, regression.triangular_factors, estimate.residual.sigma, estimate.residual.weights)
        free = estimate.consistency.unconstrained if estimate.consistency else None
        theta = estimate.value if free is None else free
        error = np.abs(basis.to_base(theta) - basis.to_base(weightless)) / std
        assert error.max() < 4
        assert (error < 1.96).mean() > 0.85


def test_a_tilt_that_no_printed_right_angle_is_stays() -> None:
    """0.02 rad, and 1.55: both are angles of their own, and add to what acts on the torque."""
    text = arm("2R")
    tilted = text.replace(f'rpy="{HALF!r} 0.0 0.0"', 'rpy="3.12 0.02 0"')
    assert structural_base_parameters(driven(tilted)).rank > exact("2R")
    assert RigidBodies(tilted).file.notes == ()


def test_a_rounded_angle_is_noted_and_written_as_it_was_read() -> None:
    model = driven(arm("2R", 4))
    bodies = model.terms[0]
    assert isinstance(bodies, RigidBodies)
    (note,) = (note for note in bodies.notes if "rounded" in note)
    assert "3.1416 of 'j2' as 3.141592654" in note
    made = export(IdentifiedModel(model, model.values), Urdf(), random_states(2, np.random.default_rng(0)))
    assert made.ready, made.refusal
    assert repr(np.pi) in made.written.text
    assert "3.1416 " not in made.written.text


def test_angles_of_an_mjcf_too() -> None:
    xml = """<mujoco><compiler angle="radian"/><worldbody>
    <body name="a"><inertial pos="0.1 0 0" mass="1" diaginertia="0.01 0.02 0.02"/><joint name="one"/>
    <body name="b" pos="0.4 0 0" euler="3.1416 0 0"><inertial pos="0.1 0 0" mass="1" diaginertia="0.01 0.02 0.02"/>
    <joint name="two"/><body name="c" pos="0.2 0 0" axisangle="1 0 0 1.571">
    <inertial pos="0.1 0 0" mass="1" diaginertia="0.01 0.02 0.02"/><joint name="three"/></body></body></body>
    </worldbody></mujoco>"""
    rounded, exact = RigidBodies(xml), RigidBodies(xml.replace("3.1416", repr(HALF)).replace("1.571", repr(RIGHT)))
    for first, second in zip(rounded.arm.bodies, exact.arm.bodies, strict=True):
        np.testing.assert_array_equal(first.placement, second.placement)
    assert any("3.1416 of 'b'" in note and "1.571 of 'c'" in note for note in rounded.notes)
    model = Model((rounded,))
    made = export(IdentifiedModel(model, model.values), Mjcf(), random_states(3, np.random.default_rng(0)))
    assert made.ready, made.refusal
    assert f'euler="{HALF!r} 0 0"' in made.written.text
    assert f'axisangle="1 0 0 {RIGHT!r}"' in made.written.text


def test_intervals_of_the_consistent_fit_hold_on_an_arm_without_a_spherical_wrist() -> None:
    """95 % intervals, from a robot file with other bodies than the true ones, over several recordings."""
    true = driven(arm("bent", 4))
    model = driven(arm("bent", 4, seed=8), nominal=False)
    motion = moved(true, np.arange(2000) * 0.01)
    recipe = Recipe(estimator=PhysicallyConsistent(costs=False), outliers="keep")
    inside, total, worst = 0, 0, 0.0
    for seed in range(4):
        result = identify(model, [recorded(motion, seed)], recipe=recipe)
        basis, std = result.base.on_data, result.errors.base_std
        assert (result.estimate.determined.rank, basis.rank, result.base.structural.rank) == (exact("bent"),) * 3
        error = np.abs(basis.to_base(result.estimate.value) - basis.to_base(true.values)) / std
        inside, total, worst = inside + int((error < 1.96).sum()), total + len(error), max(worst, error.max())
    assert worst < 4.5
    # the errors of one recording are correlated, so that they count as a third of their number
    assert inside / total > binom.ppf(0.005, total // 3, 0.95) / (total // 3)


def test_intervals_hold_where_the_true_bodies_break_physics_and_a_note_says_what_is_held() -> None:
    """Principal moments such as vendors print, of which one exceeds the sum of the others: no consistent fit is right.

    Without counting what the constraints move, base parameters are off by many standard errors of least squares.
    """
    true = driven(arm("bent", moments=(1.0, 0.2, 0.1)))
    model = driven(arm("bent", seed=8), nominal=False)
    motion = moved(true, np.arange(2000) * 0.01)

    class Exact(Smoother):
        """The motion is known exactly, so that nothing else can bias the fit."""

        def __call__(self, log: Log) -> Motion:
            return replace(motion, tau=log.tau)

    recipe = Recipe(Exact(), PhysicallyConsistent(costs=False), outliers="keep")
    for seed in range(2):
        result = identify(model, [recorded(motion, seed, 0.0, share=0.004)], recipe=recipe)
        basis, estimate, errors = result.base.on_data, result.estimate, result.errors
        free = estimate.consistency.unconstrained
        error = np.abs(basis.to_base(estimate.value) - basis.to_base(true.values))
        held = np.abs(basis.to_base(estimate.value - free))
        least_squares = np.sqrt(errors.base_std_independent**2 - held**2)
        assert (error / least_squares).max() > 8
        for std in (errors.base_std_independent, errors.base_std):
            assert (error / std).max() < 4
            assert (error < 1.96 * std).mean() > 0.85
        (note,) = (note for note in result.warnings if isinstance(note, HeldByConstraints))
        place = {name: k for k, name in enumerate(basis.groupings)}
        assert place[note.moved[0][0]] == np.argmax(held / least_squares)
        assert all(held[place[name]] > 2.5 * least_squares[place[name]] for name, _ in note.moved)
