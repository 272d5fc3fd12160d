"""The search: feasible, better, the same on any executor, and of use when it is stopped."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from dynident.apps.excitation.interior import Interior
from dynident.apps.excitation.search import STAGES, Plan, Stage, improve_motion, random_motion, search
from dynident.runtime import InputError, progress_to
from tests.apps.excitation.requests import OPEN, interior

SHORT = (Stage(1.0, 10), Stage(0.1, 10, 0.5))
ONE = interior(space=OPEN)


def test_the_motion_found_is_better_than_random_ones_and_keeps_to_the_limits():
    found = search(ONE, Plan(2, (Stage(1.0, 15), Stage(0.05, 15))), np.random.default_rng(0))
    rng = np.random.default_rng(1)
    others = [ONE.at(random_motion(ONE, rng), 0.0).criterion for _ in range(40)]
    assert found.criterion < min(others) - 3
    assert found.criterion == pytest.approx(ONE.at(found.x, 0.0).criterion)
    assert ONE.is_inside(found.x)
    assert (found.starts, found.interrupted) == (2, False)


def test_the_barrier_holds_every_iterate(monkeypatch):
    seen, at = [], Interior.at

    def watched(self, x, weight):
        point = at(self, x, weight)
        seen.append(point is None)
        return point

    x = random_motion(ONE, np.random.default_rng(5))
    monkeypatch.setattr(Interior, "at", watched)
    best, criterion = improve_motion(ONE, x, Stage(0.01, 40))
    assert any(seen)  # steps that go too far are tried, and not taken
    assert ONE.is_inside(best)
    assert criterion < at(ONE, x, 0.0).criterion


def test_a_stage_ends_where_another_way_ends():
    x, _ = improve_motion(ONE, random_motion(ONE, np.random.default_rng(2)), Stage(2.0, 300))
    value = ONE.at(x, 2.0).value
    again, _ = improve_motion(ONE, x, Stage(2.0, 300))
    assert value - ONE.at(again, 2.0).value < 0.1
    aside, _ = improve_motion(ONE, ONE.shrink(0.97 * x), Stage(2.0, 300))
    assert abs(value - ONE.at(aside, 2.0).value) < 0.3


def test_the_executor_does_not_change_the_motion():
    alone = search(ONE, Plan(3, SHORT), np.random.default_rng(4))
    with ThreadPoolExecutor(2) as two:
        spread = search(ONE, Plan(3, SHORT), np.random.default_rng(4), executor=two)
    np.testing.assert_array_equal(alone.x, spread.x)
    other = search(ONE, Plan(3, SHORT), np.random.default_rng(5))
    assert np.abs(other.x - alone.x).max() > 1e-3


def test_progress_counts_the_motions_of_all_stages_and_never_gets_worse():
    seen = []
    with progress_to(seen.append):
        search(ONE, Plan(3, SHORT), np.random.default_rng(4))
    assert [step.completed for step in seen] == [1, 2, 3, 4, 5]
    assert {step.total for step in seen} == {5}
    assert all(np.diff([float(step.words.split()[-1]) for step in seen]) >= 0)  # log det of the best so far


def test_stopped_it_gives_the_best_so_far():
    calls = []

    def stop(step):
        calls.append(float(step.words.split()[-1]))
        if step.completed == 2:
            raise KeyboardInterrupt

    with progress_to(stop):
        found = search(ONE, Plan(4, SHORT), np.random.default_rng(4))
    assert found.interrupted
    log_det = 2 * np.log(ONE.information.scale).sum() - found.criterion
    assert max(calls) == float(f"{log_det:.1f}")
    assert ONE.is_inside(found.x)


def test_stopped_before_anything_was_found_it_stops(monkeypatch):
    def stop(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("dynident.apps.excitation.search.random_motion", stop)
    with pytest.raises(KeyboardInterrupt):
        search(ONE, Plan(2), np.random.default_rng(0))


def test_it_begins_with_the_motions_that_are_given():
    x = random_motion(ONE, np.random.default_rng(9))
    found = search(ONE, Plan(5, (Stage(1.0, 0),)), np.random.default_rng(0), initial=[x])
    np.testing.assert_array_equal(found.x, x)
    assert found.starts == 1


def test_a_start_beyond_the_limits_is_refused():
    x = 10 * random_motion(ONE, np.random.default_rng(9))
    with pytest.raises(InputError, match="does not keep to the limits"):
        improve_motion(ONE, x, STAGES[0])
    with pytest.raises(InputError, match="no motion was found"):
        search(ONE, Plan(1), np.random.default_rng(0), initial=[x])
