"""Torque errors of an estimate on a log, always also against the unfiltered measurement."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynident.errors import InputError, brief, listed
from dynident.log import Log, Motion, subsample
from dynident.models import MassMatrixCheck, Model
from dynident.regression import BLOCK, ParallelFilter, fitted_rows, stretches
from dynident.validation.free_run import FreeRun
from dynident.validation.noise_floor import NoiseFloor
from dynident.validation.residuals import ResidualTest, residual_test
from dynident.validation.sensor_noise import sensor_noise

if TYPE_CHECKING:
    import polars as pl

__all__ = [
    "SEED",
    "LogValidation",
    "Signals",
    "TorqueErrors",
    "check_mass",
    "relative_error",
    "relative_errors",
    "validate",
]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Role = Literal["train", "validation"]
SEED = 0  # of the random poses, where the caller brings no generator


@dataclass(frozen=True, eq=False)
class TorqueErrors:
    """Errors of predicted torques over ``samples``, those that the motion's mask keeps.

    ``relative_error`` (%) = 100 |tau - predicted| / |tau| over all joints, against the unfiltered measured torque at
    the log's own rate; ``relative_error_filtered`` the same after the parallel filter and decimation, over the rows
    that the fit uses (None where no filter is configured); ``rmse`` (N m or N) and ``per_joint`` (%) by joint name,
    unfiltered.

    A joint whose torque never changes, and of which the motion keeps none, was not recorded: it has no errors (nan),
    and no part in that of all joints.

    By joint name too: ``per_joint_filtered`` (%; empty without a filter); ``effort_share``, the rmse in % of the effort
    limit of the robot file (of joints that have one); ``r2`` = 1 - variance of the residual / variance of the torque,
    which counts no constant part; ``sensor_noise``, the rmse that white noise of the sensors alone leaves (see
    ``dynident.validation.sensor_noise``; without the joints where it is not known).
    """

    samples: int
    relative_error: float
    relative_error_filtered: float | None
    rmse: Mapping[str, float]
    per_joint: Mapping[str, float]
    per_joint_filtered: Mapping[str, float] = field(default_factory=dict)
    effort_share: Mapping[str, float] = field(default_factory=dict)
    r2: Mapping[str, float] = field(default_factory=dict)
    sensor_noise: Mapping[str, float] = field(default_factory=dict)

    __repr__ = brief

    @property
    def over_noise(self) -> Mapping[str, float]:
        """By joint, how many times what the sensors allow the unfiltered error is, where that is known."""
        return {joint: self.rmse[joint] / size for joint, size in self.sensor_noise.items() if joint in self.rmse}

    @property
    def all_over_noise(self) -> float | None:
        """The same of all joints together for which it is known; None where it is of none."""
        squares = [[sizes[joint] ** 2 for joint in self.over_noise] for sizes in (self.rmse, self.sensor_noise)]
        return float(np.sqrt(sum(squares[0]) / sum(squares[1]))) if self.over_noise else None


@dataclass(frozen=True, eq=False)
class Signals:
    """What a validation rests on: the smoothed ``motion``, the ``predicted`` torque (N, n), and the ``recorded`` log
    before smoothing where it is known.
    """

    motion: Motion
    predicted: Array
    recorded: Log | None = None

    __repr__ = brief


@dataclass(frozen=True, eq=False)
class LogValidation:
    """How well a model does on one log: torque ``errors``, and by joint name what the unfiltered residual looks like.

    ``floors`` tell by joint what the sensors allow of the residual, where it is known (``with_floors``).
    ``free_run`` is the free simulation, where there is one. ``signals`` are None in a result that was loaded from a
    file, which holds numbers only; ``motion``, ``predicted`` and ``recorded`` then raise InputError.
    """

    name: str
    role: Role
    errors: TorqueErrors
    residuals: Mapping[str, ResidualTest] = field(default_factory=dict)
    free_run: FreeRun | None = None
    signals: Signals | None = None
    floors: Mapping[str, NoiseFloor] = field(default_factory=dict)

    @property
    def over_floor(self) -> float | None:
        """How many times what the sensors allow the error of all joints is for which that is known; None of none."""
        known = [(self.errors.rmse[joint], floor.size) for joint, floor in self.floors.items()]
        return float(np.sqrt(sum(a**2 for a, _ in known) / sum(b**2 for _, b in known))) if known else None

    @property
    def at_floor(self) -> bool:
        """Whether the residual of each joint that was recorded is at the noise floor."""
        joints = [joint for joint, size in self.errors.rmse.items() if np.isfinite(size)]
        return bool(joints) and all(joint in self.floors and self.floors[joint].reached for joint in joints)

    def __repr__(self) -> str:
        joints = listed((f"{joint} {error:.3g} %" for joint, error in self.errors.per_joint.items()), 6)
        return f"<LogValidation {self.name!r} ({self.role}): torque error {self.errors.relative_error:.3g} %; {joints}>"

    def frame(self) -> pl.DataFrame:
        """Return a table of the errors, one row per joint: joint, rmse (N m, N), relative_error (%),
        relative_error_filtered (%), effort_share (%), r2, over_noise; null where there is no such figure.
        """
        import polars as pl

        errors = self.errors
        columns = {
            "rmse": errors.rmse,
            "relative_error": errors.per_joint,
            "relative_error_filtered": errors.per_joint_filtered,
            "effort_share": errors.effort_share,
            "r2": errors.r2,
            "over_noise": errors.over_noise,
        }
        joints = list(errors.rmse)
        floats = {
            name: pl.Series([one.get(joint) for joint in joints], dtype=pl.Float64) for name, one in columns.items()
        }
        return pl.DataFrame({"joint": joints, **floats})

    @property
    def motion(self) -> Motion:
        """The smoothed motion."""
        return self._signals().motion

    @property
    def predicted(self) -> Array:
        """The predicted torque (N, n), N m or N."""
        return self._signals().predicted

    @property
    def recorded(self) -> Log | None:
        """The log before smoothing, where it is known."""
        return self._signals().recorded

    def _signals(self) -> Signals:
        if self.signals is None:
            raise InputError(
                f"{self.name}: a saved result holds the errors on this log but not its signals; predict the log again, "
                "or identify again."
            )
        return self.signals


def relative_error(measured: Array, predicted: Array) -> float:
    """Return 100 |measured - predicted| / |measured| in percent (nan where the measurement is zero)."""
    size = float(np.linalg.norm(measured))
    return 100.0 * float(np.linalg.norm(measured - predicted)) / size if size > 0 else float("nan")


def validate(
    model: Model,
    theta: ArrayLike,
    motion: Motion,
    *,
    name: str | None = None,
    role: Role = "validation",
    parallel_filter: ParallelFilter | None = None,
    min_speed: tuple[float, ...] | None = None,
) -> LogValidation:
    """Predict the torque of a motion with the parameters theta (p) and compare it with the measured one.

    ``filter`` and ``min_speed`` are those of the fit; they only affect ``relative_error_filtered``. ``name``
    (default: the motion's source) and ``role`` label the result. Raises InputError where no sample is inside the
    motion's mask, and ModelError where a shape does not fit.

    >>> import numpy as np
    >>> import dynident as dy
    >>> from dynident.models.gallery import pendulum
    >>> arm, t, rng = pendulum(), np.arange(1001) * 0.01, np.random.default_rng(0)
    >>> motion = dy.simulate(arm, arm.values, lambda s: [np.sin(5 * s)], t)
    >>> log = dy.record(motion, sigma_q=1e-4, sigma_tau=0.01, rng=rng).log
    >>> print(f"{dy.validate(arm, arm.values, dy.Spline(sigma=1e-4)(log)).errors.relative_error:.1f} %")
    2.6 %
    """
    if not motion.mask.any():
        raise InputError(
            f"{motion.source}: no usable sample is left for validation; widen the window, exclude less, or smooth less."
        )
    motion, theta = model.remembering(motion), np.asarray(theta, dtype=float)
    parts = [slice(start, start + BLOCK) for start in range(0, len(motion), BLOCK)]
    predicted = np.concatenate([model.torque(**motion.states(s), theta=theta) for s in parts])
    measured, guess = motion.tau[motion.mask], predicted[motion.mask]
    known = _recorded(motion)
    overall, by_joint = relative_errors(motion, predicted)
    error = np.where(known, np.sqrt(np.mean((measured - guess) ** 2, axis=0)), np.nan)
    filtered = None if parallel_filter is None else _filtered(motion, predicted, parallel_filter, min_speed)
    rmse = dict(zip(motion.joints, map(float, error), strict=True))
    return LogValidation(
        name=name or motion.source,
        role=role,
        errors=TorqueErrors(
            samples=len(measured),
            relative_error=overall,
            relative_error_filtered=(
                None if filtered is None else relative_error(*(one[:, known] for one in filtered))
            ),
            rmse=rmse,
            per_joint=by_joint,
            per_joint_filtered={} if filtered is None else _by_joint(motion, *filtered, known),
            effort_share=_of_limits(model, rmse),
            r2={joint: _r2(measured[:, j], guess[:, j]) for j, joint in enumerate(motion.joints)},
            sensor_noise=sensor_noise(model, theta, motion),
        ),
        residuals={joint: test for joint, test in _residuals(motion, predicted).items() if np.isfinite(rmse[joint])},
        signals=Signals(motion, predicted),
    )


def relative_errors(motion: Motion, predicted: Array) -> tuple[float, dict[str, float]]:
    """Return the relative error (%) of a predicted torque (N, n) over the usable samples of a motion: of all joints
    that were recorded, and of each by name, nan of one that was not."""
    measured, guess, known = motion.tau[motion.mask], predicted[motion.mask], _recorded(motion)
    return relative_error(measured[:, known], guess[:, known]), _by_joint(motion, measured, guess, known)


def _of_limits(model: Model, rmse: dict[str, float]) -> dict[str, float]:
    """Return the errors in % of the effort limits, for joints whose limit is known."""
    limits = {joint: limit.effort for joint, limit in model.limits.items() if joint in rmse and limit.effort}
    return {joint: 100.0 * rmse[joint] / effort for joint, effort in limits.items()}


def _by_joint(motion: Motion, measured: Array, predicted: Array, known: Mask) -> dict[str, float]:
    return {
        joint: relative_error(measured[:, j], predicted[:, j]) if known[j] else float("nan")
        for j, joint in enumerate(motion.joints)
    }


def _recorded(motion: Motion) -> Mask:
    """Return the joints (n) whose torque changes, or is kept."""
    kept = True if motion.keep is None else motion.keep.any(axis=0)
    return np.asarray((np.ptp(motion.tau, axis=0) > 0) | kept)


def _r2(measured: Array, predicted: Array) -> float:
    total = float(np.var(measured))
    return 1.0 - float(np.var(measured - predicted)) / total if total > 0 else float("nan")


def _residuals(motion: Motion, predicted: Array) -> dict[str, ResidualTest]:
    """Test the residuals of the longest stretch without a gap."""
    part = max(stretches(motion.mask), key=lambda one: one.stop - one.start)
    residual, dq = (motion.tau - predicted)[part], motion.dq[part]
    step = float(np.diff(motion.t).mean())
    return {joint: residual_test(residual[:, j], dq[:, j], step) for j, joint in enumerate(motion.joints)}


def _filtered(
    motion: Motion, predicted: Array, parallel_filter: ParallelFilter, min_speed: tuple[float, ...] | None
) -> tuple[Array, Array]:
    """Filtering Y and multiplying by theta is filtering Y theta: the filter is linear."""
    sections = parallel_filter.sections(motion)
    pairs, keep = [], fitted_rows(motion, min_speed)
    for part in stretches(motion.mask):
        if part.stop - part.start > 1:
            both = np.stack((motion.tau[part], predicted[part]))
            kept = parallel_filter.apply(sections, both.swapaxes(0, 1))[:: parallel_filter.decimate]
            if keep is not None:  # rows that the fit leaves out count as zero on both sides
                kept = kept * keep[part][:: parallel_filter.decimate, None, :]
            pairs.append(kept)
    both = np.concatenate(pairs) if pairs else np.zeros((0, 2, predicted.shape[1]))
    return both[:, 0], both[:, 1]


def check_mass(
    model: Model, theta: ArrayLike, motions: Sequence[Motion], rng: np.random.Generator | None = None, poses: int = 1000
) -> MassMatrixCheck:
    """Check the mass matrix at up to 1000 poses of each motion and as many random ones within the joints' limits.

    A joint without limits is drawn from -pi to pi rad or from -1 to 1 m. ``rng`` draws the poses, by default the same
    ones each time. Raises the errors of the model.
    """
    rng = rng or np.random.default_rng(SEED)
    seen = [motion.q[subsample([motion], 1000)[0]] for motion in motions]
    sides = []
    for joint in model.joints:
        limit, reach = model.limits.get(joint.name), np.pi if joint.kind == "revolute" else 1.0
        known = limit is not None and limit.lower is not None and limit.upper is not None and limit.lower < limit.upper
        sides.append((limit.lower, limit.upper) if limit is not None and known else (-reach, reach))
    lower, upper = np.array(sides, dtype=float).T
    return model.check_mass_matrix(np.concatenate([*seen, rng.uniform(lower, upper, (poses, len(lower)))]), theta)
