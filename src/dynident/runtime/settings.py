"""The limits of settings, which the types of their fields have (``Annotated``, ``Literal``), are checked here."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from math import isfinite
from numbers import Real
from typing import Annotated, Any, Literal, get_args, get_origin

from dynident.runtime.errors import ConfigError, choices
from dynident.runtime.families import settings_hints


def check_settings(part: Any) -> None:
    """Check the fields of a dataclass: numbers by the limits of ``annotated_types``, texts by their choices.

    A field may hold what has no limits besides: mappings, parts, None. Raises ConfigError, which names the field.
    """
    cls: type = type(part)
    for name, rule in _rules(cls).items():
        rule.check(name, getattr(part, name))


@dataclass(frozen=True)
class _Rule:
    """What a field may hold: one of the ``texts``, or a number within limits (a ``whole`` one), or None."""

    texts: tuple[str, ...]
    whole: bool
    limits: tuple[tuple[str, float], ...]
    optional: bool

    def check(self, name: str, value: Any) -> None:
        """Raise ConfigError for a value that the rule forbids."""
        if isinstance(value, str) and self.texts and value not in self.texts:
            raise ConfigError(f"{name} = {value!r}; {choices(value, self.texts)}")
        if not self.limits or isinstance(value, bool) or not isinstance(value, Real):
            return
        number = float(value)
        is_within = {
            "at least": number.__ge__, "above": number.__gt__, "at most": number.__le__, "below": number.__lt__,
        }  # fmt: skip
        is_allowed = isfinite(number) and all(is_within[side](limit) for side, limit in self.limits)
        if not is_allowed or (self.whole and number % 1):
            kind = "a whole number" if self.whole else "a number"
            sides = " and ".join(f"{side} {limit:g}" for side, limit in self.limits)
            others = "".join(f", or {other}" for other in (*map(repr, self.texts), *["null"] * self.optional))
            raise ConfigError(f"{name} = {value}; give {kind} {sides}{others}.")


@cache
def _rules(holder: type) -> dict[str, _Rule]:
    """Return the rules of a dataclass's fields, by name; none where a type is not known when it runs."""
    try:
        hints = settings_hints(holder)
    except ConfigError:
        return {}
    rules = {name: _rule(hint) for name, hint in hints.items() if name in holder.__dataclass_fields__}  # type: ignore[attr-defined]
    return {name: rule for name, rule in rules.items() if rule.texts or rule.limits}


def _rule(hint: Any) -> _Rule:
    members = (hint,) if get_origin(hint) in (Annotated, Literal) else get_args(hint)
    texts = [text for member in members if get_origin(member) is Literal for text in get_args(member)]
    number, *limits = next((get_args(member) for member in members if get_origin(member) is Annotated), (None,))
    sides = {"ge": "at least", "gt": "above", "le": "at most", "lt": "below"}
    pairs = ((side, getattr(limit, key)) for limit in limits for key, side in sides.items() if hasattr(limit, key))
    return _Rule(tuple(texts), number is int, tuple(pairs), type(None) in members)
