"""Torque errors of an estimate on a log, always also against the unfiltered measurement."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynident.models import MassMatrixCheck, Model
from dynident.motion.log import Log, Motion, subsample
from dynident.motion.splines import steady_noise, stretches
from dynident.regression import BLOCK, EVERYTHING, Selection, fitted_rows
from dynident.runtime import OMITTED, InputError, Noun, join_names
from dynident.runtime.arrays import Array
from dynident.validation.free_run import FreeRun
from dynident.validation.noise_floor import NoiseFloor, causes_text
from dynident.validation.residuals import ResidualTest, residual_test

if TYPE_CHECKING:
    import polars as pl

# times the noise of all samples, that of every second: white noise has 1, after a first-order low-pass at 0.6 of half
# the sampling rate 2; the noise of all samples is then half of what it was
MAX_NOISE_RATIO = 2.0
TORQUE_STATES = 200  # at which the torque is differentiated
FREQUENCIES = 500  # frequencies


def sensor_noise(model: Model, theta: ArrayLike, motion: Motion) -> dict[str, float]:
    """Return by joint the rms torque error (N m, N) that white noise of its torque and of all positions causes.

    Noise that is not white does not count, nor does that of positions which no spline has smoothed. A joint is
    missing where the noise of its torque is not known, as its spectrum falls up to half the sampling rate: every
    second sample then shows far more noise than all do, and the torque was filtered before it was recorded, or
    has no noise.
    """
    tau = motion.tau[motion.mask]
    if len(tau) < 20:
        return {}
    every_sample, every_second = (_torque_noise(tau, step) for step in (1, 2))
    # coloured noise shows less in neighbouring samples than in every second one
    is_white = (every_sample > 0) & (every_second < MAX_NOISE_RATIO * every_sample)
    if not is_white.any():
        return {}
    size = np.hypot(every_sample, _torque_of_position_noise(model, np.asarray(theta, dtype=float), motion))
    return {joint: float(error) for joint, error, white in zip(motion.joints, size, is_white, strict=True) if white}


def _torque_noise(tau: Array, step: int) -> Array:
    """Return the noise (n) of every ``step``-th sample, zero where it is rounding."""
    noise = np.sqrt(np.mean([steady_noise(tau[k::step], 1e-300) ** 2 for k in range(step)], axis=0))
    return np.asarray(np.where(noise > 1e-9 * np.abs(tau).max(axis=0), noise, 0.0))


def _torque_of_position_noise(model: Model, theta: Array, motion: Motion) -> Array:
    """Return the rms torque (n) that the noise of the positions makes in the smoothed motion.

    With the derivatives A, B, C of the torque by q, dq, ddq and noise sigma in steps of h, its variance is
    sum_k sigma_k^2 h / pi int ((A - C w^2)^2 + B^2 w^2) / (1 + (w b_k)^4)^2 dw, up to pi / h; of a process of order m
    the power is 2 m.
    """
    if not {"noise", "bandwidth"} <= motion.smoothing.keys():
        return np.zeros(len(motion.joints))
    sigma, width = (np.array(motion.smoothing[name], dtype=float) for name in ("noise", "bandwidth"))
    power = 2 * int(str(motion.smoothing.get("order", 2)))
    slopes = model.partials(**motion.states(subsample([motion], TORQUE_STATES)[0]), theta=theta)
    step = float(np.diff(motion.t).mean())
    moments = np.zeros((3, len(sigma)))
    for k in np.flatnonzero(np.isfinite(width) & np.isfinite(sigma)):  # a joint at rest is smoothed without limit
        # beyond four times the bandwidth nothing passes the smoother
        top = min(np.pi / step, 4.0 / max(width[k], 1e-300))
        w = (np.arange(FREQUENCIES) + 0.5) * top / FREQUENCIES
        gain = (1.0 + (w * width[k]) ** power) ** -2
        moments[:, k] = [sigma[k] ** 2 * step / np.pi * top / FREQUENCIES * (w**m * gain).sum() for m in (0, 2, 4)]
    A, B, C = slopes.q, slopes.dq, slopes.ddq
    variance = A**2 * moments[0] + (B**2 - 2.0 * A * C) * moments[1] + C**2 * moments[2]
    return np.asarray(np.sqrt(np.maximum(variance.sum(axis=2).mean(axis=0), 0.0)))


Mask = NDArray[np.bool_]
Role = Literal["train", "validation"]
SEED = 0  # of the random poses, where the caller brings no generator


class TorqueErrors(Noun):
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
    ``dynident.validation.prediction``; without the joints where it is not known).
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

    @property
    def in_fit(self) -> float:
        """The error (%) of all joints as the fit sees it: after its low-pass, where one is used."""
        return self.relative_error if self.relative_error_filtered is None else self.relative_error_filtered

    @property
    def joints_in_fit(self) -> Mapping[str, float]:
        """The same (%) by joint."""
        return self.per_joint_filtered or self.per_joint

    @property
    def over_noise(self) -> Mapping[str, float]:
        """By joint, the unfiltered error over what the sensors allow, where that is known."""
        return {joint: self.rmse[joint] / size for joint, size in self.sensor_noise.items() if joint in self.rmse}

    @property
    def all_over_noise(self) -> float | None:
        """The same for all joints together for which it is known; None where it is known for none."""
        squares = [[sizes[joint] ** 2 for joint in self.over_noise] for sizes in (self.rmse, self.sensor_noise)]
        return float(np.sqrt(sum(squares[0]) / sum(squares[1]))) if self.over_noise else None


class Signals(Noun):
    """What a validation rests on.

    The smoothed ``motion``, the ``predicted_torque`` (N, n), and the ``recorded_log`` before smoothing where it
    is known.
    """

    motion: Motion
    predicted_torque: Array
    recorded_log: Log | None = None


class LogValidation(Noun):
    """How well a model does on one log: torque ``errors``, and by joint name tests of the ``residuals``.

    ``floors`` tell by joint what the sensors allow of the residual, where it is known (``with_floors``).
    ``free_run`` is the free simulation, where there is one. ``signals`` are None in a result that was loaded from
    a file, which holds numbers only; ``motion``, ``predicted_torque`` and ``recorded_log`` then raise InputError.
    """

    name: str
    role: Role
    errors: TorqueErrors
    residuals: Mapping[str, ResidualTest] = field(default_factory=dict)
    free_run: FreeRun | None = None
    signals: Annotated[Signals | None, OMITTED] = None
    floors: Mapping[str, NoiseFloor] = field(default_factory=dict)

    @property
    def over_floor(self) -> float | None:
        """Error over what the sensors allow, for all joints for which that is known; None where it is known for
        none."""
        errors_and_floors = [(self.errors.rmse[joint], floor.size) for joint, floor in self.floors.items()]
        return (
            float(np.sqrt(sum(a**2 for a, _ in errors_and_floors) / sum(b**2 for _, b in errors_and_floors)))
            if errors_and_floors
            else None
        )

    @property
    def at_floor(self) -> bool:
        """Whether the residual of each recorded joint is at the noise floor."""
        joints = [joint for joint, size in self.errors.rmse.items() if np.isfinite(size)]
        return bool(joints) and all(joint in self.floors and self.floors[joint].is_reached for joint in joints)

    def __repr__(self) -> str:
        joints = join_names((f"{joint} {error:.3g} %" for joint, error in self.errors.per_joint.items()), 6)
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
            name: pl.Series([figures.get(joint) for joint in joints], dtype=pl.Float64)
            for name, figures in columns.items()
        }
        return pl.DataFrame({"joint": joints, **floats})

    @property
    def motion(self) -> Motion:
        """The smoothed motion."""
        return self._signals().motion

    @property
    def predicted_torque(self) -> Array:
        """The predicted torque (N, n), N m or N."""
        return self._signals().predicted_torque

    @property
    def recorded_log(self) -> Log | None:
        """The log before smoothing, where it is known."""
        return self._signals().recorded_log

    def _signals(self) -> Signals:
        if self.signals is None:
            raise InputError(
                f"{self.name}: a saved result holds the errors on this log but not its signals; predict the log again, "
                "or identify again."
            )
        return self.signals


def predict_torque(model: Model, motion: Motion, theta: Array) -> Array:
    """Return the torque (N, n) of a model with parameters theta (p) over a motion, with what it remembers there."""
    # in blocks of rows, as the kinematics of a long log at once would take too much memory
    parts = [slice(start, start + BLOCK) for start in range(0, len(motion), BLOCK)]
    return np.concatenate([model.torque(**motion.states(rows), theta=theta) for rows in parts])


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
    selection: Selection = EVERYTHING,
) -> LogValidation:
    """Predict the torque of a motion with the parameters theta (p) and compare it with the measured one.

    ``selection`` is that of the fit; it only affects ``relative_error_filtered``. ``name`` (default: the motion's
    source) and ``role`` label the result. Raises InputError where no sample is inside the motion's mask, and
    ModelError where a shape does not fit.

    >>> import numpy as np
    >>> import dynident as dy
    >>> from dynident.models.lagrangian import pendulum
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
    predicted = predict_torque(model, motion, theta)
    measured, predicted_used = motion.tau[motion.mask], predicted[motion.mask]
    is_recorded = _recorded_joints(motion)
    overall, by_joint = relative_errors(motion, predicted)
    error = np.where(is_recorded, np.sqrt(np.mean((measured - predicted_used) ** 2, axis=0)), np.nan)
    filtered = _filter_torques(motion, predicted, selection)
    rmse = dict(zip(motion.joints, map(float, error), strict=True))
    limits = {joint: limit.effort for joint, limit in model.limits.items() if joint in rmse and limit.effort}
    unexplained, total = np.var(measured - predicted_used, axis=0), np.var(measured, axis=0)
    r2 = 1.0 - np.divide(unexplained, total, out=np.full(len(total), np.nan), where=total > 0)
    return LogValidation(
        name=name or motion.source,
        role=role,
        errors=TorqueErrors(
            samples=len(measured),
            relative_error=overall,
            relative_error_filtered=(
                None if filtered is None else relative_error(*(channel[:, is_recorded] for channel in filtered))
            ),
            rmse=rmse,
            per_joint=by_joint,
            per_joint_filtered={} if filtered is None else _errors_by_joint(motion, *filtered, is_recorded),
            effort_share={joint: 100.0 * rmse[joint] / effort for joint, effort in limits.items()},
            r2=dict(zip(motion.joints, map(float, r2), strict=True)),
            sensor_noise=sensor_noise(model, theta, motion),
        ),
        residuals={
            joint: test for joint, test in _test_residuals(motion, predicted).items() if np.isfinite(rmse[joint])
        },
        signals=Signals(motion, predicted),
    )


def relative_errors(motion: Motion, predicted: Array) -> tuple[float, dict[str, float]]:
    """Return the relative error (%) of a predicted torque (N, n) over the usable samples of a motion.

    The first number is of all recorded joints, the mapping of each joint by name, nan for one that was not
    recorded.
    """
    measured, predicted_used, is_recorded = motion.tau[motion.mask], predicted[motion.mask], _recorded_joints(motion)
    return relative_error(measured[:, is_recorded], predicted_used[:, is_recorded]), _errors_by_joint(
        motion, measured, predicted_used, is_recorded
    )


def _errors_by_joint(motion: Motion, measured: Array, predicted: Array, is_recorded: Mask) -> dict[str, float]:
    return {
        joint: relative_error(measured[:, j], predicted[:, j]) if is_recorded[j] else float("nan")
        for j, joint in enumerate(motion.joints)
    }


def _recorded_joints(motion: Motion) -> Mask:
    """Return which joints (n) have a torque that changes, or is kept."""
    is_kept = True if motion.keep is None else motion.keep.any(axis=0)
    return np.asarray((np.ptp(motion.tau, axis=0) > 0) | is_kept)


def _test_residuals(motion: Motion, predicted: Array) -> dict[str, ResidualTest]:
    """Test the residuals of the longest stretch without a gap."""
    # autocorrelations need samples without a gap
    part = max(stretches(motion.mask), key=lambda stretch: stretch.stop - stretch.start)
    residual, dq = (motion.tau - predicted)[part], motion.dq[part]
    step = float(np.diff(motion.t).mean())
    return {joint: residual_test(residual[:, j], dq[:, j], step) for j, joint in enumerate(motion.joints)}


def _filter_torques(motion: Motion, predicted: Array, selection: Selection) -> tuple[Array, Array] | None:
    """Return the measured and the predicted torque after the parallel filter, None where there is none.

    Filtering Y and multiplying by theta is filtering Y theta: the filter is linear.
    """
    if (parallel_filter := selection.filter) is None:
        return None
    sections = parallel_filter.sections(motion)
    pairs, keep = [], fitted_rows(motion, selection.min_speed)
    for part in stretches(motion.mask):
        if part.stop - part.start > 1:
            # both torques go through the filter together, as its rows do in the fit
            torques = np.stack((motion.tau[part], predicted[part]))
            filtered = parallel_filter.apply(sections, torques.swapaxes(0, 1))[:: parallel_filter.decimate]
            if keep is not None:  # rows that the fit leaves out count as zero on both sides
                filtered = filtered * keep[part][:: parallel_filter.decimate, None, :]
            pairs.append(filtered)
    torques = np.concatenate(pairs) if pairs else np.zeros((0, 2, predicted.shape[1]))
    return torques[:, 0], torques[:, 1]


def check_mass(
    model: Model, theta: ArrayLike, motions: Sequence[Motion], rng: np.random.Generator | None = None, poses: int = 1000
) -> MassMatrixCheck:
    """Check the mass matrix at up to 1000 poses of each motion and as many random ones within the joints' limits.

    A joint without limits is drawn from -pi to pi rad or from -1 to 1 m. ``rng`` draws the poses, by default the same
    ones each time. Raises the errors of the model.
    """
    rng = rng or np.random.default_rng(SEED)
    poses_in_motion = [motion.q[subsample([motion], 1000)[0]] for motion in motions]
    sides = []
    for joint in model.joints:
        limit, reach = model.limits.get(joint.name), np.pi if joint.kind == "revolute" else 1.0
        has_limits = (
            limit is not None and limit.lower is not None and limit.upper is not None and limit.lower < limit.upper
        )
        sides.append((limit.lower, limit.upper) if limit is not None and has_limits else (-reach, reach))
    lower, upper = np.array(sides, dtype=float).T
    return model.check_mass_matrix(
        np.concatenate([*poses_in_motion, rng.uniform(lower, upper, (poses, len(lower)))]), theta
    )


def residual_text(log: LogValidation, joint: str) -> str:
    """Return what the residual of a joint points to: noise of the sensors alone, its likely causes, or nothing."""
    floor = log.floors.get(joint)
    return "at the noise floor" if floor and floor.is_reached else causes_text(log.residuals[joint].causes, floor)
