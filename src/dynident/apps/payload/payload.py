"""Identification of a payload from a result and recordings with it: parameters, errors and their sources."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np

from dynident.apps.payload.body import (
    Component,
    GainsUnknown,
    Mount,
    NoPayload,
    NotShown,
    OtherArm,
    PayloadOrDrift,
    PhysicalBody,
    Turning,
    best_turning,
    make_consistent,
    mount_of,
    physical_components,
    physical_jacobian,
    turnings,
)
from dynident.apps.payload.estimate import (
    ArmEvidence,
    DriveGains,
    ErrorSource,
    PayloadRequest,
    PayloadSolution,
    solve_payload,
)
from dynident.estimators import LeastSquares
from dynident.identification import Identification, Logs, identify, logs_by_name
from dynident.models import Model
from dynident.motion.log import stack_states
from dynident.regression import BaseParameters, structural_base_parameters
from dynident.runtime import InputError, Note, Noun, check_type, report_progress
from dynident.runtime.arrays import Array
from dynident.validation import LogValidation

# times the error of the training, and %: with more left, a recording is of another arm
MAX_ERROR_RATIO, MAX_ERROR = 5.0, 20.0
MAX_SHOWN_STD = (0.2, 0.03, 1.0)  # of mass, m, of mass (0.1 m)^2: a component with a larger standard error is not shown
MAX_MASS_DIFFERENCE = 0.1  # of a weighed mass: such a difference is no error of weighing
MIN_SIGNIFICANCE = 2.0  # standard errors; and of the misfit per degree of freedom
MIN_MASS_SIGNIFICANCE = 3.0  # standard errors of the mass, from which on there is a payload
MIN_NOTED_STD = (0.01, 0.003, 0.2)  # of mass, m, of mass (0.1 m)^2: an error by drift or gains that is worth a note
MAIN_SHARE = 0.5  # share of the variance
COMPONENT_KIND = np.array([0, 1, 1, 1, 2, 2, 2, 2, 2, 2])


@dataclass(frozen=True, eq=False)
class LoadedLog:
    """The residual torque of a recording (%): of the arm alone, with the payload, of a fit to this alone."""

    name: str
    without: float
    with_payload: float
    free: float


class Payload(Noun):
    """A payload in the frame of its ``mount``.

    ``value`` (10) are its parameters as in ``INERTIAL`` about the origin of the frame, physically consistent, ``free``
    (10) those without this constraint, with their ``covariance`` (10, 10); ``body`` is the same as mass, centre and
    inertia about it. ``shares`` says for each source of errors, which part (10) of the variances of the body it has.
    ``gains`` are those of the drives as far as they are known, ``drift`` and ``friction`` (p) how much the model's
    parameters have changed since the arm was identified, and by the load. ``factor``: by how much the standard errors
    were made larger, because more is left than they allow.
    """

    mount: Mount
    value: Array
    free: Array
    covariance: Array
    body: PhysicalBody
    shares: Mapping[ErrorSource, Array]
    gains: DriveGains
    drift: Array
    friction: Array
    request: PayloadRequest
    factor: float
    logs: tuple[LoadedLog, ...] = ()
    notes: tuple[Note, ...] = field(default=())

    @property
    def is_significant(self) -> bool:
        """Whether there is a payload; otherwise only its mass is known, to be about zero."""
        return bool(self.body.mass >= MIN_MASS_SIGNIFICANCE * self.body.std[0])


def find_payload(
    identification: Identification,
    loaded: Logs | Identification,
    unloaded: Logs | None = None,
    request: PayloadRequest | None = None,
) -> Payload:
    """Find what the arm of a result carries in recordings ``loaded``, or in a second result of the same arm.

    Recordings are identified by themselves with the recipe of the result, by least squares; ``unloaded`` are
    recordings without the payload, best of the same day: they tell drift from payload. ``solve_payload`` then
    solves for all unknowns together, and the payload is made physically consistent; what this moves a value by
    counts as its error.

    Raises InputError where the result is of an older version, the results are of different models, the payload is
    negative, or the recordings are of another arm; ModelError where there is no such frame; the errors of ``identify``.

    An arm of two joints picks up 1 kg:

    >>> import numpy as np
    >>> import dynident as dy
    >>> body = '<link name="{}"><inertial><origin xyz="0.2 0 0"/><mass value="2"/>'
    >>> body += '<inertia ixx="0.01" iyy="0.05" izz="0.05" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    >>> hinge = '<joint name="{}" type="continuous"><parent link="{}"/><child link="{}"/>'
    >>> hinge += '<origin xyz="{} 0 0"/><axis xyz="0 1 0"/></joint>'
    >>> text = '<robot name="arm"><link name="base"/>' + body.format("upper") + body.format("fore")
    >>> text += hinge.format("shoulder", "base", "upper", 0) + hinge.format("elbow", "upper", "fore", 0.4) + "</robot>"
    >>> bodies = dy.RigidBodies(text)
    >>> arm, rng = dy.Model((bodies, dy.Viscous(bodies.joints))), np.random.default_rng(0)
    >>> empty = np.array([*(parameter.value for parameter in bodies.parameters), 0.5, 0.3])
    >>> full = empty.copy()
    >>> full[[10, 11, 16, 19]] += 1.0, 0.3, 0.09, 0.09  # a point at 0.3 m of the fore arm
    >>> t = np.arange(2000) * 0.005
    >>> rate, phase = np.array([2.0, 3.1]), np.array([0.0, 1.0])
    >>> def recorded(theta):
    ...     q, dq, ddq = (rate**k * np.sin(np.outer(t, rate) + phase + k * np.pi / 2) for k in range(3))
    ...     tau = arm.torque(q, dq, ddq, theta) + 0.02 * rng.standard_normal(q.shape)
    ...     return dy.Log(t, q + 1e-5 * rng.standard_normal(q.shape), tau, ("shoulder", "elbow"))
    >>> found = dy.identify(arm, recorded(empty), estimator=dy.LeastSquares())
    >>> payload = find_payload(found, recorded(full))
    >>> f"{payload.body.values[0]:.1f} kg at {payload.body.values[1]:.1f} m"
    '1.0 kg at 0.3 m'
    """
    check_type("find_payload", identification, Identification, "give that of the arm, as `load` reads it from a file")
    request = request or PayloadRequest()
    mount = mount_of(identification.model, request.frame)
    if request.gains is not None:
        request = replace(request, gains=_match_gains(request.gains, identification.model))
    _check_distinct(identification, loaded, unloaded or {})
    loaded_result = loaded
    if not isinstance(loaded_result, Identification):
        loaded_result = _identify_recordings(identification, loaded_result, "with the payload")
    _check_same(identification, loaded_result)
    evidence = {
        ErrorSource.ARM: [ArmEvidence.of(identification)],
        ErrorSource.LOADED: [ArmEvidence.of(loaded_result, "the result with the payload")],
    }
    if unloaded:
        empty = _identify_recordings(identification, unloaded, "without the payload")
        evidence[ErrorSource.UNLOADED] = [ArmEvidence.of(empty)]
    report_progress("solving for the payload")
    basis = identification.base.structural or structural_base_parameters(identification.model)
    solution = solve_payload(identification, basis, mount, evidence, request)
    logs = tuple(_loaded_logs(identification, mount, solution, loaded_result, request))
    _check_known_mass(solution.phi[0], request)
    payload = _payload(mount, solution, request, logs, tuple(joint.name for joint in identification.model.joints))
    information = solution.information / payload.factor**2
    notes = _notes(payload, identification, loaded_result, information, unloaded=bool(unloaded))
    return replace(payload, notes=tuple(notes))


def _identify_recordings(identification: Identification, logs: Logs, words: str) -> Identification:
    report_progress(f"identifying the recordings {words}")
    estimator = LeastSquares(weights="per_joint")  # the model is on its base as it is tilted
    recipe = replace(identification.recipe, estimator=estimator, base_tilt=None, restart=None, terms=None, proposed=())
    return identify(replace(identification.model, load=None), logs, recipe=recipe)


def _check_distinct(identification: Identification, loaded: Logs | Identification, unloaded: Logs) -> None:
    """Raise InputError where a recording is given twice: it would count twice, or hide the payload."""
    if isinstance(loaded, Identification):
        shared = {file.sha256 for file in identification.provenance.logs} - {""}
        for path in (file.path for file in loaded.provenance.logs if file.sha256 in shared):
            raise InputError(f"{path}: both results were made from it; a payload is the difference of two recordings.")
        loaded = {}
    logs = [*logs_by_name(loaded, "loaded").items(), *logs_by_name(unloaded, "unloaded").items()]
    for (name, log), (other_name, other) in combinations(logs, 2):
        if np.array_equal(log.q, other.q) and np.array_equal(log.tau, other.tau):
            raise InputError(f"{other_name}: holds the same samples as {name!r}; give each recording once.")


def _check_same(identification: Identification, loaded_result: Identification) -> None:
    names = set(identification.model.names) ^ set(loaded_result.model.names)
    if names or identification.model.names != loaded_result.model.names:
        raise InputError(
            f"the results have different parameters ({', '.join(sorted(names)[:3])}): a payload is the difference of "
            "two results of one arm with the same terms; identify both with the same configuration."
        )


def _match_gains(gains: DriveGains, model: Model) -> DriveGains:
    """Return gains in the order of the model's joints; InputError where a joint is missing."""
    names = [joint.name for joint in model.joints]
    missing = [name for name in names if name not in gains.joints]
    if missing:
        raise InputError(
            f"the gains are of the joints {', '.join(gains.joints)}, without {missing[0]!r} of the result."
        )
    order = [gains.joints.index(name) for name in names]
    return DriveGains(tuple(names), gains.factor[order], gains.covariance[np.ix_(order, order)], gains.known_mass)


def _payload(
    mount: Mount,
    solution: PayloadSolution,
    request: PayloadRequest,
    logs: tuple[LoadedLog, ...],
    joints: tuple[str, ...],
) -> Payload:
    """Return the payload of a solution as a body that is physically consistent, with its errors and their sources."""
    # Standard errors grow where the residual exceeds what they allow, and never shrink.
    factor = float(np.sqrt(max(solution.misfit / solution.freedom, 1.0))) if solution.freedom >= 1 else 1.0
    covariance: Array = np.asarray(factor**2 * np.linalg.inv(solution.information), dtype=np.float64)
    std = float(np.sqrt(covariance[0, 0]))
    if solution.phi[0] < -max(MIN_SIGNIFICANCE * std, 0.01):
        raise InputError(_negative_mass_message(solution.phi[0], std, request))
    value = make_consistent(solution.phi, solution.information)
    J, components = physical_jacobian(value), physical_components(value)
    # A shift by the constraint counts as an error, except for a mass that is not significant.
    shift = components - physical_components(solution.phi) if solution.phi[0] > MIN_SIGNIFICANCE * std else np.zeros(10)
    variance = np.diag(J @ covariance @ J.T) + shift**2
    shares = {source: factor**2 * np.diag(J @ part @ J.T) / variance for source, part in solution.by_source.items()}
    body = PhysicalBody(components, np.sqrt(variance))
    gains = DriveGains(
        joints, 1.0 + solution.gain_errors, factor**2 * solution.gain_covariance,
        request.known_mass or (request.gains.known_mass if request.gains else 0.0),
    )  # fmt: skip
    return Payload(
        mount, value, solution.phi, covariance, body, shares, gains, solution.drift, solution.friction, request,
        factor, logs,
    )  # fmt: skip


def _check_known_mass(mass: float, request: PayloadRequest) -> None:
    """Raise InputError where the estimated mass (kg) contradicts the known one: no gains of the drives explain that."""
    known_mass = request.known_mass
    if known_mass is not None and abs(mass - known_mass) > MAX_MASS_DIFFERENCE * known_mass:
        raise InputError(
            f"the known mass is {known_mass:g} kg, and the recordings show {mass:.3g} kg whatever the gains of the "
            "drives: give the mass in kg of what these recordings carry, or leave it out."
        )


def _negative_mass_message(mass: float, std: float, request: PayloadRequest) -> str:
    words = "less than when it was identified; if a tool was removed since, ask for the removed one (--removed)."
    if request.removed:
        words = "more than when it was identified; drop --removed, or check which recordings are with the payload."
    return f"the payload has a mass of {mass:.3g} +- {std:.2g} kg: the arm carries {words}"


def _loaded_logs(
    arm: Identification, mount: Mount, solution: PayloadSolution, loaded_result: Identification, request: PayloadRequest
) -> Iterator[LoadedLog]:
    """Yield the residual torque of each recording; InputError where it indicates another arm."""
    basis: BaseParameters = solution.basis
    trained = (validation for validation in arm.validations if validation.role == "train")
    train_error = max((validation.errors.relative_error for validation in trained), default=0.0)
    carried = mount.transform @ solution.phi * (-1.0 if request.removed else 1.0)
    # Drift acts on the arm alone; friction by the load only with the payload.
    alone = basis.to_standard(solution.beta + basis.to_base(solution.drift))
    with_payload = basis.to_standard(solution.beta + basis.to_base(solution.drift + solution.friction + carried))
    factor = 1.0 + solution.gain_errors
    for validation in loaded_result.validations:
        if validation.signals is None:
            continue
        pairs = ((alone, factor), (with_payload, factor), (loaded_result.estimate.value, np.ones_like(factor)))
        shares = (_residual_share(loaded_result.model, validation, theta, gain) for theta, gain in pairs)
        loaded_log = LoadedLog(validation.name, *shares)
        if loaded_log.with_payload > max(MAX_ERROR_RATIO * train_error, MAX_ERROR):
            raise InputError(_other_arm_message(loaded_log, request))
        yield loaded_log


def _other_arm_message(log: LoadedLog, request: PayloadRequest) -> str:
    known_mass = request.known_mass
    payload_words = "any payload" if known_mass is None else f"a payload of {known_mass:g} kg"
    cause = "" if known_mass is None else "the known mass is another (leave it out to see which), "
    cause += "" if request.frame is None else f"another link than {request.frame!r} carries it, "
    return (
        f"{log.name}: the arm of the result with {payload_words} leaves {log.with_payload:.3g} % of the torque, and a "
        f"fit to this recording alone {log.free:.3g} %: {cause}it is of another arm, or its columns, units or gains "
        "are others."
    )


def _residual_share(model: Model, log: LogValidation, theta: Array, factor: Array) -> float:
    """Return the residual torque (%) where the measured torque is ``factor`` (n) times that of the model."""
    motion = log.motion
    tau = motion.tau[motion.mask]
    residual = tau - factor * model.torque(**motion.states(motion.mask), theta=theta)
    return 100.0 * float(np.linalg.norm(residual)) / (float(np.linalg.norm(tau)) or np.inf)


def _notes(
    payload: Payload,
    identification: Identification,
    loaded_result: Identification,
    information: Array,
    *,
    unloaded: bool,
) -> Iterator[Note]:
    body, request = payload.body, payload.request
    sizes = _sizes(body.mass)
    if payload.factor > MIN_SIGNIFICANCE:
        yield OtherArm(payload.factor)
    if not payload.is_significant:
        yield NoPayload(body.mass, float(body.std[0]))
        return
    yield from _not_shown_notes(payload, identification, loaded_result, information)
    drift = payload.shares.get(ErrorSource.DRIFT, np.zeros(10)) + payload.shares.get(ErrorSource.FRICTION, np.zeros(10))
    for k, component in enumerate(list(Component)[:4]):
        if drift[k] > MAIN_SHARE and body.std[k] > MIN_NOTED_STD[COMPONENT_KIND[k]] * sizes[k]:
            yield PayloadOrDrift(component, float(drift[k]), unloaded)
    by_gains = float(payload.shares.get(ErrorSource.GAINS, np.zeros(1))[0])
    if by_gains > MAIN_SHARE and body.std[0] > MIN_NOTED_STD[0] * body.mass and request.known_mass is None:
        data = float(body.std[0]) * np.sqrt(max(1.0 - by_gains, 0.0))
        yield GainsUnknown(float(body.std[0]), data, request.gain_error)


def _not_shown_notes(
    payload: Payload, identification: Identification, loaded_result: Identification, information: Array
) -> Iterator[NotShown]:
    body, sizes = payload.body, _sizes(payload.body.mass)
    hidden = [k for k in range(10) if body.std[k] > MAX_SHOWN_STD[COMPONENT_KIND[k]] * sizes[k]]
    logs = [validation for validation in loaded_result.validations if validation.signals is not None]
    turnings_found: tuple[Turning, ...] = ()
    if hidden and logs:
        poses = stack_states([validation.motion for validation in logs])["q"]
        variance = _variance_per_second(identification.model, loaded_result, logs)
        turnings_found = turnings(identification.model, payload.mount, payload.value, information, variance, poses)
    # Components that the same motion would show share one note.
    groups: dict[Turning | None, list[int]] = {}
    for k in hidden:
        groups.setdefault(best_turning(turnings_found, k, float(body.std[k])), []).append(k)
    for way, several in groups.items():
        names, std = tuple(list(Component)[k] for k in several), tuple(float(body.std[k]) for k in several)
        if way is None:
            yield NotShown(names, std)
            continue
        kind = next(joint.kind for joint in identification.model.joints if joint.name == way.joint)
        unit = "m/s" if kind == "prismatic" else "rad/s"
        yield NotShown(names, std, way.joint, way.speed, unit, tuple(float(way.std[k]) for k in several))


def _variance_per_second(model: Model, loaded_result: Identification, logs: Sequence[LogValidation]) -> Array:
    """Return the variance (n) of each joint's torque averaged over a second.

    It is that of the residual times its correlation time.
    """
    sigma, sample_time = loaded_result.estimate.residual.sigma, float(np.median(np.diff(logs[0].motion.t)))
    tests = [[validation.residuals.get(joint.name) for joint in model.joints] for validation in logs]
    spans = [[test.decorrelation if test else 0.0 for test in log_tests] for log_tests in tests]
    floor = max(1e-6 * float(sigma.max()), 1e-12)
    return np.asarray(np.maximum(sigma, floor) ** 2 * np.maximum(np.max(spans, axis=0), sample_time))


def _sizes(mass: float) -> Array:
    """Return the sizes (10) of the components of a payload of a mass: the mass, one metre, its inertia at 0.1 m."""
    return np.asarray(np.array([mass, 1.0, mass * 0.01])[COMPONENT_KIND])
