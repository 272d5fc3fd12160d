"""Masks in a row of the table."""

from __future__ import annotations

import numpy as np

from dynident.apps.ranking import CombinationOutcome
from dynident.apps.ranking.task import empty_row, pack_masks, row_schema, unpack_masks


def test_masks_come_back_as_they_were() -> None:
    rng = np.random.default_rng(0)
    masks = {"train": {"a": rng.random(13) > 0.5, "b": rng.random(5) > 0.5}, "validation": {"c": rng.random(9) > 0.5}}
    again = unpack_masks(pack_masks(masks), masks)
    assert {role: {name: one.tolist() for name, one in some.items()} for role, some in again.items()} == {
        role: {name: one.tolist() for name, one in some.items()} for role, some in masks.items()
    }


def test_an_empty_row_has_all_columns() -> None:
    assert set(empty_row(("a", "b", "c"), CombinationOutcome.FAILED)) == set(row_schema())
