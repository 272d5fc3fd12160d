"""Tests of instrumental variables."""
