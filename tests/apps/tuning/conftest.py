"""Two benches for all tests that do not need another."""

from __future__ import annotations

import pytest

from dynident.apps.tuning import Bench
from tests.apps.tuning.arms import bench, logs, recording


@pytest.fixture(scope="package")
def arm() -> Bench:
    return bench()


@pytest.fixture(scope="package")
def validated_arm() -> Bench:
    """A small arm with a recording and a held-out one."""
    return bench(logs(recording(0, 8.0, "monday"), held=(recording(1, name="tuesday"),)))
