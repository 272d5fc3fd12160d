import numpy as np
import pytest

from dynident.apps.fleets import find_changes, pool_robots
from dynident.apps.fleets.components import scatter_of
from dynident.apps.fleets.result import baseline
from dynident.runtime import InputError
from tests.apps.fleets.simulated import GROUPS, PAYLOAD, SIZE, B, fleet, robot

SPREAD = 0.2


def shared(rng, robots=12, logs=8, changes=None):
    histories = fleet(rng, robots, logs, changes)
    found = find_changes(histories, GROUPS, rng, draws=200)
    return histories, found, pool_robots(histories, GROUPS, found.scatter, found.changes)


def test_mean_and_spread_are_those_of_the_robots() -> None:
    _, _, type_ = shared(np.random.default_rng(1), robots=30)
    spread = np.sqrt(np.diag(type_.spread)) / SIZE
    assert (np.abs(spread / SPREAD - 1) < 0.5).all()
    scores = (type_.mean - SIZE) / np.sqrt(np.diag(type_.covariance))
    assert 0.5 < np.sqrt(np.mean(scores**2)) < 1.6


def test_posteriors_hold_the_truth() -> None:
    """Of robots among them, and of new ones with one short log."""
    rng, old, new = np.random.default_rng(2), [], []
    for _ in range(4):
        truth = SIZE * (1 + SPREAD * rng.standard_normal((12, B)))
        histories = [robot(rng, f"robot{r}", truth[r], 8) for r in range(12)]
        scatter = scatter_of(histories, GROUPS, rng)
        type_ = pool_robots(histories, GROUPS, scatter)
        old += [(one.value - beta) / one.std for one, beta in zip(type_.robots, truth, strict=True)]
        for _ in range(12):
            beta = SIZE * (1 + SPREAD * rng.standard_normal(B))
            log = robot(rng, "new", beta, 1, rows=13)
            one = type_.borrow("new", log.value[0], scatter.with_scatter(log.information[0]))
            new.append((one.value - beta) / one.std)
    for scores in (old, new):
        assert 0.75 < np.sqrt(np.mean(np.square(scores))) < 1.3


def test_a_new_robot_is_nearer_to_the_truth_by_what_it_borrows() -> None:
    rng = np.random.default_rng(3)
    _, found, type_ = shared(rng)
    own, mean, borrowed = [], [], []
    for _ in range(60):
        beta = SIZE * (1 + SPREAD * rng.standard_normal(B))
        log = robot(rng, "new", beta, 1, rows=13)
        one = type_.borrow("new", log.value[0], found.scatter.with_scatter(log.information[0]))
        for errors, value in ((own, log.value[0]), (mean, type_.mean), (borrowed, one.value)):
            errors.append(np.linalg.norm((value - beta) / SIZE))
    assert np.median(borrowed) < 0.8 * min(np.median(own), np.median(mean))


def test_borrowing_is_between_the_value_and_the_mean() -> None:
    _, _, type_ = shared(np.random.default_rng(4))
    value = 1.5 * SIZE
    nothing = type_.borrow("new", value, np.zeros((B, B)))
    np.testing.assert_allclose(nothing.value, type_.mean, rtol=1e-12)
    np.testing.assert_allclose(nothing.covariance, type_.spread + type_.covariance, rtol=1e-12)
    all_ = type_.borrow("new", value, np.diag(1e12 / SIZE**2))
    np.testing.assert_allclose(all_.value, value, rtol=1e-6)
    assert (all_.std < 1e-5 * SIZE).all()


def test_an_odd_robot_hardly_moves_the_others() -> None:
    rng = np.random.default_rng(5)
    histories = fleet(rng, 12, 8)
    scatter = scatter_of(histories, GROUPS, rng)
    plain = pool_robots(histories, GROUPS, scatter)
    histories[4].value[:, 6:8] *= 6.0
    odd = pool_robots(histories, GROUPS, scatter)
    assert odd.weights[4] == odd.weights.min() < 0.5
    spread = np.sqrt(np.diag(plain.spread))
    assert (np.abs(odd.mean - plain.mean) < 0.5 * spread).all()
    assert (np.sqrt(np.diag(odd.spread)) < 2.5 * spread).all()
    deviation, std = odd.deviation("robot4")
    assert (deviation[6:8] > 10 * std[6:8]).all()
    with pytest.raises(KeyError):
        odd.deviation("robot99")


def test_robots_are_pooled_as_they_were_before_their_changes() -> None:
    def carries(log: int, value: np.ndarray) -> None:
        value += (log >= 3) * GROUPS[PAYLOAD].directions @ np.array([0.05, 0.0, 0.1])

    rng = np.random.default_rng(6)
    truth = SIZE * (1 + SPREAD * rng.standard_normal((8, B)))
    histories = [robot(rng, f"robot{r}", truth[r], 9, *([carries] if r == 2 else [])) for r in range(8)]
    found = find_changes(histories, GROUPS, rng, draws=200)
    assert {one.robot for one in found.changes} == {"robot2"}
    value, information = baseline(histories[2], found.scatter, found.of("robot2"))
    std = np.sqrt(np.diag(np.linalg.inv(information)))
    assert (np.abs(value - truth[2]) < 4.5 * std).all()
    later, _ = baseline(histories[2], found.scatter)
    assert (np.abs(later - truth[2]) > 4.5 * std).any()


def test_two_robots_do_not_show_how_robots_differ() -> None:
    rng = np.random.default_rng(7)
    histories = fleet(rng, 2, 8)
    with pytest.raises(InputError, match="2 robots"):
        pool_robots(histories, GROUPS, scatter_of(histories, GROUPS, rng))
