"""Errors that a user can cause, and notes on a result, as data."""

from dynident.errors.brief import brief, changed, listed, shortened
from dynident.errors.budget import GIGABYTE, MEMORY, amount, budgeted, give, memory
from dynident.errors.errors import ConfigError, DynidentError, InputError, MissingInputError, ModelError, choices
from dynident.errors.finding import Finding
from dynident.errors.install import install_command
from dynident.errors.note import Note, Remark, Severity, Use
from dynident.errors.part import called
from dynident.errors.step import Step

__all__ = [
    "GIGABYTE",
    "MEMORY",
    "ConfigError",
    "DynidentError",
    "Finding",
    "InputError",
    "MissingInputError",
    "ModelError",
    "Note",
    "Remark",
    "Severity",
    "Step",
    "Use",
    "amount",
    "brief",
    "budgeted",
    "called",
    "changed",
    "choices",
    "give",
    "install_command",
    "listed",
    "memory",
    "shortened",
]
