"""Settings of the tests of jobs."""

import pytest

from dynident.jobs import workers


@pytest.fixture(autouse=True)
def light(monkeypatch: pytest.MonkeyPatch) -> None:
    """Workers without what real jobs need start in no time."""
    monkeypatch.setattr(workers, "HEAVY", ())
