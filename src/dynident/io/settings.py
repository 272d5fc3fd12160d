"""The settings of an identification, as frozen values; what they mean is said by the parts they set up."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Literal, Self

from pydantic import Field, StrictBool, model_validator

from dynident.errors import ConfigError, choices
from dynident.io.fields import (
    UNITS,
    Count,
    CountOrEach,
    Files,
    Gain,
    Name,
    NonNegative,
    Number,
    Positive,
    PositiveOrEach,
    Section,
    Windows,
    unit_factor,
)
from dynident.terms.term import Joint

__all__ = [
    "ButterworthSettings",
    "CascadeJoint",
    "CascadeSettings",
    "Channel",
    "Config",
    "ConsistentSettings",
    "CouplingSettings",
    "DifferenceSettings",
    "LeastSquaresSettings",
    "LogSpec",
    "MaximumLikelihoodSettings",
    "ParallelSettings",
    "PositionChannel",
    "RobotSettings",
    "SplineSettings",
    "Time",
    "TorqueInputSettings",
    "check_joints",
]

POSITIONS = {"revolute": "angle", "prismatic": "length"}
TORQUES = {"revolute": "torque", "prismatic": "force"}


class Time(Section):
    """Time stamps: a column and its unit, or the sampling rate (Hz) of a file without such a column."""

    column: Name | None = None
    unit: str = "s"
    rate: Positive | None = None

    @model_validator(mode="after")
    def _one(self) -> Self:
        if (self.column is None) == (self.rate is None):
            raise ValueError("needs either `column` (with its `unit`) or `rate` (Hz)")
        if self.column is not None and "unit" not in self.model_fields_set:
            raise ValueError("needs the `unit` of its column: " + ", ".join(UNITS["time"]))
        return self


class Channel(Section):
    """A signal in ``unit``: gain * (column, or the sum of columns times their coefficients) + offset."""

    column: Name | None = None
    sum: dict[Name, Gain] | None = Field(None, min_length=1)
    gain: Gain = 1.0
    offset: Gain = 0.0
    unit: str

    @model_validator(mode="after")
    def _one(self) -> Self:
        if (self.column is None) == (self.sum is None):
            raise ValueError("needs either `column` or `sum` (a mapping of columns to coefficients)")
        return self

    @property
    def terms(self) -> Mapping[str, float | str]:
        """Coefficients by column."""
        return {self.column: 1.0} if self.column is not None else self.sum or {}


class PositionChannel(Channel):
    """A position; ``multi_turn`` says that a revolute joint may turn without end."""

    multi_turn: StrictBool = False


class LogSpec(Section):
    """One recording: its file (or files, whose columns are then named ``key.column``) and the parts to use.

    ``width`` is the number of columns of a text file with one number a line. ``window`` holds (start, stop) in s.
    """

    file: Files
    width: CountOrEach = None
    window: Windows = ()
    name: Name | None = None

    @model_validator(mode="after")
    def _widths(self) -> Self:
        for key in self.width if isinstance(self.width, Mapping) else ():
            if key not in self.file:
                raise ValueError(f"`width` names a file {key!r} that `file` lacks; {choices(key, self.file)}")
        return self

    @property
    def label(self) -> str:
        """The name of the log, by default the stem of its first file."""
        return self.name or next(iter(self.file.values())).stem


class CouplingSettings(Section):
    """A motor whose coordinate is a sum of joint coordinates times ``joints``, with its own rotor and friction."""

    joints: Mapping[Name, Number] = Field(min_length=1)
    terms: tuple[Literal["rotor", "viscous", "coulomb"], ...] = ("rotor", "viscous", "coulomb")


class RobotSettings(Section):
    """A model built from a robot file (URDF or MJCF): its rigid bodies, and per joint what else is identified.

    ``joints`` chooses and orders the moving joints (null: all, in the order of the file); ``lock`` holds positions
    (rad, m) of the others; ``lean`` is that of the base away from ``gravity`` (m/s^2); ``coulomb_width`` (rad/s, m/s)
    smooths the sign in the Coulomb friction.
    """

    file: Files
    joints: tuple[Name, ...] | None = None
    lock: Mapping[Name, Number] = {}
    gravity: tuple[Number, Number, Number] = (0.0, 0.0, -9.81)
    lean: Literal["none", "estimate"] = "none"
    terms: tuple[Literal["rotor", "viscous", "coulomb", "offset"], ...] = ("rotor", "viscous", "coulomb", "offset")
    coulomb_width: NonNegative = 0.0
    couplings: Mapping[Name, CouplingSettings] = {}


class SplineSettings(Section):
    """Smoothing spline: the rule that chooses how smooth, and what the rule needs.

    ``S`` null is the number of samples; ``sigma`` null is estimated from the data, else in SI, for all joints or
    by joint; ``ends`` is the number of bandwidths masked at each end.
    """

    kind: Literal["spline"] = "spline"
    rule: Literal["constraint", "torque", "gcv", "reml", "interpolate", "fixed"] = "constraint"
    S: NonNegative | None = None
    p: Positive | None = None
    lam: Positive | None = None
    sigma: PositiveOrEach = None
    ends: NonNegative = 6.0

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        given = [name for name in ("p", "lam") if getattr(self, name) is not None]
        if self.rule == "fixed" and len(given) != 1:
            raise ValueError("`rule: fixed` needs either `p` or `lam`")
        if self.rule != "fixed" and given:
            raise ValueError(f"`{given[0]}` is only used by `rule: fixed`, not by `rule: {self.rule}`")
        if self.rule != "constraint" and self.S is not None:
            raise ValueError(f"`S` is only used by `rule: constraint`, not by `rule: {self.rule}`")
        return self


class DifferenceSettings(Section):
    """Finite differences, without smoothing."""

    kind: Literal["difference"] = "difference"
    scheme: Literal["forward", "central"] = "forward"


class ButterworthSettings(Section):
    """Zero-phase low-pass of q, dq and ddq: ``orders``, ``cutoffs`` (Hz), and the ``settle`` (s) masked at the ends.

    The defaults are the article's (eq. 53).
    """

    kind: Literal["butterworth"] = "butterworth"
    orders: tuple[Count, Count, Count] = (3, 3, 4)
    cutoffs: tuple[Positive, Positive, Positive] = (10.0, 3.0, 2.0)
    settle: tuple[NonNegative, NonNegative] | None = None


class LeastSquaresSettings(Section):
    """Ordinary least squares; singular values below ``tolerance`` times the largest count as zero."""

    kind: Literal["least_squares"] = "least_squares"
    tolerance: Annotated[Positive, Field(lt=1)] | None = None
    weights: Literal["equal", "per_joint"] = "equal"


class ConsistentSettings(Section):
    """Least squares over what physics allows; the keys are those of ``dynident.estimators.Consistent``."""

    kind: Literal["consistent"]
    inertia: StrictBool = True
    viscous: StrictBool = True
    coulomb: StrictBool = True
    rotor: StrictBool = True
    total_mass: Positive | tuple[Positive | None, Positive | None] | None = None
    bounds: Mapping[Name, tuple[Number | None, Number | None]] = {}
    centre_of_mass: Mapping[Name, tuple[tuple[Number, Number, Number], tuple[Number, Number, Number]]] = {}
    prior: Literal["nominal", "none"] | Mapping[Name, Number] = "nominal"
    distance: Literal["entropic", "euclidean"] = "entropic"
    threshold: Annotated[Positive, Field(lt=1)] | None = None
    weights: Literal["equal", "per_joint"] = "per_joint"


class MaximumLikelihoodSettings(Section):
    """Errors in positions and torques alike; the keys are those of ``dynident.estimators.MaximumLikelihood``."""

    kind: Literal["maximum_likelihood"]
    start: Literal["free", "rest", "test"] = "free"
    spacing: Positive | None = None
    steps: StrictBool | None = None
    huber: Positive | None = None
    profile: Positive | None = 0.4


class ParallelSettings(Section):
    """Low-pass (``cutoff`` Hz, ``order``) and decimation, alike for the torque and all columns of the regressor."""

    decimate: Count = 1
    cutoff: Positive | None = None
    order: Count = 4


class CascadeJoint(Section):
    """The drive of one joint: input = kv (kp (reference - q) - dq) + feedforward, within +-saturation, times gain.

    ``feedforward`` is a column, in units of the input, or by the name of a recording the column of those that have one.
    """

    reference: Channel
    kp: Gain
    kv: Gain
    gain: Gain = 1.0
    saturation: Gain | None = None
    feedforward: Name | Mapping[Name, Name] | None = None


class CascadeSettings(Section):
    """Free simulation in the loop of the drives' own controllers, by joint."""

    kind: Literal["cascade"]
    joints: Mapping[Name, CascadeJoint] = Field(min_length=1)


class TorqueInputSettings(Section):
    """Free simulation driven by the measured torque, started again each ``restart`` s from the measured state."""

    kind: Literal["measured_torque"]
    restart: Positive = 0.5


Estimator = Annotated[
    LeastSquaresSettings | ConsistentSettings | MaximumLikelihoodSettings, Field(discriminator="kind")
]
Smoother = Annotated[SplineSettings | DifferenceSettings | ButterworthSettings, Field(discriminator="kind")]
Simulation = Annotated[CascadeSettings | TorqueInputSettings, Field(discriminator="kind")]


class Config(Section):
    """All settings of one identification; channels by the names of the model's joints.

    With ``transmission`` the channels are those of the motors: it gives for each motor, named like its joint, the
    coefficients of the joints in its position (gear ratios and couplings). ``zero`` (rad, m) is added to positions.
    """

    model: Name | RobotSettings
    time: Time
    position: Mapping[Name, PositionChannel]
    torque: Mapping[Name, Channel]
    transmission: Mapping[Name, Mapping[Name, Number]] = {}
    zero: Mapping[Name, Number] = {}
    train: tuple[LogSpec, ...] = Field(min_length=1)
    validation: tuple[LogSpec, ...] = ()
    gaps: Literal["error", "split"] = "error"
    smoother: Smoother = SplineSettings(rule="torque")
    estimator: Estimator = LeastSquaresSettings()
    parallel: ParallelSettings | None = None
    slow: PositiveOrEach = None
    delay: Number | Literal["estimate"] = "estimate"
    simulation: Simulation | None = None


def check_joints(config: Config, joints: Sequence[Joint]) -> None:
    """Check the channels against the model's joints, by name, and their units against the joints' kinds.

    Raises ConfigError for a joint without a position or torque, an unknown joint, or a unit that does not fit.
    """
    for section, channels, units in (
        ("position", config.position, POSITIONS),
        ("torque", config.torque, TORQUES),
    ):
        _same_names(section, channels, joints)
        for joint in joints:
            unit_factor(channels[joint.name].unit, units[joint.kind], f"{section}.{joint.name}.unit")
    if config.time.column is not None:
        unit_factor(config.time.unit, "time", "time.unit")
    if isinstance(config.smoother, SplineSettings) and isinstance(config.smoother.sigma, Mapping):
        _same_names("smoother.sigma", config.smoother.sigma, joints)
    _known_names("zero", config.zero, joints)
    if isinstance(config.slow, Mapping):
        _known_names("slow", config.slow, joints)
    if isinstance(config.simulation, CascadeSettings):
        _check_cascade(config, config.simulation, joints)
    _known_names("transmission", config.transmission, joints)
    for name, row in config.transmission.items():
        _known_names(f"transmission.{name}", row, joints)
    for joint in joints:
        if joint.kind == "prismatic" and config.position[joint.name].multi_turn:
            raise ConfigError(f"position.{joint.name}.multi_turn: joint {joint.name!r} slides; leave the key out.")


def _check_cascade(config: Config, cascade: CascadeSettings, joints: Sequence[Joint]) -> None:
    _same_names("simulation.joints", cascade.joints, joints)
    if config.transmission:
        raise ConfigError(
            "simulation: a controller of motors behind a transmission cannot be simulated; use `kind: measured_torque`."
        )
    labels = [spec.label for spec in (*config.train, *config.validation)]
    for joint in joints:
        one, where = cascade.joints[joint.name], f"simulation.joints.{joint.name}"
        unit_factor(one.reference.unit, POSITIONS[joint.kind], f"{where}.reference.unit")
        for name in one.feedforward if isinstance(one.feedforward, Mapping) else ():
            if name not in labels:
                raise ConfigError(f"{where}.feedforward: there is no recording {name!r}; {choices(name, labels)}")


def _known_names(section: str, given: Mapping[str, object], joints: Sequence[Joint]) -> None:
    names = [joint.name for joint in joints]
    for name in given:
        if name not in names:
            raise ConfigError(f"{section}.{name}: the model has no joint {name!r}; {choices(name, names)}")


def _same_names(section: str, given: Mapping[str, object], joints: Sequence[Joint]) -> None:
    _known_names(section, given, joints)
    for name in (joint.name for joint in joints):
        if name not in given:
            raise ConfigError(
                f"{section}: joint {name!r} of the model is missing; add a line `{name}: ...` like that of the others."
            )
