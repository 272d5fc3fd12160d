"""A robot model: the sum of terms that are linear in their parameters, tau = Y(q, dq, ddq) theta."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynident.errors import ModelError, listed
from dynident.log import Motion
from dynident.models.checked import called, check_terms, checked, kind_of, states_of, theta_of
from dynident.models.mass_matrix import MassMatrixCheck, accelerations, checked_mass
from dynident.models.memory import loading, loads, memory_of, needs_load, parts_of, remembered
from dynident.models.robot_file import Limits
from dynident.models.structure import Structure, is_selective, random_states, structure_of, support_of
from dynident.models.term import (
    HasGravity,
    HasLimits,
    HasMassMatrix,
    HasNotes,
    Joint,
    Parameter,
    Partials,
    Recursive,
    Term,
    declares,
)
from dynident.models.weighted import times, weighted_gradient

__all__ = ["MassMatrixCheck", "Model"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Model:
    """An ordered sum of terms for the same n joints; its p parameters are those of the terms, one after the other.

    In all methods q (rad or m), dq, ddq (per s and s^2) and tau (N m or N) are (N, n), and theta is (p) or, except in
    ``partials``, one row per sample (N, p); ``memory`` (N, m) is what terms such as ``Dahl`` remember, which motions of
    ``remembering`` hold. ``load`` are parameters of the bodies, whose torque is the load that such terms see.
    Raises ModelError where the terms differ in their joints or share a parameter name; the methods raise it where a
    shape does not fit, a memory is missing, or a term fails or returns a wrong shape or a number that is not finite.

    >>> import dynident as dy
    >>> from dynident.models.gallery import pendulum
    >>> (links,) = pendulum().terms
    >>> dy.Model((links, dy.Viscous(links.joints), dy.Coulomb(links.joints)), name="rusty")
    <Model 'rusty': 1 joint (pivot), 4 parameters (Lagrangian 2, Viscous 1, Coulomb 1)>
    """

    terms: tuple[Term, ...]
    name: str = "model"
    load: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "terms", tuple(self.terms) if isinstance(self.terms, Iterable) else (self.terms,))
        check_terms(self)
        if self.load is not None:
            object.__setattr__(self, "load", tuple(map(float, self.load)))
            if len(self.load) != (count := int(self._loading.sum())):
                raise ModelError(f"{self.name}: load has {len(self.load)} parameters, but its bodies have {count}.")

    def __repr__(self) -> str:
        joints = listed((joint.name for joint in self.joints), 6)
        terms = listed((f"{kind_of(term)} {len(term.parameters)}" for term in self.terms), 6)
        count = f"{len(self.joints)} joint{'s' * (len(self.joints) > 1)}"
        return f"<Model {self.name!r}: {count} ({joints}), {len(self.names)} parameters ({terms})>"

    @property
    def joints(self) -> tuple[Joint, ...]:
        """The n joints, in the order of the columns of q."""
        return tuple(self.terms[0].joints)

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """The p parameters, in the order of the regressor's columns."""
        return tuple(parameter for term in self.terms for parameter in term.parameters)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the p parameters."""
        return tuple(parameter.name for parameter in self.parameters)

    @property
    def values(self) -> Array | None:
        """The nominal parameters (p) in SI units, or None where one of them is not known."""
        known = [parameter.value for parameter in self.parameters if parameter.value is not None]
        return np.array(known) if len(known) == len(self.parameters) else None

    @property
    def limits(self) -> Mapping[str, Limits]:
        """Limits of the joints by name, where a robot file gives them."""
        have = (term.limits for term in self.terms if isinstance(term, HasLimits))
        return {name: limit for limits in have for name, limit in limits.items()}

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes of the terms on the files they were made from."""
        return tuple(note for term in self.terms if isinstance(term, HasNotes) for note in term.notes)

    def with_terms(self, *terms: Term) -> Model:
        """Return the model with further terms, whose parameters follow its own.

        >>> import dynident as dy
        >>> from dynident.models.gallery import pendulum
        >>> pendulum().with_terms(dy.Viscous(pendulum().joints)).names[-1]
        'Fv_pivot'
        """
        return replace(self, terms=(*self.terms, *terms))

    def with_gravity(self, change: Callable[[Array], ArrayLike]) -> Model:
        """Return the model in which ``change`` is applied to the gravity (3), m/s^2, of each term that has one."""

        def changed(term: Term) -> Term:
            if not isinstance(term, HasGravity):
                return term
            return term.with_gravity(tuple(np.asarray(change(np.array(term.gravity)), dtype=float).tolist()))

        return replace(self, terms=tuple(map(changed, self.terms)))

    @cached_property
    def memory(self) -> int:
        """The number m of states that the terms remember."""
        return max((part.stop for part in self.remembered.values()), default=0)

    @cached_property
    def remembered(self) -> dict[int, slice]:
        """Where the states of each term that remembers are in the memory, by the place of the term."""
        return parts_of(self.terms)

    @cached_property
    def bodies(self) -> Model:
        """The terms whose torque is the load, as a model."""
        return replace(self, terms=loads(self.terms), load=None)

    @cached_property
    def needs_load(self) -> bool:
        """Whether a term remembers the load, which a first fit must find."""
        return any(map(needs_load, self.terms))

    def loaded(self, theta: ArrayLike) -> Model:
        """Return the model whose ``load`` is that of its bodies at theta (p); ModelError where it has none."""
        if not self._loading.any():
            raise ModelError(f"{self.name}: no term is of bodies, so there is no load; leave out what depends on it.")
        return replace(self, load=tuple(theta_of(self, theta, None)[self._loading].tolist()))

    def remembering(self, motion: Motion, start: Array | None = None) -> Motion:
        """Return a motion, whole and not thinned, with what the terms remember of it.

        ``start`` (m) is the memory at its first sample, where that is not the first of a recording.
        """
        if not self.memory:
            return motion
        return replace(motion, memory=remembered(self, motion.t, motion.q, motion.dq, motion.ddq, start))

    def random_states(self, rng: np.random.Generator, samples: int) -> dict[str, Array]:
        """Draw states at random by name: q, dq, ddq (samples, n) and, where the model has one, memory (samples, m)."""
        found = dict(zip(("q", "dq", "ddq"), random_states(self.joints, rng, samples), strict=True))
        return found | ({"memory": rng.uniform(-1.0, 1.0, (samples, self.memory))} if self.memory else {})

    def regressor(self, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike, memory: ArrayLike | None = None) -> Array:
        """Return Y, shape (N, n, p): article, eq. (8)."""
        return self._regressor(self._states(q, dq, ddq, memory))

    @cached_property
    def support(self) -> NDArray[np.bool_]:
        """Where the regressor can be other than zero, shape (n, p), as far as the terms tell."""
        return np.concatenate([support_of(term) for term in self.terms], axis=1)

    @cached_property
    def structure(self) -> Structure:
        """The entries of the regressor that hold all others."""
        return structure_of([self])

    def structure_with(self, columns: Sequence[int]) -> Structure:
        """Return the structure of these columns alone, without regard to what they determine."""
        chosen = self.support & np.isin(np.arange(len(self.parameters)), columns)
        own = tuple(map(np.flatnonzero, chosen))
        return Structure(own, tuple(np.eye(len(self.parameters))[one] for one in own))

    def entries(
        self,
        q: ArrayLike,
        dq: ArrayLike,
        ddq: ArrayLike,
        joint: NDArray[np.intp],
        parameter: NDArray[np.intp],
        memory: ArrayLike | None = None,
    ) -> Array:
        """Return Y[:, joint[m], parameter[m]] as rows m, shape (M, N)."""
        states = self._states(q, dq, ddq, memory)
        out, first = np.empty((len(joint), len(states[0]))), 0
        for k, width in enumerate(self._widths):
            mine = np.flatnonzero((parameter >= first) & (parameter < first + width))
            where, first = (joint[mine], parameter[mine] - first), first + width
            if not len(mine):
                continue
            if self._selective[k]:
                rows = called(self, self.terms[k], "entries", *states[:3], *where, *self._own(k, states))
                out[mine] = checked(self, self.terms[k], "entries", rows, (len(mine), len(out[0])), states)
            else:
                out[mine] = self._block(k, states).transpose(1, 2, 0)[where]
        return out

    def torque(
        self, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike, theta: ArrayLike, memory: ArrayLike | None = None
    ) -> Array:
        """Return the inverse dynamics Y theta, shape (N, n): article, eq. (8)."""
        states = self._states(q, dq, ddq, memory)
        return self._torque(states, theta_of(self, theta, len(states[0])))

    def mass_matrix(self, q: ArrayLike, theta: ArrayLike) -> Array:
        """Return D of the article's eq. (4), shape (N, n, n); its column j is Y(q, 0, e_j) theta - Y(q, 0, 0) theta."""
        (q,) = states_of(self, q=q)
        memory = np.zeros((len(q), self.memory))  # no part of the mass
        return self._linear(self._states(q, np.zeros_like(q), None, memory), theta_of(self, theta, len(q)))[0]

    def mass_and_bias(
        self, q: ArrayLike, dq: ArrayLike, theta: ArrayLike, memory: ArrayLike | None = None
    ) -> tuple[Array, Array]:
        """Return ``mass_matrix`` and ``bias`` from one call of the regressor."""
        states = self._states(q, dq, None, memory)
        return self._linear(states, theta_of(self, theta, len(states[0])))

    def bias(self, q: ArrayLike, dq: ArrayLike, theta: ArrayLike, memory: ArrayLike | None = None) -> Array:
        """Return the torque at ddq = 0, shape (N, n): C dq + G of the article's eq. (4), with friction."""
        states = self._states(q, dq, None, memory)
        return self._torque(states, theta_of(self, theta, len(states[0])))

    def forward_dynamics(
        self, q: ArrayLike, dq: ArrayLike, tau: ArrayLike, theta: ArrayLike, memory: ArrayLike | None = None
    ) -> Array:
        """Return ddq = D^-1 (tau - bias), shape (N, n): article, eq. (43).

        Raises ModelError where the mass matrix is singular.
        """
        q, dq, tau = states_of(self, q=q, dq=dq, tau=tau)
        theta = theta_of(self, theta, len(q))
        return accelerations(self, q, tau, theta, *self._linear(self._states(q, dq, None, memory), theta))

    def partials(
        self, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike, theta: ArrayLike, memory: ArrayLike | None = None
    ) -> Partials:
        """Return the derivatives of the torque with respect to q, dq and ddq, each (N, n, n), for one theta (p).

        They are at constant memory.
        """
        states = self._states(q, dq, ddq, memory)
        theta = theta_of(self, theta, None)
        shape = (*states[0].shape, len(self.joints))
        total = np.zeros((3, *shape))
        for i, (term, part) in enumerate(zip(self.terms, self._parts, strict=True)):
            slopes = called(self, term, "partials", *states[:3], theta[part], *self._own(i, states))
            for k, wrt in enumerate(("q", "dq", "ddq")):
                total[k] += checked(self, term, f"derivative by {wrt}", getattr(slopes, wrt, None), shape, states)
        return Partials(*total)

    def weighted_gradient(
        self, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike, weights: Array, memory: ArrayLike | None = None
    ) -> Array:
        """Return the derivatives (3, N, n) by q, dq and ddq, at constant memory, of the sums <G_i, Y_i> of products of
        the entries of the regressor with weights G (N, n, p)."""
        return weighted_gradient(self, self._states(q, dq, ddq, memory), np.asarray(weights, dtype=float))

    def check_mass_matrix(self, q: ArrayLike, theta: ArrayLike) -> MassMatrixCheck:
        """Return the smallest eigenvalue of the mass matrix over the configurations q (N, n), N at least 1."""
        (q,) = states_of(self, q=q)
        return checked_mass(self, q, self.mass_matrix(q, theta) if len(q) else np.zeros((0, 0, 0)))

    @cached_property
    def _widths(self) -> list[int]:
        return [len(term.parameters) for term in self.terms]

    def _states(
        self, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike | None, memory: ArrayLike | None
    ) -> tuple[Array, ...]:
        """Return q, dq, ddq, zero where it is None, and the memory where the model has one."""
        found = states_of(self, q=q, dq=dq, ddq=np.zeros(np.shape(q)) if ddq is None else ddq)
        return (*found, *memory_of(self, memory, len(found[0])))

    def _own(self, k: int, states: tuple[Array, ...]) -> tuple[Array, ...]:
        """Return the memory of term k, where it has one."""
        return (states[3][:, self.remembered[k]],) if k in self.remembered else ()

    @cached_property
    def _loading(self) -> NDArray[np.bool_]:
        return loading(self.terms)

    def _linear(self, states: tuple[Array, ...], theta: Array) -> tuple[Array, Array]:
        """Return mass matrix and bias: of each term that has them, and of all others from one call of the torque."""
        (q, dq), (rows, n) = states[:2], states[0].shape
        direct = self._direct if theta.ndim == 1 else []
        mass, bias = np.zeros((rows, n, n)), np.zeros((rows, n))
        if len(direct) < len(self.terms):
            ddq = np.repeat(np.eye(n + 1, n, k=-1), rows, axis=0)
            many = theta if theta.ndim == 1 else np.concatenate([theta] * (n + 1))
            q_, dq_, *memory = (np.concatenate([one] * (n + 1)) for one in (q, dq, *states[3:]))
            tau = self._torque((q_, dq_, ddq, *memory), many, without=direct).reshape(n + 1, rows, n)
            mass, bias = (tau[1:] - tau[0]).transpose(1, 2, 0), tau[0]
        for k in direct:
            own = called(self, self.terms[k], "mass_and_bias", q, dq, theta[self._parts[k]])
            mass = mass + checked(self, self.terms[k], "mass matrix", own[0], (rows, n, n), states)
            bias = bias + checked(self, self.terms[k], "bias", own[1], (rows, n), states)
        return mass, bias

    def _regressor(self, states: tuple[Array, ...]) -> Array:
        return np.concatenate([self._block(k, states) for k in range(len(self.terms))], axis=2)

    def _block(self, k: int, states: tuple[Array, ...]) -> Array:
        """Return the columns of the regressor that belong to term k."""
        block = called(self, self.terms[k], "regressor", *states[:3], *self._own(k, states))
        return checked(self, self.terms[k], "regressor", block, (*states[0].shape, self._widths[k]), states)

    @cached_property
    def _selective(self) -> list[bool]:
        return [is_selective(term) for term in self.terms]

    @cached_property
    def _recursive(self) -> list[bool]:
        return [isinstance(term, Recursive) and declares(term, "torque") for term in self.terms]

    @cached_property
    def _direct(self) -> list[int]:
        """The terms that have their own mass matrix."""
        own = (isinstance(term, HasMassMatrix) and declares(term, "mass_and_bias") for term in self.terms)
        return [k for k, direct in enumerate(own) if direct]

    @cached_property
    def _parts(self) -> list[slice]:
        """The parameters of each term."""
        return [slice(end - n, end) for end, n in zip(np.cumsum(self._widths).tolist(), self._widths, strict=True)]

    def _torque(self, states: tuple[Array, ...], theta: Array, without: Sequence[int] = ()) -> Array:
        """Return the torque of all terms, or of some."""
        if theta.ndim == 2 or not (without or any(self._recursive)):
            return times(self._regressor(states), theta)
        total = np.zeros(shape := states[0].shape)
        for k, part in enumerate(self._parts):
            if k in without:
                continue
            if self._recursive[k]:
                tau = called(self, self.terms[k], "torque", *states[:3], theta[part], *self._own(k, states))
                total += checked(self, self.terms[k], "torque", tau, shape, states)
            else:
                total += times(self._block(k, states), theta[part])
        return total
