"""The fixtures of the report's tests."""

from tests.report.conftest import reproduction as reproduction
