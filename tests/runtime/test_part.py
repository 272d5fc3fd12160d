"""Parts that fail or return another type are said by name, with the line of their own file."""

import pytest

from dynident.runtime import ConfigError, InputError, call_part


def fails(given: object) -> object:
    raise ZeroDivisionError(given)


def refuses(given: object) -> object:
    raise InputError(str(given))


def ends(given: object) -> object:
    raise SystemExit(given)


def starves(given: object) -> object:
    raise MemoryError(given)


def test_a_part_of_somebody_else_is_named_with_its_line() -> None:
    assert call_part(str, 3, str) == "3"
    with pytest.raises(ConfigError, match=r"fails failed at .*test_part\.py:\d+: ZeroDivisionError: 3"):
        call_part(fails, 3, str)
    with pytest.raises(ConfigError, match="ends failed at"):
        call_part(ends, 3, str)
    with pytest.raises(ConfigError, match="repr returned a str; it must return a int"):
        call_part(repr, 3, int)
    with pytest.raises(InputError, match="3"):
        call_part(refuses, 3, str)
    with pytest.raises(MemoryError):
        call_part(starves, 3, str)
