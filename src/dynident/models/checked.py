"""What goes into a model and comes out of its terms, checked: errors name the model, the term and the sample."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynident.errors import DynidentError, ModelError
from dynident.models.term import Joint, Term

if TYPE_CHECKING:
    from dynident.models.model import Model

__all__ = ["called", "check_terms", "checked", "kind_of", "listed_joints", "states_of", "theta_of"]

Array = NDArray[np.float64]


def called(model: Model, term: Term, method: str, *arguments: Any) -> Any:
    """Return what a method of a term returns; ModelError where it fails, unless with an error of dynident itself."""
    try:
        return getattr(term, method)(*arguments)
    except DynidentError:
        raise
    except (Exception, SystemExit) as error:
        raise ModelError(
            f"{model.name}: {method} of term {kind_of(term)} failed with {type(error).__name__}: {error}"
        ) from error


def checked(
    model: Model, term: Term, what: str, value: Any, shape: tuple[int, ...], states: tuple[Array, ...]
) -> Array:
    """Return what a term gave at the states as an array; ModelError unless it has this shape and is finite."""
    array: Array = np.asarray(value)
    if array.shape != shape or array.dtype.kind not in "fiu":
        raise ModelError(
            f"{model.name}: the {what} of term {kind_of(term)} has shape {array.shape} and type {array.dtype}, "
            f"expected floats of shape {shape}."
        )
    if not np.isfinite(array).all():
        place = tuple(int(k) for k in np.argwhere(~np.isfinite(array))[0])
        later = {"entries": (place[1], None), "weighted gradient": place[1:]}
        sample, joint = later.get(what, place[:2])
        of = "" if joint is None else f", joint {model.joints[joint].name!r}"
        q, dq, ddq = (state[sample].tolist() for state in states[:3])
        raise ModelError(
            f"{model.name}: term {kind_of(term)} returned {array[place]} at sample {sample} in its {what}{of}, "
            f"where q = {q}, dq = {dq}, ddq = {ddq}; check both."
        )
    return array


def check_terms(model: Model) -> None:
    """Raise ModelError unless the model has terms, these have the same joints, and all parameters another name."""
    if not model.terms:
        raise ModelError(f"{model.name}: a model needs at least one term.")
    for term in model.terms:
        if not all(hasattr(term, name) for name in ("joints", "parameters", "regressor")):
            raise ModelError(f"{model.name}: a {type(term).__name__} is no term; give terms such as Viscous(joints).")
    for term in model.terms[1:]:
        if tuple(term.joints) != model.joints:
            raise ModelError(
                f"{model.name}: term {kind_of(term)} has joints {listed_joints(term.joints)}, but "
                f"{kind_of(model.terms[0])} has {listed_joints(model.joints)}; give all terms the same joints, in "
                "the same order."
            )
    seen: set[str] = set()
    for name in model.names:
        if name in seen:
            raise ModelError(
                f"{model.name}: two parameters are called {name!r}; rename one with the field 'names' of its term."
            )
        seen.add(name)


def states_of(model: Model, **given: ArrayLike) -> tuple[Array, ...]:
    """Return the arrays as floats; ModelError unless all are (N, n) with the same N."""
    arrays = {name: np.asarray(value, dtype=float) for name, value in given.items()}
    rows = next(iter(arrays.values())).shape[:1]
    for name, array in arrays.items():
        if array.ndim != 2 or array.shape != (*rows, len(model.joints)):
            raise ModelError(
                f"{model.name}: {name} has shape {array.shape}, expected ({rows[0] if rows else 'N'}, "
                f"{len(model.joints)}): one row per sample, one column per joint ({listed_joints(model.joints)})."
            )
    return tuple(arrays.values())


def theta_of(model: Model, theta: ArrayLike, rows: int | None) -> Array:
    """Return theta (p) or, unless ``rows`` is None, (rows, p) as floats; ModelError for another shape."""
    array = np.asarray(theta, dtype=float)
    p = len(model.parameters)
    if array.shape not in ((p,), (rows, p)):
        per_sample = f" or ({rows}, {p})" if rows is not None else ""
        raise ModelError(
            f"{model.name}: theta has shape {array.shape}, expected ({p},){per_sample}: {', '.join(model.names)}."
        )
    return array


def kind_of(term: Term) -> str:
    """Return the kind of a term as messages have it."""
    return type(term).__name__


def listed_joints(joints: tuple[Joint, ...]) -> str:
    """Return names and kinds of joints as messages have them."""
    return ", ".join(f"{joint.name} ({joint.kind})" for joint in joints)
