"""Random motions keep to all limits, and use them."""

from dataclasses import replace

import numpy as np
import pytest

from dynident.apps.excitation.search import random_motion
from dynident.runtime import InputError
from tests.apps.excitation.requests import OPEN, interior


@pytest.mark.parametrize("family", ["fourier", "bspline"])
def test_random_motions_keep_to_all_limits_and_use_them(family):
    one = interior(family=family)
    rng = np.random.default_rng(0)
    found = [random_motion(one, rng) for _ in range(6)]
    assert all(map(one.is_inside, found))
    used = [1 - one.range_slack(x).min() for x in found]
    assert np.median(used) > 0.3
    assert np.abs(found[0] - found[1]).max() > 0.1


def test_the_generator_alone_decides():
    one = interior()
    twice = [random_motion(one, np.random.default_rng(3)) for _ in range(2)]
    np.testing.assert_array_equal(*twice)


def test_where_only_standing_is_possible_it_is_said():
    one = interior(space=OPEN)
    heavy = one.with_reserve(replace(one.spare, torque=np.ones(2)))
    with pytest.raises(InputError, match="no random motion keeps to the limits"):
        random_motion(heavy, np.random.default_rng(0))
