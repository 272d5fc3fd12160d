"""A payload in words, tables and files."""

import json
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dynident.apps.payload import Payload, PayloadRequest, PhysicalBody, find_payload
from dynident.apps.payload import body as notes
from dynident.apps.payload.config import payload_data, payload_name, payload_urdf, read_gains
from dynident.apps.payload.report import gains_table, payload_page, payload_table, payload_words, shares_table
from dynident.files.results import json_text
from dynident.identification import SourceFile, Sources
from dynident.models import RigidBodies
from dynident.runtime import InputError, ModelError
from tests.apps.payload.arms import SIX, loaded_result, result


@cache
def weighed() -> Payload:
    return find_payload(result(), loaded_result(), request=PayloadRequest(known_mass=3.0))


def written(folder: Path, **changes: Any) -> Path:
    data = json.loads(json_text(payload_data(weighed(), result().provenance, ["said"])))
    data["gains"] |= changes
    path = folder / "payload.json"
    path.write_text(json.dumps(data))
    return path


def test_gains_are_read_as_they_were_found_beside_the_payload_and_its_notes(tmp_path: Path) -> None:
    path = written(tmp_path)
    gains, data = read_gains(path), json.loads(path.read_text())
    assert (gains.joints, gains.known_mass) == (weighed().gains.joints, 3.0)
    np.testing.assert_array_equal(gains.factor, weighed().gains.factor)
    np.testing.assert_array_equal(gains.covariance, weighed().gains.covariance)
    assert (data["frame"], data["notes"]) == ("arm_tool0", ["said"])
    mass, std = weighed().body.mass, weighed().body.std[0]
    assert data["payload"][0] == {"name": "mass", "value": mass, "std": std, "unit": "kg"}


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"known_mass": None}, "had no known mass"),
        ({"factor": [1.0]}, "its gains are damaged"),
        ({"factor": [0.0] * 6}, "its gains are damaged"),
        ({"covariance": (-np.eye(6)).tolist()}, "its gains are damaged"),
        ({"factor": "many"}, "its gains cannot be read"),
    ],
)
def test_gains_that_are_none_are_refused(tmp_path: Path, changes: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        read_gains(written(tmp_path, **changes))


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"format": "dynident result"}', "[" * 10000])
def test_other_files_are_no_gains(tmp_path: Path, text: str) -> None:
    (tmp_path / "other.json").write_text(text)
    with pytest.raises(InputError, match=r"is not a payload\.json"):
        read_gains(tmp_path / "other.json")


def test_of_no_payload_the_mass_alone_is_written_and_shown(tmp_path: Path) -> None:
    none = replace(weighed(), body=PhysicalBody(np.full(10, 0.1), np.full(10, 0.2)))
    assert [row[0] for row in payload_table(none).rows] == ["mass"]
    assert {len(row) for row in shares_table(none).rows} == {2}
    page = payload_page(none, result())
    assert "centre of mass" not in page.partition("</style>")[2]
    assert payload_words(none) == "No payload is seen on arm_tool0: its mass is 0.10 ± 0.20 kg, so it is below 0.7 kg."
    assert "<dt>on arm_tool0</dt><dd>no payload</dd>" in page
    assert page.count("payload is seen") == 1
    data = payload_data(none, result().provenance, [])
    assert [data["seen"], data["payload"][0]["value"], data["payload"][1]["value"]] == [False, 0.1, None]
    with pytest.raises(ModelError, match="no payload is seen"):
        payload_urdf(result(), none, tmp_path)


def test_the_urdf_holds_arm_and_payload_for_its_folder(tmp_path: Path) -> None:
    shape = '<link name="base"><visual><geometry><mesh filename="m.stl"/></geometry></visual></link>'
    bodies = RigidBodies(SIX.replace('<link name="base"/>', shape), source="six.urdf")
    sources = Sources(model=SourceFile(str(tmp_path / "robots" / "six.urdf")))
    model = replace(result().model, terms=(bodies, *result().model.terms[1:]))
    actual = replace(result(), model=model, provenance=sources)
    assert payload_name(actual) == "six_payload.urdf"
    text, said = payload_urdf(actual, weighed(), tmp_path / "out")
    assert '"../robots/m.stl"' in text
    masses = {parameter.name: parameter.value for parameter in RigidBodies(text).parameters}
    assert masses["turn.mass"] > 3.0
    assert all("inertias of its file" in words for words in said)


def test_a_removed_payload_was_carried_and_has_no_gains() -> None:
    removed = replace(weighed(), request=replace(weighed().request, removed=True, known_mass=None))
    assert "carried" in payload_words(removed)
    assert list(gains_table(removed)) == []


def test_the_page_escapes_names_and_tells_results_from_recordings() -> None:
    evil = replace(weighed(), mount=replace(weighed().mount, frame="</script><b>"), notes=(notes.OtherArm(2.0),))
    page = payload_page(evil, result())
    assert "</script><b>" not in page
    assert "<li>Payload, drift and gains leave 2 times what" in page
    assert payload_page(replace(weighed(), logs=()), result()).count("Two results are compared") == 1
