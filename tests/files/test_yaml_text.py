"""YAML as configurations have it."""

from __future__ import annotations

from dynident.files.yaml_text import load_yaml


def test_keys_are_names_and_values_may_be_truth_values() -> None:
    """YAML 1.1 reads the key ``on`` as true."""
    assert load_yaml("{ on: [a], no: yes, off: on, true: 1 }", "text") == {
        "on": ["a"],
        "no": True,
        "off": True,
        "true": 1,
    }
