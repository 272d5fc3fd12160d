"""The words, tables and page of a payload."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from dynident.apps.payload import Component, Payload, PayloadRequest, PhysicalBody, find_payload
from dynident.apps.payload import body as notes
from dynident.apps.payload.report import (
    gains_table,
    payload_page,
    payload_table,
    payload_words,
    shares_table,
    torque_table,
)
from dynident.runtime import Note
from tests.apps.payload.arms import CARRIED, recorded, result


@cache
def found() -> Payload:
    return find_payload(result(), {"loaded": recorded("loaded", CARRIED)}, request=PayloadRequest(known_mass=3.0))


def test_the_tables_hold_the_payload() -> None:
    assert payload_words(found()).startswith("arm_tool0 carries 3 ± ")
    assert [row[0] for row in payload_table(found()).rows][:2] == ["mass", "centre of mass, x"]
    assert [row[0] for table in gains_table(found()) for row in table.rows] == ["j1", "j2", "j3", "j4", "j5", "j6"]
    assert [row[0] for table in torque_table(found()) for row in table.rows] == ["loaded"]
    assert "gains" in [row[0] for row in shares_table(found()).rows]
    removed = replace(found(), request=replace(found().request, removed=True, known_mass=None))
    assert "carried" in payload_words(removed)
    assert list(gains_table(removed)) == []


def test_the_page_holds_all_of_it_and_escapes_names() -> None:
    evil = replace(found(), mount=replace(found().mount, frame="</script><b>"), notes=(notes.NoPayload(0.1, 0.2),))
    page = payload_page(evil, result())
    assert "</script><b>" not in page
    assert "no payload is seen: its mass is 0.1 ± 0.2 kg, so it is below 0.7 kg." in page
    assert "Gains of the drives" in page
    assert payload_page(replace(found(), logs=()), result()).count("Two results are compared") == 1


def test_of_no_payload_the_mass_alone_is_shown() -> None:
    none = replace(found(), body=PhysicalBody(np.full(10, 0.1), np.full(10, 0.2)))
    assert payload_words(none) == "No payload is seen on arm_tool0: its mass is 0.1 ± 0.2 kg, so it is below 0.7 kg."
    assert [row[0] for row in payload_table(none).rows] == ["mass"]
    assert {len(row) for row in shares_table(none).rows} == {2}
    page = payload_page(none, result())
    assert "centre of mass" not in page.partition("</style>")[2]
    assert "No payload is seen" in page


@pytest.mark.parametrize(
    ("note", "said"),
    [
        (
            notes.NotShown((Component.Z, Component.IXX), (0.05, 0.01), "j5", 1.5, "rad/s", (0.002, 0.003)),
            (
                "the motion does not show centre of mass, z (± 0.05 m), inertia about the centre of mass, xx "
                "(± 0.01 kg m^2) of the payload; 10 s of turning j5 back and forth at up to 1.5 rad/s would lower that "
                "to ± 0.002 m, 0.003 kg m^2; `dynident excite` designs a motion of all joints"
            ),
        ),
        (
            notes.NotShown((Component.IZZ,), (0.05,)),
            (
                "the motion does not show inertia about the centre of mass, zz (± 0.05 kg m^2) of the payload; no "
                "single joint would by itself: turn the last joints together, fast, in several postures"
            ),
        ),
        (
            notes.PayloadOrDrift(Component.MASS, 0.9, unloaded=False),
            "record the same motion without the payload on the same day",
        ),
        (notes.PayloadOrDrift(Component.MASS, 0.9, unloaded=True), "move the arm through more postures"),
        (notes.GainsUnknown(0.09, 0.01, 3.0), "with known gains it would be ± 0.01 kg"),
        (notes.OtherArm(3.14), "leave 3.1 times what the standard errors allow"),
        (notes.SameRecording("a.csv"), "a.csv: the result was made from it"),
    ],
)
def test_notes_have_words(note: Note, said: str) -> None:
    assert said in str(note)
