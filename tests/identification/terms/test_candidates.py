"""Terms on single joints become one per class; rates and delays of a ripple are found where they are."""

import numpy as np
import pytest
from numpy.typing import NDArray

from dynident.identification.terms.candidates import LENGTHS, WIDE_WIDTHS, WIDTHS, JointExcitation, combine_terms
from dynident.identification.terms.ripples import PositionResidual, largest_lines, ripple_kinds
from dynident.identification.terms.samples import select_samples
from dynident.models import Joint, Model
from dynident.models.friction import Coulomb, Ripple, Viscous
from tests.identification.terms.simulated import bodies, none, recorded

JOINTS = tuple(map(Joint, ("a", "b", "c")))


def test_the_regressor_of_the_whole_is_that_of_the_parts() -> None:
    parts = [
        [Viscous(JOINTS, on=("a",)), Coulomb(JOINTS, on=("a",), width=0.1)],
        [Coulomb(JOINTS, on=("b",), width=0.2)],
        [
            Viscous(JOINTS, on=("c",)),
            Ripple(JOINTS, on=("c",), cycles=(10.0,)),
            Ripple(JOINTS, on=("c",), cycles=(7.0,)),
        ],
    ]
    full = Model(combine_terms(JOINTS, parts))
    single = {x.parameters[k].name: x.regressor for some in parts for x in some for k in [0]}
    q, dq, ddq = np.random.default_rng(0).normal(size=(3, 20, 3))
    Y = full.regressor(q, dq, ddq)
    assert [type(term).__name__ for term in full.terms] == ["Viscous", "Coulomb", "Ripple"]
    assert len(full.names) == 8
    for name, regressor in single.items():
        assert np.allclose(Y[:, :, full.names.index(name)], regressor(q, dq, ddq)[:, :, 0])


@pytest.mark.parametrize(
    ("grid", "first", "last"), [(WIDTHS, 0.005, 0.43368), (WIDE_WIDTHS, 0.1, 1.16415), (LENGTHS, 1e-4, 0.0413590)]
)
def test_grids_are_geometric(grid: tuple[float, ...], first: float, last: float) -> None:
    np.testing.assert_allclose(grid, np.geomspace(first, last, len(grid)), rtol=1e-4)


def test_ripples_of_one_joint_keep_their_delays() -> None:
    early, delayed = (Ripple(JOINTS, on=("c",), cycles=(k,), delay=d) for k, d in ((10.0, -0.002), (7.0, 0.004)))
    elsewhere = Ripple(JOINTS, on=("a",), cycles=(5.0,), delay=0.001)
    result = combine_terms(JOINTS, [[elsewhere], [], [early, delayed]])
    assert [x.acts_on for x in result] == [("a", "c"), ("c",)]  # type: ignore[attr-defined]
    q, dq, ddq = np.random.default_rng(0).normal(size=(3, 20, 3))
    regressor = Model(result).regressor(q, dq, ddq)
    parts = Model((elsewhere, early, delayed)).regressor(q, dq, ddq)
    assert np.allclose(regressor, parts)


Array = NDArray[np.float64]
T = np.linspace(0.0, 20.0, 8000)
Q, DQ = 1.5 * np.sin(T) + 0.4 * np.sin(2.3 * T), 1.5 * np.cos(T) + 0.92 * np.cos(2.3 * T)
BLOCK = np.arange(len(T)) * 8 // len(T)


def left(r: Array, *, q: Array = Q, turns: bool = True) -> PositionResidual:
    return PositionResidual(q, DQ, r, BLOCK, 8, turns)


def noisy(r: Array, size: float = 1.0) -> Array:
    return r + size * np.random.default_rng(0).normal(size=len(T))


@pytest.mark.parametrize(("rate", "delay", "noise"), [(45.4, 0.0, 0.3), (120.3, 0.007, 1.0)])
def test_rate_and_delay_of_a_ripple_are_found(rate: float, delay: float, noise: float) -> None:
    result = largest_lines(left(noisy(np.sin(rate * (Q - delay * DQ) + 0.3), noise)), 200.0)
    assert result
    assert (np.abs(np.subtract(result, (rate, delay))) < (0.15, 0.0011)).all()


def test_whole_rates_are_preferred_where_the_joint_turns() -> None:
    r = noisy(np.sin(45.0 * Q + 0.3), 2.0)
    assert {k for k, _ in largest_lines(left(r), 200.0)} == {45.0}
    assert 45.0 not in {k for k, _ in largest_lines(left(r, turns=False), 200.0)}


def test_joints_that_stand_and_slow_waves_show_no_ripple() -> None:
    assert largest_lines(left(np.ones(len(T)), q=np.zeros(len(T))), 200.0) == ()
    assert largest_lines(left(np.sin(2.0 * Q)), 200.0) == ()
    reach = float(np.ptp(Q))
    assert all(k * reach > 4.0 * 2.0 * np.pi - 2.0 for k, _ in largest_lines(left(np.sin(6.0 * Q)), 200.0))


def test_a_rate_is_tried_once_and_higher_where_a_joint_slides() -> None:
    samples, (joint, *_) = select_samples(Model((bodies(),)), [recorded(none, 1)]), bodies().joints
    excitation = JointExcitation(bodies().joints, joint, 0.5, 1.0, 20.0)
    wave = np.sin(32 * samples.states["q"][:, 0])
    kinds = ripple_kinds(samples, excitation, wave, samples.block, ())
    assert [kind.name for kind in kinds] == ["ripple", "load_ripple"]
    assert ripple_kinds(samples, excitation, wave, samples.block, kinds) == []
    for turns, rates in ((True, set()), (False, {628})):
        assert {round(k) for k, _ in largest_lines(left(np.sin(628 * Q), turns=turns), 1e3)} == rates  # a 1 cm screw
