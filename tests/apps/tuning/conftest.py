"""A bench for all tests that do not need another."""

import pytest

from dynident.apps.tuning import Bench
from tests.apps.tuning.arms import bench


@pytest.fixture(scope="package")
def arm() -> Bench:
    """A small arm with a recording and a held-out one."""
    return bench()
