"""What a watch knows, as bytes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dynident.apps.online import Alarm
from dynident.apps.online.detector import Phase
from dynident.apps.online.scores import Gram
from dynident.apps.online.watch import read_state, state_bytes
from dynident.regression import GroupKind
from dynident.runtime import InputError


def test_nouns_arrays_and_numbers_come_back(tmp_path: Path) -> None:
    alarm = Alarm(1.0, GroupKind.PAYLOAD, "wrist", 0.5, (0.25, float("nan")), 20.0)
    gram = Gram(np.arange(8.0).reshape(1, 2, 2, 2)[0], np.eye(2), np.array([np.inf]), np.zeros(0))
    state = {
        "alarm": alarm,
        "gram": gram,
        "phase": Phase.SETTLE,
        "none": None,
        "many": (1, "two", -np.inf, True),
        "map": {"x": [gram]},
    }
    path = tmp_path / "state.npz"
    path.write_bytes(state_bytes(state))
    found = read_state(path)
    assert repr(found["alarm"]) == repr(alarm)
    assert found["phase"] is Phase.SETTLE
    assert found["many"] == (1, "two", -np.inf, True)
    assert found["none"] is None
    for one in (found["gram"], found["map"]["x"][0]):
        assert all(np.array_equal(getattr(one, name), getattr(gram, name)) for name in vars(gram))
        one.rows.resize(1)  # its own, to be written to


@pytest.mark.parametrize("share", [0.0, 0.3, 0.9])
def test_a_damaged_state_is_said(tmp_path: Path, share: float) -> None:
    path, data = tmp_path / "state.npz", state_bytes({"x": np.arange(100.0)})
    path.write_bytes(data[: int(share * len(data))])
    with pytest.raises(InputError, match="delete it, and the watch begins anew"):
        read_state(path)


def test_a_state_of_another_version_is_said(tmp_path: Path) -> None:
    path = tmp_path / "state.npz"
    text = np.frombuffer(b'{"format": "dynident watch", "version": 99, "state": {}}', dtype=np.uint8)
    np.savez(path, state=text)
    with pytest.raises(InputError, match="of version 99"):
        read_state(path)
