"""What a page shows, and its address, which says all of it."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, fields
from functools import cache
from typing import Any
from urllib.parse import parse_qsl, quote

from pydantic import TypeAdapter, ValidationError
from pydantic_core import from_json

from dynident.apps.tuning.bench import Bench
from dynident.apps.tuning.tuning import Tuning
from dynident.project.python_file import error_text
from dynident.runtime import ConfigError, choices

MAX_CHARACTERS = 20_000  # of an address
SHOWN = ("joint", "log", "only_this_joint", "column")


@dataclass(frozen=True)
class View:
    """A ``tuning``, the ``joint`` and the ``log`` that are drawn, whether a change is of that joint ``alone``, and the
    other ``column`` of the recording that is drawn ("": none)."""

    tuning: Tuning
    joint: str
    log: str
    alone: bool = False
    column: str = ""

    @classmethod
    def start(cls, bench: Bench) -> View:
        """Return the view that is shown first."""
        return cls(bench.start, bench.joints[0], bench.log_names[0])

    @classmethod
    def of_query(cls, text: str, bench: Bench) -> View:
        """Return the view of an address (its part after the question mark); ConfigError where it makes no sense."""
        settings = {**cls.start(bench)._settings(), **_parse_fields(text)}
        joint, log, alone, column = (settings.pop(key) for key in SHOWN)
        for key, value, allowed in (("joint", joint, bench.joints), ("log", log, bench.log_names)):
            if value not in allowed:
                raise ConfigError(f"address: there is no {key} {value!r}; {choices(value, allowed)}")
        if unknown := settings.keys() - {field.name for field in fields(Tuning)}:
            name = min(unknown)
            raise ConfigError(f"address: there is no setting {name!r}; {choices(name, [*asdict(bench.start), *SHOWN])}")
        try:
            tuning = _adapter().validate_python(settings)
        except ValidationError as error:
            raise ConfigError(error_text(error, settings, "address")) from None
        bench.check(tuning)
        return cls(tuning, joint, log, alone is True, str(column or ""))

    def to_query(self, bench: Bench) -> str:
        """Return the part of an address from the question mark on: what differs from the start, each value as JSON.

        Such as ``?degree=[1.2,0.5]&joint=%22elbow%22``. Numbers are exact.
        """
        start = View.start(bench)._settings()
        changed = {key: value for key, value in self._settings().items() if value != start[key]}
        pairs = (f"{key}={quote(json.dumps(value, separators=(',', ':')), '[]{}:,')}" for key, value in changed.items())
        return f"?{'&'.join(pairs)}" if changed else ""

    def _settings(self) -> dict[str, Any]:
        """Return all settings by their names in an address."""
        return {**asdict(self.tuning), **dict(zip(SHOWN, (self.joint, self.log, self.alone, self.column), strict=True))}


@cache
def _adapter() -> TypeAdapter[Tuning]:
    return TypeAdapter(Tuning)


def _parse_fields(text: str) -> dict[str, Any]:
    """Return the values of an address by name; ConfigError where one is no JSON."""
    if len(text) > MAX_CHARACTERS:
        raise ConfigError(f"address: {len(text)} characters are more than the settings can take ({MAX_CHARACTERS}).")
    values = {}
    for name, value in parse_qsl(text.removeprefix("?"), keep_blank_values=True):
        try:
            values[name] = from_json(value, allow_inf_nan=False)
        except ValueError as error:
            raise ConfigError(f"address: {name} is {value[:80]!r}, which is no JSON: {error}.") from None
    return values
