"""The base of terms that act on single joints."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ModelError, choices
from dynident.models.term import Joint, Parameter, Partials

__all__ = ["PerJoint"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PerJoint(ABC):
    """Base of terms with one parameter for each joint in ``on``: tau_j = theta_j * shape(dq_j), or shape(ddq_j).

    A subclass defines ``shape``, its derivative ``slope``, and ``meaning``; ``symbol`` is the prefix of the parameters'
    names, ``role`` that of ``Parameter``, ``of`` the rate that ``shape`` depends on; ``formula`` is ``shape`` as text,
    for exports. Further fields are settings.
    """

    symbol: ClassVar[str]
    role: ClassVar[str] = ""
    of: ClassVar[Literal["dq", "ddq"]] = "dq"
    joints: tuple[Joint, ...] = field(repr=False)
    on: tuple[str, ...] | None = None
    names: tuple[str, ...] | None = None
    expressions: tuple[str, ...] | None = None
    values: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        for name in ("joints", "on", "names", "expressions", "values"):
            given = getattr(self, name)
            object.__setattr__(self, name, None if given is None else tuple(given))
        known = [joint.name for joint in self.joints]
        on = known if self.on is None else self.on
        self._check_on(on, known)
        for name in ("names", "expressions", "values"):
            given = getattr(self, name)
            if given is not None and len(given) != len(on):
                raise ModelError(f"{type(self).__name__}: {len(given)} {name} for {len(on)} joints ({', '.join(on)}).")

    def _check_on(self, on: Sequence[str], known: Sequence[str]) -> None:
        for k, name in enumerate(on):
            if name not in known:
                raise ModelError(f"{type(self).__name__}: no joint {name!r}; {choices(name, known)}")
            if name in on[:k]:
                raise ModelError(f"{type(self).__name__}: joint {name!r} is listed twice in 'on'.")

    @cached_property
    def _columns(self) -> list[int]:
        """Index of the joint that each parameter acts on."""
        known = [joint.name for joint in self.joints]
        return list(range(len(known))) if self.on is None else [known.index(name) for name in self.on]

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """One parameter per joint in ``on``, in that order."""
        joints = [self.joints[j] for j in self._columns]
        names = self.names or tuple(f"{self.symbol}_{joint.name}" for joint in joints)
        expressions = self.expressions or (self.meaning(),) * len(joints)
        values = self.values or (None,) * len(joints)
        units = [self.unit(joint) for joint in joints]
        return tuple(map(Parameter, names, units, expressions, values, (self.role,) * len(joints)))

    @property
    def support(self) -> NDArray[np.bool_]:
        """Where Y can be other than zero, shape (n, p): each parameter acts on one joint."""
        return np.asarray(np.arange(len(self.joints))[:, None] == np.array(self._columns, dtype=int))

    def entries(
        self,
        q: Array,  # noqa: ARG002
        dq: Array,
        ddq: Array,
        joint: NDArray[np.intp],
        parameter: NDArray[np.intp],
    ) -> Array:
        """Return Y[:, joint[m], parameter[m]] as rows m, shape (M, N)."""
        shapes = self.shape((dq if self.of == "dq" else ddq)[:, self._columns]).T
        return shapes[parameter] * self.support[joint, parameter][:, None]

    def regressor(self, q: Array, dq: Array, ddq: Array) -> Array:  # noqa: ARG002
        """Return Y, shape (N, n, p), for dq and ddq (N, n) in rad or m and seconds; q has no effect."""
        joints = self._columns
        rate = dq if self.of == "dq" else ddq
        out = np.zeros((*rate.shape, len(joints)))
        out[:, joints, range(len(joints))] = self.shape(rate[:, joints])
        return out

    def torque(self, q: Array, dq: Array, ddq: Array, theta: Array) -> Array:  # noqa: ARG002
        """Return Y theta, shape (N, n), for one theta (p)."""
        joints, rate = self._columns, dq if self.of == "dq" else ddq
        out = np.zeros(rate.shape)
        out[:, joints] = self.shape(rate[:, joints]) * theta
        return out

    def partials(self, q: Array, dq: Array, ddq: Array, theta: Array) -> Partials:  # noqa: ARG002
        """Return the derivatives of Y theta by q, dq and ddq, each (N, n, n); only that by ``of`` is not zero."""
        joints, zero = self._columns, np.zeros((*dq.shape, dq.shape[1]))
        rate, slope = dq if self.of == "dq" else ddq, zero.copy()
        slope[:, joints, joints] = self.slope(rate[:, joints]) * theta
        return Partials(zero, slope, zero) if self.of == "dq" else Partials(zero, zero, slope)

    def unit(self, joint: Joint) -> str:
        """Return the unit of a joint's parameter."""
        return joint.effort

    def formula(self) -> str:
        """Return ``shape`` as NumPy source, with the rate named as ``of`` says; empty where it is not known."""
        return ""

    def numpy_source(self, name: str, theta: Array) -> str:
        """Return the text of a function of q, dq and ddq that gives Y theta; ModelError without a ``formula``."""
        if not (formula := self.formula()):
            cls = type(self).__name__
            raise ModelError(f"model.py cannot hold the term {cls}: give its formula by a method `{cls}.formula`.")
        values = np.zeros(len(self.joints))
        values[self._columns] = theta
        return f"def {name}(q, dq, ddq):\n    return np.array({values.tolist()!r}) * ({formula})\n"

    @abstractmethod
    def meaning(self) -> str:
        """Return the meaning of the parameter."""

    @abstractmethod
    def shape(self, dq: Array, /) -> Array:
        """Return the torque per unit of the parameter."""

    @abstractmethod
    def slope(self, dq: Array, /) -> Array:
        """Return the derivative of ``shape``."""
