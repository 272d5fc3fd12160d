"""Parts of a motion: samples evenly spread over the usable ones, and pieces whose samples stay neighbours."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from dynident.log import Motion, pieces, subsample


def motion(count: int, first: int = 0) -> Motion:
    """Return a motion of so many samples, 0.01 s apart, usable from the first named on."""
    x = np.zeros((count, 1))
    return Motion(np.arange(count) * 0.01, x, x, x, x, ("a",), np.arange(count) >= first)


def test_samples_are_spread_over_the_usable_ones_of_all_motions() -> None:
    one, other = subsample([motion(1000, 500), motion(100)], 100)
    np.testing.assert_array_equal(one, np.arange(500, 1000, 6))
    np.testing.assert_array_equal(other, np.arange(0, 100, 6))
    np.testing.assert_array_equal(subsample([motion(30, 10)], 100)[0], np.arange(10, 30))


def test_samples_keep_their_distance_from_the_ends() -> None:
    (rows,) = subsample([motion(101)], 1000, margin=0.2)
    np.testing.assert_array_equal(rows, np.arange(20, 81))


@pytest.mark.parametrize(("count", "share"), [(5, 0.25), (3, 1.0), (1, 0.5)])
def test_pieces_cover_their_share_of_a_stretch(count: int, share: float) -> None:
    found = pieces(slice(100, 1000), count, share)
    assert len(found) == count
    assert found[0].start == 100
    assert found[-1].stop <= 1000
    assert sum(one.stop - one.start for one in found) == pytest.approx(900 * share, abs=count)
    assert all(left.stop <= right.start for left, right in itertools.pairwise(found))
