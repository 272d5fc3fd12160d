"""Rigid-body dynamics from symbolic kinetic and potential energies: article, eqs. (1)-(8) and (40)."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np

from dynident.models.friction import Coulomb, Offset, Viscous
from dynident.models.lumping import Lump, Monomial, compile_expressions, lump_parameters
from dynident.models.model import Model
from dynident.models.motor import RotorInertia
from dynident.models.term import Joint, Parameter, Partials, Term, check_joints
from dynident.runtime import ModelError, install_command, join_names
from dynident.runtime.arrays import Array

_FACTOR = r"(1|[^\W\d_]+(\^-?\d+)?)"
_UNIT = re.compile(rf"{_FACTOR}( {_FACTOR})*(/{_FACTOR}( {_FACTOR})*)?")


@dataclass(frozen=True)
class Unknown:
    """An unknown physical parameter: its SymPy symbol, its unit such as ``"kg m^2"``, its value if known (SI).

    Raises ModelError for a unit that is not a product of powers, with at most one ``/``.
    """

    symbol: Any
    unit: str
    value: float | None = None

    def __post_init__(self) -> None:
        if not _UNIT.fullmatch(self.unit):
            raise ModelError(
                f"unknown {self.symbol}: cannot read the unit {self.unit!r}; write it like 'kg m^2', 'N s/m' or '1'."
            )


@dataclass(frozen=True, eq=False)
class Lagrangian(Term):
    """The Euler-Lagrange torque of n joints, linear in p lumped parameters (article, eqs. 1-8).

    ``q``, ``dq`` are n SymPy symbols each, for positions (rad or m) and their rates; ``kinetic`` and ``potential``
    are energies (J) in them, in the ``unknowns``, and in the ``constants`` (symbol -> number), which are substituted as
    exact decimals. ``names`` of the lumped parameters default to theta1, theta2, ...

    Each product of unknowns in the energies contributes n functions of (q, dq, ddq) to the torque. Products with
    proportional functions are lumped into one parameter (eq. 40): a sum, scaled so that its product of lowest degree,
    then first in order of declaration, has factor one. Products without any torque are dropped. Functions are
    compared at random states with 50 digits. Linear dependence among three or more parameters is not removed.

    Order of the parameters: those of the kinetic energy, then those of the potential energy only; among the
    kinetic, constant inertia before inertia that changes with q; then by the last joint acted upon, which orders a
    chain from base to tip; then by degree and declaration of the unknowns.

    Raises ModelError where the numbers of symbols do not match, an energy holds an undeclared symbol or is not
    polynomial in the unknowns, the kinetic energy is not quadratic in dq, the potential energy depends on dq, or a
    part of the torque holds no unknown.

    A mass on a rail that is inclined by 30 degrees:

    >>> import dynident as dy
    >>> import sympy as sp
    >>> from dynident.models import Unknown
    >>> q, dq, m = sp.symbols("q dq m")
    >>> rail = dy.Joint("rail", "prismatic")
    >>> dy.Lagrangian((rail,), (q,), (dq,), m * dq**2 / 2, 9.81 * m * q / 2, (Unknown(m, "kg", 3.0),), names=("m",))
    <Lagrangian of rail: m>
    """

    loads: ClassVar[bool] = True
    joints: tuple[Joint, ...]
    q: tuple[Any, ...]
    dq: tuple[Any, ...]
    kinetic: Any
    potential: Any
    unknowns: tuple[Unknown, ...]
    constants: Mapping[Any, float] = field(default_factory=dict)
    names: tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "joints", check_joints(self, self.joints))
        for name in ("q", "dq", "unknowns"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        object.__setattr__(self, "constants", dict(self.constants))
        _check_symbols(self)
        lumps = self._lumps
        if self.names is not None and len(self.names) != len(lumps):
            formulas = "; ".join(str(lump.expression) for lump in lumps)
            raise ModelError(f"Lagrangian: {len(self.names)} names for {len(lumps)} lumped parameters: {formulas}.")

    def __repr__(self) -> str:
        joints = join_names((joint.name for joint in self.joints), 6)
        return f"<Lagrangian of {joints}: {join_names((parameter.name for parameter in self.parameters), 6)}>"

    @cached_property
    def _ddq(self) -> tuple[Any, ...]:
        import sympy as sp

        return tuple(sp.Dummy(f"ddq{i + 1}") for i in range(len(self.q)))

    @cached_property
    def _lumps(self) -> tuple[Lump, ...]:
        symbols = [unknown.symbol for unknown in self.unknowns]
        kinetic, potential = _energy(self, "kinetic"), _energy(self, "potential")
        velocities = sorted(str(s) for s in potential.free_symbols & set(self.dq))
        if velocities:
            raise ModelError(f"Lagrangian: the potential energy depends on {velocities[0]}; it may depend on q only.")
        return lump_parameters(kinetic, potential, self.q, self.dq, self._ddq, symbols)

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """The p lumped parameters: name, unit, formula, and value (SI) where all unknowns in it have one."""
        names = self.names or tuple(f"theta{k + 1}" for k in range(len(self._lumps)))
        values = {u.symbol: u.value for u in self.unknowns if u.value is not None}
        units = [u.unit for u in self.unknowns]
        return tuple(
            Parameter(name, _unit(units, lump.leader), str(lump.expression), _value(lump.expression, values))
            for name, lump in zip(names, self._lumps, strict=True)
        )

    def regressor(self, q: Array, dq: Array, ddq: Array) -> Array:
        """Return Z of tau = Z theta (article, eq. 8), shape (N, n, p), for q, dq, ddq of shape (N, n) in SI units."""
        flat = self._compiled(q.T, dq.T, ddq.T)
        return _stack(flat, (len(q), len(self.joints), len(self._lumps)))

    def mass_and_bias(self, q: Array, dq: Array, theta: Array) -> tuple[Array, Array]:
        """Return the mass matrix (N, n, n) and the torque at ddq = 0 (N, n) for one theta (p): article, eq. (4)."""
        n, single = len(self.joints), len(q) == 1  # a single state, as in a simulation, is faster in plain numbers
        states = (q[0].tolist(), dq[0].tolist(), theta.tolist()) if single else (q.T, dq.T, theta)
        stacked = _stack(self._compiled_mass(*states), (len(q), n + 1, n))
        return stacked[:, 1:], stacked[:, 0]

    def partials(self, q: Array, dq: Array, ddq: Array, theta: Array) -> Partials:
        """Return the derivatives of Z theta by q, dq and ddq, each (N, n, n); they are symbolic, compiled once."""
        flat = self._compiled_partials(q.T, dq.T, ddq.T, theta)
        n = len(self.joints)
        by_q, by_dq, by_ddq = np.moveaxis(_stack(flat, (len(q), 3, n, n)), 1, 0)
        return Partials(by_q, by_dq, by_ddq)

    def torques(self, theta: Array) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
        """Return the symbols of q, dq and ddq (3 n), and the n torques in them for the parameters theta (p)."""
        import sympy as sp

        # 17 digits keep every double as it is
        total = [
            sp.Add(*(sp.Float(float(x), 17) * lump.torque[i] for x, lump in zip(theta, self._lumps, strict=True)))
            for i in range(len(self.q))
        ]
        return (*self.q, *self.dq, *self._ddq), tuple(total)

    def texts(self) -> tuple[tuple[str, ...], ...]:
        """Return the torque (n, p) at each joint per unit of each parameter as text, in ``q``, ``dq`` and their rates.

        The acceleration of the joint with the index i is called ddq_i there, counted from 1.
        """
        import sympy as sp

        rates = {atom: sp.Symbol(f"ddq_{i + 1}") for i, atom in enumerate(self._ddq)}
        # constants became fractions: write those with a long denominator as decimals again
        exact = {atom for lump in self._lumps for torque in lump.torque for atom in torque.atoms(sp.Rational)}
        decimals = {atom: sp.Float(float(atom), 6) for atom in exact if atom.q > 9}  # 981/100 is 9.81
        torques = [[lump.torque[i].xreplace(rates | decimals) for lump in self._lumps] for i in range(len(self.q))]
        return tuple(tuple(map(str, row)) for row in torques)

    @cached_property
    def _compiled(self) -> Callable[..., Sequence[Any]]:
        torques = [lump.torque[i] for i in range(len(self.q)) for lump in self._lumps]
        return compile_expressions((self.q, self.dq, self._ddq), torques)

    @cached_property
    def _compiled_partials(self) -> Callable[..., Sequence[Any]]:
        import sympy as sp

        theta, torques = self._symbolic_torques
        # differentiate the torques weighted by theta: n functions in place of n p
        slopes = [sp.diff(tau, s) for by in (self.q, self.dq, self._ddq) for tau in torques for s in by]
        return compile_expressions((self.q, self.dq, self._ddq, theta), slopes)

    @cached_property
    def _compiled_mass(self) -> Callable[..., Sequence[Any]]:
        import sympy as sp

        theta, torques = self._symbolic_torques
        # the torque is linear in ddq: its slopes are the mass matrix, the rest is the bias
        still = dict.fromkeys(self._ddq, 0)
        mass = [sp.diff(tau, s) for tau in torques for s in self._ddq]
        return compile_expressions((self.q, self.dq, theta), [*(tau.subs(still) for tau in torques), *mass])

    @property
    def _symbolic_torques(self) -> tuple[tuple[Any, ...], list[Any]]:
        """Symbols of the parameters (p), and the torques (n) in them."""
        import sympy as sp

        theta = tuple(sp.Dummy(f"theta{k + 1}") for k in range(len(self._lumps)))
        pairs = [[(s, lump.torque[i]) for s, lump in zip(theta, self._lumps, strict=True)] for i in range(len(self.q))]
        return theta, [sp.Add(*(s * torque for s, torque in row)) for row in pairs]

    def __getstate__(self) -> dict[str, Any]:
        compiled_names = ("_compiled", "_compiled_mass", "_compiled_partials")  # such functions cannot be pickled
        return {name: value for name, value in self.__dict__.items() if name not in compiled_names}


def _check_symbols(model: Lagrangian) -> None:
    n = len(model.joints)
    if not n or len(model.q) != n or len(model.dq) != n:
        raise ModelError(
            f"Lagrangian: {n} joints, but {len(model.q)} symbols in q and {len(model.dq)} in dq; "
            "give one of each per joint."
        )
    declared = [*model.q, *model.dq, *(u.symbol for u in model.unknowns), *model.constants]
    duplicates = [str(s) for k, s in enumerate(declared) if s in declared[:k]]
    if duplicates:
        raise ModelError(f"Lagrangian: {duplicates[0]} is declared twice among q, dq, the unknowns and the constants.")


def _energy(model: Lagrangian, which: str) -> Any:
    """Return an energy with its constants substituted exactly; ModelError where it holds an undeclared symbol."""
    import sympy as sp

    # exact fractions, so that proportional functions can be recognised as such
    exact = {s: sp.Rational(str(value)) for s, value in model.constants.items()}
    energy = sp.nsimplify(sp.sympify(getattr(model, which)).subs(exact), rational=True)
    declared = {*model.q, *model.dq, *(u.symbol for u in model.unknowns)}
    undeclared = sorted(str(s) for s in energy.free_symbols - declared)
    if undeclared:
        raise ModelError(
            f"Lagrangian: the {which} energy holds undeclared {', '.join(undeclared)}; make each an Unknown "
            "or a constant "
            f"(with the same SymPy assumptions). Declared: {', '.join(sorted(map(str, declared)))}."
        )
    return energy


def _value(expression: Any, values: Mapping[Any, float]) -> float | None:
    return float(expression.subs(values)) if expression.free_symbols <= values.keys() else None


def _unit(units: Sequence[str], powers: Monomial) -> str:
    """Return the unit of a product of powers: ``_unit(["kg", "m"], (1, 2))`` is ``"kg m^2"``."""
    # count the power of each base unit, then write positive powers above the line and negative ones below
    total: Counter[str] = Counter()
    for unit, times in zip(units, powers, strict=True):
        for base, power in _factors(unit) if times else ():
            total[base] += times * power
    total.pop("1", None)
    above, below = (
        [base if sign * k == 1 else f"{base}^{sign * k}" for base, k in total.items() if sign * k > 0]
        for sign in (1, -1)
    )
    return (" ".join(above) or "1") + ("/" if below else "") + " ".join(below)


def _factors(unit: str) -> Iterator[tuple[str, int]]:
    """Yield the bases of a unit with their powers: ``"kg m^2/s"`` has kg, m^2 and s^-1."""
    for side, factors in enumerate(unit.split("/")):
        for factor in factors.split():
            base, _, power = factor.partition("^")
            yield base, (1 - 2 * side) * int(power or 1)


def _stack(flat: Sequence[Any], shape: tuple[int, ...]) -> Array:
    """Stack functions of the samples, some of them constant, into an array of the given shape (N, ...)."""
    out = np.empty((shape[0], len(flat)))
    for column, value in enumerate(flat):
        out[:, column] = value
    return out.reshape(shape)


def _import_sympy(model: str) -> Any:
    """Return SymPy; ModelError where it is not installed."""
    try:
        import sympy
    except ImportError as error:
        words = f"the model {model!r} is derived by SymPy (the extra `dynident[symbolic]`)"
        raise ModelError(f"{words}; install it: {install_command('sympy')}") from error
    return sympy


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
    sp = _import_sympy("two_link_arm")
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
    nominal = (None if value is None else (value,) for value in values or (None,) * 4)
    mass_value, viscous_value, coulomb_value, offset_value = nominal
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
    sp = _import_sympy("pendulum")
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
