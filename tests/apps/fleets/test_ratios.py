import numpy as np
import pytest
from scipy.stats import chi2

from dynident.apps.fleets.components import VarianceComponents
from dynident.apps.fleets.ratios import LikelihoodRatios, NullDraws, evidence
from tests.apps.fleets.simulated import FRICTION_A, GROUPS, PAYLOAD, SIZE, B, fleet

STEP, DRIFT = np.repeat([0.0, 1.0], [3, 5]), np.linspace(0.0, 1.0, 8)
PARTS = VarianceComponents(tuple(np.arange(B)[:, None]), np.diag((0.03 * SIZE) ** 2), 1.7)


def ratios(history):
    return LikelihoodRatios.of(history, GROUPS, PARTS, np.array([STEP, DRIFT]), 50.0)


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
    found, squares, *_ = np.linalg.lstsq(rows / scale, left.ravel())
    return found / scale, squares.sum(), np.linalg.inv((rows / scale).T @ (rows / scale)) / np.outer(scale, scale)


def test_ratios_are_those_of_least_squares() -> None:
    (history,) = fleet(np.random.default_rng(1), 1, 8, {0: with_step})
    friction, payload = (
        [course[:, None, None] * GROUPS[g].directions] for g, course in ((FRICTION_A, DRIFT), (PAYLOAD, STEP))
    )
    one = ratios(history)
    taken = [(PAYLOAD, 0), (FRICTION_A, 1)]
    (_, nothing, _), (_, single, _) = weighted_squares(history, []), weighted_squares(history, payload)
    value, both, covariance = weighted_squares(history, payload + friction)
    assert one.profile(taken[:1], 0)[0] == pytest.approx(nothing - single, rel=1e-6)
    assert one.profile(taken, 1)[1] == pytest.approx(single - both, rel=1e-6)
    (size, std), (rubbing, _) = one.fit(taken)
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


def test_chunks_of_draws_are_all_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    (history,) = fleet(np.random.default_rng(3), 1, 8)
    _, whole = ratios(history).clearest_change([], NullDraws(np.random.default_rng(4), 999))
    monkeypatch.setattr("dynident.apps.fleets.ratios.CHUNK", 7 * history.value.size)
    _, parts = ratios(history).clearest_change([], NullDraws(np.random.default_rng(5), 999))
    assert (1000 * parts) == pytest.approx(round(1000 * parts))
    assert abs(parts - whole) < 0.1


def test_errors_drawn_from_a_pool_are_those_of_logs() -> None:
    """Standardised errors have a variance of one, and rows made of them the spread of the logs they are drawn for."""
    rng = np.random.default_rng(9)
    many = [ratios(history) for history in fleet(rng, 30, 8)]
    pool = np.concatenate([one.standardised_errors([]) for one in many])
    assert pool.shape == (240, B)
    drawn = many[0]._draw_rows(NullDraws(rng, 400, pool), 400)
    rows = np.concatenate([one.value - _fitted(one) for one in many]).ravel()
    assert np.std(drawn) == pytest.approx(np.std(rows) * np.sqrt(8 / 7), rel=0.1)
    value = many[0].rows[0].T @ many[0].rotations[0]  # the symmetric root of the log's information
    scale = np.linalg.norm(many[0].rows[0], axis=0)
    root = value / scale[:, None]
    np.testing.assert_allclose(root, root.T, atol=1e-9)


def test_a_pool_with_heavy_tails_makes_changes_less_clear() -> None:
    (history,) = fleet(np.random.default_rng(10), 1, 8)
    pool = np.random.default_rng(11).standard_normal((300, B))
    _, plain = ratios(history).clearest_change([], NullDraws(np.random.default_rng(12), 400, pool))
    pool[:15] *= 8.0
    _, heavy = ratios(history).clearest_change([], NullDraws(np.random.default_rng(12), 400, pool))
    assert heavy > plain + 0.1


def _fitted(one: LikelihoodRatios) -> np.ndarray:
    X = one.rows.reshape(-1, B)
    return ((X * SIZE) @ np.linalg.lstsq(X * SIZE, one.value.ravel())[0]).reshape(one.value.shape)


def test_what_no_log_shows_has_an_infinite_error() -> None:
    (history,) = fleet(np.random.default_rng(6), 1, 8)
    history.information[:, 5, :] = history.information[:, :, 5] = 0.0
    (size, std), *_ = ratios(history).fit([(FRICTION_A, 0)])
    assert np.isfinite(size).all()
    assert np.isfinite(std[0])
    assert np.isinf(std[1])


def test_nothing_can_change_where_nothing_is_tried() -> None:
    (history,) = fleet(np.random.default_rng(7), 1, 8)
    none = LikelihoodRatios.of(history, (), PARTS, np.array([STEP]), 50.0)
    assert none.clearest_change([], NullDraws(np.random.default_rng(8), 200)) == (None, 1.0)


@pytest.mark.parametrize("rank", [1, 2, 3, 10])
def test_evidence_is_the_tail_of_chi_square(rank: int) -> None:
    gain = np.array([0.0, 0.5, 10.0, 600.0])
    np.testing.assert_allclose(evidence(gain, rank), -chi2.logsf(gain, rank), rtol=1e-10, atol=1e-12)
    far = evidence(np.array([1250.0, 1290.0, 1330.0, 1e6]), rank)  # where the probability underflows on the way
    assert np.isfinite(far).all()
    assert (np.diff(far[:3]) / 20.0) == pytest.approx(1.0, abs=0.02)
