"""From a result and recordings with a payload to its ten parameters, with their errors and where these come from."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from dynident.errors import InputError, Note, brief
from dynident.estimators import LeastSquares
from dynident.identification import Identification, identify
from dynident.log import Log, together
from dynident.models import Model
from dynident.payload.body import Component, PhysicalBody, consistent, physical, slopes
from dynident.payload.estimate import Solved, Source, solved
from dynident.payload.evidence import Evidence
from dynident.payload.mount import Mount, mount_of
from dynident.payload.notes import GainsUnknown, NoPayload, NotShown, OtherArm, PayloadOrDrift
from dynident.payload.request import DriveGains, Request
from dynident.payload.wrist import Turning, best_of, turnings
from dynident.regression import BaseParameters, structural_base_parameters
from dynident.validation import LogValidation

__all__ = ["LoadedLog", "Payload", "find_payload"]

Array = NDArray[np.float64]
MOST, WRONG = 5.0, 20.0  # times the error of the training, and %: with more left, a recording is of another arm
SHOWN = (0.2, 0.03, 1.0)  # of mass, m, of mass (0.1 m)^2: a component with a larger standard error is not shown
CONTRADICTS = 0.1  # of a weighed mass: such a difference is no error of weighing
CLEAR = 2.0  # standard errors; and of the misfit per degree of freedom
SEEN = 3.0  # standard errors of the mass, from which on there is a payload
TELLING = (0.01, 0.003, 0.2)  # of mass, m, of mass (0.1 m)^2: an error by drift or gains that is worth a note
MAINLY = 0.5  # share of the variance
KIND = np.array([0, 1, 1, 1, 2, 2, 2, 2, 2, 2])
HELPS = 0.7  # of the standard error: what is left by a motion that is worth naming


@dataclass(frozen=True, eq=False)
class LoadedLog:
    """What is left of the torque of a recording (%): by the arm alone, with the payload, and by a fit to this alone."""

    name: str
    without: float
    with_payload: float
    free: float


@dataclass(frozen=True, eq=False)
class Payload:
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
    shares: Mapping[Source, Array]
    gains: DriveGains
    drift: Array
    friction: Array
    request: Request
    factor: float
    logs: tuple[LoadedLog, ...] = ()
    notes: tuple[Note, ...] = field(default=())

    __repr__ = brief

    @property
    def seen(self) -> bool:
        """Whether there is a payload; else its mass alone is known, to be about nothing."""
        return bool(self.body.mass >= SEEN * self.body.std[0])


def find_payload(
    found: Identification,
    loaded: Mapping[str, Log] | Identification,
    unloaded: Mapping[str, Log] | None = None,
    request: Request | None = None,
    *,
    progress: Callable[[str], None] | None = None,
) -> Payload:
    """Return what the arm of a result carries in recordings ``loaded``, or in a second result of the same arm.

    Recordings are identified by themselves with the recipe of the result, by least squares; ``unloaded`` are recordings
    without the payload, best of the same day: they tell drift from payload. The rest is ``solved`` for all together,
    and the payload is made physically consistent; what this moves a value by counts as its error.

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
    >>> empty = np.array([*(one.value for one in bodies.parameters), 0.5, 0.3])
    >>> full = empty.copy()
    >>> full[[10, 11, 16, 19]] += 1.0, 0.3, 0.09, 0.09  # a point at 0.3 m of the fore arm
    >>> t = np.arange(2000) * 0.005
    >>> rate, phase = np.array([2.0, 3.1]), np.array([0.0, 1.0])
    >>> def recorded(theta):
    ...     q, dq, ddq = (rate**k * np.sin(np.outer(t, rate) + phase + k * np.pi / 2) for k in range(3))
    ...     tau = arm.torque(q, dq, ddq, theta) + 0.02 * rng.standard_normal(q.shape)
    ...     return dy.Log(t, q + 1e-5 * rng.standard_normal(q.shape), tau, ("shoulder", "elbow"))
    >>> found = dy.identify(arm, recorded(empty), estimator=dy.LeastSquares())
    >>> payload = find_payload(found, {"loaded": recorded(full)})
    >>> f"{payload.body.values[0]:.1f} kg at {payload.body.values[1]:.1f} m"
    '1.0 kg at 0.3 m'
    """
    request, say = request or Request(), progress or (lambda _: None)
    mount = mount_of(found.model, request.frame)
    if request.gains is not None:
        request = replace(request, gains=_matched(request.gains, found.model))
    other = loaded if isinstance(loaded, Identification) else _identified(found, loaded, "with the payload", say)
    _check_same(found, other)
    evidence = {Source.ARM: [Evidence.of(found)], Source.LOADED: [Evidence.of(other, "the result with the payload")]}
    if unloaded:
        evidence[Source.UNLOADED] = [Evidence.of(_identified(found, unloaded, "without the payload", say))]
    say("solving for the payload")
    basis = found.base.structural or structural_base_parameters(found.model)
    solution = solved(found.model, basis, found.estimate.value, mount, evidence, request)
    logs = tuple(_loaded_logs(found, mount, solution, other, request))
    _check_weighed(solution.phi[0], request)
    return _payload(found, other, mount, solution, request, logs, unloaded=bool(unloaded))


def _identified(
    found: Identification, logs: Mapping[str, Log], words: str, say: Callable[[str], None]
) -> Identification:
    say(f"identifying the recordings {words}")
    own = LeastSquares(weights="per_joint")  # the model is on its base as it is tilted
    recipe = replace(found.recipe, estimator=own, base_tilt=None, restart=None, terms=None, proposed=())
    return identify(replace(found.model, load=None), logs, recipe=recipe, progress=say)


def _check_same(found: Identification, other: Identification) -> None:
    names = set(found.model.names) ^ set(other.model.names)
    if names or found.model.names != other.model.names:
        raise InputError(
            f"the results have different parameters ({', '.join(sorted(names)[:3])}): a payload is the difference of "
            "two results of one arm with the same terms; identify both with the same configuration."
        )


def _matched(gains: DriveGains, model: Model) -> DriveGains:
    """Return gains in the order of the model's joints; InputError where they are of others."""
    names = [joint.name for joint in model.joints]
    missing = [name for name in names if name not in gains.joints]
    if missing:
        raise InputError(
            f"the gains are of the joints {', '.join(gains.joints)}, without {missing[0]!r} of the result."
        )
    order = [gains.joints.index(name) for name in names]
    return DriveGains(tuple(names), gains.factor[order], gains.covariance[np.ix_(order, order)], gains.known_mass)


def _payload(
    found: Identification,
    other: Identification,
    mount: Mount,
    solution: Solved,
    request: Request,
    logs: tuple[LoadedLog, ...],
    *,
    unloaded: bool,
) -> Payload:
    factor = float(np.sqrt(max(solution.misfit / solution.freedom, 1.0))) if solution.freedom >= 1 else 1.0
    covariance: Array = np.asarray(factor**2 * np.linalg.inv(solution.information), dtype=np.float64)
    std = float(np.sqrt(covariance[0, 0]))
    if solution.phi[0] < -max(CLEAR * std, 0.01):
        raise InputError(_negative(solution.phi[0], std, request))
    value = consistent(solution.phi, solution.information)
    J, centre = slopes(value), physical(value)
    moved = centre - physical(solution.phi) if solution.phi[0] > CLEAR * std else np.zeros(10)
    variance = np.diag(J @ covariance @ J.T) + moved**2
    shares = {source: factor**2 * np.diag(J @ part @ J.T) / variance for source, part in solution.by_source.items()}
    body = PhysicalBody(centre, np.sqrt(variance))
    names = tuple(joint.name for joint in found.model.joints)
    gains = DriveGains(
        names, 1.0 + solution.gain_errors, factor**2 * solution.gain_covariance,
        request.known_mass or (request.gains.known_mass if request.gains else 0.0),
    )  # fmt: skip
    payload = Payload(
        mount, value, solution.phi, covariance, body, shares, gains, solution.drift, solution.friction, request,
        factor, logs,
    )  # fmt: skip
    turned = solution.information / factor**2
    return replace(payload, notes=tuple(_notes(payload, found, other, turned, unloaded=unloaded)))


def _check_weighed(mass: float, request: Request) -> None:
    """Raise InputError where the mass (kg) that fits is not that which was weighed: no gains of drives explain it."""
    known = request.known_mass
    if known is not None and abs(mass - known) > CONTRADICTS * known:
        raise InputError(
            f"the known mass is {known:g} kg, and the recordings show {mass:.3g} kg whatever the gains of the drives: "
            "give the mass in kg of what these recordings carry, or leave it out."
        )


def _negative(mass: float, std: float, request: Request) -> str:
    said = f"the payload has a mass of {mass:.3g} +- {std:.2g} kg: the arm carries "
    if request.removed:
        return (
            f"{said}more than when it was identified; drop --removed, or check which recordings are with the payload."
        )
    return f"{said}less than when it was identified; if a tool was removed since, ask for the removed one (--removed)."


def _loaded_logs(
    arm: Identification, mount: Mount, solution: Solved, other: Identification, request: Request
) -> Iterator[LoadedLog]:
    """Yield what is left of the torque of each recording; InputError where that shows another arm."""
    basis: BaseParameters = solution.basis
    usual = max((one.errors.relative_error for one in arm.validations if one.role == "train"), default=0.0)
    carried = mount.turn @ solution.phi * (-1.0 if request.removed else 1.0)
    alone = basis.to_standard(solution.beta + basis.to_base(solution.drift))
    whole = basis.to_standard(solution.beta + basis.to_base(solution.drift + solution.friction + carried))
    factor = 1.0 + solution.gain_errors
    for one in other.validations:
        if one.signals is None:
            continue
        pairs = ((alone, factor), (whole, factor), (other.estimate.value, np.ones_like(factor)))
        found = LoadedLog(one.name, *(_left(other.model, one, theta, gain) for theta, gain in pairs))
        if found.with_payload > max(MOST * usual, WRONG):
            raise InputError(_of_another(found, request))
        yield found


def _of_another(log: LoadedLog, request: Request) -> str:
    known = request.known_mass
    what = "any payload" if known is None else f"a payload of {known:g} kg"
    cause = "" if known is None else "the known mass is another (leave it out to see which), "
    return (
        f"{log.name}: the arm of the result with {what} leaves {log.with_payload:.3g} % of the torque, and a fit to "
        f"this recording alone {log.free:.3g} %: {cause}it is of another arm, or its columns, units or gains are "
        "others."
    )


def _left(model: Model, log: LogValidation, theta: Array, factor: Array) -> float:
    """Return what is left of the torque (%) where it is ``factor`` (n) times that of the model."""
    motion = log.motion
    tau = motion.tau[motion.mask]
    rest = tau - factor * model.torque(**motion.states(motion.mask), theta=theta)
    return 100.0 * float(np.linalg.norm(rest)) / (float(np.linalg.norm(tau)) or np.inf)


def _notes(
    payload: Payload, found: Identification, other: Identification, information: Array, *, unloaded: bool
) -> Iterator[Note]:
    body, request = payload.body, payload.request
    sizes = _sizes(body.mass)
    if payload.factor > CLEAR:
        yield OtherArm(payload.factor)
    if not payload.seen:
        yield NoPayload(body.mass, float(body.std[0]))
        return
    yield from _not_shown(payload, found, other, information)
    drift = payload.shares.get(Source.DRIFT, np.zeros(10)) + payload.shares.get(Source.FRICTION, np.zeros(10))
    for k, component in enumerate(list(Component)[:4]):
        if drift[k] > MAINLY and body.std[k] > TELLING[KIND[k]] * sizes[k]:
            yield PayloadOrDrift(component, float(drift[k]), unloaded)
    by_gains = float(payload.shares.get(Source.GAINS, np.zeros(1))[0])
    if by_gains > MAINLY and body.std[0] > TELLING[0] * body.mass and request.known_mass is None:
        data = float(body.std[0]) * np.sqrt(max(1.0 - by_gains, 0.0))
        yield GainsUnknown(float(body.std[0]), data, request.gain_error)


def _not_shown(
    payload: Payload, found: Identification, other: Identification, information: Array
) -> Iterator[NotShown]:
    body, sizes = payload.body, _sizes(payload.body.mass)
    hidden = [k for k in range(10) if body.std[k] > SHOWN[KIND[k]] * sizes[k]]
    logs = [one for one in other.validations if one.signals is not None]
    ways: tuple[Turning, ...] = ()
    if hidden and logs:
        poses, variance = together([one.motion for one in logs])["q"], _per_second(found.model, other, logs)
        ways = turnings(found.model, payload.mount, payload.value, information, variance, poses)
    groups: dict[Turning | None, list[int]] = {}
    for k in hidden:
        groups.setdefault(_way_to_show(k, float(body.std[k]), ways), []).append(k)
    for way, several in groups.items():
        names, std = tuple(list(Component)[k] for k in several), tuple(float(body.std[k]) for k in several)
        if way is None:
            yield NotShown(names, std)
            continue
        kind = next(one.kind for one in found.model.joints if one.name == way.joint)
        unit = "m/s" if kind == "prismatic" else "rad/s"
        yield NotShown(names, std, way.joint, way.speed, unit, tuple(float(way.std[k]) for k in several))


def _way_to_show(k: int, std: float, ways: Sequence[Turning]) -> Turning | None:
    best = best_of(ways, k) if ways else None
    return None if best is None or best.std[k] > HELPS * std else best


def _per_second(model: Model, other: Identification, logs: Sequence[LogValidation]) -> Array:
    """Return the variance (n) of each joint's torque over a second: that of the residual, as long as it correlates."""
    sigma, least = other.estimate.residual.sigma, float(np.median(np.diff(logs[0].motion.t)))
    spans = [[one.residuals[joint.name].decorrelation if joint.name in one.residuals else 0.0 for joint in model.joints]
             for one in logs]  # fmt: skip
    floor = max(1e-6 * float(sigma.max()), 1e-12)
    return np.asarray(np.maximum(sigma, floor) ** 2 * np.maximum(np.max(spans, axis=0), least))


def _sizes(mass: float) -> Array:
    """Return the size (10) of what a payload of a mass has: the mass, one metre, and its mass 0.1 m from the centre."""
    return np.asarray(np.array([mass, 1.0, mass * 0.01])[KIND])
