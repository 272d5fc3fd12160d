"""The terms that a model has beside its bodies: kinds that are switched on and off joint by joint."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from dynident.apps.tuning.curve import degree_of
from dynident.apps.tuning.tuning import MAX_DEGREE, MIN_DEGREE, Tuning, Window
from dynident.estimators import Estimator, LeastSquares, PhysicallyConsistent
from dynident.identification import Identification
from dynident.identification.terms import MIN_DRIFT_DURATION, JointExcitation, library_kinds
from dynident.identification.terms.candidates import combine_terms
from dynident.identification.terms.samples import TermSamples, columns_of, select_samples
from dynident.models import CoupledMotor, Joint, Model, RigidBodies, Term
from dynident.models.friction import JointTerm
from dynident.motion.log import Log, Motion
from dynident.motion.smoothers import Spline, position_noise, smooth_log, strip_time_offset
from dynident.motion.splines import Constraint, stretches
from dynident.runtime import ModelError, Noun, join_names
from dynident.runtime.arrays import Array
from dynident.runtime.families import TERMS

LEAST_SQUARES, CONSISTENT = "least_squares", "consistent"
MAX_SAMPLES = 3000  # on which sizes are compared
MIN_REACH = 1e-4  # rad, m: what a joint that never moves is taken to move, so that shapes have a size
MIN_NEW_SHARE = 1e-6  # share of a column that the model does not have: of less, nothing can be said


def start_of(
    identification: Identification,
    terms: tuple[tuple[str, ...], ...],
    logs: Mapping[str, Mapping[str, Log]],
    estimator: str,
) -> Tuning:
    """Return the tuning of an identification with these terms and this estimator, for logs as read."""
    recipe, joints = identification.recipe, tuple(joint.name for joint in identification.model.joints)
    return Tuning(
        degree=_degrees(identification, joints),
        terms=terms,
        min_speed=recipe.min_speeds(joints) or (0.0,) * len(joints),
        estimator=estimator,
        excluded=tuple(_excluded_windows(logs)),
        unfitted=recipe.unfitted,
        filter=recipe.filter,
        time_offset=float(recipe.time_offset),
    )


def noise_of(spline: Spline, log: Log) -> Array:
    """Return the noise (n) of the positions in terms of which a spline counts S."""
    if isinstance(spline.sigma, Mapping):
        estimate = position_noise(log)
        return np.array([spline.sigma.get(name, estimate[j]) for j, name in enumerate(log.joints)])
    return position_noise(log) if spline.sigma is None else np.full(len(log.joints), float(spline.sigma))


def _degrees(identification: Identification, joints: Sequence[str]) -> tuple[float, ...]:
    """Return log10(S/n) of the smoother as it was used.

    Of a smoother other than the spline with S in terms of n it is taken from what it left of the positions.
    """
    recipe = identification.recipe
    smoother = strip_time_offset(recipe.smoothers[0])
    if isinstance(smoother, Spline) and smoother.rule == Constraint():
        factors = [
            smoother.factor.get(name, 1.0) if isinstance(smoother.factor, Mapping) else smoother.factor
            for name in joints
        ]
        return tuple(float(np.clip(2.0 * np.log10(factor), MIN_DEGREE, MAX_DEGREE)) for factor in factors)
    spline = smoother if isinstance(smoother, Spline) else Spline()
    log_degrees = []
    for validation in identification.validations:
        if validation.role == "train" and validation.recorded_log is not None:
            log = recipe.repair(validation.recorded_log)
            q, noise = smooth_log(smoother, log).q, noise_of(spline, log)
            log_degrees.append([degree_of(log.q[:, j] - q[:, j], float(noise[j])) for j in range(len(joints))])
    return tuple(np.clip(np.mean(log_degrees, axis=0), MIN_DEGREE, MAX_DEGREE).tolist())


def _excluded_windows(logs: Mapping[str, Mapping[str, Log]]) -> list[Window]:
    """Return the windows that the logs exclude."""
    windows = []
    for by_name in logs.values():
        for name, log in by_name.items():
            for part in stretches(log.excluded) if log.excluded is not None else ():
                start, stop = float(log.t[part.start]), float(log.t[part.stop - 1])
                windows.append((name, start, stop if stop > start else float(np.nextafter(stop, np.inf))))
    return windows


def estimators_of(configured: Estimator, kind: str = "") -> tuple[str, dict[str, Estimator]]:
    """Return the kind of an estimator, and all estimators to choose from, it first.

    The default ``kind`` is the name of its class.
    """
    offered: dict[str, Estimator] = {LEAST_SQUARES: LeastSquares(), CONSISTENT: PhysicallyConsistent(strength=0.0)}
    kind = kind or type(configured).__name__
    kind = next((name for name, estimator in offered.items() if type(estimator) is type(configured)), kind)
    return kind, {kind: configured} | {name: estimator for name, estimator in offered.items() if name != kind}


class Offers(Noun):
    """A ``model`` with its ``residual`` torque (N, n) on ``samples``, and the ``loads``.

    These are the torque of the bodies on each motion.
    """

    model: Model
    samples: TermSamples
    residual: Array
    loads: tuple[Array, ...]

    @classmethod
    def of(cls, model: Model, theta: Array, motions: Sequence[Motion]) -> Offers:
        """Return the offers for a model with the parameters theta (p), on the motions that it was fitted to."""
        samples = select_samples(model, motions, max_samples=MAX_SAMPLES)
        residual = samples.tau - model.torque(**samples.states, theta=theta)
        loaded = any(term.loads for term in model.terms)
        return cls(model, samples, residual, samples.loads(model.with_load(theta).load if loaded else None))

    def kinds_of_joint(self, j: int) -> Iterator[tuple[str, tuple[Term, ...]]]:
        """Yield all kinds for a joint, by name, with the term alone on it."""
        joint = self.model.joints[j]
        is_fitted = self.samples.keep[:, j]
        structure = self.model.structure
        columns = structure.columns[j]
        rows = self.model.entries(**self.samples.states, joint=np.full(len(columns), j), parameter=columns)[
            :, is_fitted
        ]
        basis, names = _basis(rows), set[str]()
        loaded = any(load.any() for load in self.loads)
        for kind in library_kinds():
            if kind.name not in names and (loaded or not kind.needs_load):
                names.add(kind.name)
                sizes = kind.sizes(self._excitation(joint, j))
                gains = [self._gain(term, j, is_fitted, basis) for term in sizes] if len(sizes) > 1 else [0.0]
                yield kind.name, (sizes[int(np.argmax(gains))],)

    def _excitation(self, joint: Joint, j: int) -> JointExcitation:
        q, dq = (self.samples.states[name][:, j] for name in ("q", "dq"))
        speed, reach = (max(float(x), MIN_REACH) for x in (np.sqrt(np.mean(dq**2)), np.ptp(q)))
        # who asks for drift on a short recording gets it
        duration = max([MIN_DRIFT_DURATION, *(float(np.ptp(motion.t)) for motion in self.samples.motions)])
        return JointExcitation(self.model.joints, joint, speed, reach, duration)

    def _gain(self, term: Term, j: int, rows: NDArray[np.bool_], basis: Array) -> float:
        """Return by how much a term lowers the squared residual of a joint, beside its other terms."""
        new = columns_of(self.samples, term, j, self.loads)[:, rows]
        # Only the part of the new columns that the model does not have can explain the residual.
        remainder = new - (new @ basis) @ basis.T
        if np.linalg.norm(remainder) <= MIN_NEW_SHARE * np.linalg.norm(new):
            return 0.0
        directions = _basis(remainder)
        return float(np.square(self.residual[rows, j] @ directions).sum())


def _basis(rows: Array) -> Array:
    """Return orthonormal columns (N, r) that span rows (b, N)."""
    size = np.linalg.norm(rows, axis=1)
    U, s, _ = np.linalg.svd((rows[size > 0] / size[size > 0, None]).T, full_matrices=False)
    return U[:, s > 1e-8 * s.max(initial=0.0)]


@dataclass(frozen=True, eq=False)
class Switches:
    """The switchable terms of a ``model``: for each of its joints the terms on it alone, by kind.

    ``start`` are the kinds that it has as configured. Terms on several joints (bodies, coupled motors, terms of the
    user) are always there. ``kinds`` are the names of all kinds that can be switched, none where the model was not
    built of a robot file.
    """

    model: Model
    start: tuple[tuple[str, ...], ...]
    by_kind: tuple[Mapping[str, tuple[Term, ...]], ...]

    def __repr__(self) -> str:
        kinds = join_names(self.kinds, 6) or "none"
        return f"<Switches of {self.model.name!r}: kinds of terms {kinds}>"

    @classmethod
    def of(cls, model: Model, offers: Offers | None) -> Switches:
        """Return the switches of a model and of its offers; without offers nothing can be switched."""
        joints = model.joints
        if offers is None:
            return cls(model, ((),) * len(joints), ({},) * len(joints))
        own_terms = [_own_terms(model, joint.name) for joint in joints]
        by_kind = (terms | (dict(offers.kinds_of_joint(j)) | terms) for j, terms in enumerate(own_terms))
        return cls(model, tuple(map(tuple, own_terms)), tuple(by_kind))

    @cached_property
    def kinds(self) -> tuple[str, ...]:
        """The kinds that can be switched."""
        return tuple(dict.fromkeys(chain(*self.start, *self.by_kind)))

    def terms(self, selection: tuple[tuple[str, ...], ...]) -> tuple[Term, ...]:
        """Return the terms that are switched on, and those that always are beside the bodies; coupled motors last."""
        present = [term for term in self.model.terms if not isinstance(term, RigidBodies | CoupledMotor)]
        # An unchanged selection keeps the terms as configured, also where several joints share one term.
        if all(set(kinds) == set(current) for kinds, current in zip(selection, self.start, strict=True)):
            return tuple(present)
        terms_by_joint = [
            [term for kind in _order_kinds(kinds, self.start[j]) for term in self._terms_of_kind(j, kind)]
            for j, kinds in enumerate(selection)
        ]
        return (
            *combine_terms(self.model.joints, terms_by_joint),
            *(term for term in present if not isinstance(term, JointTerm)),
        )

    def with_terms(self, selection: tuple[tuple[str, ...], ...]) -> Model:
        """Return the model with these kinds, in the order in which a configuration builds it."""
        if not self.kinds:
            return self.model
        bodies = (term for term in self.model.terms if isinstance(term, RigidBodies))
        motors = (term for term in self.model.terms if isinstance(term, CoupledMotor))
        return replace(self.model, terms=(*bodies, *self.terms(selection), *motors), load=None)

    def _terms_of_kind(self, joint: int, kind: str) -> tuple[Term, ...]:
        if kind not in self.by_kind[joint]:
            raise ModelError(f"{self.model.joints[joint].name}: there is no term of kind {kind!r}.")
        return self.by_kind[joint][kind]


def _order_kinds(kinds: Sequence[str], own_kinds: Sequence[str]) -> list[str]:
    """Return kinds in one order, whatever the order of switching: the joint's own first."""
    order = [*own_kinds, *(candidate.name for candidate in library_kinds())]
    return sorted(set(kinds), key=lambda kind: order.index(kind) if kind in order else len(order))


def _own_terms(model: Model, joint: str) -> dict[str, tuple[Term, ...]]:
    """Return the terms of a model on a joint alone, by kind."""
    by_kind: dict[str, tuple[Term, ...]] = {}
    for term in model.terms:
        if isinstance(term, JointTerm) and joint in term.acts_on:
            kind = TERMS.kind_of(term).rpartition(":")[2]  # a class of the user goes by its name
            by_kind[kind] = (*by_kind.get(kind, ()), term.for_joint(joint))
    return by_kind
