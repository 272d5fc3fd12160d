"""What a signal to stop does: it is said in one line what is kept, and the exit code is 128 + the signal's number."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import NoReturn

from dynident.cli.escapes import one_line
from dynident.cli.voice import complain

__all__ = ["interruptible"]

SIGNALS = [one for name in ("SIGTERM", "SIGHUP") if (one := getattr(signal, name, None)) is not None]


class Stopped(KeyboardInterrupt):
    """A signal other than that of Ctrl-C, which ends a command in the same way: what is open is closed first."""

    def __init__(self, number: int) -> None:
        super().__init__()
        self.number = number


@contextmanager
def interruptible() -> Iterator[None]:
    """Turn signals to stop, and Ctrl-C, into one line and an exit code."""
    before = {}
    try:
        for number in SIGNALS if threading.current_thread() is threading.main_thread() else ():
            if signal.getsignal(number) is signal.SIG_DFL:  # nohup, or a caller, may have other wishes
                before[number] = signal.signal(number, _stop)
        yield
    except KeyboardInterrupt as stop:
        kept = " ".join(getattr(stop, "__notes__", ["each file is as it was or complete; run the same command again."]))
        complain(one_line(f"Interrupted: {kept}"))
        raise SystemExit(128 + getattr(stop, "number", signal.SIGINT)) from None
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _stop(number: int, frame: FrameType | None) -> NoReturn:  # noqa: ARG001 -- so are handlers called
    raise Stopped(number)
