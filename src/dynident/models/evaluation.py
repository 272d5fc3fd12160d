"""What a model checks of its terms and of what it is given, and what follows from their torques."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike

from dynident.models.term import Joint, Past, Term
from dynident.runtime import Axes, DynidentError, ModelError, Noun, short, vector
from dynident.runtime.arrays import Array, as_numbers

if TYPE_CHECKING:
    from dynident.models.model import Model


def call_term(model: Model, term: Term, method: str, *arguments: Any) -> Any:
    """Call a method of a term and return its result.

    Raises ModelError where the call fails, unless with an error of dynident itself.
    """
    try:
        return getattr(term, method)(*arguments)
    except DynidentError:
        raise
    except (Exception, SystemExit) as error:
        raise ModelError(
            f"{model.name}: {method} of term {term_kind(term)} failed with {type(error).__name__}: {error}"
        ) from error


def check_output(
    model: Model, term: Term, quantity: str, value: Any, shape: tuple[int, ...], states: tuple[Array, ...]
) -> Array:
    """Return the output of a term at the states as an array.

    Raises ModelError unless it has this shape and is finite.
    """
    array: Array = np.asarray(value)
    if array.shape != shape or array.dtype.kind not in "fiu":
        raise ModelError(
            f"{model.name}: the {quantity} of term {term_kind(term)} has shape {array.shape} and type {array.dtype}, "
            f"expected floats of shape {shape}."
        )
    if not np.isfinite(array).all():
        # report the first bad entry; sample and joint are on other axes where the quantity is transposed
        index = tuple(int(k) for k in np.argwhere(~np.isfinite(array))[0])
        positions = {"entries": (index[1], None), "weighted gradient": index[1:]}
        sample, joint = positions.get(quantity, index[:2])
        joint_text = "" if joint is None else f", joint {model.joints[joint].name!r}"
        q, dq, ddq = (state[sample].tolist() for state in states[:3])
        raise ModelError(
            f"{model.name}: term {term_kind(term)} returned {array[index]} at sample {sample} in its "
            f"{quantity}{joint_text}, where q = {q}, dq = {dq}, ddq = {ddq}; check both."
        )
    return array


def check_terms(model: Model) -> None:
    """Raise ModelError unless the model has terms, these have the same joints, and all parameters another name."""
    if not model.terms:
        raise ModelError(f"{model.name}: a model needs at least one term.")
    for term in model.terms:
        if not (isinstance(term, Term) and hasattr(term, "joints") and hasattr(term, "parameters")):
            raise ModelError(
                f"{model.name}: a {type(term).__name__} is no term; give terms such as Viscous(joints), or derive its "
                "class from `dynident.models.Term` and give it `joints` and `parameters`."
            )
    for term in model.terms[1:]:
        if tuple(term.joints) != model.joints:
            raise ModelError(
                f"{model.name}: term {term_kind(term)} has joints {format_joints(term.joints)}, but "
                f"{term_kind(model.terms[0])} has {format_joints(model.joints)}; give all terms the same joints, in "
                "the same order."
            )
    earlier_names: set[str] = set()
    for name in model.names:
        if name in earlier_names:
            raise ModelError(
                f"{model.name}: two parameters are called {name!r}; rename one with the field 'names' of its term."
            )
        earlier_names.add(name)


def check_states(model: Model, **values: ArrayLike) -> tuple[Array, ...]:
    """Return the arrays as floats; ModelError unless all are (N, n) with the same N."""
    arrays = {name: as_numbers(value) for name, value in values.items()}
    rows = next(iter(arrays.values())).shape[:1]
    for name, array in arrays.items():
        if array.ndim != 2 or array.shape != (*rows, len(model.joints)):
            raise ModelError(
                f"{model.name}: {name} has shape {array.shape}, expected ({rows[0] if rows else 'N'}, "
                f"{len(model.joints)}): one row per sample, one column per joint ({format_joints(model.joints)})."
            )
    return tuple(arrays.values())


def check_theta(model: Model, theta: ArrayLike, rows: int | None) -> Array:
    """Return theta (p) or, unless ``rows`` is None, (rows, p) as floats; ModelError for another shape."""
    array = as_numbers(theta)
    p = len(model.parameters)
    if array.shape not in ((p,), (rows, p)):
        per_sample = f" or ({rows}, {p})" if rows is not None else ""
        raise ModelError(
            f"{model.name}: theta has shape {array.shape}, expected ({p},){per_sample}: {', '.join(model.names)}."
        )
    return array


def term_kind(term: Term) -> str:
    """Return the kind of a term as messages have it."""
    return type(term).__name__


def format_joints(joints: tuple[Joint, ...]) -> str:
    """Return names and kinds of joints as messages have them."""
    return ", ".join(f"{joint.name} ({joint.kind})" for joint in joints)


def kinds_that_remember(terms: Sequence[Term]) -> tuple[str, ...]:
    """Return the kinds of the terms that remember."""
    return tuple(term_kind(term) for term in terms if term.memory)


def drop_load_dependence(model: Model) -> Model:
    """Return the model without the terms that remember the load, or the model itself where its load is known.

    A first fit without these terms finds the load. Raises ModelError where no term is of bodies.
    """
    if model.load is not None or not model.needs_load:
        return model
    if not model.load_mask.any():
        raise ModelError(f"{model.name}: no term is of bodies, so there is no load; leave out what depends on it.")
    return replace(model, terms=tuple(term for term in model.terms if not term.needs_load))


def check_memory(model: Model, memory: ArrayLike | None, rows: int) -> tuple[Array, ...]:
    """Return the memory (rows, m) as floats where the model has one; ModelError where it is missing or misshapen."""
    if not model.memory:
        return ()
    kinds = ", ".join(kinds_that_remember(model.terms))
    if memory is None:
        raise ModelError(
            f"{model.name}: its torque depends on the motion before ({kinds}), and no memory of it is given; use a "
            "motion that `Model.remembering` returns, or the argument 'memory'."
        )
    array = np.asarray(memory, dtype=float)
    if array.shape != (rows, model.memory):
        raise ModelError(
            f"{model.name}: memory has shape {array.shape}, expected ({rows}, {model.memory}) of its terms {kinds}; "
            "use a motion that `Model.remembering` of this model returns."
        )
    return (array,)


def motion_memory(model: Model, t: Array, q: Array, dq: Array, ddq: Array, start: Array | None = None) -> Array:
    """Return the memory (N, m) of a motion at the times t (N), s.

    ``start`` (m) is the memory at the first sample, where that is not the first of a recording.
    """
    load, out = _load(model, (q, dq, ddq)), np.empty((len(t), model.memory))
    for k, part in model.memory_slices.items():
        past = Past(t, q, dq, ddq, load, None if start is None else start[part])
        term_memory = call_term(model, model.terms[k], "remember", past)
        out[:, part] = check_output(model, model.terms[k], "memory", term_memory, out[:, part].shape, (q, dq, ddq))
    return out


def _load(model: Model, states: tuple[Array, Array, Array]) -> Array:
    """Return the torque of the bodies (N, n) with the parameters of the load, zero where there are none."""
    if model.load is None or not model.needs_load:
        return np.zeros_like(states[0])
    return model.bodies.torque(*states, model.load)


class MassMatrixCheck(Noun):
    """The ``smallest`` eigenvalue of the mass matrix over some configurations, and the configuration ``q`` (n) of it.

    ``positive`` is True where it exceeds the rounding error of the largest eigenvalue. With both revolute and prismatic
    joints only the sign of the eigenvalue is meaningful; its size depends on the units.
    """

    smallest: float
    q: Annotated[Array, Axes("n")]
    positive: bool

    def __str__(self) -> str:
        if self.positive:
            smallest, pose = short(self.smallest, 4), vector(self.q, 4)
            return f"The mass matrix is positive definite: smallest eigenvalue {smallest}, at q = {pose}."
        return (
            f"The mass matrix is not positive definite: eigenvalue {short(self.smallest, 4)} at q = "
            f"{vector(self.q, 4)}. These parameters are not physically consistent and cannot be simulated; excite the "
            "robot more, or constrain the fit."
        )


def accelerations(model: Model, q: Array, tau: Array, theta: Array, mass: Array, bias: Array) -> Array:
    """Return mass^-1 (tau - bias), shape (N, n); ModelError where the mass matrix (N, n, n) is singular."""
    try:
        ddq = np.linalg.solve(mass, (tau - bias)[..., None])[..., 0]
    except np.linalg.LinAlgError:
        _raise_singular(model, q, mass, theta)
    # a solution this large comes from a mass matrix that is singular to working precision
    rounding = 10 * np.finfo(float).eps * np.abs(mass).max(axis=(1, 2)) * np.abs(ddq).max(axis=1)
    if (rounding > np.abs(tau).max(axis=1) + np.abs(bias).max(axis=1)).any():
        _raise_singular(model, q, mass, theta)
    return np.asarray(ddq, dtype=np.float64)


def _raise_singular(model: Model, q: Array, mass: Array, theta: Array) -> NoReturn:
    i = int(np.argmin(np.abs(np.linalg.eigvalsh(mass)).min(axis=1)))
    raise ModelError(
        f"{model.name}: the mass matrix is singular at q = {q[i].tolist()} for theta = "
        f"{(theta[i] if theta.ndim == 2 else theta).tolist()}; every joint needs an inertia."
    )


def check_positive_definite(model: Model, q: Array, mass: Array) -> MassMatrixCheck:
    """Return the smallest eigenvalue of mass matrices (N, n, n) at q (N, n), N at least 1."""
    if not len(q):
        raise ModelError(f"{model.name}: the mass matrix cannot be checked at 0 configurations; give some rows of q.")
    eigenvalues = np.linalg.eigvalsh(mass)
    i = int(np.argmin(eigenvalues[:, 0]))
    rounding = np.finfo(float).eps * len(model.joints) * np.abs(eigenvalues[i]).max()
    smallest = float(eigenvalues[i, 0])
    return MassMatrixCheck(smallest, q[i].copy(), smallest > rounding)


def times(Y: Array, theta: Array) -> Array:
    """Return Y theta for Y (N, n, p) and theta (p) or (N, p)."""
    return Y @ theta if theta.ndim == 1 else np.einsum("nij,nj->ni", Y, theta)
