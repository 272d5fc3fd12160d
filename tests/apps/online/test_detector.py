"""Changes are found in their group, with their size, and at most as often by chance as is stated."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from dynident.apps.online import Alarm, BaselineKnown, Changed, Event, NewMotion, Passed, Unsteady
from dynident.apps.online.candidates import threshold
from dynident.apps.online.detector import Detector, Knowledge
from dynident.apps.online.scores import Scores, _score_spread
from dynident.regression import GroupKind
from dynident.runtime.arrays import Array
from tests.apps.online.blocks import INFORMATION, SPREAD, block, candidates


@pytest.mark.parametrize(
    ("u", "M", "variance"),
    [
        ([3.0] * 8, [1.0] * 8, 1e-6),
        ([0.2, -0.2] * 4, [1.0] * 8, 0.32 / 7),
        ([0.2, -0.2] * 4, [4.0] * 8, 0.08 / 7),
        ([9.0, -9.0, 9.0] * 2, [1.0, 1.0, 1.0, 0.0, 0.0, 0.0], 1.0),
    ],
)
def test_the_spread_of_scores_is_that_of_what_shows_the_direction(
    u: list[float], M: list[float], variance: float
) -> None:
    assert _score_spread(np.array(u), np.array(M)) == pytest.approx(variance)


BASELINE, SETTLE, START = 60, 6, 100  # blocks: of the baseline, after an alarm, and without a change before one


@cache
def limit(rate: float) -> float:
    return threshold(rate, 5.0, candidates().ranks, BASELINE / 2, np.random.default_rng(0), BASELINE)


@cache
def detector(rate: float = 0.03, tolerance: float = 0.0) -> Detector:
    return Detector(candidates(tolerance), BASELINE, SETTLE, limit(rate), np.ones(2))


def stepped(of: Detector, knowledge: Knowledge, blocks: Iterable[Scores]) -> tuple[Knowledge, list[Event]]:
    events = list[Event]()
    for scores in blocks:
        knowledge, said = of.step(knowledge, scores)
        events += said
    return knowledge, events


@cache
def quiet(of: Detector) -> tuple[Knowledge, list[Event]]:
    rng = np.random.default_rng(1)
    return stepped(of, of.start(), (block(rng, k) for k in range(START)))


def watched(blocks: int, make: Callable[[np.random.Generator, int], Scores], of: Detector | None = None) -> list[Event]:
    """Return what is said of blocks after ``START`` quiet ones, in which the baseline is found."""
    of, rng = of or detector(), np.random.default_rng(2)
    reference, events = quiet(of)
    return events + stepped(of, reference, (make(rng, k) for k in range(START, blocks)))[1]


def changed(events: list[Event]) -> list[tuple[GroupKind, str]]:
    return [(event.kind, event.joint) for event in events if isinstance(event, Changed)]


def test_nothing_is_said_where_nothing_changes_but_that_the_baseline_is_known() -> None:
    (only,) = watched(300, block)
    assert isinstance(only, BaselineKnown)
    assert only.time == 5.0 * BASELINE
    assert only.since == 0.0
    np.testing.assert_allclose(only.residual, 1.0, atol=0.1)


def test_alarms_by_chance_are_not_more_than_stated() -> None:
    """At 1440 a day, or one in 12 blocks: the stated rate is an upper bound, and not far from what is."""
    events = watched(600 + BASELINE, block, detector(rate=1440.0))
    alarms, stated = sum(isinstance(event, Alarm | Unsteady) for event in events), 1440.0 * 600 * 5.0 / 86_400
    assert 0.1 * stated < alarms < 1.2 * stated


@pytest.mark.parametrize(
    ("kind", "joint", "at"), [("friction", "one", 0), ("friction", "two", 3), ("payload", "two", 6)]
)
def test_a_change_is_found_in_its_group_with_its_size(kind: str, joint: str, at: int) -> None:
    change = np.zeros(8)
    change[at] = 8.0 * np.sqrt(SPREAD / INFORMATION)
    events = watched(200, lambda rng, k: block(rng, k, change))
    assert changed(events) == [(kind, joint)]
    alarm, result = (next(event for event in events if isinstance(event, noun)) for noun in (Alarm, Changed))
    assert 500.0 < alarm.time <= 520.0
    assert alarm.since == 500.0
    (part,) = [
        part
        for group, part in zip(candidates().groups, candidates().group_slices, strict=True)
        if group.kind == kind and group.joint == joint
    ]
    own = at - part.start
    assert abs(result.size[own] - change[at]) < 4 * result.std[own]
    assert result.total == result.size


def test_what_lasts_for_a_few_blocks_has_passed() -> None:
    change = np.append(10.0 * np.sqrt(SPREAD / INFORMATION), np.zeros(7))
    events = watched(200, lambda rng, k: block(rng, k, change if k < 103 else None))
    assert [type(x) for x in events[1:]] == [Alarm, Passed]


def test_what_no_parameter_explains_is_found_at_its_joint() -> None:
    events = watched(200, lambda rng, k: block(rng, k, louder=np.log(4.0)))
    assert changed(events) == [("residual", "two")]
    result = next(event for event in events if isinstance(event, Changed))
    assert np.exp(result.size[0]) == pytest.approx(2.0, rel=0.1)  # of the root mean square


def test_a_change_within_the_baseline_is_said_and_the_baseline_goes_on() -> None:
    change = np.append(8.0 * np.sqrt(SPREAD / INFORMATION), np.zeros(7))
    rng, of = np.random.default_rng(1), detector()
    _, events = stepped(of, of.start(), (block(rng, k, change if k >= BASELINE // 2 else None) for k in range(200)))
    assert [type(event) for event in events] == [Unsteady, BaselineKnown]
    assert [(event.since, event.time) for event in events] == [(0.0, 300.0), (150.0, 450.0)]


def test_what_is_within_the_tolerance_is_no_change() -> None:
    change = np.append(0.3, np.zeros(7))
    samples = 1000
    size = 0.3 * np.sqrt(INFORMATION / samples)  # torque in units of the noise
    for tolerance in (0.0, 2 * size):
        events = watched(200, lambda rng, k: block(rng, k, change), detector(tolerance=tolerance))
        assert bool(changed(events)) == (not tolerance)


def learned(blocks: int, shown: Callable[[int], Array], wrong: Array | float = 0.0) -> list[type[Event]]:
    """Return what is said where block k shows the directions by these shares, and the result is ``wrong``."""
    rng, of = np.random.default_rng(1), detector()
    made = (showing(block(rng, k, mixed=0.0), shown(k), wrong) for k in range(blocks))
    return [type(event) for event in stepped(of, of.start(), made)[1]]


def showing(scores: Scores, share: Array, wrong: Array | float = 0.0) -> Scores:
    A = scores.information * np.outer(share, share)
    return replace(scores, information=A, score=share * scores.score + A @ np.broadcast_to(wrong, 8))


def test_the_windows_move_with_a_reference_that_learns() -> None:
    weak = np.append(np.ones(4), np.full(4, 1e-3))
    rng, of = np.random.default_rng(1), detector()
    blocks = [showing(block(rng, k, mixed=0.0), weak) for k in range(BASELINE + 1)]
    before, _ = stepped(of, of.start(), blocks)
    after, _ = of.step(before, block(rng, BASELINE + 1, np.full(8, 0.5)))  # motion that nothing has shown
    assert after.new == 1
    sums = of.candidates.sums(after.reference, blocks[-1])
    assert not np.allclose(sums.clipped, before.windows[0].clipped)
    np.testing.assert_allclose(after.windows[0].clipped, sums.clipped, atol=1e-9)


def test_motion_that_the_baseline_did_not_show_is_learned() -> None:
    far = np.where(np.arange(8) == 5, 1.0, 0.0)  # the result was wrong there, which nothing has shown
    weak = np.append(np.ones(4), np.full(4, 1e-4))
    said = learned(300, lambda k: np.ones(8) if k >= START else weak, far)
    assert not {Changed, Alarm} & set(said)


def test_new_motion_that_lasts_is_said() -> None:
    weak = np.append(np.ones(4), np.full(4, 1e-6))
    said = learned(140, lambda k: np.where(np.arange(8) == k % 8, 1.0, 1e-3) if k >= START else weak)
    assert said.count(NewMotion) <= 1
    assert Changed not in said
