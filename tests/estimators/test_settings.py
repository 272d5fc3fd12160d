"""Settings of every estimator outside the limits that their types have: an error that names them and the limits."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import Annotated, Any, Literal, get_args, get_origin

import pytest
from annotated_types import Ge, Gt

from dynident.estimators import LeastSquares, Ridge
from dynident.runtime import ConfigError, check_settings
from dynident.runtime.families import ESTIMATORS, settings_hints

KINDS = [ESTIMATORS.get(kind) for kind in ESTIMATORS.table]


def wrong_values(hint: Any) -> Iterator[tuple[Any, str]]:
    """Values beyond each limit of a type, with words of the error."""
    for member in (hint, *get_args(hint)):
        if get_origin(member) is Literal and all(isinstance(text, str) for text in get_args(member)):
            yield f"{get_args(member)[0]}x", "did you mean"
        elif get_origin(member) is Annotated:
            number, *limits = get_args(member)
            yield float("nan"), "give a"
            for limit in limits:
                size = getattr(limit, "ge", getattr(limit, "gt", getattr(limit, "le", getattr(limit, "lt", None))))
                step = -1 if isinstance(limit, Ge | Gt) else 1
                yield number(size + step * max(1, abs(size))), f"{size:g}"


CASES = [
    (cls, field.name, value, words)
    for cls in KINDS
    for field in fields(cls)
    for value, words in wrong_values(settings_hints(cls)[field.name])
]


@pytest.mark.parametrize(("cls", "name", "value", "words"), CASES)
def test_a_setting_beyond_its_limits_is_named_with_them(cls: type, name: str, value: Any, words: str) -> None:
    with pytest.raises(ConfigError, match=rf"{name} = .*{re.escape(words)}"):
        cls(**{name: value})


def test_the_error_says_what_else_may_be_given() -> None:
    with pytest.raises(ConfigError, match=r"tolerance = 1\.0; give a number above 0 and at most 0\.01, or null\."):
        LeastSquares(tolerance=1.0)
    with pytest.raises(ConfigError, match=r"iterations = 2\.5; give a whole number at least 1 and at most 1000\."):
        LeastSquares(iterations=2.5)
    with pytest.raises(ConfigError, match=r"strength = -1\.0; give a number at least 0 and .*, or 'auto'\."):
        Ridge(strength=-1.0)


def test_a_type_that_is_not_known_has_no_limits() -> None:
    @dataclass(frozen=True)
    class Part:
        size: Unknown = -1  # noqa: F821

    check_settings(Part())
