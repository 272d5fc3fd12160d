"""The streamed linear problem: blocks, masks, and several motions."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from dynident.estimators.least_squares import solve_least_squares
from dynident.models import Joint, Model, Parameter, Partials, Term
from dynident.models.friction import Viscous
from dynident.motion.log import Motion
from dynident.regression import ParallelFilter, Regression, Selection, linear_problem
from dynident.runtime import InputError
from tests.regression.random_motion import ARM, holes, motion

Array = NDArray[np.float64]


def rows(motions: Sequence[Motion]) -> Array:
    """The whole matrix [Y_j | tau_j] of each joint, (n, N, p + 1), in one piece."""
    parts = [np.concatenate((ARM.regressor(m.q, m.dq, m.ddq), m.tau[:, :, None]), axis=2)[m.mask] for m in motions]
    return np.concatenate(parts).transpose(1, 0, 2)


@pytest.mark.parametrize("size", [1, 37, 512, 100_000])
def test_merged_blocks_are_one_big_least_squares(monkeypatch: pytest.MonkeyPatch, size: int) -> None:
    monkeypatch.setattr(linear_problem, "BLOCK", size)
    monkeypatch.setattr(linear_problem, "BLOCK_ENTRIES", size)
    motions = (motion(300, seed=1, mask=holes(1000)[:300]), motion(50, seed=2))
    triangular_factors = Regression(ARM, motions).triangular_factors
    full = rows(motions)
    assert triangular_factors.samples == full.shape[1]
    for factor, case in zip(triangular_factors.factors, full, strict=True):
        np.testing.assert_array_equal(factor, np.triu(factor))
        np.testing.assert_allclose(factor.T @ factor, case.T @ case, rtol=0, atol=1e-12 * np.sum(case**2))
    stacked = np.concatenate(full)
    direct = np.linalg.lstsq(stacked[:, :-1], stacked[:, -1])[0]
    np.testing.assert_allclose(
        solve_least_squares(triangular_factors.stack()).value,
        direct,
        rtol=1e-12,
        atol=1e-12 * float(np.linalg.norm(direct)),
    )


def test_joints_of_another_arm_are_refused() -> None:
    with pytest.raises(InputError, match=r"other: has the joints \('joint2', 'joint1'\), the model \('joint1'"):
        Regression(ARM, (motion(), replace(motion(), joints=("joint2", "joint1"), source="other")))


@pytest.mark.parametrize(("used", "enough"), [(0, False), (1, False), (2, True)])
def test_as_many_rows_as_parameters_are_too_few(used: int, enough: bool) -> None:
    """Two joints, two parameters: one sample makes two rows, which any parameters fit."""
    made = Regression(Model((Viscous(ARM.joints),)), (motion(20, mask=np.arange(20) < used, source="short"),))
    if enough:
        assert made.triangular_factors.samples == used
    else:
        with pytest.raises(InputError, match=rf"short: {used} usable samples of 2 joints are too few for 2 param"):
            _ = made.triangular_factors


@dataclass(frozen=True)
class Counting(Term):
    """A term tau = theta ddq that remembers how many samples it was asked for at once."""

    joints: tuple[Joint, ...] = (Joint("joint1"), Joint("joint2"))
    parameters: tuple[Parameter, ...] = (Parameter("J", "kg m^2", value=2.0),)
    asked: list[int] = field(default_factory=list)

    def regressor(self, q: Array, dq: Array, ddq: Array) -> Array:
        self.asked.append(len(q))
        return ddq[:, :, None]

    def partials(self, q: Array, dq: Array, ddq: Array, theta: Array) -> Partials:
        zero = np.zeros((*q.shape, 2))
        return Partials(zero, zero, zero + theta * np.eye(2))


@pytest.mark.parametrize(
    ("parallel_filter", "most"),
    [(None, 64), (ParallelFilter(cutoff=20.0, order=2), 600), (ParallelFilter(3, 10.0), 1000)],
)
def test_memory_does_not_grow_with_the_samples(
    monkeypatch: pytest.MonkeyPatch, parallel_filter: ParallelFilter | None, most: int
) -> None:
    monkeypatch.setattr(linear_problem, "BLOCK", 64)
    monkeypatch.setattr(linear_problem, "BLOCK_ENTRIES", 64)
    term = Counting()
    triangular_factors = Regression(Model((term,)), (motion(5000),), Selection(parallel_filter)).triangular_factors
    assert triangular_factors.samples == (
        5000 if parallel_filter is None else len(range(0, 5000, parallel_filter.decimate))
    )
    assert len(term.asked) > 5
    assert max(term.asked) <= most
