"""Folders named after what may hold anything."""

from __future__ import annotations

import string

import pytest

from dynident.apps.fleets.config import MAX_NAME_LENGTH, folder_names

ODD = ["con", "NUL.txt", "ö" * 100, "x" * 300, "x" * 299, "a\0b", "\ud800", "a.", " "]
NAMES = ["arm", "ARM", "..", ".", "a/b", "a\\b", "a=2Fb", *ODD]
SAFE = set(string.ascii_letters + string.digits + "._-=")


def test_no_two_names_share_a_folder_and_none_leaves_it() -> None:
    found = folder_names(NAMES)
    assert list(found) == NAMES
    assert len({one.casefold() for one in found.values()}) == len(NAMES)
    for one in found.values():
        assert set(one) <= SAFE
        assert 0 < len(one) <= MAX_NAME_LENGTH
        assert not one.startswith(".")
        assert not one.endswith(".")


@pytest.mark.parametrize("name", ["arm-07", "UR10e_3", "2026-11-22T10.30"])
def test_usual_names_stay_as_they_are(name: str) -> None:
    assert folder_names([name]) == {name: name}


def test_a_folder_does_not_depend_on_other_names_that_differ() -> None:
    assert folder_names(["arm", "leg"])["arm"] == folder_names(["arm"])["arm"]
