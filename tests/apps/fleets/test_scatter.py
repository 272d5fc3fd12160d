import numpy as np
import pytest

from dynident.apps.fleets.components import blocks_of, scatter_of
from dynident.regression import GroupKind
from dynident.runtime import InputError
from tests.apps.fleets.simulated import GROUPS, SCATTER, SIZE, B, E, fleet, group


def test_parameters_of_a_group_scatter_together() -> None:
    blocks = [block.tolist() for block in blocks_of(GROUPS, B)]
    assert blocks == [[0], [1], [2], [3], [4, 5], [6, 7], [8], [9], [10, 11]]
    overlapping = (*GROUPS, group(GroupKind.RIPPLE, "a", E[:, [5, 9]]))
    assert [4, 5, 9] in [block.tolist() for block in blocks_of(overlapping, B)]


@pytest.mark.parametrize(("robots", "logs"), [(10, 20), (2, 60)])
def test_scatter_is_that_of_friction_and_offsets(robots: int, logs: int) -> None:
    """Standard errors are 1.5 times too small; the parameters of bodies do not scatter."""
    rng = np.random.default_rng(1)
    found = scatter_of(fleet(rng, robots, logs), GROUPS, rng)
    assert 1.1 < found.inflation < 1.6
    relative = np.sqrt(np.diag(found.covariance)) / SIZE
    expected = np.hypot(*SCATTER[:2])
    assert (np.abs(relative[4:8] - expected) < 0.6 * expected).all()
    assert found.covariance[4, 5] > 0.4 * np.sqrt(found.covariance[4, 4] * found.covariance[5, 5])
    assert relative[:4].max() < 0.03
    assert found.dof == robots * logs - (robots if robots > 4 else robots * logs / 3)


def test_a_robot_that_changes_does_not_hide_it_in_the_scatter() -> None:
    def doubled(log: int, value: np.ndarray) -> None:
        value[:4] *= 1.0 + (log > 6)

    rng = np.random.default_rng(2)
    for robots in (1, 8):
        found = scatter_of(fleet(rng, robots, 15, {0: doubled}), GROUPS, rng)
        assert (np.sqrt(np.diag(found.covariance))[:4] < 0.1 * SIZE[:4]).all()


def test_a_fleet_of_single_logs_has_no_scatter() -> None:
    rng = np.random.default_rng(4)
    found = scatter_of(fleet(rng, 5, 1), GROUPS, rng)
    assert found.dof == 0.0
    assert not found.covariance.any()
    assert scatter_of([], GROUPS, rng).dof == 0.0


def test_robots_of_other_parameters_are_refused() -> None:
    rng = np.random.default_rng(5)
    one, other = fleet(rng, 2, 3)
    short = type(other)(other.robot, other.logs, other.days, other.value[:, :5], other.information[:, :5, :5])
    with pytest.raises(InputError, match=r"\[5, 12\] base parameters"):
        scatter_of([one, short], GROUPS, rng)


def test_what_a_log_says_of_the_robot_is_less_than_of_the_day() -> None:
    rng = np.random.default_rng(6)
    (history, *_), found = fleet(rng, 6, 8), scatter_of(fleet(rng, 6, 8), GROUPS, rng)
    J = history.information[0]
    expected = np.linalg.inv(found.inflation**2 * np.linalg.inv(J) + found.covariance)
    np.testing.assert_allclose(found.with_scatter(J), expected, rtol=1e-6, atol=1e-9 * np.abs(expected).max())
    assert not found.with_scatter(np.zeros_like(J)).any()
