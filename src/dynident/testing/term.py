"""What every term of a model promises."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ModelError
from dynident.models import (
    FUNCTIONS,
    HasEquations,
    HasGravity,
    HasMassMatrix,
    HasMemory,
    HasNumpySource,
    HasSign,
    Model,
    Past,
    Term,
)

__all__ = ["TERM_CHECKS", "check_term", "states"]

Array = NDArray[np.float64]


def check_term(term: Term) -> None:
    """Raise AssertionError unless the term keeps all promises of its family.

    It is tried at positions within 0.2 and 1.2 rad or m, and speeds within 0.4 and 2 per s, of either sign.
    """
    for check in TERM_CHECKS:
        check(term)


def states(n: int, seed: int = 0, samples: int = 6) -> tuple[Array, Array, Array]:
    """Return q, dq, ddq (samples, n), with velocities off the jumps of dry friction."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(0.2, 1.2, (samples, n))
    return q, rng.choice([-1, 1], (samples, n)) * rng.uniform(0.4, 2.0, (samples, n)), rng.normal(size=(samples, n))


def memory_of(term: Term, samples: int = 6) -> tuple[Array, ...]:
    """Return a memory (samples, m) of a term that has one, as the last of its arguments."""
    rng = np.random.default_rng(3)
    return (rng.uniform(-1.0, 1.0, (samples, term.memory)),) if isinstance(term, HasMemory) else ()


def describes_its_parameters(term: Term) -> None:
    """Parameters have distinct names, units and meanings."""
    names = [parameter.name for parameter in term.parameters]
    assert len(set(names)) == len(names) > 0, "names are distinct, and there is one"
    assert all(x.name and x.unit and x.expression for x in term.parameters), "each has a name, unit and expression"


def returns_finite_arrays(term: Term) -> None:
    """Regressor and derivatives have the right shapes for any number of samples."""
    n, p = len(term.joints), len(term.parameters)
    for samples in (0, 1, 5):
        state, own = states(n, samples=samples), memory_of(term, samples)
        Y, slopes = term.regressor(*state, *own), term.partials(*state, np.ones(p), *own)
        assert Y.shape == (samples, n, p), f"the regressor has shape {Y.shape}, expected {(samples, n, p)}"
        for array in (slopes.q, slopes.dq, slopes.ddq):
            assert array.shape == (samples, n, n), f"a derivative has shape {array.shape}"
        for array in (Y, slopes.q, slopes.dq, slopes.ddq):
            assert np.isfinite(array).all()
            assert array.dtype == float


def has_the_torque_of_its_regressor(term: Term) -> None:
    """A ``torque`` of its own is that of the regressor."""
    state, theta = states(len(term.joints)), np.linspace(0.5, 1.5, len(term.parameters))
    own, model = memory_of(term), Model((term,))
    whole = term.regressor(*state, *own) @ theta
    allowed = 1e-11 * np.abs(whole).max()
    np.testing.assert_allclose(model.torque(*state, theta, *own), whole, rtol=1e-11, atol=allowed)
    many = np.tile(theta, (len(whole), 1))
    np.testing.assert_allclose(model.torque(*state, many, *own), whole, rtol=1e-11, atol=allowed)


def has_the_mass_matrix_of_its_regressor(term: Term) -> None:
    """A mass matrix of its own, with the torque without acceleration, is that of the regressor."""
    if not isinstance(term, HasMassMatrix):
        return
    (q, dq, _), theta = states(len(term.joints)), np.linspace(0.5, 1.5, len(term.parameters))
    mass, bias = term.mass_and_bias(q, dq, theta)
    still = term.regressor(q, dq, np.zeros_like(q)) @ theta
    allowed = 1e-11 * max(np.abs(still).max(), np.abs(mass).max())
    np.testing.assert_allclose(bias, still, rtol=1e-11, atol=allowed)
    for k, unit in enumerate(np.eye(q.shape[1])):
        column = term.regressor(q, dq, np.tile(unit, (len(q), 1))) @ theta - still
        np.testing.assert_allclose(mass[:, :, k], column, rtol=1e-11, atol=allowed)


def has_the_entries_of_its_regressor(term: Term) -> None:
    """``support`` and ``entries`` are those of the regressor, where they are said; its structure holds all of it."""
    state, model, own = states(len(term.joints)), Model((term,)), memory_of(term)
    whole, structure = term.regressor(*state, *own), model.structure
    assert not whole[:, ~model.support].any(), "the regressor is zero where there is no support"
    allowed = 1e-12 * np.abs(whole).max()
    joint, parameter = np.nonzero(np.ones_like(model.support))
    every = model.entries(*state, joint, parameter, *own)
    np.testing.assert_allclose(every, whole[:, joint, parameter].T, rtol=1e-12, atol=allowed)
    entries = model.entries(*state, structure.joint, structure.parameter, *own)
    for j, (part, columns) in enumerate(zip(structure.parts, structure.maps, strict=True)):
        np.testing.assert_allclose(entries[part].T @ columns, whole[:, j], rtol=1e-11, atol=10 * allowed)


def works_row_by_row(term: Term) -> None:
    """Samples do not depend on each other."""
    state, theta = states(len(term.joints)), np.linspace(0.5, 1.5, len(term.parameters))
    own = memory_of(term)
    q, dq, ddq = state
    rows = [((q[k : k + 1], dq[k : k + 1], ddq[k : k + 1]), [one[k : k + 1] for one in own]) for k in range(len(q))]
    single = np.concatenate([term.regressor(*row, *mine) for row, mine in rows])
    np.testing.assert_allclose(term.regressor(*state, *own), single, rtol=1e-13)
    for name in ("q", "dq", "ddq"):
        whole = getattr(term.partials(*state, theta, *own), name)
        slopes = [getattr(term.partials(*row, theta, *mine), name) for row, mine in rows]
        np.testing.assert_allclose(whole, np.concatenate(slopes), rtol=1e-12, atol=1e-14)


def does_not_change_its_arguments(term: Term) -> None:
    """Read-only arrays will do, and the same arrays give the same regressor."""
    state, own = states(len(term.joints)), memory_of(term)
    for x in (*state, *own):
        x.flags.writeable = False
    term.partials(*state, np.ones(len(term.parameters)), *own)
    np.testing.assert_array_equal(term.regressor(*state, *own), term.regressor(*state, *own))


def survives_pickling(term: Term) -> None:
    """A copy in another process is the same term."""
    state, theta = states(len(term.joints)), np.ones(len(term.parameters))
    own = memory_of(term)
    Y, slope = term.regressor(*state, *own), term.partials(*state, theta, *own).dq
    copy = pickle.loads(pickle.dumps(term))
    assert (copy.joints, copy.parameters) == (term.joints, term.parameters)
    np.testing.assert_array_equal(copy.regressor(*state, *own), Y)
    np.testing.assert_array_equal(copy.partials(*state, theta, *own).dq, slope)


def has_partials_linear_in_theta(term: Term) -> None:
    """The torque is linear in the parameters, and so are its derivatives."""
    state, (a, b) = states(len(term.joints)), np.random.default_rng(1).normal(size=(2, len(term.parameters)))
    for name in ("q", "dq", "ddq"):
        one, two, both = (getattr(term.partials(*state, x, *memory_of(term)), name) for x in (a, b, 2 * a - b))
        np.testing.assert_allclose(both, 2 * one - two, rtol=1e-10, atol=1e-12)


def has_partials_that_are_slopes(term: Term) -> None:
    """Central differences of fourth order, at constant memory."""
    state, own, h = states(len(term.joints)), memory_of(term), 1e-3
    theta = np.random.default_rng(2).uniform(0.5, 1.5, len(term.parameters))
    slopes = term.partials(*state, theta, *own)
    for which, name in enumerate(("q", "dq", "ddq")):
        for k in range(len(term.joints)):

            def torque(step: float, which: int = which, k: int = k) -> Array:
                moved = [x.copy() for x in state]
                moved[which][:, k] += step
                return np.asarray(term.regressor(moved[0], moved[1], moved[2], *own) @ theta)

            slope = (8 * (torque(h) - torque(-h)) - torque(2 * h) + torque(-2 * h)) / (12 * h)
            np.testing.assert_allclose(getattr(slopes, name)[:, :, k], slope, rtol=1e-7, atol=1e-8)


def has_the_weighted_gradient_of_its_partials(term: Term) -> None:
    """The derivatives of a sum of all entries with weights are those of each joint's torque by its row of weights."""
    state, own, model = states(len(term.joints)), memory_of(term), Model((term,))
    weights = np.random.default_rng(5).normal(size=(*state[0].shape, len(term.parameters)))
    found = model.weighted_gradient(*state, weights, *own)
    for i in range(len(weights)):
        q, dq, ddq, *memory = (x[i : i + 1] for x in (*state, *own))
        for j, theta in enumerate(weights[i]):
            slopes = term.partials(q, dq, ddq, theta, *memory)
            found[:, i] -= [slopes.q[0, j], slopes.dq[0, j], slopes.ddq[0, j]]
    np.testing.assert_allclose(found, 0.0, atol=1e-11 * np.abs(weights).max() * max(1.0, _largest(term)))


def _largest(term: Term) -> float:
    """The largest slope of any parameter's torque."""
    units = (term.partials(*states(len(term.joints)), one, *memory_of(term)) for one in np.eye(len(term.parameters)))
    return max(float(np.abs(array).max()) for one in units for array in (one.q, one.dq, one.ddq))


def remembers_in_pieces(term: Term) -> None:
    """What it remembers does not depend on where a motion is cut, nor on what comes later."""
    if not isinstance(term, HasMemory):
        return
    past = motion_before(len(term.joints))
    whole = term.remember(past)
    assert whole.shape == (len(past.t), term.memory), f"the memory has shape {whole.shape}"
    assert np.isfinite(whole).all()
    for cut in (1, 7, len(past.t) - 1):
        first = term.remember(_part(past, slice(0, cut + 1)))
        second = term.remember(replace(_part(past, slice(cut, None)), start=whole[cut]))
        np.testing.assert_allclose(np.concatenate([first, second[1:]]), whole, rtol=1e-9, atol=1e-12)


def remembers_no_mass(term: Term) -> None:
    """At constant memory, the torque of a term that remembers does not depend on the acceleration."""
    if isinstance(term, HasMemory):
        q, dq, ddq = states(len(term.joints))
        own = memory_of(term)
        np.testing.assert_array_equal(term.regressor(q, dq, ddq, *own), term.regressor(q, dq, 0 * ddq, *own))


def motion_before(n: int, samples: int = 60) -> Past:
    """Return a motion of n joints that reverse at different times, with a load."""
    t, phase = np.linspace(0.0, 1.2, samples), np.arange(1.0, n + 1)
    w = 5.0 + phase
    angle = np.outer(t, w) + phase
    return Past(t, np.sin(angle) / w, np.cos(angle), -np.sin(angle) * w, np.cos(2.0 * angle) * phase)


def _part(past: Past, rows: slice) -> Past:
    return Past(past.t[rows], past.q[rows], past.dq[rows], past.ddq[rows], past.load[rows])


def softens_its_sign(term: Term) -> None:
    """A term with a jump has a smooth form with the same parameters, which tends to it with the width."""
    if not (isinstance(term, HasSign) and term.discontinuous):
        return
    n, theta = len(term.joints), np.linspace(0.5, 1.5, len(term.parameters))
    soft = Model(term.with_smooth_sign(np.full(n, 1e-3)))
    assert soft.names == tuple(parameter.name for parameter in term.parameters), "the parameters stay the same"
    tau = Model((term,)).torque(*states(n), theta, *memory_of(term))
    np.testing.assert_allclose(soft.torque(*states(n), theta, *memory_of(term)), tau, rtol=1e-6)
    assert not any(isinstance(one, HasSign) and one.discontinuous for one in soft.terms), "no jump is left"


def turns_its_gravity(term: Term) -> None:
    """A term under its own gravity is the same; the torque of gravity is linear in it."""
    if not isinstance(term, HasGravity):
        return
    state, theta = states(len(term.joints)), np.linspace(0.5, 1.5, len(term.parameters))
    own, none, twice = (Model((term.with_gravity(tuple(k * g for g in term.gravity)),)) for k in (1.0, 0.0, 2.0))
    tau = Model((term,)).torque(*state, theta)
    np.testing.assert_array_equal(own.torque(*state, theta), tau)
    pulled = tau - none.torque(*state, theta)
    np.testing.assert_allclose(twice.torque(*state, theta) - tau, pulled, rtol=1e-9, atol=1e-9)


def is_the_same_in_numpy(term: Term) -> None:
    """Its text for the exported module, where there is one, gives the same torque."""
    if not isinstance(term, HasNumpySource):
        return
    state, theta = states(len(term.joints)), np.linspace(0.5, 1.5, len(term.parameters))
    try:
        text = term.numpy_source("torque", theta)
    except ModelError:  # it has none
        return
    load = np.random.default_rng(4).normal(size=state[0].shape)
    own = [term.remember(Past(np.arange(6.0), *state, load))] if isinstance(term, HasMemory) else []
    namespace: dict[str, Any] = {"np": np, "_load": lambda *_: load}
    exec(text, namespace)  # noqa: S102 - the text of the term that is checked
    whole = Model((term,)).torque(*state, theta, *own)
    np.testing.assert_allclose(namespace["torque"](*state), whole, rtol=1e-9, atol=1e-9 * np.abs(whole).max())


def is_what_its_equations_say(term: Term) -> None:
    """Its equations, where it has them, name all of its parameters and give its torque."""
    if not isinstance(term, HasEquations) or not term.equations:
        return
    n, theta = len(term.joints), np.linspace(0.5, 1.5, len(term.parameters))
    names = [parameter.name for parameter in term.parameters]
    assert sorted(name for one in term.equations for name in one.parameters) == sorted(names), "it names all parameters"
    past, place = motion_before(n), [joint.name for joint in term.joints]
    own = [term.remember(past)] if isinstance(term, HasMemory) else []
    whole = np.zeros_like(past.q)
    for k, one in enumerate(term.equations):
        factors = np.zeros(n)
        factors[[place.index(name) for name, _ in one.on]] = [factor for _, factor in one.on]
        q, dq, ddq = (x @ factors for x in (past.q, past.dq, past.ddq))
        known: dict[str, Any] = {**FUNCTIONS, "q": q, "dq": dq, "ddq": ddq, "t": past.t - past.t[0]}
        known |= {"load": past.load @ factors, "z": own[0][:, k] if own else 0.0, "__builtins__": {}}
        known |= {symbol: theta[names.index(name)] for symbol, name in zip(one.symbols, one.parameters, strict=True)}
        known |= {symbol: value for symbol, value, _ in one.constants}
        for symbol, text in one.where:
            known[symbol] = eval(text, known)  # noqa: S307 - the text of the term that is checked
        torque = eval(one.torque, known)  # noqa: S307
        whole += np.outer(np.broadcast_to(torque, past.t.shape), factors)
    found = term.regressor(past.q, past.dq, past.ddq, *own) @ theta
    np.testing.assert_allclose(whole, found, rtol=1e-9, atol=1e-9 * np.abs(found).max())


TERM_CHECKS: tuple[Callable[[Term], None], ...] = (
    describes_its_parameters,
    returns_finite_arrays,
    has_the_torque_of_its_regressor,
    has_the_mass_matrix_of_its_regressor,
    has_the_entries_of_its_regressor,
    works_row_by_row,
    does_not_change_its_arguments,
    survives_pickling,
    has_partials_linear_in_theta,
    has_partials_that_are_slopes,
    has_the_weighted_gradient_of_its_partials,
    remembers_in_pieces,
    remembers_no_mass,
    softens_its_sign,
    turns_its_gravity,
    is_the_same_in_numpy,
    is_what_its_equations_say,
)
