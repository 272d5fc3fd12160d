"""One bench for all tests that do not need another."""

from __future__ import annotations

import pytest

from dynident.tuning import Bench
from tests.tuning.arms import bench


@pytest.fixture(scope="package")
def arm() -> Bench:
    return bench()
