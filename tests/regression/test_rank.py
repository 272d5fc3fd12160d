"""Rank: what counts as rounding, whatever the weights of the rows."""

import numpy as np
import pytest
from numpy.typing import NDArray

from dynident.models import Parameter
from dynident.regression import precision, rank_of
from dynident.runtime import ConfigError

Array = NDArray[np.float64]
BODY = [Parameter(role, "", role=role, body="b") for role in ("mass", "mx", "my", "mz")]
FREE = [Parameter(name, "") for name in "abcd"]


def factor(X: Array) -> Array:
    return np.asarray(np.linalg.qr(np.column_stack([X, np.zeros(len(X))]), mode="r"))


def columns(sizes: list[float], seed: int = 0) -> Array:
    return np.random.default_rng(seed).standard_normal((50, len(sizes))) * sizes


def test_a_column_is_rounding_beside_those_of_its_kind_only_in_a_robot_file() -> None:
    """A moment about an axis that is turned by the rounding of 3.1416 acts a millionth as much as the others."""
    X = columns([1.0, 1.0, 1.0, 3e-6])
    rank = rank_of(factor(X), BODY)
    assert (rank.rank, rank.groups) == (3, ((3,),))
    assert rank_of(factor(X), FREE).rank == 4
    mass = rank_of(factor(columns([3e-6, 1.0, 1.0, 1.0])), BODY)
    assert mass.rank == 4  # a small effect of another kind, in other units
    assert precision(FREE) < 1e-9 < precision(BODY) < 1e-4


@pytest.mark.parametrize("tolerance", [0.0, 1.0, -1e-9, float("nan")])
def test_wrong_tolerance(tolerance: float) -> None:
    with pytest.raises(ConfigError, match=f"rank is {tolerance}"):
        rank_of(np.eye(3), tolerance=tolerance)


def test_weights_of_the_rows_do_not_decide() -> None:
    """A weight of a million makes rounding large, or all other rows small; the null space is that without weights."""
    X = columns([1.0, 1.0, 1.0, 1e-7])  # the last is the rounding of an angle
    weight = np.where(np.arange(50) < 5, 1e6, 1.0)[:, None]
    weighted = X * weight
    weighted[:5, :2] *= 1e-6  # only the third acts on the heavy rows
    shown = rank_of(factor(weighted / weight), BODY)
    rank = rank_of(factor(weighted), BODY, unweighted=shown)
    assert rank_of(factor(weighted), BODY).rank < shown.rank == rank.rank == 3
    assert rank.groups == ((3,),)
    np.testing.assert_allclose(rank.determined_directions[3], 0.0, atol=1e-12)
    full = rank_of(factor(X[:, :3]), FREE[:3])
    again = rank_of(factor(X[:, :3]), FREE[:3], unweighted=full)
    np.testing.assert_allclose(again.inverse, full.inverse, rtol=1e-12)
