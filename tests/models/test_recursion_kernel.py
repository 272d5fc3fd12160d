"""The kernel's recursion is that of NumPy, on every level of this CPU with the same bits."""

import numpy as np
import pytest

from dynident.models import recursion_kernel
from dynident.models.recursion import Recursion
from dynident.models.recursion_kernel import CompiledRecursion
from tests.kernel_levels import BEST, NAMES, functions_of
from tests.models.judge import assert_same, random_bodies, random_states, recursion_of

SAMPLES = (1, 2, 7, 8, 33, 200)  # whole vectors, and not


def use(level, monkeypatch):
    if level not in BEST:
        pytest.skip(f"there is no kernel for {level} here")
    monkeypatch.setattr(recursion_kernel, "function", functions_of(level))
    return CompiledRecursion


@pytest.fixture(params=NAMES)
def compiled(request, monkeypatch):
    return use(request.param, monkeypatch)


@pytest.fixture(params=["numpy", *NAMES])
def kind(request, monkeypatch):
    return Recursion if request.param == "numpy" else use(request.param, monkeypatch)


def everything(mine, state, values):
    joint, parameter = np.nonzero(mine.layout.support)
    weights = np.random.default_rng(0).normal(size=(*state[0].shape, mine.layout.support.shape[1]))
    return [
        mine.regressor(*state), mine.entries(*state, joint, parameter), mine.torque(*state, values),
        mine.partials(*state, values), *mine.mass_and_bias(*state[:2], values),
        mine.weighted_gradient(*state, weights),
    ]  # fmt: skip


@pytest.mark.parametrize("seed", [0, 2, 4, 7, 9, 11])
def test_the_kernel_is_numpy(compiled, seed):
    bodies, theta = random_bodies(seed, 1 + seed)
    values = recursion_of(bodies).layout.expand_parameters(theta)
    for samples in SAMPLES[seed % 3 :: 3]:
        state = random_states(bodies, seed, samples)
        result = everything(recursion_of(bodies, compiled), state, values)
        for first, second in zip(result, everything(recursion_of(bodies), state, values), strict=True):
            assert_same(first, second, 1e-13)


def test_all_levels_give_the_same_bits(monkeypatch):
    bodies, theta = random_bodies(3, 9)
    values, state = recursion_of(bodies).layout.expand_parameters(theta), random_states(bodies, 1, 45)
    result = []
    for name in BEST:
        monkeypatch.setattr(recursion_kernel, "function", functions_of(name))
        result.append(everything(recursion_of(bodies, CompiledRecursion), state, values))
    for other in result[1:]:
        for case, same in zip(result[0], other, strict=True):
            np.testing.assert_array_equal(case, same)


@pytest.mark.parametrize("size", [1e-300, 1e-8, 1.0, 100.0, 4.9e5, 6e5, 1e15])
def test_angles_of_any_size(compiled, size):
    bodies, _ = random_bodies(7, 1, ("continuous",))
    rng = np.random.default_rng(0)
    q = np.concatenate((rng.uniform(-size, size, 400), size * rng.choice([-1, 1], 7), np.arange(-40, 40) * np.pi / 2))
    rest = np.zeros((len(q), 1))
    result, expected = (recursion_of(bodies, kind).regressor(q[:, None], rest, rest) for kind in (compiled, Recursion))
    assert_same(result, expected, 1e-15)


def test_entries_in_any_order_and_twice(kind):
    bodies, _ = random_bodies(2, 4, mimics=0.0)
    state, mine = random_states(bodies, 3, 7), recursion_of(bodies, kind)
    joint, parameter = np.array([0, 3, 0, 1, 0, 3]), np.array([39, 1, 39, 12, 5, 0])
    assert_same(mine.entries(*state, joint, parameter), mine.regressor(*state)[:, joint, parameter].T, 1e-15)
