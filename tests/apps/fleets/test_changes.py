"""Changes of robots are found, quiet ones stay quiet, and what a type shares is told."""

from dataclasses import replace

import numpy as np

from dynident.apps.fleets import ChangeShape, History, find_changes, pool_robots
from dynident.apps.fleets.changes import course
from dynident.apps.fleets.components import scatter_of
from dynident.apps.fleets.result import baseline
from tests.apps.fleets.simulated import (
    CARRIED,
    FRICTION_A,
    GROUPS,
    OFFSET_B,
    PAYLOAD,
    RIPPLE,
    SIZE,
    B,
    carries,
    fleet,
    robot,
)


def rubs(log: int, value: np.ndarray) -> None:
    value[4:6] *= 1 + 0.5 * max(log - 3, 0) / 12


def slips(log: int, value: np.ndarray) -> None:
    value[9] += (log >= 15) * 0.3 * SIZE[9]


def wears(log: int, value: np.ndarray) -> None:
    value[10:] += 0.3 * SIZE[10:] * max(log - 7, 0) / 8


def both(log: int, value: np.ndarray) -> None:
    rubs(log, value)
    carries(log, value)


FAULTS = {1: rubs, 3: carries, 5: slips, 7: wears, 8: both}
FOUND = {(1, FRICTION_A), (3, PAYLOAD), (5, OFFSET_B), (7, RIPPLE), (8, FRICTION_A), (8, PAYLOAD)}


def test_large_fleets_are_not_judged_too_mildly() -> None:
    """With 190 degrees of freedom the p-values are nearly uniform, so that small changes are found, too."""
    rng = np.random.default_rng(5)
    chances = np.concatenate(
        [list(find_changes(fleet(rng, 10, 20), GROUPS, rng, draws=60).p_values.values()) for _ in range(4)]
    )
    assert np.mean(chances <= 0.4) > 0.2


def test_what_changes_is_found_with_its_size_and_nothing_else() -> None:
    flagged, scores = set(), []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        changes = find_changes(fleet(rng, 10, 16, FAULTS), GROUPS, rng, draws=300)
        pairs = {(int(change.robot[5:]), GROUPS.index(change.group)) for change in changes.changes}
        assert pairs >= FOUND
        flagged |= pairs - FOUND
        (step,) = changes.of("robot3")
        assert (step.shape, step.since, step.day, step.between) == (ChangeShape.STEP, "log10", 70.0, ("log10", "log10"))
        assert step.odds > 1e3
        payloads = [change for change in changes.changes if change.group is GROUPS[PAYLOAD]]
        scores += [(payload.size - CARRIED) / payload.std for payload in payloads]
        assert step.per_day is None
        assert step.p_value == 1 / 301
        wear = next(x for x in changes.of("robot7") if x.group is GROUPS[RIPPLE])
        assert wear.shape is ChangeShape.DRIFT
        assert (np.abs(wear.size - 0.3 * SIZE[10:]) < 4 * wear.std).all()
        assert wear.per_day is not None
        np.testing.assert_allclose(wear.per_day, wear.size / (105.0 - wear.day))
    assert len(flagged) <= 2  # of 15 quiet robots, and further changes of others
    assert np.abs(scores).max() < 4
    assert 0.6 < np.sqrt(np.mean(np.square(scores))) < 1.3


def test_one_robot_alone_shows_a_large_change() -> None:
    rng = np.random.default_rng(3)
    changes = find_changes(fleet(rng, 1, 14, {0: carries}), GROUPS, rng, draws=300)
    assert [(GROUPS.index(change.group), change.index) for change in changes.changes] == [(PAYLOAD, 10)]


def test_one_of_three_robots_does_not_hide_in_its_own_scatter() -> None:
    """Its friction rises by a half from log to log, five times what friction scatters; the others are steady."""

    def rises(log: int, value: np.ndarray) -> None:
        value[4:6] *= 1 + 0.5 * log

    for seed in range(4):
        rng = np.random.default_rng(seed)
        changes = find_changes(fleet(rng, 3, 4, {1: rises}), GROUPS, rng, draws=300)
        assert {(change.robot, GROUPS.index(change.group)) for change in changes.changes} == {("robot1", FRICTION_A)}


def test_a_group_of_many_directions_does_not_hide_the_changes_of_others() -> None:
    """Of few logs its gain has a heavy tail by chance, with which only its own gain compares."""
    wide = replace(GROUPS[PAYLOAD], directions=np.delete(np.eye(B), [4, 5], axis=1))

    def rises(log: int, value: np.ndarray) -> None:
        value[4:6] *= 1 + 3 * (log >= 3)

    for seed in range(4):
        rng = np.random.default_rng(seed)
        changes = find_changes(fleet(rng, 3, 6, {1: rises}), [*GROUPS, wide], rng, draws=300)
        assert [(change.robot, change.group) for change in changes.changes] == [("robot1", GROUPS[FRICTION_A])]


def test_too_few_logs_say_nothing_and_are_named() -> None:
    rng = np.random.default_rng(4)
    for robots, logs in ((1, 1), (1, 4), (3, 2), (8, 1)):
        changes = find_changes(
            fleet(rng, robots, logs, {0: lambda log, value: value.__imul__(1 + 9 * log)}), GROUPS, rng
        )
        assert changes.changes == ()
        assert changes.scatter.dof <= 4
        assert len(changes.silent) + len(changes.p_values) == robots
    single = fleet(rng, 1, 1)[0]
    changes = find_changes([*fleet(rng, 6, 5), History("new", *_fields(single))], GROUPS, rng)
    assert changes.silent == ("new",)
    assert find_changes([], GROUPS, rng).silent == ()


def test_what_a_log_does_not_show_changes_nothing() -> None:
    """Its value is arbitrary there."""
    rng = np.random.default_rng(6)
    histories = fleet(rng, 6, 8)
    for history in histories:
        history.information[::3, 9, :] = history.information[::3, :, 9] = 0.0
    changes = find_changes(histories, GROUPS, np.random.default_rng(1), draws=200)
    for history in histories:
        history.value[::3, 9] += 1e3
    other = find_changes(histories, GROUPS, np.random.default_rng(1), draws=200)
    assert changes.changes == other.changes == ()
    np.testing.assert_allclose(list(changes.p_values.values()), list(other.p_values.values()), atol=0.05)


def test_draws_depend_on_the_generator_alone() -> None:
    histories = fleet(np.random.default_rng(7), 3, 4)
    first, second = (find_changes(histories, GROUPS, np.random.default_rng(1), draws=50) for _ in range(2))
    assert first.p_values == second.p_values


def test_courses_step_at_a_log_and_drift_from_its_day() -> None:
    days = np.array([0.0, 1.0, 1.0, 5.0])
    assert course(days, ChangeShape.STEP, 2).tolist() == [0.0, 0.0, 1.0, 1.0]
    assert course(days, ChangeShape.DRIFT, 1).tolist() == [0.0, 0.0, 0.0, 1.0]


def test_logs_of_one_day_have_no_drift() -> None:
    rng = np.random.default_rng(10)
    histories = [History(x.robot, x.logs, 0 * x.days, x.value, x.information) for x in fleet(rng, 8, 12, {0: carries})]
    (step,) = find_changes(histories, GROUPS, rng, draws=200).changes
    assert (step.shape, step.index, step.odds) == (ChangeShape.STEP, 10, np.inf)


def _fields(history: History):
    return history.logs, history.days, history.value, history.information


SPREAD = 0.2


def shared(rng, robots=12, logs=8, changes=None):
    histories = fleet(rng, robots, logs, changes)
    test_changes = find_changes(histories, GROUPS, rng, draws=200)
    return histories, test_changes, pool_robots(histories, GROUPS, test_changes.scatter, test_changes.changes)


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
        old += [(x.value - beta) / x.std for x, beta in zip(type_.robots, truth, strict=True)]
        for _ in range(12):
            beta = SIZE * (1 + SPREAD * rng.standard_normal(B))
            log = robot(rng, "new", beta, 1, rows=13)
            case = type_.borrow("new", log.value[0], scatter.with_scatter(log.information[0]))
            new.append((case.value - beta) / case.std)
    for scores in (old, new):
        assert 0.75 < np.sqrt(np.mean(np.square(scores))) < 1.3


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
    posterior = odd.robots[4]
    assert ((posterior.value - odd.mean)[6:8] > 10 * posterior.std[6:8]).all()


def test_robots_are_pooled_as_they_were_before_their_changes() -> None:
    def carries(log: int, value: np.ndarray) -> None:
        value += (log >= 3) * GROUPS[PAYLOAD].directions @ np.array([0.05, 0.0, 0.1])

    rng = np.random.default_rng(6)
    truth = SIZE * (1 + SPREAD * rng.standard_normal((8, B)))
    histories = [robot(rng, f"robot{r}", truth[r], 9, *([carries] if r == 2 else [])) for r in range(8)]
    changes = find_changes(histories, GROUPS, rng, draws=200)
    assert {change.robot for change in changes.changes} == {"robot2"}
    value, information = baseline(histories[2], changes.scatter, changes.of("robot2"))
    std = np.sqrt(np.diag(np.linalg.inv(information)))
    assert (np.abs(value - truth[2]) < 4.5 * std).all()
    later, _ = baseline(histories[2], changes.scatter)
    assert (np.abs(later - truth[2]) > 4.5 * std).any()
