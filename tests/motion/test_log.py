"""Logs and motions: their tables, samples evenly spread over the usable ones, pieces whose samples stay neighbours."""

import itertools

import numpy as np
import pytest

from dynident.motion.log import Log, Motion, spread_pieces, subsample, thin_motions
from dynident.runtime import InputError


def motion(count: int, first: int = 0) -> Motion:
    """Return a motion of so many samples, 0.01 s apart, usable from the first named on."""
    x = np.zeros((count, 1))
    return Motion(np.arange(count) * 0.01, x, x, x, x, ("a",), np.arange(count) >= first)


def test_samples_keep_their_distance_from_the_ends() -> None:
    (rows,) = subsample([motion(101)], 1000, margin=0.2)
    np.testing.assert_array_equal(rows, np.arange(20, 81))


@pytest.mark.parametrize(("count", "share"), [(5, 0.25), (3, 1.0), (1, 0.5)])
def test_pieces_cover_their_share_of_a_stretch(count: int, share: float) -> None:
    result = spread_pieces(slice(100, 1000), count, share)
    assert len(result) == count
    assert result[0].start == 100
    assert result[-1].stop <= 1000
    assert sum(x.stop - x.start for x in result) == pytest.approx(900 * share, abs=count)
    assert all(left.stop <= right.start for left, right in itertools.pairwise(result))


def test_thinned_motions_have_the_samples_of_subsample():
    long, other = motion(1000, 500), motion(100)
    first, second = thin_motions([long, other], 100)
    rows = subsample([long, other], 100)
    np.testing.assert_array_equal(first.t, long.t[rows[0]])
    np.testing.assert_array_equal(second.q, other.q[rows[1]])
    assert [len(thin_motion) for thin_motion in thin_motions([motion(1000, 999), motion(100)], 100)] == [100]


def test_frames_name_each_column_by_signal_and_joint() -> None:
    t, q = np.arange(5) * 0.1, np.arange(10.0).reshape(5, 2)
    log = Log(t, q, -q, ("shoulder", "elbow"), dq=2 * q)
    table = log.frame()
    assert table.columns == ["t", "q.shoulder", "q.elbow", "tau.shoulder", "tau.elbow", "dq.shoulder", "dq.elbow"]
    np.testing.assert_array_equal(table["q.elbow"], q[:, 1])
    motion = Motion(t, q, 2 * q, 3 * q, -q, log.joints, np.arange(5) > 1)
    table = motion.frame()
    np.testing.assert_array_equal(table["ddq.shoulder"], 3 * q[:, 0])
    assert table["usable"].to_list() == [False, False, True, True, True]


def test_what_is_excluded_follows_the_samples() -> None:
    t = np.arange(10) * 0.1
    log = Log(t, np.zeros((10, 2)), np.zeros((10, 2)), ("a", "b"))
    gone = log.exclude([(0.2, 0.4), (0.7, 5.0)])
    assert np.flatnonzero(gone.excluded).tolist() == [2, 3, 4, 7, 8, 9]
    assert gone.exclude([(0.3, 0.4)]) is gone
    assert log.exclude([(2.0, 3.0)]) is log
    cut = gone.window(0.35, 0.75).select(("b", "a"))
    assert cut.excluded.tolist() == [True, False, False, True]
    assert gone.include_all().excluded is None
    assert log.include_all() is log
    with pytest.raises(InputError, match=r"log: time stamp 2 \(1.0 s\) repeats stamp 1 \(1.0 s\)"):
        Log([0.0, 1.0, 1.0], np.zeros((3, 1)), np.zeros((3, 1)), ("a",))
    with pytest.raises(InputError, match=r"log: tau has shape \(1,\), expected \(10, 2\)"):
        Log(log.t, log.q, None, log.joints)
    with pytest.raises(InputError, match=r"log: excluded has shape \(3,\), expected \(10,\)"):
        Log(t, np.zeros((10, 2)), np.zeros((10, 2)), ("a", "b"), excluded=np.zeros(3, dtype=bool))
