"""A robot model: the sum of terms that are linear in their parameters, tau = Y(q, dq, ddq) theta."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynident.models.evaluation import (
    MassMatrixCheck,
    accelerations,
    call_term,
    check_memory,
    check_output,
    check_positive_definite,
    check_states,
    check_terms,
    check_theta,
    motion_memory,
    term_kind,
    times,
)
from dynident.models.robot_files import RobotJointLimits
from dynident.models.structure import Structure, common_structure, random_states, term_support
from dynident.models.term import Joint, Parameter, Partials, Term
from dynident.motion.log import Motion
from dynident.runtime import ModelError, join_names
from dynident.runtime.arrays import Array


@dataclass(frozen=True)
class Model:
    """An ordered sum of terms for the same n joints; its p parameters are those of the terms, one after the other.

    In all methods q (rad or m), dq, ddq (per s and s^2) and tau (N m or N) are (N, n), and theta is (p) or, except in
    ``partials``, one row per sample (N, p); ``memory`` (N, m) is what terms such as ``Dahl`` remember, which motions of
    ``remembering`` hold. ``load`` are parameters of the bodies, whose torque is the load that such terms see.
    ``chooses_terms`` says that the training logs are to choose further terms of each joint, for which classes in
    ``proposed`` are tried as well.
    Raises ModelError where the terms differ in their joints or share a parameter name; the methods raise it where a
    shape does not fit, a memory is missing, or a term fails or returns a wrong shape or a number that is not finite.

    >>> import dynident as dy
    >>> from dynident.models.lagrangian import pendulum
    >>> (links,) = pendulum().terms
    >>> dy.Model((links, dy.Viscous(links.joints), dy.Coulomb(links.joints)), name="rusty")
    <Model 'rusty': 1 joint (pivot), 4 parameters (Lagrangian 2, Viscous 1, Coulomb 1)>
    """

    terms: tuple[Term, ...]
    name: str = "model"
    load: tuple[float, ...] | None = None
    chooses_terms: bool = False
    proposed: tuple[type, ...] = ()

    def __post_init__(self) -> None:
        # a single term needs no tuple
        object.__setattr__(self, "terms", tuple(self.terms) if isinstance(self.terms, Iterable) else (self.terms,))
        check_terms(self)
        if self.load is not None:
            object.__setattr__(self, "load", tuple(map(float, self.load)))
            if len(self.load) != (count := int(self.load_mask.sum())):
                raise ModelError(f"{self.name}: load has {len(self.load)} parameters, but its bodies have {count}.")

    def __repr__(self) -> str:
        joints = join_names((joint.name for joint in self.joints), 6)
        terms = join_names((f"{term_kind(term)} {len(term.parameters)}" for term in self.terms), 6)
        count = f"{len(self.joints)} joint{'s' * (len(self.joints) > 1)}"
        further = "; further terms are to be chosen" if self.chooses_terms else ""
        return f"<Model {self.name!r}: {count} ({joints}), {len(self.names)} parameters ({terms}){further}>"

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
        nominal = [parameter.value for parameter in self.parameters if parameter.value is not None]
        return np.array(nominal) if len(nominal) == len(self.parameters) else None

    @cached_property
    def parameter_slices(self) -> list[slice]:
        """The parameters of each term."""
        return [slice(end - n, end) for end, n in zip(np.cumsum(self._widths).tolist(), self._widths, strict=True)]

    @property
    def limits(self) -> Mapping[str, RobotJointLimits]:
        """Limits of the joints by name, where a robot file gives them."""
        return {name: limit for term in self.terms for name, limit in term.limits.items()}

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes of the terms on the files they were made from."""
        return tuple(note for term in self.terms for note in term.notes)

    def with_terms(self, *terms: Term) -> Model:
        """Return the model with further terms, whose parameters follow its own.

        >>> import dynident as dy
        >>> from dynident.models.lagrangian import pendulum
        >>> pendulum().with_terms(dy.Viscous(pendulum().joints)).names[-1]
        'Fv_pivot'
        """
        return replace(self, terms=(*self.terms, *terms))

    def with_gravity(self, change: Callable[[Array], ArrayLike]) -> Model:
        """Return the model in which ``change`` is applied to the gravity (3), m/s^2, of each term that has one."""

        def turn_gravity(term: Term) -> Term:
            if term.gravity is None:
                return term
            return term.with_gravity(tuple(np.asarray(change(np.array(term.gravity)), dtype=float).tolist()))

        return replace(self, terms=tuple(map(turn_gravity, self.terms)))

    @cached_property
    def memory(self) -> int:
        """The number m of states that the terms remember."""
        return max((part.stop for part in self.memory_slices.values()), default=0)

    @cached_property
    def memory_slices(self) -> dict[int, slice]:
        """The slice of each term that remembers in the memory, by the index of the term."""
        slices, end = {}, 0
        for k, term in enumerate(self.terms):
            if term.memory:
                slices[k], end = slice(end, end + term.memory), end + term.memory
        return slices

    @cached_property
    def bodies(self) -> Model:
        """The terms whose torque is the load, as a model."""
        return replace(self, terms=tuple(term for term in self.terms if term.loads), load=None)

    @cached_property
    def needs_load(self) -> bool:
        """Whether a term remembers the load, which a first fit must find."""
        return any(term.needs_load for term in self.terms)

    def with_load(self, theta: ArrayLike) -> Model:
        """Return the model whose ``load`` are the parameters of its bodies in theta (p).

        Raises ModelError where no term is of bodies.
        """
        if not self.load_mask.any():
            raise ModelError(f"{self.name}: no term is of bodies, so there is no load; leave out what depends on it.")
        return replace(self, load=tuple(check_theta(self, theta, None)[self.load_mask].tolist()))

    def remembering(self, motion: Motion, start: Array | None = None) -> Motion:
        """Return a motion, whole and not thinned, with what the terms remember of it.

        ``start`` (m) is the memory at its first sample, where that is not the first of a recording.
        """
        if not self.memory:
            return motion
        return replace(motion, memory=motion_memory(self, motion.t, motion.q, motion.dq, motion.ddq, start))

    def random_states(self, rng: np.random.Generator, samples: int) -> dict[str, Array]:
        """Draw states at random by name: q, dq, ddq (samples, n) and, where the model has one, memory (samples, m)."""
        states = dict(zip(("q", "dq", "ddq"), random_states(self.joints, rng, samples), strict=True))
        return states | ({"memory": rng.uniform(-1.0, 1.0, (samples, self.memory))} if self.memory else {})

    def regressor(self, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike, memory: ArrayLike | None = None) -> Array:
        """Return Y, shape (N, n, p): article, eq. (8)."""
        return self._regressor(self._states(q, dq, ddq, memory))

    @cached_property
    def support(self) -> NDArray[np.bool_]:
        """Where the regressor can be other than zero, shape (n, p), as far as the terms tell."""
        return np.concatenate([term_support(term) for term in self.terms], axis=1)

    @cached_property
    def structure(self) -> Structure:
        """The entries of the regressor that hold all others."""
        return common_structure([self])

    def structure_with(self, columns: Sequence[int]) -> Structure:
        """Return the structure of these columns alone; columns that others determine are not left out."""
        selected = self.support & np.isin(np.arange(len(self.parameters)), columns)
        joint_columns = tuple(map(np.flatnonzero, selected))
        return Structure(joint_columns, tuple(np.eye(len(self.parameters))[indices] for indices in joint_columns))

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
        out, start = np.empty((len(joint), len(states[0]))), 0
        # each term computes the entries whose parameters are in its range of columns
        for k, width in enumerate(self._widths):
            requested = np.flatnonzero((parameter >= start) & (parameter < start + width))
            indices, start = (joint[requested], parameter[requested] - start), start + width
            if not len(requested):
                continue
            rows = call_term(self, self.terms[k], "entries", *states[:3], *indices, *self._term_memory(k, states))
            out[requested] = check_output(self, self.terms[k], "entries", rows, (len(requested), len(out[0])), states)
        return out

    def torque(
        self, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike, theta: ArrayLike, memory: ArrayLike | None = None
    ) -> Array:
        """Return the inverse dynamics Y theta, shape (N, n): article, eq. (8)."""
        states = self._states(q, dq, ddq, memory)
        return self._torque(states, check_theta(self, theta, len(states[0])))

    def mass_matrix(self, q: ArrayLike, theta: ArrayLike) -> Array:
        """Return D of the article's eq. (4), shape (N, n, n); its column j is Y(q, 0, e_j) theta - Y(q, 0, 0) theta."""
        (q,) = check_states(self, q=q)
        memory = np.zeros((len(q), self.memory))  # no part of the mass
        return self._mass_and_bias(self._states(q, np.zeros_like(q), None, memory), check_theta(self, theta, len(q)))[0]

    def mass_and_bias(
        self, q: ArrayLike, dq: ArrayLike, theta: ArrayLike, memory: ArrayLike | None = None
    ) -> tuple[Array, Array]:
        """Return ``mass_matrix`` and ``bias`` from one call of the regressor."""
        states = self._states(q, dq, None, memory)
        return self._mass_and_bias(states, check_theta(self, theta, len(states[0])))

    def bias(self, q: ArrayLike, dq: ArrayLike, theta: ArrayLike, memory: ArrayLike | None = None) -> Array:
        """Return the torque at ddq = 0, shape (N, n): C dq + G of the article's eq. (4), with friction."""
        states = self._states(q, dq, None, memory)
        return self._torque(states, check_theta(self, theta, len(states[0])))

    def forward_dynamics(
        self, q: ArrayLike, dq: ArrayLike, tau: ArrayLike, theta: ArrayLike, memory: ArrayLike | None = None
    ) -> Array:
        """Return ddq = D^-1 (tau - bias), shape (N, n): article, eq. (43).

        Raises ModelError where the mass matrix is singular.
        """
        q, dq, tau = check_states(self, q=q, dq=dq, tau=tau)
        theta = check_theta(self, theta, len(q))
        return accelerations(self, q, tau, theta, *self._mass_and_bias(self._states(q, dq, None, memory), theta))

    def partials(
        self, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike, theta: ArrayLike, memory: ArrayLike | None = None
    ) -> Partials:
        """Return the derivatives of the torque with respect to q, dq and ddq, each (N, n, n), for one theta (p).

        They are at constant memory.
        """
        states = self._states(q, dq, ddq, memory)
        theta = check_theta(self, theta, None)
        shape = (*states[0].shape, len(self.joints))
        total = np.zeros((3, *shape))
        for i, (term, part) in enumerate(zip(self.terms, self.parameter_slices, strict=True)):
            slopes = call_term(self, term, "partials", *states[:3], theta[part], *self._term_memory(i, states))
            for k, wrt in enumerate(("q", "dq", "ddq")):
                total[k] += check_output(self, term, f"derivative by {wrt}", getattr(slopes, wrt, None), shape, states)
        return Partials(*total)

    def weighted_gradient(
        self, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike, weights: Array, memory: ArrayLike | None = None
    ) -> Array:
        """Return the derivatives (3, N, n) by q, dq and ddq, at constant memory, of the sums <G_i, Y_i> of products of
        the entries of the regressor with weights G (N, n, p).

        They are one reverse pass for each term. A criterion of a motion's information M = sum_i Y_i' W Y_i changes by
        such a sum: d log det M = 2 sum_i <G_i, dY_i> with G_i = W Y_i M^-1.
        """
        states, weights = self._states(q, dq, ddq, memory), np.asarray(weights, dtype=float)
        shape, total = (*states[0].shape, len(self.parameters)), np.zeros((3, *states[0].shape))
        if weights.shape != shape:
            raise ModelError(f"{self.name}: the weights have shape {weights.shape}, expected {shape}: those of Y.")
        for k, (term, part) in enumerate(zip(self.terms, self.parameter_slices, strict=True)):
            arguments = (*states[:3], weights[..., part], *self._term_memory(k, states))
            gradient = call_term(self, term, "weighted_gradient", *arguments)
            total += check_output(self, term, "weighted gradient", gradient, total.shape, states)
        return total

    def check_mass_matrix(self, q: ArrayLike, theta: ArrayLike) -> MassMatrixCheck:
        """Return the smallest eigenvalue of the mass matrix over the configurations q (N, n), N at least 1."""
        (q,) = check_states(self, q=q)
        return check_positive_definite(self, q, self.mass_matrix(q, theta) if len(q) else np.zeros((0, 0, 0)))

    @cached_property
    def _widths(self) -> list[int]:
        return [len(term.parameters) for term in self.terms]

    def _states(
        self, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike | None, memory: ArrayLike | None
    ) -> tuple[Array, ...]:
        """Return q, dq, ddq, zero where it is None, and the memory where the model has one."""
        states = check_states(self, q=q, dq=dq, ddq=np.zeros(np.shape(q)) if ddq is None else ddq)
        return (*states, *check_memory(self, memory, len(states[0])))

    def _term_memory(self, k: int, states: tuple[Array, ...]) -> tuple[Array, ...]:
        """Return the memory of term k as further arguments of its methods; none where it does not remember."""
        return (states[3][:, self.memory_slices[k]],) if k in self.memory_slices else ()

    @cached_property
    def load_mask(self) -> NDArray[np.bool_]:
        """Which of the p parameters belong to terms whose torque is the load."""
        return np.repeat(np.array([term.loads for term in self.terms], dtype=bool), self._widths)

    def _mass_and_bias(self, states: tuple[Array, ...], theta: Array) -> tuple[Array, Array]:
        """Return the mass matrix (N, n, n) and the bias (N, n).

        Terms with a mass matrix of their own compute both; those of all other terms follow from one call of the
        torque.
        """
        (q, dq), (rows, n) = states[:2], states[0].shape
        # methods of terms take one theta: parameters by sample need the regressor
        direct = self._mass_matrix_terms if theta.ndim == 1 else []
        mass, bias = np.zeros((rows, n, n)), np.zeros((rows, n))
        if len(direct) < len(self.terms):
            # the torque is linear in ddq: evaluate it at ddq = 0 and at the n unit accelerations, all stacked
            ddq = np.repeat(np.eye(n + 1, n, k=-1), rows, axis=0)
            thetas = theta if theta.ndim == 1 else np.concatenate([theta] * (n + 1))
            q_, dq_, *memory = (np.concatenate([array] * (n + 1)) for array in (q, dq, *states[3:]))
            tau = self._torque((q_, dq_, ddq, *memory), thetas, without=direct).reshape(n + 1, rows, n)
            mass, bias = (tau[1:] - tau[0]).transpose(1, 2, 0), tau[0]
        for k in direct:
            term_matrices = call_term(self, self.terms[k], "mass_and_bias", q, dq, theta[self.parameter_slices[k]])
            mass = mass + check_output(self, self.terms[k], "mass matrix", term_matrices[0], (rows, n, n), states)
            bias = bias + check_output(self, self.terms[k], "bias", term_matrices[1], (rows, n), states)
        return mass, bias

    def _regressor(self, states: tuple[Array, ...]) -> Array:
        return np.concatenate([self._block(k, states) for k in range(len(self.terms))], axis=2)

    def _block(self, k: int, states: tuple[Array, ...]) -> Array:
        """Return the columns of the regressor that belong to term k."""
        block = call_term(self, self.terms[k], "regressor", *states[:3], *self._term_memory(k, states))
        return check_output(self, self.terms[k], "regressor", block, (*states[0].shape, self._widths[k]), states)

    @cached_property
    def _mass_matrix_terms(self) -> list[int]:
        """The terms that have their own mass matrix."""
        return [k for k, term in enumerate(self.terms) if term.has_own("mass_and_bias")]

    def _torque(self, states: tuple[Array, ...], theta: Array, without: Sequence[int] = ()) -> Array:
        """Return the torque of all terms, but those with the indices ``without``."""
        # one product with the whole regressor, unless a term has a faster torque of its own
        if theta.ndim == 2 or not (without or any(term.has_own("torque") for term in self.terms)):
            return times(self._regressor(states), theta)
        total = np.zeros(shape := states[0].shape)
        for k, part in enumerate(self.parameter_slices):
            if k in without:
                continue
            if self.terms[k].has_own("torque"):
                tau = call_term(self, self.terms[k], "torque", *states[:3], theta[part], *self._term_memory(k, states))
                total += check_output(self, self.terms[k], "torque", tau, shape, states)
            else:
                total += times(self._block(k, states), theta[part])
        return total
