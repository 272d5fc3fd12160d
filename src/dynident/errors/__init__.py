"""Errors that a user can cause, and notes: what a stage has to say about its result, as data."""

from dynident.errors.errors import ConfigError, DynidentError, InputError, ModelError, choices, listed
from dynident.errors.note import Note, Remark, Severity

__all__ = [
    "ConfigError",
    "DynidentError",
    "InputError",
    "ModelError",
    "Note",
    "Remark",
    "Severity",
    "choices",
    "listed",
]
