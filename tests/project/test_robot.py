"""Fingerprints of what a run reads."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest

from dynident.project.config import fingerprint, parse_config
from dynident.project.project import log_files
from dynident.runtime import ModelError


def test_a_file_has_the_digest_of_its_bytes(tmp_path: Path) -> None:
    file = tmp_path / "log.bin"
    file.write_bytes(b"x" * 3_000_000)  # more than one part
    assert fingerprint(file) == hashlib.sha256(b"x" * 3_000_000).hexdigest()


def test_a_folder_has_the_digest_of_all_its_files(tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    bag.mkdir()
    (bag / "metadata.yaml").write_bytes(b"late")
    (bag / "a.db3").write_bytes(b"early, ")
    assert fingerprint(bag) == hashlib.sha256(b"early, late").hexdigest()


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=r"gone\.csv: cannot be read"):
        fingerprint(tmp_path / "gone.csv")


def test_every_recording_is_hashed_once(tmp_path: Path) -> None:
    for name in ("a.csv", "b.csv"):
        (tmp_path / name).write_text(name)
    text = """
model: gallery:slider
time: {rate: 100}
position: {slider: {column: q, unit: m}}
torque: {slider: {column: f, unit: N}}
train: [{file: a.csv, window: [0, 1]}, {file: a.csv, window: [1, 2]}]
validation: [{file: {x: a.csv, y: b.csv}}]
"""
    found = {file.path: file.sha256 for file in log_files(parse_config(text, tmp_path))}
    assert found == {str(tmp_path / name): hashlib.sha256(name.encode()).hexdigest() for name in ("a.csv", "b.csv")}
