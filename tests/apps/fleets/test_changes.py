"""Changes of robots are found, quiet ones stay quiet; components of variance, scatter and likelihood ratios."""

from dataclasses import replace

import numpy as np
import pytest

from dynident.apps.fleets import ChangeShape, History, find_changes, pool_robots
from dynident.apps.fleets.components import (
    Scatter,
    VarianceComponents,
    blocks_of,
    scatter_of,
    variance_components,
    whiten,
)
from dynident.apps.fleets.ratios import LikelihoodRatios, NullDraws
from dynident.regression import GroupKind
from dynident.runtime import InputError
from tests.apps.fleets.simulated import (
    CARRIED,
    FRICTION_A,
    GROUPS,
    OFFSET_B,
    PAYLOAD,
    RIPPLE,
    SCATTER,
    SIZE,
    B,
    E,
    carries,
    fleet,
    group,
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
        np.testing.assert_allclose(wear.per_day, wear.size / (105.0 - wear.day))
    assert len(flagged) <= 2  # of 15 quiet robots, and further changes of others
    assert np.abs(scores).max() < 4
    assert 0.6 < np.sqrt(np.mean(np.square(scores))) < 1.3


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


BLOCKS = tuple(np.array(block) for block in ((0, 1), (2,)))
TRUE = np.array([[1.0, 0.8, 0.0], [0.8, 2.0, 0.0], [0.0, 0.0, 0.25]])


def drawn(rng, sets, vectors, inflation=1.0):
    """Sets of vectors of three parameters that deviate by TRUE about a mean of their own; some show more, some less."""
    result = []
    for _ in range(sets):
        X = rng.standard_normal((vectors, 30, 3)) * 10 ** rng.uniform(-1.5, 0.5, (vectors, 1, 1))
        J = X.swapaxes(1, 2) @ X
        errors = np.sqrt(inflation) * np.linalg.cholesky(np.linalg.inv(J)) @ rng.standard_normal((vectors, 3, 1))
        deviations = rng.multivariate_normal(np.zeros(3), TRUE, vectors)
        result.append((5 * rng.standard_normal(3) + deviations + errors[:, :, 0], J))
    return result


def test_restricted_likelihood_has_no_bias_by_the_means() -> None:
    """With two vectors a set, maximum likelihood would find half of the variance."""
    sets = [whiten(*x) for x in drawn(np.random.default_rng(2), 600, 2)]
    np.testing.assert_allclose(np.diag(variance_components(sets, BLOCKS).covariance), np.diag(TRUE), rtol=0.2)


def test_a_direction_that_is_not_shown_says_nothing() -> None:
    rng = np.random.default_rng(5)
    hidden, changed = [], []
    for y, J in drawn(rng, 6, 5):
        J[::2, 1, :] = J[::2, :, 1] = 0.0
        J[:, 2, :] = J[:, :, 2] = 0.0
        hidden.append(whiten(y, J))
        other = y.copy()
        other[::2, 1] += 100.0
        other[:, 2] -= 100.0
        changed.append(whiten(other, J))
    case, two = (variance_components(sets, BLOCKS, inflate=True) for sets in (hidden, changed))
    np.testing.assert_allclose(case.covariance, two.covariance, rtol=1e-3)
    assert case.covariance[2, 2] == 0.0
    run = hidden[0].solve(case)
    assert np.isfinite(run.value).all()
    assert run.covariance[2, 2] == 0.0


def test_solved_is_generalised_least_squares() -> None:
    (history,) = fleet(np.random.default_rng(6), 1, 5)
    parts = VarianceComponents((np.arange(B),), np.diag(np.full(B, 1e-3)), 2.0)
    W = np.linalg.inv(2.0 * np.linalg.inv(history.information) + parts.covariance)
    run = whiten(history.value, history.information).solve(parts)
    expected = np.linalg.solve(W.sum(axis=0), np.einsum("kij,kj->i", W, history.value))
    np.testing.assert_allclose(run.value, expected, rtol=1e-8)
    np.testing.assert_allclose(run.covariance, np.linalg.inv(W.sum(axis=0)), rtol=1e-6)
    deviation = history.value - expected
    np.testing.assert_allclose(run.distance, np.einsum("ki,kij,kj->k", deviation, W, deviation), rtol=1e-6)


def test_parameters_of_a_group_scatter_together() -> None:
    blocks = [block.tolist() for block in blocks_of(GROUPS, B)]
    assert blocks == [[0], [1], [2], [3], [4, 5], [6, 7], [8], [9], [10, 11]]
    overlapping = (*GROUPS, group(GroupKind.RIPPLE, "a", E[:, [5, 9]]))
    assert [4, 5, 9] in [block.tolist() for block in blocks_of(overlapping, B)]


@pytest.mark.parametrize(("robots", "logs"), [(10, 20), (2, 60)])
def test_scatter_is_that_of_friction_and_offsets(robots: int, logs: int) -> None:
    """Standard errors are 1.5 times too small; the parameters of bodies do not scatter."""
    rng = np.random.default_rng(1)
    result = scatter_of(fleet(rng, robots, logs), GROUPS, rng)
    assert 1.1**2 < result.inflation < 1.6**2
    relative = np.sqrt(np.diag(result.covariance)) / SIZE
    expected = np.hypot(*SCATTER[:2])
    assert (np.abs(relative[4:8] - expected) < 0.6 * expected).all()
    assert result.covariance[4, 5] > 0.4 * np.sqrt(result.covariance[4, 4] * result.covariance[5, 5])
    assert relative[:4].max() < 0.03
    assert result.dof == robots * logs - (robots if robots > 4 else robots * logs / 3)


def test_robots_of_other_parameters_are_refused() -> None:
    rng = np.random.default_rng(5)
    first, second = fleet(rng, 2, 3)
    short = type(second)(second.robot, second.logs, second.days, second.value[:, :5], second.information[:, :5, :5])
    with pytest.raises(InputError, match=r"\[5, 12\] base parameters"):
        scatter_of([first, short], GROUPS, rng)


def test_what_a_log_says_of_the_robot_is_less_than_of_the_day() -> None:
    rng = np.random.default_rng(6)
    (history, *_), result = fleet(rng, 6, 8), scatter_of(fleet(rng, 6, 8), GROUPS, rng)
    J = history.information[0]
    expected = np.linalg.inv(result.inflation * np.linalg.inv(J) + result.covariance)
    np.testing.assert_allclose(result.with_scatter(J), expected, rtol=1e-6, atol=1e-9 * np.abs(expected).max())
    assert not result.with_scatter(np.zeros_like(J)).any()


STEP, DRIFT = np.repeat([0.0, 1.0], [3, 5]), np.linspace(0.0, 1.0, 8)
PARTS = Scatter(tuple(np.arange(B)[:, None]), np.diag((0.03 * SIZE) ** 2), 1.7, 50.0)


def ratios(history):
    return LikelihoodRatios.of(history, GROUPS, PARTS, np.array([STEP, DRIFT]))


def with_step(log: int, value: np.ndarray) -> None:
    value[:4] += (log > 2) * GROUPS[PAYLOAD].directions[:4] @ np.array([0.02, 0.0, 0.05])


def weighted_squares(history, columns):
    """The least of the weighted squared residuals with the base parameters and further columns (K, b, q)."""
    K = len(history.logs)
    X = np.concatenate([np.broadcast_to(np.eye(B), (K, B, B)), *columns], axis=2)
    L = np.linalg.cholesky(np.linalg.inv(1.7 * np.linalg.inv(history.information) + PARTS.covariance))
    rows, left = L.swapaxes(1, 2) @ X, np.einsum("kji,kj->ki", L, history.value)
    rows = rows.reshape(-1, X.shape[2])
    scale = np.linalg.norm(rows, axis=0)
    result, squares, *_ = np.linalg.lstsq(rows / scale, left.ravel())
    return result / scale, squares.sum(), np.linalg.inv((rows / scale).T @ (rows / scale)) / np.outer(scale, scale)


def test_ratios_are_those_of_least_squares() -> None:
    (history,) = fleet(np.random.default_rng(1), 1, 8, {0: with_step})
    friction, payload = (
        [course[:, None, None] * GROUPS[g].directions] for g, course in ((FRICTION_A, DRIFT), (PAYLOAD, STEP))
    )
    case = ratios(history)
    taken = [(PAYLOAD, 0), (FRICTION_A, 1)]
    (_, nothing, _), (_, single, _) = weighted_squares(history, []), weighted_squares(history, payload)
    value, both, covariance = weighted_squares(history, payload + friction)
    assert case.profile(taken[:1], 0)[0] == pytest.approx(nothing - single, rel=1e-6)
    assert case.profile(taken, 1)[1] == pytest.approx(single - both, rel=1e-6)
    (size, std), (rubbing, _) = case.fit(taken)
    np.testing.assert_allclose(size, value[B : B + 3], rtol=1e-6)
    np.testing.assert_allclose(rubbing, value[B + 3 :], rtol=1e-6)
    np.testing.assert_allclose(std, np.sqrt(np.diag(covariance)[B : B + 3]), rtol=1e-6)


def test_the_clearest_change_is_found_and_then_no_other() -> None:
    rng = np.random.default_rng(2)
    (history,) = fleet(rng, 1, 8, {0: with_step})
    best, chance = ratios(history).clearest_change([], NullDraws(rng, 400))
    assert best == (PAYLOAD, 0)
    assert chance == 1 / 401
    _, further = ratios(history).clearest_change([(PAYLOAD, 0)], NullDraws(rng, 400))
    assert further > 0.01
    assert ratios(history).refine([(PAYLOAD, 1)]) == [(PAYLOAD, 0)]
