"""The kinds of terms that a joint could have besides its own, each in the size that explains most of what is left."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief
from dynident.identification.terms.candidates import KINDS, Seen
from dynident.identification.terms.samples import Samples, columns_of, samples_of
from dynident.log import Motion
from dynident.models import Joint, Loads, Model, Term

__all__ = ["Offers", "kind_of"]

Array = NDArray[np.float64]
SAMPLES = 3000  # on which sizes are compared
SMALLEST = 1e-4  # rad, m: what a joint that never moves is taken to move, so that shapes have a size
NEW = 1e-6  # share of a column that the model does not have: of less, nothing can be said


@dataclass(frozen=True, eq=False)
class Offers:
    """A ``model`` as fitted to ``samples``: what it ``left`` (N, n) of the torque, and on each motion the torque of the
    bodies, ``loads``."""

    model: Model
    samples: Samples
    left: Array
    loads: tuple[Array, ...]

    __repr__ = brief

    @classmethod
    def of(cls, model: Model, theta: Array, motions: Sequence[Motion]) -> Offers:
        """Return what can be offered to a model with the parameters theta (p), by the motions that it was fitted to."""
        samples = samples_of(model, motions, most=SAMPLES)
        left = samples.tau - model.torque(**samples.states, theta=theta)
        loaded = any(isinstance(term, Loads) and term.loads for term in model.terms)
        return cls(model, samples, left, samples.loads(model.loaded(theta).load if loaded else None))

    def at(self, j: int) -> Iterator[tuple[str, tuple[Term, ...]]]:
        """Yield all kinds for a joint, by name, with the term alone on it."""
        joint = self.model.joints[j]
        kept = self.samples.keep[:, j]
        structure = self.model.structure
        columns = structure.columns[j]
        rows = self.model.entries(**self.samples.states, joint=np.full(len(columns), j), parameter=columns)[:, kept]
        basis, known = _basis(rows), set[str]()
        loaded = any(one.any() for one in self.loads)
        for kind in KINDS:
            if kind.name not in known and (loaded or not kind.needs_load):
                known.add(kind.name)
                sizes = kind.sizes(self._seen(joint, j))
                gains = [self._gain(term, j, kept, basis) for term in sizes] if len(sizes) > 1 else [0.0]
                yield kind.name, (sizes[int(np.argmax(gains))],)

    def _seen(self, joint: Joint, j: int) -> Seen:
        q, dq = (self.samples.states[name][:, j] for name in ("q", "dq"))
        speed, reach = (max(float(x), SMALLEST) for x in (np.sqrt(np.mean(dq**2)), np.ptp(q)))
        return Seen(self.model.joints, joint, speed, reach, max(float(np.ptp(one.t)) for one in self.samples.motions))

    def _gain(self, term: Term, j: int, kept: NDArray[np.bool_], basis: Array) -> float:
        """Return what a term removes of the squared residual of a joint, beside the terms that it has."""
        new = columns_of(self.samples, term, j, self.loads)[:, kept]
        rest = new - (new @ basis) @ basis.T
        if np.linalg.norm(rest) <= NEW * np.linalg.norm(new):
            return 0.0
        turned = _basis(rest)
        return float(np.square(self.left[kept, j] @ turned).sum())


def _basis(rows: Array) -> Array:
    """Return orthonormal columns (N, r) that span rows (b, N)."""
    size = np.linalg.norm(rows, axis=1)
    U, s, _ = np.linalg.svd((rows[size > 0] / size[size > 0, None]).T, full_matrices=False)
    return U[:, s > 1e-8 * s.max(initial=0.0)]


def kind_of(term: Term) -> str:
    """Return the kind of a term: the name by which a configuration lists it, for others that of its class."""
    return _NAMES.get(type(term), type(term).__name__)


def _names() -> dict[type, str]:
    joint = Joint("joint")
    return {type(kind.sizes(Seen((joint,), joint, 1.0, 1.0, 1.0))[0]): kind.name for kind in KINDS}


_NAMES = _names()
