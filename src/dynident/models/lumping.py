"""Euler-Lagrange torques of symbolic energies, lumped into linear parameters: article, eqs. (1)-(8) and (40)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynident.runtime import ModelError, Noun

Symbols = Sequence[Any]
Monomial = tuple[int, ...]  # powers of the unknowns, in order of declaration

DIGITS = 50  # working precision of the comparison of functions
EQUALITY_TOLERANCE = 1e-30  # functions that differ by less are equal
POINTS = 4  # random states at which functions are compared


@dataclass(frozen=True)
class Lump:
    """A lumped parameter: its formula, the monomial in it that has factor one, and its n torques per unit."""

    expression: Any
    leader: Monomial
    torque: tuple[Any, ...]


class _Share(Noun):
    """What one monomial of the unknowns contributes: n torques, and their values (POINTS, n) at random states."""

    monomial: Monomial
    torque: tuple[Any, ...]
    samples: NDArray[np.object_]
    kinetic: bool
    varying: bool

    @property
    def rank(self) -> tuple[int, Monomial]:
        """Lowest degree first, then the order of declaration."""
        return sum(self.monomial), tuple(-power for power in self.monomial)

    def ratio(self, reference: _Share) -> Any:
        """Return c with torque = c * other.torque, or None where there is none."""
        import mpmath  # type: ignore[import-untyped]

        # divide at the largest value of the reference, where the ratio is most accurate
        pivot = np.unravel_index(np.argmax(np.abs(reference.samples)), reference.samples.shape)
        c = mpmath.mpmathify(self.samples[pivot]) / reference.samples[pivot]
        scale = np.abs(self.samples).max()
        return c if np.abs(self.samples - c * reference.samples).max() <= EQUALITY_TOLERANCE * scale else None


ShareGroup = list[tuple[_Share, Any]]  # proportional shares with their ratios to the first


def lump_parameters(
    kinetic: Any, potential: Any, q: Symbols, dq: Symbols, ddq: Symbols, unknowns: Symbols
) -> tuple[Lump, ...]:
    """Return the lumped parameters of the torque of two energies, in the order that ``Lagrangian`` documents.

    The energies are SymPy expressions with exact numbers in no other symbols than q, dq and the unknowns.
    Raises ModelError where the kinetic energy is not quadratic in dq, an energy is not polynomial in an unknown,
    or a part of the torque contains no unknown.
    """
    import mpmath

    groups: list[ShareGroup] = []
    with mpmath.workdps(DIGITS):
        shares = _make_shares(_split_energies(kinetic, potential, dq, unknowns), q, dq, ddq)
        # in order of rank, so that the share of lowest degree leads its group
        for share in sorted(shares, key=lambda share: share.rank):
            if not any(share.monomial):
                raise ModelError(
                    "Lagrangian: a part of the energies holds no unknown, so its torque has no parameter; "
                    "declare one of its factors (a mass, say) as an Unknown."
                )
            for group in groups:
                if (ratio := share.ratio(group[0][0])) is not None:
                    group.append((share, ratio))
                    break
            else:
                groups.append([(share, mpmath.mpf(1))])
    groups.sort(key=_sort_key)
    return tuple(_make_lump(group, unknowns) for group in groups)


def compile_expressions(arguments: Any, expressions: Symbols, module: str = "numpy") -> Callable[..., Sequence[Any]]:
    """Return a function of the arguments that gives the values of all expressions as one list."""
    import sympy as sp

    function: Callable[..., Sequence[Any]] = sp.lambdify(arguments, list(expressions), modules=module, cse=True)
    return function


def _split_energies(kinetic: Any, potential: Any, dq: Symbols, unknowns: Symbols) -> dict[Monomial, list[Any]]:
    """Return per monomial of the unknowns the factors [kinetic, potential] that multiply it."""
    import sympy as sp

    n = len(dq)
    parts: dict[Monomial, list[Any]] = {}
    for powers, factor in _terms(kinetic, (*dq, *unknowns), "kinetic"):
        # powers begin with those of dq: the kinetic energy must be of degree two in these
        if factor != 0 and sum(powers[:n]) != 2:
            culprit = _product((*dq, *unknowns), powers) * factor
            raise ModelError(f"Lagrangian: the kinetic energy must be quadratic in dq (eq. 3), but holds {culprit}.")
        parts.setdefault(powers[n:], [sp.S.Zero, sp.S.Zero])[0] += factor * _product(dq, powers[:n])
    for powers, factor in _terms(potential, unknowns, "potential"):
        parts.setdefault(powers, [sp.S.Zero, sp.S.Zero])[1] += factor
    return parts


def _terms(energy: Any, symbols: Symbols, which: str) -> Iterable[tuple[Monomial, Any]]:
    import sympy as sp

    for symbol in symbols:
        if not energy.is_polynomial(symbol):
            raise ModelError(
                f"Lagrangian: the {which} energy is not polynomial in {symbol}; declare another unknown "
                f"(a product such as m*cos({symbol}), say), or make {symbol} a constant."
            )
    terms: Iterable[tuple[Monomial, Any]] = sp.Poly(energy, *symbols).terms() if symbols else [((), energy)]
    return terms


def _product(symbols: Symbols, powers: Monomial) -> Any:
    import sympy as sp

    return sp.Mul(*(symbol**power for symbol, power in zip(symbols, powers, strict=True)))


def _inertial_torques(kinetic: Any, q: Symbols, dq: Symbols, ddq: Symbols) -> tuple[Any, ...]:
    """Return d/dt(dT/d(dq)) - dT/dq by the chain rule: article, eq. (1)."""
    import sympy as sp

    rates = list(zip((*dq, *q), (*ddq, *dq), strict=True))
    momenta = (sp.diff(kinetic, velocity) for velocity in dq)
    return tuple(
        sp.Add(*(sp.diff(momentum, s) * rate for s, rate in rates)) - sp.diff(kinetic, position)
        for momentum, position in zip(momenta, q, strict=True)
    )


def _make_shares(parts: dict[Monomial, list[Any]], q: Symbols, dq: Symbols, ddq: Symbols) -> list[_Share]:
    """Return what each monomial adds to the torque, without those that add nothing."""
    import sympy as sp

    n = len(q)
    inertial = [_inertial_torques(kinetic, q, dq, ddq) for kinetic, _ in parts.values()]
    static = [tuple(sp.diff(potential, s) for s in q) for _, potential in parts.values()]
    # one function for all torques at all states: common subexpressions are evaluated once
    function = compile_expressions((q, dq, ddq), sp.flatten([inertial, static]), "mpmath")
    states = _random_states(n)
    moving = np.array([function(*state) for state in states], dtype=object).reshape(POINTS, 2, -1, n)
    # without acceleration the inertial torque is that of the changes of the inertia with q
    coasting = np.array([function(q, dq, [0] * n) for q, dq, _ in states], dtype=object).reshape(moving.shape)
    shares = [
        _Share(
            monomial=monomial,
            torque=tuple(a + b for a, b in zip(inertial[k], static[k], strict=True)),
            samples=moving[:, 0, k] + moving[:, 1, k],
            kinetic=_is_nonzero(moving[:, 0, k]),
            varying=_is_nonzero(coasting[:, 0, k]),
        )
        for k, monomial in enumerate(parts)
    ]
    return [share for share in shares if _is_nonzero(share.samples)]


def _random_states(n: int) -> list[list[list[Any]]]:
    """Return POINTS random q, dq, ddq; positive, so that roots and logarithms of q stay real."""
    import mpmath

    points = np.random.default_rng(20).uniform(0.1, 1.1, (POINTS, 3, n))
    return [[[mpmath.mpf(x) for x in row] for row in point] for point in points]


def _is_nonzero(samples: NDArray[np.object_]) -> bool:
    """Return whether a function is nonzero at any of the states."""
    return bool(np.abs(samples).max() > EQUALITY_TOLERANCE)


def _sort_key(group: ShareGroup) -> tuple[bool, bool, int, tuple[int, Monomial]]:
    shares = [share for share, _ in group]
    acts_on = [_is_nonzero(column) for column in shares[0].samples.T]
    last_joint = max(joint for joint, acts in enumerate(acts_on) if acts)
    return not any(s.kinetic for s in shares), any(s.varying for s in shares), last_joint, shares[0].rank


def _make_lump(group: ShareGroup, unknowns: Symbols) -> Lump:
    import sympy as sp

    leader = group[0][0]
    expression = sp.Add(*(_readable(ratio) * _product(unknowns, share.monomial) for share, ratio in group))
    return Lump(expression, leader.monomial, leader.torque)


def _readable(ratio: Any) -> Any:
    """Return a simple fraction exactly, any other number as a short decimal."""
    import sympy as sp

    # ratios such as 1/2 are found as fractions; others would only be noise in digits
    fraction = sp.nsimplify(sp.Float(ratio, DIGITS), rational=True, tolerance=EQUALITY_TOLERANCE)
    return fraction if fraction.q <= 100 else sp.Float(repr(float(ratio)))
