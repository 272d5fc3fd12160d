"""The fixtures of the report's tests."""

from __future__ import annotations

from tests.report.conftest import reproduction as reproduction
