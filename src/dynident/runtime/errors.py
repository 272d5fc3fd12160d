"""The errors dynident raises on purpose: each message names the wrong value, where it is, and how to correct it."""

from __future__ import annotations

import importlib.util
import os
import shlex
import subprocess
import sys
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import MISSING, Field, dataclass, field, fields
from difflib import get_close_matches
from typing import Any, Generic, TypeVar, dataclass_transform

T = TypeVar("T")

MAX_SHOWN = 3  # items and numbers that are shown
MAX_FIELD_LENGTH, MAX_TEXT_LENGTH = 80, 400  # letters of a field, and of all

MEMORY_VARIABLE = "DYNIDENT_MEMORY"  # the environment variable with the budget, in GB
DEFAULT_GIGABYTES = 4.0  # GB
GIGABYTE = 10**9
_BUDGET: ContextVar[float | None] = ContextVar("memory", default=None)


class DynidentError(Exception):
    """Base of all errors meant for the user; the command prints its message without a traceback."""


class InputError(DynidentError):
    """Measured data that cannot be used: a file, a column, a time stamp or a value."""


class MissingInputError(InputError):
    """A part needs something that the log does not have: a controller, a period, a second recording."""


class ConfigError(DynidentError):
    """A setting that is unknown, of the wrong type or out of range."""


class ModelError(DynidentError):
    """A robot model that cannot be built or evaluated."""


def check_type(argument: str, value: object, kind: type | tuple[type, ...], advice: str) -> None:
    """Raise InputError where an argument is of another kind; ``advice`` says what to give."""
    if not isinstance(value, kind):
        raise InputError(f"{argument}: a {type(value).__name__} is given; {advice}.")


def choices(wrong: object, alternatives: Iterable[str]) -> str:
    """Return the alternatives to a wrong name, the nearest first: ``did you mean 'x'? Choose from ...``."""
    names = [str(name) for name in alternatives]
    if not names:
        return "there is none to choose from."
    closest = get_close_matches(str(wrong), names, n=1)
    if closest == names:
        return f"did you mean {closest[0]!r}?"
    hint = f"did you mean {closest[0]!r}? " if closest else ""
    listing = ", ".join(repr(name) for name in names[:20]) + (", ..." if len(names) > 20 else "")
    return f"{hint}{'Choose' if hint else 'choose'} from {listing}."


def install_command(package: str) -> str:
    """Return the command that installs a package for the running Python, as a shell takes it.

    The package itself and no extra of dynident, which may be on no index. An environment made by uv has no pip.
    """
    pip = [sys.executable, "-m", "pip", "install", package]
    uv = ["uv", "pip", "install", "--python", sys.executable, package]
    words = pip if importlib.util.find_spec("pip") else uv
    return subprocess.list2cmdline(words) if os.name == "nt" else shlex.join(words)


def call_part(part: Callable[[Any], object], argument: object, result: type[T]) -> T:
    """Return what a part makes of its ``argument``; ConfigError where it fails or returns no ``result``.

    Errors of the parts of this library are left as they are, and so is a lack of memory.
    """
    name = getattr(part, "__name__", type(part).__name__)
    try:
        output = part(argument)
    except (DynidentError, MemoryError):
        raise
    except (Exception, SystemExit) as error:
        # an error inside dynident itself is a bug, whose traceback is needed
        if str(getattr(part, "__module__", "")).startswith("dynident."):
            raise
        last = traceback.extract_tb(error.__traceback__)[-1]
        words = f"{name} failed at {last.filename}:{last.lineno}: {type(error).__name__}: {error}"
        raise ConfigError(words) from error
    if not isinstance(output, result):
        raise ConfigError(f"{name} returned a {type(output).__name__}; it must return a {result.__name__}.")
    return output


def join_names(names: Iterable[str], max_names: int = 12) -> str:
    """Return names joined by commas, at most ``max_names`` of them, and how many more there are."""
    all_names = list(names)
    return ", ".join(all_names[:max_names]) + (
        f" and {len(all_names) - max_names} more" if len(all_names) > max_names else ""
    )


def shorten_names(names: Sequence[str], width: int) -> list[str]:
    """Return names, of which the longer ones are cut in the middle to ``width`` letters, such that they stay distinct.

    >>> shorten_names(["left_arm_shoulder_pan_joint", "left_arm_shoulder_lift_joint", "gripper"], 16)
    ['left_arm…n_joint', 'left_arm…t_joint', 'gripper']
    """
    width = max(width, 2)
    long = [name for name in dict.fromkeys(names) if len(name) > width]
    # the place of the cut that keeps most names distinct, the middle if several do
    cuts = sorted(range(width), key=lambda tail: abs(2 * tail + 1 - width))  # half of the letters before the cut first
    tail = max(cuts, key=lambda tail: len({_cut_middle(name, width, tail) for name in long})) if long else 0
    return [name if len(name) <= width else _cut_middle(name, width, tail) for name in names]


def _cut_middle(name: str, width: int, tail: int) -> str:
    return f"{name[: width - 1 - tail]}…{name[len(name) - tail :]}"


def brief(noun: Any) -> str:
    """Return the text of a dataclass for display, as its ``__repr__``: large fields by their size."""
    field_texts = (f"{field.name}={_field_text(getattr(noun, field.name))}" for field in fields(noun) if field.repr)
    return _truncate(f"{type(noun).__name__}({', '.join(field_texts)})", MAX_TEXT_LENGTH)


@dataclass_transform(frozen_default=True, eq_default=False, field_specifiers=(field,))
class Noun:
    """Base of immutable data that hold arrays; each class derived from it is a frozen dataclass.

    Two are equal where they are the same object; shown, large fields are given by their size.
    """

    __repr__ = brief

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        dataclass(frozen=True, eq=False, repr=False)(cls)


def settings_repr(noun: Any) -> str:
    """Return the text of settings for display: the fields that differ from their defaults."""
    field_texts = (
        f"{field.name}={_field_text(getattr(noun, field.name))}" for field in fields(noun) if is_changed(noun, field)
    )
    return _truncate(f"{type(noun).__name__}({', '.join(field_texts)})", MAX_TEXT_LENGTH)


def is_changed(noun: Any, field: Field[Any]) -> bool:
    """Return whether a setting differs from its default."""
    default = field.default if field.default_factory is MISSING else field.default_factory()
    value = getattr(noun, field.name)
    # an array has no single answer to whether it differs
    return value is not default and bool(getattr(value, "ndim", 0) or value != default)


def _field_text(value: Any) -> str:
    if hasattr(value, "dtype"):  # an array
        is_short = value.ndim == 1 and value.size <= MAX_SHOWN
        return f"[{', '.join(f'{x:.4g}' for x in value)}]" if is_short else f"array{value.shape}"
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, Mapping):
        return "{" + join_names((f"{key}: {_field_text(entry)}" for key, entry in value.items()), MAX_SHOWN) + "}"
    if isinstance(value, tuple | list):
        return "(" + join_names(map(_field_text, value), MAX_SHOWN) + ")"
    return _truncate(repr(value), MAX_FIELD_LENGTH)


def _truncate(text: str, longest: int) -> str:
    return text if len(text) <= longest else f"{text[:longest]}..."


@contextmanager
def budget_scope() -> Iterator[None]:
    """Restore the budget at the end: what is set inside does not affect what follows."""
    token = _BUDGET.set(_BUDGET.get())
    try:
        yield
    finally:
        _BUDGET.reset(token)


def set_budget(gigabytes: float) -> None:
    """Set the budget, in GB."""
    _BUDGET.set(gigabytes)


def memory_budget() -> int:
    """Return the bytes of the budget; ConfigError where the environment has no number."""
    setting, budget = os.environ.get(MEMORY_VARIABLE) or DEFAULT_GIGABYTES, _BUDGET.get()
    try:
        gigabytes = float(setting if budget is None else budget)
        if not 0 < gigabytes < float("inf"):
            raise ValueError
    except ValueError as error:
        raise ConfigError(f"{MEMORY_VARIABLE} is {setting!r}; give a positive number of GB.") from error
    return int(gigabytes * GIGABYTE)


@dataclass(frozen=True)
class BudgetedFunction(Generic[T]):
    """A function with the budget (GB) in force where this object is made, for other threads and processes."""

    function: Callable[..., T]
    gigabytes: float = field(default_factory=lambda: memory_budget() / GIGABYTE)

    def __call__(self, *arguments: Any) -> T:
        """Return what the function returns within the budget."""
        with budget_scope():
            set_budget(self.gigabytes)
            return self.function(*arguments)


def format_bytes(count: float) -> str:
    """Return a number of bytes as a text."""
    return f"{count / GIGABYTE:.3g} GB" if count >= GIGABYTE / 10 else f"{count / 1e6:.3g} MB"


_LISTENER: ContextVar[Callable[[str], None] | None] = ContextVar("listener", default=None)


class Step(str):
    """A step of long work: a few words, and how much of it is ``completed``, of a ``total`` where that is known.

    >>> Step("smoothing", 2, 5)
    'smoothing (2 of 5)'
    """

    words: str
    completed: int
    total: int | None

    def __new__(cls, words: str, completed: int = 0, total: int | None = None) -> Step:
        """Make the text of all three."""
        suffix = (
            ""
            if total is None and not completed
            else f" ({completed})"
            if total is None
            else f" ({completed} of {total})"
        )
        step = super().__new__(cls, words + suffix)
        step.words, step.completed, step.total = words, completed, total
        return step

    @classmethod
    def of(cls, step: str) -> Step:
        """Return a step that is given by its words alone as a ``Step``."""
        return step if isinstance(step, Step) else cls(step)


def report_progress(step: str) -> None:
    """Tell the listener, if there is one, what is done next: a few words, or a ``Step``."""
    if (listener := _LISTENER.get()) is not None:
        listener(step)


@contextmanager
def progress_to(listener: Callable[[str], None]) -> Iterator[None]:
    """Call ``listener`` with each step of the work within, in this thread; an exception that it raises ends the work.

    >>> with progress_to(print):
    ...     report_progress(Step("smoothing", 2, 5))
    smoothing (2 of 5)
    """
    token = _LISTENER.set(listener)
    try:
        yield
    finally:
        _LISTENER.reset(token)
