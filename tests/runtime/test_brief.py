"""Long names in few letters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynident.runtime import settings_repr, shorten_names


@dataclass(frozen=True)
class Part:
    value: object = None


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, ""),
        (np.array([1.0, 2.5]), "value=[1, 2.5]"),
        (np.zeros(4), "value=array(4,)"),
        (np.zeros((1, 2)), "value=array(1, 2)"),
        ({"a": np.ones(3)}, "value={a: [1, 1, 1]}"),
    ],
)
def test_settings_are_shown_where_they_are_changed(value: object, text: str) -> None:
    assert settings_repr(Part(value)) == f"Part({text})"


def test_names_are_cut_in_the_middle() -> None:
    assert shorten_names(["robot_cell_left_joint1_x", "short"], 13) == ["robot_…int1_x", "short"]


def test_the_cut_moves_where_names_differ_in_the_middle() -> None:
    names = ["arm_shoulder_of_the_left_robot", "arm_elbow_of_the_left_robot", "arm_wrist_of_the_left_robot"]
    found = shorten_names(names, 12)
    assert len(set(found)) == 3
    assert all(len(name) <= 12 for name in found)


@given(st.lists(st.text(max_size=40), max_size=5), st.integers(-1, 50))
def test_no_name_is_longer(names: list[str], width: int) -> None:
    found = shorten_names(names, width)
    assert all(len(name) <= max(width, 2) for name in found)
    assert len(found) == len(names)
