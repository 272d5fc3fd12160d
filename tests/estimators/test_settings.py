"""Settings outside the limits that their types have, and the notes of an estimate: each says its figures."""

import re
from collections.abc import Iterator
from dataclasses import fields
from typing import Annotated, Any, Literal, get_args, get_origin

import pytest
from annotated_types import Ge, Gt

from dynident.estimators import instruments, notes
from dynident.estimators.instruments import InstrumentKind
from dynident.estimators.notes import FirstModel, StartedElsewhere
from dynident.runtime import ConfigError
from dynident.runtime.families import ESTIMATORS, settings_hints

KINDS = [ESTIMATORS.get(kind) for kind in ESTIMATORS.table]


def wrong_values(hint: Any) -> Iterator[tuple[Any, str]]:
    """Values beyond each limit of a type, with words of the error."""
    for member in (hint, *get_args(hint)):
        if get_origin(member) is Literal and all(isinstance(text, str) for text in get_args(member)):
            yield f"{get_args(member)[0]}x", "did you mean"
        elif get_origin(member) is Annotated:
            number, *limits = get_args(member)
            yield float("nan"), "give a"
            for limit in limits:
                size = getattr(limit, "ge", getattr(limit, "gt", getattr(limit, "le", getattr(limit, "lt", None))))
                step = -1 if isinstance(limit, Ge | Gt) else 1
                yield number(size + step * max(1, abs(size))), f"{size:g}"


CASES = [
    (cls, field.name, value, words)
    for cls in KINDS
    for field in fields(cls)
    for value, words in wrong_values(settings_hints(cls)[field.name])
]


@pytest.mark.parametrize(("cls", "name", "value", "words"), CASES)
def test_a_setting_beyond_its_limits_is_named_with_them(cls: type, name: str, value: Any, words: str) -> None:
    with pytest.raises(ConfigError, match=rf"{name} = .*{re.escape(words)}"):
        cls(**{name: value})


NOTES = [
    notes.RankDeficient(3, 5, ("Fc",), (("v1", "v2"),)),
    notes.RankDeficient(10, 20),
    notes.DecidedByPrior(20),
    notes.NotIdentifiable(1),
    notes.NotByData(4),
    notes.NotAlone(("a", "b")),
    notes.HeldByConstraints((("Ia_elbow", 8.04), ("forearm.mx", 3.5))),
    notes.PriorApproached(2e-3),
    notes.NotConverged(60, 3.21),
    notes.Failed("no luck"),
    notes.MovingStart(1e-4),
    notes.StillMoving(9, 0.25),
    notes.Downweighted((("elbow", 0.1),)),
    notes.DrawnToPrior(0.01),
    notes.ErrorsInRegressor("m1", 36.0),
    notes.Averaged(3),
    notes.SmoothSigns((0.0123, 0.4)),
    notes.NotWhite(0.456),
    notes.StillColoured("elbow", 0.456),
    notes.WhiteningCostly("elbow", 1.239, chance=True),
    notes.WhiteningCostly("elbow", 1.239),
    notes.ScatterLarger("Fc", 1.66),
    notes.MotionCorrected("Izz1 + Ia1", 3.21),
    notes.LimitedByMotion("Izz1 + Ia1", 3, 12),
    notes.MotionTooNoisy("Izz1 + Ia1", 3.21),
    StartedElsewhere(FirstModel.INSTRUMENTS),
    instruments.InstrumentsUsed((InstrumentKind.SIMULATED,), 0.9876, None, "M", 2.345),
    instruments.InstrumentsUsed((InstrumentKind.REPEATED, InstrumentKind.LAGGED), 0.5, 0.0123),
    instruments.InstrumentsUsed((InstrumentKind.LAGGED,), 0.5, 0.0123),
    instruments.WeakInstruments("M", 0.0123, 1.5),
    instruments.NotSimulated("it runs away after 0.3 s"),
    notes.StillMoving(1, 0.5, "its mass matrix is singular"),
]  # whose sentences are kept in tests/snapshots
