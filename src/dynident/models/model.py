"""A robot model: the sum of terms that are linear in their parameters, tau = Y(q, dq, ddq) theta."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynident.errors import ModelError, brief, listed
from dynident.models.checked import called, checked, kind_of, listed_joints, states_of, theta_of
from dynident.models.robot_file import Limits
from dynident.models.structure import Structure, is_selective, structure_of, support_of
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

__all__ = ["MassMatrixCheck", "Model"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class MassMatrixCheck:
    """The ``smallest`` eigenvalue of the mass matrix over some configurations, and the configuration ``q`` (n) of it.

    ``positive`` is True where it exceeds the rounding error of the largest eigenvalue. With both revolute and prismatic
    joints only the sign of the eigenvalue is meaningful; its size depends on the units.
    """

    smallest: float
    q: Array
    positive: bool

    __repr__ = brief


@dataclass(frozen=True)
class Model:
    """An ordered sum of terms for the same n joints; its p parameters are those of the terms, one after the other.

    In all methods q (rad or m), dq, ddq (per s and s^2) and tau (N m or N) are (N, n), and theta is (p) or, except in
    ``partials``, one row per sample (N, p). Raises ModelError where the terms differ in their joints or share a
    parameter name; the methods raise it where a shape does not fit, or a term fails or returns a wrong shape or a
    number that is not finite.

    >>> import dynident as dy
    >>> from dynident.models.gallery import pendulum
    >>> (links,) = pendulum().terms
    >>> dy.Model((links, dy.Viscous(links.joints), dy.Coulomb(links.joints)), name="rusty")
    <Model 'rusty': 1 joint (pivot), 4 parameters (Lagrangian 2, Viscous 1, Coulomb 1)>
    """

    terms: tuple[Term, ...]
    name: str = "model"

    def __post_init__(self) -> None:
        object.__setattr__(self, "terms", tuple(self.terms) if isinstance(self.terms, Iterable) else (self.terms,))
        if not self.terms:
            raise ModelError(f"{self.name}: a model needs at least one term.")
        for term in self.terms:
            if not all(hasattr(term, name) for name in ("joints", "parameters", "regressor")):
                raise ModelError(
                    f"{self.name}: a {type(term).__name__} is no term; give terms such as Viscous(joints)."
                )
        for term in self.terms[1:]:
            if tuple(term.joints) != self.joints:
                raise ModelError(
                    f"{self.name}: term {kind_of(term)} has joints {listed_joints(term.joints)}, but "
                    f"{kind_of(self.terms[0])} has {listed_joints(self.joints)}; give all terms the same joints, in "
                    "the same order."
                )
        seen: set[str] = set()
        for name in self.names:
            if name in seen:
                raise ModelError(
                    f"{self.name}: two parameters are called {name!r}; rename one with the field 'names' of its term."
                )
            seen.add(name)

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
        return {name: limit for term in self.terms for name, limit in _limits(term).items()}

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes of the terms on the files they were made from."""
        return tuple(note for term in self.terms if isinstance(term, HasNotes) for note in term.notes)

    def with_gravity(self, change: Callable[[Array], ArrayLike]) -> Model:
        """Return the model in which ``change`` is applied to the gravity (3), m/s^2, of each term that has one."""

        def changed(term: Term) -> Term:
            if not isinstance(term, HasGravity):
                return term
            return term.with_gravity(tuple(np.asarray(change(np.array(term.gravity)), dtype=float).tolist()))

        return replace(self, terms=tuple(map(changed, self.terms)))

    def regressor(self, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike) -> Array:
        """Return Y, shape (N, n, p): article, eq. (8)."""
        return self._regressor(*states_of(self, q=q, dq=dq, ddq=ddq))

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
        self, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike, joint: NDArray[np.intp], parameter: NDArray[np.intp]
    ) -> Array:
        """Return Y[:, joint[m], parameter[m]] as rows m, shape (M, N)."""
        states = states_of(self, q=q, dq=dq, ddq=ddq)
        out, first = np.empty((len(joint), len(states[0]))), 0
        for k, width in enumerate(self._widths):
            mine = np.flatnonzero((parameter >= first) & (parameter < first + width))
            where, first = (joint[mine], parameter[mine] - first), first + width
            if not len(mine):
                continue
            if self._selective[k]:
                rows = called(self, self.terms[k], "entries", *states, *where)
                out[mine] = checked(self, self.terms[k], "entries", rows, (len(mine), len(out[0])), states)
            else:
                out[mine] = self._block(k, states).transpose(1, 2, 0)[where]
        return out

    def torque(self, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike, theta: ArrayLike) -> Array:
        """Return the inverse dynamics Y theta, shape (N, n): article, eq. (8)."""
        q, dq, ddq = states_of(self, q=q, dq=dq, ddq=ddq)
        return self._torque(q, dq, ddq, theta_of(self, theta, len(q)))

    def mass_matrix(self, q: ArrayLike, theta: ArrayLike) -> Array:
        """Return D of the article's eq. (4), shape (N, n, n); its column j is Y(q, 0, e_j) theta - Y(q, 0, 0) theta."""
        (q,) = states_of(self, q=q)
        return self._linear(q, np.zeros_like(q), theta_of(self, theta, len(q)))[0]

    def mass_and_bias(self, q: ArrayLike, dq: ArrayLike, theta: ArrayLike) -> tuple[Array, Array]:
        """Return ``mass_matrix`` and ``bias`` from one call of the regressor."""
        q, dq = states_of(self, q=q, dq=dq)
        return self._linear(q, dq, theta_of(self, theta, len(q)))

    def bias(self, q: ArrayLike, dq: ArrayLike, theta: ArrayLike) -> Array:
        """Return the torque at ddq = 0, shape (N, n): C dq + G of the article's eq. (4), with friction."""
        q, dq = states_of(self, q=q, dq=dq)
        return self.torque(q, dq, np.zeros_like(q), theta)

    def forward_dynamics(self, q: ArrayLike, dq: ArrayLike, tau: ArrayLike, theta: ArrayLike) -> Array:
        """Return ddq = D^-1 (tau - bias), shape (N, n): article, eq. (43).

        Raises ModelError where the mass matrix is singular.
        """
        q, dq, tau = states_of(self, q=q, dq=dq, tau=tau)
        theta = theta_of(self, theta, len(q))
        mass, bias = self._linear(q, dq, theta)
        try:
            ddq = np.linalg.solve(mass, (tau - bias)[..., None])[..., 0]
        except np.linalg.LinAlgError:
            self._singular(q, mass, theta)
        # a solution this large comes from a mass matrix that is singular to working precision
        reach = 10 * np.finfo(float).eps * np.abs(mass).max(axis=(1, 2)) * np.abs(ddq).max(axis=1)
        if (reach > np.abs(tau).max(axis=1) + np.abs(bias).max(axis=1)).any():
            self._singular(q, mass, theta)
        return np.asarray(ddq, dtype=np.float64)

    def partials(self, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike, theta: ArrayLike) -> Partials:
        """Return the derivatives of the torque with respect to q, dq and ddq, each (N, n, n), for one theta (p)."""
        states = states_of(self, q=q, dq=dq, ddq=ddq)
        theta = theta_of(self, theta, None)
        shape = (*states[0].shape, len(self.joints))
        total = np.zeros((3, *shape))
        for term, part in zip(self.terms, np.split(theta, np.cumsum(self._widths)[:-1]), strict=True):
            slopes = called(self, term, "partials", *states, part)
            for k, wrt in enumerate(("q", "dq", "ddq")):
                total[k] += checked(self, term, f"derivative by {wrt}", getattr(slopes, wrt, None), shape, states)
        return Partials(*total)

    def check_mass_matrix(self, q: ArrayLike, theta: ArrayLike) -> MassMatrixCheck:
        """Return the smallest eigenvalue of the mass matrix over the configurations q (N, n), N at least 1."""
        (q,) = states_of(self, q=q)
        if not len(q):
            raise ModelError(
                f"{self.name}: the mass matrix cannot be checked at 0 configurations; give some rows of q."
            )
        eigenvalues = np.linalg.eigvalsh(self.mass_matrix(q, theta))
        i = int(np.argmin(eigenvalues[:, 0]))
        rounding = np.finfo(float).eps * len(self.joints) * np.abs(eigenvalues[i]).max()
        smallest = float(eigenvalues[i, 0])
        return MassMatrixCheck(smallest, q[i].copy(), smallest > rounding)

    @cached_property
    def _widths(self) -> list[int]:
        return [len(term.parameters) for term in self.terms]

    def _linear(self, q: Array, dq: Array, theta: Array) -> tuple[Array, Array]:
        """Return mass matrix and bias: of each term that has them, and of all others from one call of the torque."""
        rows, n = q.shape
        direct = self._direct if theta.ndim == 1 else []
        ddq = np.repeat(np.eye(n + 1, n, k=-1), rows, axis=0)
        many = theta if theta.ndim == 1 else np.concatenate([theta] * (n + 1))
        tau = self._torque(np.concatenate([q] * (n + 1)), np.concatenate([dq] * (n + 1)), ddq, many, without=direct)
        tau = tau.reshape(n + 1, rows, n)
        mass, bias = (tau[1:] - tau[0]).transpose(1, 2, 0), tau[0]
        for k in direct:
            own = called(self, self.terms[k], "mass_and_bias", q, dq, theta[self._parts[k]])
            states = q, dq, np.zeros_like(q)
            mass = mass + checked(self, self.terms[k], "mass matrix", own[0], (rows, n, n), states)
            bias = bias + checked(self, self.terms[k], "bias", own[1], (rows, n), states)
        return mass, bias

    def _singular(self, q: Array, mass: Array, theta: Array) -> NoReturn:
        i = int(np.argmin(np.abs(np.linalg.eigvalsh(mass)).min(axis=1)))
        raise ModelError(
            f"{self.name}: the mass matrix is singular at q = {q[i].tolist()} for theta = "
            f"{(theta[i] if theta.ndim == 2 else theta).tolist()}; every joint needs an inertia."
        )

    def _regressor(self, q: Array, dq: Array, ddq: Array) -> Array:
        return np.concatenate([self._block(k, (q, dq, ddq)) for k in range(len(self.terms))], axis=2)

    def _block(self, k: int, states: tuple[Array, ...]) -> Array:
        """Return the columns of the regressor that belong to term k."""
        block = called(self, self.terms[k], "regressor", *states)
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
        ends = np.cumsum(self._widths).tolist()
        return [slice(end - width, end) for end, width in zip(ends, self._widths, strict=True)]

    def _torque(self, q: Array, dq: Array, ddq: Array, theta: Array, without: Sequence[int] = ()) -> Array:
        """Return the torque of all terms, or of some."""
        if theta.ndim == 2 or not (without or any(self._recursive)):
            return _times(self._regressor(q, dq, ddq), theta)
        total, states = np.zeros(q.shape), (q, dq, ddq)
        for k, part in enumerate(self._parts):
            if k in without:
                continue
            if self._recursive[k]:
                tau = called(self, self.terms[k], "torque", *states, theta[part])
                total += checked(self, self.terms[k], "torque", tau, q.shape, states)
            else:
                total += _times(self._block(k, states), theta[part])
        return total


def _times(Y: Array, theta: Array) -> Array:
    """Return Y theta for Y (N, n, p) and theta (p) or (N, p)."""
    return Y @ theta if theta.ndim == 1 else np.einsum("nij,nj->ni", Y, theta)


def _limits(term: Term) -> Mapping[str, Limits]:
    return term.limits if isinstance(term, HasLimits) else {}
