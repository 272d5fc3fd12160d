"""Stand-ins for the nouns that a report receives, with every kind of value that must be shown."""

from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np
import pytest

from dynident.estimators import DataRank, Residual
from dynident.estimators.notes import NotAlone
from dynident.identification import Calibration, Identifiability, Identification, Recipe, Sources, StandardErrors
from dynident.models import Joint, MassMatrixCheck, Parameter
from dynident.models.robot_files import RobotJointLimits
from dynident.models.structure import Structure
from dynident.motion.log import Motion
from dynident.motion.smoothers import Spline
from dynident.report.identification import identification_page
from dynident.runtime import KeepsFacts, Remark
from dynident.validation import FloorOrigin, NoiseFloor, TorqueErrors, residual_test

PARAMETERS = (
    Parameter("theta1", "kg m^2", "m1 lc1^2 + I1 + m2 l1^2", 0.0340),
    Parameter("theta2", "kg m^2", "m2 lc2^2 + I2", 0.0030),
    Parameter("theta3", "kg m^2", "m2 l1 lc2", 0.0045),
    Parameter("theta4", "kg m", "m1 lc1 + m2 l1", 0.1329),
    Parameter("theta5", "kg m", "m2 lc2", 0.0170),
    Parameter("theta6", "N m s/rad", "mu1", 0.6189),
    Parameter("theta7", "N m s/rad", "mu2", 0.6189),
)
TRUE = np.array([parameter.value for parameter in PARAMETERS])


class Fake(KeepsFacts, SimpleNamespace):
    """An identification that is told from others by identity, as a real one."""

    __hash__ = object.__hash__
    of_role, training_motions = Identification.of_role, Identification.training_motions
    verdict = Identification.verdict


@dataclass(frozen=True)
class Case:
    sigma_q2: float
    method: str
    estimates: np.ndarray
    failed: int = 0
    published_mean: tuple | None = None
    published_variance: tuple | None = None
    coverage: np.ndarray = field(default_factory=lambda: np.full(7, np.nan))
    unsettled: int = 0

    @property
    def mean(self):
        return self.estimates.mean(axis=0) if len(self.estimates) else np.full(7, np.nan)

    @property
    def variance(self):
        return self.estimates.var(axis=0, ddof=1) if len(self.estimates) else np.full(7, np.nan)


@dataclass(frozen=True)
class Reproduction:
    cases: tuple
    traces: dict = field(default_factory=dict)
    scenario: str = "tabulated"
    description: str = "The torque amplitudes that fit the article's tables."
    runs: int = 12
    seed: int = 1
    seconds: float = 21.5
    names: tuple = tuple(parameter.name for parameter in PARAMETERS)
    expressions: tuple = tuple(parameter.expression for parameter in PARAMETERS)
    true: np.ndarray = field(default_factory=lambda: TRUE)
    bounds: dict = field(default_factory=dict)
    settings: dict = field(default_factory=lambda: {"torque amplitudes": "1.13, 0.78 N m", "duration": "10 s"})


class ModelOfOnes(SimpleNamespace):
    """A model each entry of whose regressor is one."""

    @property
    def structure(self):
        p = len(self.parameters)
        return Structure((np.arange(p),) * len(self.joints), (np.eye(p),) * len(self.joints))

    def entries(self, q, joint, **_):
        return np.ones((len(joint), len(q)))

    def regressor(self, q, *_, **__):
        return np.ones((*q.shape, len(self.parameters)))

    def torque(self, q, theta, **_):
        return np.full(q.shape, np.sum(theta))


class ChangeableErrors(SimpleNamespace):
    """Torque errors that a test may change."""

    in_fit, joints_in_fit = TorqueErrors.in_fit, TorqueErrors.joints_in_fit


def motion(joints=("joint1", "joint2"), start=0.25, noise=0.0, n=1200, smoothing=None, source="run.csv"):
    """Two sines in time with their derivatives; the mask begins at ``start`` and has a hole near 6 s."""
    t = np.linspace(0.0, 10.0, n)
    rng = np.random.default_rng(7)
    phase = np.arange(1, len(joints) + 1)
    angle = np.outer(t, np.ones(len(joints))) + phase
    ddq = -np.sin(angle) + noise * rng.standard_normal(angle.shape) + 30 * np.exp(-np.outer(t, 3.0 * phase))
    tau = 0.6 * np.cos(angle) + 0.01 * rng.standard_normal(angle.shape)
    mask = (t >= start) & ~((t > 6.0) & (t < 6.2))
    return Motion(t, np.sin(angle), np.cos(angle), ddq, tau, joints, mask, source, smoothing or {})


def cases(runs=12):
    rng = np.random.default_rng(3)
    bias = {"raw": (0.02, 0.1, -0.1, 0.95, 1.05, 0.7, 0.8), "filtered": (0.97,) * 7, "spline": (1.08, 0.8, *(1.0,) * 5)}
    for level, spread in ((1e-8, 0.003), (1e-6, 0.02), (1e-4, 0.4)):
        for method, factor in bias.items():
            noise = 1 + spread * rng.standard_normal((runs, 7)) * (0.05 if method == "raw" else 1)
            means = tuple(np.round(TRUE * factor, 4)[:6]) + ((None,) if method == "raw" else (0.6191,))
            yield Case(level, method, TRUE * factor * noise, 0, means, (None, *(1.23e-7,) * 6))


@pytest.fixture
def reproduction():
    traces = {"simulated": motion(start=0.0), "spline": motion(noise=0.05), "filtered": motion(start=1.75)}
    return Reproduction(tuple(cases()), traces)


def log_validation(name, role, joints, filtered):
    smoothing = {"method": "spline", "sigma": np.full(len(joints), 1e-3), "S": [1200.0] * len(joints), "note": "S = n"}
    held = motion(joints, n=300, smoothing=smoothing, source=name)
    rng = np.random.default_rng(5)
    return SimpleNamespace(
        signals="as they were",
        name=name,
        role=role,
        motion=held,
        predicted_torque=held.tau + 0.02 * rng.standard_normal(held.tau.shape),
        recorded_log=None,
        free_run=None,
        floors={joint: NoiseFloor(0.01, 2.0, 2.1, FloorOrigin.WHITE) for joint in joints},
        over_floor=2.0,
        at_floor=False,
        errors=ChangeableErrors(
            samples=int(held.mask.sum()),
            relative_error=4.2 if role == "train" else 5.1,
            relative_error_filtered=filtered,
            rmse=dict.fromkeys(joints, 0.02),
            per_joint={joint: 3.5 + j for j, joint in enumerate(joints)},
            per_joint_filtered={},
            effort_share={joints[0]: 0.4},
            r2=dict.fromkeys(joints, 0.99),
            sensor_noise=dict.fromkeys(joints, 0.01),
            over_noise=dict.fromkeys(joints, 2.0),
            all_over_noise=2.0,
        ),
        residuals={
            joint: residual_test(0.02 * rng.standard_normal(len(held)), held.dq[:, j], 0.01)
            for j, joint in enumerate(joints)
        },
    )


WARNINGS = (Remark("elbow hardly moves"),)


def identification_of(joints=("shoulder", "elbow"), logs=("swing.csv", "reach.csv"), warnings=WARNINGS):
    std = np.array([4e-4, 3e-4, np.inf, 2e-4, 1e-4, 9e-4, 8e-4])
    estimate = SimpleNamespace(
        information=None,
        value=TRUE * (1, 1.1, 1.3, 1, 1, 1, 1),
        std=std,
        names=tuple(parameter.name for parameter in PARAMETERS),
        units=tuple(parameter.unit for parameter in PARAMETERS),
        notes=(NotAlone(("theta3",)),),
        determined=DataRank(6, 143.7),
        residual=Residual(np.full(len(joints), 0.0101), 2000),
        provenance=(),
        consistency=None,
    )
    model = ModelOfOnes(
        name="two-link arm", joints=tuple(map(Joint, joints)), parameters=PARAMETERS, terms=(), limits={}, memory=0
    )
    model.limits[joints[0]] = RobotJointLimits(5.0, 2.0, -1.5, 1.5)
    return Fake(
        model=model,
        estimate=estimate,
        recipe=Recipe(Spline()),
        errors=StandardErrors(std, std),
        base=Identifiability(),
        validations=tuple(
            log_validation(name, "train" if i == 0 else "validation", joints, 1.1 if i == 0 else None)
            for i, name in enumerate(logs)
        ),
        notes=warnings,
        findings=(),
        mass=MassMatrixCheck(0.5, np.array([0.0, 1.0]), True),
        runs=(),
        calibration=Calibration(),
        provenance=Sources(versions={"dynident": "0.1.0", "numpy": "2.0"}),
        pieces=None,
    )


@pytest.fixture
def identification():
    return identification_of()


@pytest.fixture(scope="session")
def page():
    """The page of an identification that no test has changed."""
    return identification_page(identification_of())
