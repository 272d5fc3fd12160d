"""A context delivers each sample once, with what it needs around it."""

from __future__ import annotations

import numpy as np
import pytest

from dynident.apps.online.fixed_lag import Context, cut_motion, join_motions
from dynident.motion.log import Motion

N = 200


def motion(start: int, stop: int, usable: int = 0) -> Motion:
    """Samples whose time is their number, usable from one of them on."""
    t = np.arange(start, stop, dtype=float)
    x = np.outer(t, [1.0, 2.0])
    return Motion(t, x, x + 1, x + 2, x + 3, ("a", "b"), t >= usable)


@pytest.mark.parametrize(
    ("before", "after", "multiple", "usable"), [(0, 0, 1, 0), (7, 5, 1, 3), (10, 12, 4, 9), (3, 30, 7, 40)]
)
@pytest.mark.parametrize("size", [2, 3, 11, 64])
def test_each_sample_is_delivered_once_with_those_around_it(before, after, multiple, usable, size) -> None:
    context, seen, held = Context(before, after, multiple), [], []
    stops = [*range(size, N - 1, size), N]
    for start, stop in zip([0, *stops[:-1]], stops, strict=True):
        found = context.push(motion(start, stop, usable), ended=stop == N)
        if found is None:
            continue
        whole, new = found
        seen += whole.t[new].tolist()
        assert whole.t[0] <= max(0.0, whole.t[new.start] - before)
        assert stop == N or whole.t[-1] >= whole.t[new.stop - 1] + after
        if whole.t[0] > usable:
            assert (whole.t[0] - usable) % multiple == 0
        held.append(len(whole))
    assert seen == list(range(N))
    assert max(held) <= before + after + multiple + 2 * size + 2
    assert context.held is None


def test_a_saved_context_goes_on() -> None:
    one, other = Context(5, 4), Context(5, 4)
    for context in (one, other):
        context.push(motion(0, 20, 3))
    other.push(motion(20, 40))
    other.restore(one.state, motion(0, 2))
    for context in (one, other):
        whole, new = context.push(motion(20, 30))
        assert whole.t[new].tolist() == list(range(16, 26))
        np.testing.assert_array_equal(whole.mask, whole.t >= 3)
    other.restore(Context().state, motion(0, 2))
    assert other.held is None
    assert other.push(None) is None


def test_motions_are_cut_and_joined_with_their_memory() -> None:
    first, then = motion(0, 10), motion(10, 30)
    assert join_motions(first, then).memory is None
    from dataclasses import replace

    both = join_motions(*(replace(one, memory=one.q[:, :1]) for one in (first, then)))
    np.testing.assert_array_equal(both.t, np.arange(30.0))
    part = cut_motion(both, slice(5, 12))
    np.testing.assert_array_equal(part.memory, part.q[:, :1])
    assert len(part) == 7
