"""What every term of a model promises."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from dynident.models import FUNCTIONS, Model, Past, Term
from dynident.runtime import ModelError
from dynident.runtime.arrays import Array


def check_term(term: Term) -> None:
    """Raise AssertionError unless the term keeps all promises of its family.

    It is tried at positions within 0.2 and 1.2 rad or m, and speeds within 0.4 and 2 per s, of either sign.
    """
    for check in TERM_CHECKS:
        check(term)


def sample_states(n: int, seed: int = 0, samples: int = 6) -> tuple[Array, Array, Array]:
    """Return q, dq, ddq (samples, n), with velocities off the jumps of dry friction."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(0.2, 1.2, (samples, n))
    return q, rng.choice([-1, 1], (samples, n)) * rng.uniform(0.4, 2.0, (samples, n)), rng.normal(size=(samples, n))


def random_memory(term: Term, samples: int = 6) -> tuple[Array, ...]:
    """Return a memory (samples, m) of a term that has one, as the last of its arguments."""
    rng = np.random.default_rng(3)
    return (rng.uniform(-1.0, 1.0, (samples, term.memory)),) if term.memory else ()


def describes_its_parameters(term: Term) -> None:
    """Parameters have distinct names, units and meanings."""
    names = [parameter.name for parameter in term.parameters]
    assert len(set(names)) == len(names) > 0, "names are distinct, and there is one"
    assert all(x.name and x.unit and x.expression for x in term.parameters), "each has a name, unit and expression"


def returns_finite_arrays(term: Term) -> None:
    """Regressor and derivatives have the right shapes for any number of samples."""
    n, p = len(term.joints), len(term.parameters)
    for samples in (0, 1, 5):
        state, memory = sample_states(n, samples=samples), random_memory(term, samples)
        Y, slopes = term.regressor(*state, *memory), term.partials(*state, np.ones(p), *memory)
        assert Y.shape == (samples, n, p), f"the regressor has shape {Y.shape}, expected {(samples, n, p)}"
        for array in (slopes.q, slopes.dq, slopes.ddq):
            assert array.shape == (samples, n, n), f"a derivative has shape {array.shape}"
        for array in (Y, slopes.q, slopes.dq, slopes.ddq):
            assert np.isfinite(array).all()
            assert array.dtype == float


def has_the_torque_of_its_regressor(term: Term) -> None:
    """A ``torque`` of its own is that of the regressor."""
    state, theta = sample_states(len(term.joints)), np.linspace(0.5, 1.5, len(term.parameters))
    memory, model = random_memory(term), Model((term,))
    expected = term.regressor(*state, *memory) @ theta
    allowed = 1e-11 * np.abs(expected).max()
    np.testing.assert_allclose(model.torque(*state, theta, *memory), expected, rtol=1e-11, atol=allowed)
    thetas = np.tile(theta, (len(expected), 1))
    np.testing.assert_allclose(model.torque(*state, thetas, *memory), expected, rtol=1e-11, atol=allowed)


def has_the_mass_matrix_of_its_regressor(term: Term) -> None:
    """Its mass matrix, with the torque without acceleration, is that of the regressor."""
    if term.memory:
        return  # it has no mass
    (q, dq, _), theta = sample_states(len(term.joints)), np.linspace(0.5, 1.5, len(term.parameters))
    mass, bias = term.mass_and_bias(q, dq, theta)
    at_rest = term.regressor(q, dq, np.zeros_like(q)) @ theta
    allowed = 1e-11 * max(np.abs(at_rest).max(), np.abs(mass).max())
    np.testing.assert_allclose(bias, at_rest, rtol=1e-11, atol=allowed)
    for k, unit in enumerate(np.eye(q.shape[1])):
        column = term.regressor(q, dq, np.tile(unit, (len(q), 1))) @ theta - at_rest
        np.testing.assert_allclose(mass[:, :, k], column, rtol=1e-11, atol=allowed)


def has_the_entries_of_its_regressor(term: Term) -> None:
    """``support`` and ``entries`` are those of the regressor, where they are said; its structure holds all of it."""
    state, model, memory = sample_states(len(term.joints)), Model((term,)), random_memory(term)
    Y, structure = term.regressor(*state, *memory), model.structure
    assert not Y[:, ~model.support].any(), "the regressor is zero where there is no support"
    allowed = 1e-12 * np.abs(Y).max()
    joint, parameter = np.nonzero(np.ones_like(model.support))
    all_entries = model.entries(*state, joint, parameter, *memory)
    np.testing.assert_allclose(all_entries, Y[:, joint, parameter].T, rtol=1e-12, atol=allowed)
    entries = model.entries(*state, structure.joint, structure.parameter, *memory)
    for j, (part, columns) in enumerate(zip(structure.parts, structure.maps, strict=True)):
        np.testing.assert_allclose(entries[part].T @ columns, Y[:, j], rtol=1e-11, atol=10 * allowed)


def works_row_by_row(term: Term) -> None:
    """Samples do not depend on each other."""
    state, theta = sample_states(len(term.joints)), np.linspace(0.5, 1.5, len(term.parameters))
    memory = random_memory(term)
    q, dq, ddq = state
    rows = [
        ((q[k : k + 1], dq[k : k + 1], ddq[k : k + 1]), [array[k : k + 1] for array in memory]) for k in range(len(q))
    ]
    single = np.concatenate([term.regressor(*row, *row_memory) for row, row_memory in rows])
    np.testing.assert_allclose(term.regressor(*state, *memory), single, rtol=1e-13)
    for name in ("q", "dq", "ddq"):
        together = getattr(term.partials(*state, theta, *memory), name)
        slopes = [getattr(term.partials(*row, theta, *row_memory), name) for row, row_memory in rows]
        np.testing.assert_allclose(together, np.concatenate(slopes), rtol=1e-12, atol=1e-14)


def does_not_change_its_arguments(term: Term) -> None:
    """Read-only arrays will do, and the same arrays give the same regressor."""
    state, memory = sample_states(len(term.joints)), random_memory(term)
    for x in (*state, *memory):
        x.flags.writeable = False
    term.partials(*state, np.ones(len(term.parameters)), *memory)
    np.testing.assert_array_equal(term.regressor(*state, *memory), term.regressor(*state, *memory))


def survives_pickling(term: Term) -> None:
    """A copy in another process is the same term."""
    state, theta = sample_states(len(term.joints)), np.ones(len(term.parameters))
    memory = random_memory(term)
    Y, slope = term.regressor(*state, *memory), term.partials(*state, theta, *memory).dq
    copy = pickle.loads(pickle.dumps(term))
    assert (copy.joints, copy.parameters) == (term.joints, term.parameters)
    np.testing.assert_array_equal(copy.regressor(*state, *memory), Y)
    np.testing.assert_array_equal(copy.partials(*state, theta, *memory).dq, slope)


def has_partials_linear_in_theta(term: Term) -> None:
    """The torque is linear in the parameters, and so are its derivatives."""
    state, (a, b) = sample_states(len(term.joints)), np.random.default_rng(1).normal(size=(2, len(term.parameters)))
    for name in ("q", "dq", "ddq"):
        by_a, by_b, by_sum = (getattr(term.partials(*state, x, *random_memory(term)), name) for x in (a, b, 2 * a - b))
        np.testing.assert_allclose(by_sum, 2 * by_a - by_b, rtol=1e-10, atol=1e-12)


def has_partials_that_are_slopes(term: Term) -> None:
    """Central differences of fourth order, at constant memory."""
    state, memory, h = sample_states(len(term.joints)), random_memory(term), 1e-3
    theta = np.random.default_rng(2).uniform(0.5, 1.5, len(term.parameters))
    slopes = term.partials(*state, theta, *memory)
    for which, name in enumerate(("q", "dq", "ddq")):
        for k in range(len(term.joints)):

            def torque(step: float, which: int = which, k: int = k) -> Array:
                displaced = [x.copy() for x in state]
                displaced[which][:, k] += step
                return np.asarray(term.regressor(displaced[0], displaced[1], displaced[2], *memory) @ theta)

            slope = (8 * (torque(h) - torque(-h)) - torque(2 * h) + torque(-2 * h)) / (12 * h)
            np.testing.assert_allclose(getattr(slopes, name)[:, :, k], slope, rtol=1e-7, atol=1e-8)


def has_the_weighted_gradient_of_its_partials(term: Term) -> None:
    """The derivatives of a sum of all entries with weights are those of each joint's torque by its row of weights."""
    state, full_memory, model = sample_states(len(term.joints)), random_memory(term), Model((term,))
    weights = np.random.default_rng(5).normal(size=(*state[0].shape, len(term.parameters)))
    gradient = model.weighted_gradient(*state, weights, *full_memory)
    for i in range(len(weights)):
        q, dq, ddq, *memory = (x[i : i + 1] for x in (*state, *full_memory))
        # row j of the weights is a theta, of whose torques only that of joint j counts
        for j, theta in enumerate(weights[i]):
            slopes = term.partials(q, dq, ddq, theta, *memory)
            gradient[:, i] -= [slopes.q[0, j], slopes.dq[0, j], slopes.ddq[0, j]]
    np.testing.assert_allclose(gradient, 0.0, atol=1e-11 * np.abs(weights).max() * max(1.0, _largest_slope(term)))


def _largest_slope(term: Term) -> float:
    """The largest slope of any parameter's torque."""
    units = (
        term.partials(*sample_states(len(term.joints)), unit, *random_memory(term))
        for unit in np.eye(len(term.parameters))
    )
    return max(float(np.abs(array).max()) for unit in units for array in (unit.q, unit.dq, unit.ddq))


def remembers_in_pieces(term: Term) -> None:
    """What it remembers does not depend on where a motion is cut, nor on what comes later."""
    if not term.memory:
        return
    past = make_past(len(term.joints))
    memory = term.remember(past)
    assert memory.shape == (len(past.t), term.memory), f"the memory has shape {memory.shape}"
    assert np.isfinite(memory).all()
    for cut in (1, 7, len(past.t) - 1):
        first_part = term.remember(_cut_past(past, slice(0, cut + 1)))
        second_part = term.remember(replace(_cut_past(past, slice(cut, None)), start=memory[cut]))
        np.testing.assert_allclose(np.concatenate([first_part, second_part[1:]]), memory, rtol=1e-9, atol=1e-12)


def remembers_no_mass(term: Term) -> None:
    """At constant memory, the torque of a term that remembers does not depend on the acceleration."""
    if term.memory:
        q, dq, ddq = sample_states(len(term.joints))
        memory = random_memory(term)
        np.testing.assert_array_equal(term.regressor(q, dq, ddq, *memory), term.regressor(q, dq, 0 * ddq, *memory))


def make_past(n: int) -> Past:
    """Return a motion of n joints that reverse at different times, with a load."""
    t, phase = np.linspace(0.0, 1.2, 60), np.arange(1.0, n + 1)
    w = 5.0 + phase
    angle = np.outer(t, w) + phase
    return Past(t, np.sin(angle) / w, np.cos(angle), -np.sin(angle) * w, np.cos(2.0 * angle) * phase)


def _cut_past(past: Past, rows: slice) -> Past:
    return Past(past.t[rows], past.q[rows], past.dq[rows], past.ddq[rows], past.load[rows])


def softens_its_sign(term: Term) -> None:
    """A term with a jump has a smooth form with the same parameters, which tends to it with the width."""
    if not term.discontinuous:
        return
    n, theta = len(term.joints), np.linspace(0.5, 1.5, len(term.parameters))
    soft = Model(term.with_smooth_sign(np.full(n, 1e-3)))
    assert soft.names == tuple(parameter.name for parameter in term.parameters), "the parameters stay the same"
    tau = Model((term,)).torque(*sample_states(n), theta, *random_memory(term))
    np.testing.assert_allclose(soft.torque(*sample_states(n), theta, *random_memory(term)), tau, rtol=1e-6)
    assert not any(soft_term.discontinuous for soft_term in soft.terms), "no jump is left"


def turns_its_gravity(term: Term) -> None:
    """A term under its own gravity is the same; the torque of gravity is linear in it."""
    if (gravity := term.gravity) is None:
        return
    state, theta = sample_states(len(term.joints)), np.linspace(0.5, 1.5, len(term.parameters))
    unchanged, weightless, doubled = (
        Model((term.with_gravity(tuple(k * g for g in gravity)),)) for k in (1.0, 0.0, 2.0)
    )
    tau = Model((term,)).torque(*state, theta)
    np.testing.assert_array_equal(unchanged.torque(*state, theta), tau)
    gravity_torque = tau - weightless.torque(*state, theta)
    np.testing.assert_allclose(doubled.torque(*state, theta) - tau, gravity_torque, rtol=1e-9, atol=1e-9)


def is_the_same_in_numpy(term: Term) -> None:
    """Its text for the exported module, where there is one, gives the same torque."""
    state, theta = sample_states(len(term.joints)), np.linspace(0.5, 1.5, len(term.parameters))
    try:
        text = term.numpy_source("torque", theta)
    except ModelError:  # it has none
        return
    load = np.random.default_rng(4).normal(size=state[0].shape)
    memory = [term.remember(Past(np.arange(6.0), *state, load))] if term.memory else []
    namespace: dict[str, Any] = {"np": np, "_load": lambda *_: load}
    exec(text, namespace)  # noqa: S102 - the text of the term that is checked
    expected = Model((term,)).torque(*state, theta, *memory)
    np.testing.assert_allclose(namespace["torque"](*state), expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


def is_what_its_equations_say(term: Term) -> None:
    """Its equations, where it has them, name all of its parameters and give its torque."""
    if not term.equations:
        return
    n, theta = len(term.joints), np.linspace(0.5, 1.5, len(term.parameters))
    names = [parameter.name for parameter in term.parameters]
    assert sorted(name for equation in term.equations for name in equation.parameters) == sorted(names), (
        "it names all parameters"
    )
    past, place = make_past(n), [joint.name for joint in term.joints]
    memory = [term.remember(past)] if term.memory else []
    total = np.zeros_like(past.q)
    for k, equation in enumerate(term.equations):
        # an equation is of the motion of a joint or a motor, whose torque its factors bring to the joints
        factors = np.zeros(n)
        factors[[place.index(name) for name, _ in equation.on]] = [factor for _, factor in equation.on]
        q, dq, ddq = (x @ factors for x in (past.q, past.dq, past.ddq))
        namespace: dict[str, Any] = {**FUNCTIONS, "q": q, "dq": dq, "ddq": ddq, "t": past.t - past.t[0]}
        namespace |= {"load": past.load @ factors, "z": memory[0][:, k] if memory else 0.0, "__builtins__": {}}
        namespace |= {
            symbol: theta[names.index(name)] for symbol, name in zip(equation.symbols, equation.parameters, strict=True)
        }
        namespace |= {symbol: value for symbol, value, _ in equation.constants}
        for symbol, text in equation.where:
            namespace[symbol] = eval(text, namespace)  # noqa: S307 - the text of the term that is checked
        torque = eval(equation.torque, namespace)  # noqa: S307
        total += np.outer(np.broadcast_to(torque, past.t.shape), factors)
    expected = term.regressor(past.q, past.dq, past.ddq, *memory) @ theta
    np.testing.assert_allclose(total, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


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
