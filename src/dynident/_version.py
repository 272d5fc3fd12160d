"""The version of dynident."""

__version__ = "0.1.0"
