"""Errors that a user can cause, and notes on a result, as data."""

from dynident.errors.brief import brief, changed, listed
from dynident.errors.errors import ConfigError, DynidentError, InputError, ModelError, choices
from dynident.errors.note import Note, Remark, Severity
from dynident.errors.part import called

__all__ = [
    "ConfigError",
    "DynidentError",
    "InputError",
    "ModelError",
    "Note",
    "Remark",
    "Severity",
    "brief",
    "called",
    "changed",
    "choices",
    "listed",
]
