"""Ready-made models: the article's arm, a slider and a pendulum."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from types import MappingProxyType

from dynident.models.friction import Coulomb, Offset, Viscous
from dynident.models.lagrangian import Lagrangian, Unknown
from dynident.models.model import Model
from dynident.models.motor import RotorInertia
from dynident.models.term import Joint

__all__ = ["MODELS", "pendulum", "slider", "two_link_arm"]

GRAVITY = 9.81  # m/s^2


@cache
def two_link_arm() -> Model:
    """The article's planar arm of two links in a vertical plane (fig. 1, eqs. 37-40).

    q1 is zero where link 1 hangs down, q2 is relative to link 1. The printed unit of friction, N s/m, is read as
    N m s/rad, because the joints are revolute.

    >>> import numpy as np
    >>> arm = two_link_arm()
    >>> arm.names
    ('theta1', 'theta2', 'theta3', 'theta4', 'theta5', 'theta6', 'theta7')
    >>> zero = [[0.0, 0.0]]
    >>> arm.torque(q=[[np.pi / 2, 0.0]], dq=zero, ddq=zero, theta=arm.values).tolist()  # N m, held level
    [[1.4701, 0.1662]]
    """
    import sympy as sp

    q1, q2, dq1, dq2 = sp.symbols("q1 q2 dq1 dq2")
    l1, lc1, lc2, m1, m2, I1, I2, g = sp.symbols("l1 lc1 lc2 m1 m2 I1 I2 g")
    dq12 = dq1 + dq2
    v1 = (lc1 * dq1) ** 2
    v2 = (l1 * dq1) ** 2 + (lc2 * dq12) ** 2 + 2 * l1 * lc2 * sp.cos(q2) * dq1 * dq12
    height1 = -lc1 * sp.cos(q1)
    height2 = -l1 * sp.cos(q1) - lc2 * sp.cos(q1 + q2)
    joints = (Joint("joint1"), Joint("joint2"))
    links = Lagrangian(
        joints=joints,
        q=(q1, q2),
        dq=(dq1, dq2),
        kinetic=(m1 * v1 + m2 * v2 + I1 * dq1**2 + I2 * dq12**2) / 2,
        potential=g * (m1 * height1 + m2 * height2),
        unknowns=(
            Unknown(m1, "kg", 0.4347),
            Unknown(m2, "kg", 0.4322),
            Unknown(l1, "m", 0.2675),
            Unknown(lc1, "m", 0.0398),
            Unknown(lc2, "m", 0.0392),
            Unknown(I1, "kg m^2", 0.0024),
            Unknown(I2, "kg m^2", 0.0024),
        ),
        constants={g: GRAVITY},
    )
    friction = Viscous(joints, names=("theta6", "theta7"), expressions=("mu1", "mu2"), values=(0.6189, 0.6189))
    return Model((links, friction), name="two_link_arm")


@cache
def slider(width: float = 0.0, values: tuple[float, float, float, float] | None = None) -> Model:
    """A mass on a horizontal rail, with viscous and Coulomb friction and a constant offset of the force.

    ``width`` (m/s) is that of the smooth sign tanh(dq / width) in the Coulomb friction; 0 gives the discontinuous sign,
    which fits measurements best but cannot be simulated. ``values`` are M (kg), Fv (N s/m), Fc (N) and offset (N).
    """
    joints = (Joint("slider", "prismatic"),)
    known = (None if value is None else (value,) for value in values or (None,) * 4)
    mass_value, viscous_value, coulomb_value, offset_value = known
    mass = RotorInertia(joints, names=("M",), expressions=("M",), values=mass_value)  # a mass on a rail is no more
    viscous = Viscous(joints, names=("Fv",), values=viscous_value)
    coulomb = Coulomb(joints, names=("Fc",), values=coulomb_value, width=width)
    offset = Offset(joints, names=("offset",), values=offset_value)
    return Model((mass, viscous, coulomb, offset), name="slider")


@cache
def pendulum() -> Model:
    """A compound pendulum of 1 kg without friction, whose period is known in closed form.

    One joint, "pivot", q zero where it hangs down; J is the inertia about the pivot and h the first moment m*lc.

    >>> model = pendulum()
    >>> dict(zip(model.names, model.values.tolist()))
    {'J': 0.0825, 'h': 0.25}
    """
    import sympy as sp

    q, dq, m, lc, I, g = sp.symbols("q dq m lc I g")  # noqa: E741
    links = Lagrangian(
        joints=(Joint("pivot"),),
        q=(q,),
        dq=(dq,),
        kinetic=(m * lc**2 + I) * dq**2 / 2,
        potential=-m * g * lc * sp.cos(q),
        unknowns=(Unknown(m, "kg", 1.0), Unknown(lc, "m", 0.25), Unknown(I, "kg m^2", 0.02)),
        constants={g: GRAVITY},
        names=("J", "h"),
    )
    return Model((links,), name="pendulum")


MODELS: Mapping[str, Callable[[], Model]] = MappingProxyType(
    {function.__name__: function for function in (two_link_arm, slider, pendulum)}
)
"""Name -> function that builds the model; the first line of its docstring describes it."""
