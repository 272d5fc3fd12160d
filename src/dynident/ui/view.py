"""What a page shows, as its address says it: a setting, and the joint, the log and the reach of a change."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING
from urllib.parse import parse_qsl, urlencode

from dynident.errors import ConfigError, choices

if TYPE_CHECKING:
    from dynident.tuning import Bench, Tuning

__all__ = ["View"]

JOINT, LOG, ONE = "show_joint", "show_log", "only_this_joint"
OWN = (JOINT, LOG, ONE)


@dataclass(frozen=True)
class View:
    """A ``tuning``, the ``joint`` and the ``log`` that are drawn, and whether a change is of that joint ``alone``."""

    tuning: Tuning
    joint: str
    log: str
    alone: bool = False

    @classmethod
    def start(cls, bench: Bench) -> View:
        """Return what is shown first."""
        return cls(bench.start, bench.joints[0], bench.log_names[0])

    @classmethod
    def of_query(cls, text: str, bench: Bench) -> View:
        """Return what an address (its part after the question mark) asks for; ConfigError where it makes no sense."""
        from dynident.tuning import of_query

        pairs = parse_qsl(text.removeprefix("?"), keep_blank_values=True)
        own = dict(pair for pair in pairs if pair[0] in OWN)
        tuning = of_query(urlencode([pair for pair in pairs if pair[0] not in OWN]), bench)
        joints, logs = bench.joints, bench.log_names
        joint, log = own.get(JOINT, joints[0]), own.get(LOG, logs[0])
        for key, value, known in ((JOINT, joint, joints), (LOG, log, logs)):
            if value not in known:
                raise ConfigError(f"address: {key}={value}: there is no such one; {choices(value, known)}")
        return cls(tuning, joint, log, alone=own.get(ONE) == "yes")

    def to_query(self, bench: Bench) -> str:
        """Return the part of an address after the question mark, with it, that says what differs from the start."""
        from dynident.tuning import to_query

        own = [(JOINT, self.joint, bench.joints[0]), (LOG, self.log, bench.log_names[0])]
        kept = [(key, value) for key, value, usual in own if value != usual] + [(ONE, "yes")] * self.alone
        texts = [to_query(self.tuning, bench.start, bench.joints), urlencode(kept)]
        query = "&".join(text for text in texts if text)
        return f"?{query}" if query else ""
