"""A proof notices what is wrong with a text, and says so."""

import re
import sys
from dataclasses import replace

import pytest

from dynident.project.export import Mjcf, Numpy, Urdf, Yaml, export, identified_urdf, prove
from tests.project.export.arms import STATES, arm
from tests.robots import ARM, ARM_MJCF

WRONG = {
    Urdf(): ('damping="1.0"', 'damping="1.00001"'),
    Mjcf(): ('armature="0.5"', 'armature="0.50001"'),
    Numpy(): ("(0.5, 1.0, 2.0, -0.3)", "(0.5, 1.0, 2.0, -0.30001)"),
    Yaml(): ("value: 3.0", "value: 3.0001"),
}


def text(exporter):
    return ARM_MJCF if exporter.format == "mjcf" else ARM


@pytest.mark.parametrize("exporter", WRONG)
def test_a_wrong_digit_is_noticed(exporter):
    test_arm = arm(text(exporter))
    written = exporter.write(test_arm)
    assert prove(written, test_arm, STATES, exporter).agreement < 1e-8
    old, new = WRONG[exporter]
    assert old in written.text
    tampered = replace(written, text=written.text.replace(old, new, 1))
    assert not prove(tampered, test_arm, STATES, exporter).proven
    assert exporter == Yaml() or prove(tampered, test_arm, STATES, exporter).agreement < 1e-2


@pytest.mark.parametrize("exporter", WRONG)
def test_a_text_that_cannot_be_read_is_not_proven(exporter):
    test_arm = arm(text(exporter))
    written = exporter.write(test_arm)
    proof = prove(replace(written, text=written.text[: len(written.text) // 2]), test_arm, STATES, exporter)
    assert not proof.proven
    told = [words for words in proof.skipped if "installed" not in words]
    assert told
    assert all("cannot read it" in words or "can read neither" in words for words in told)


def test_a_failed_proof_is_a_refusal(monkeypatch):
    monkeypatch.setattr(Urdf, "write", lambda _, x: replace(identified_urdf(x), text=ARM))
    made = export(arm(), Urdf(), STATES)
    assert not made.ready
    assert "does not reproduce the identified torque" in made.refusal
    assert "Pinocchio" in made.refusal


def test_a_reader_that_is_not_installed_is_named(monkeypatch):
    """Nothing fails, and the result says who loaded the file."""
    monkeypatch.setitem(sys.modules, "pinocchio", None)
    made = export(arm(), Urdf(), STATES)
    assert made.ready
    assert list(made.proof.readers) == ["dynident"]
    assert made.proof.skipped == ("Pinocchio is not installed (the package `pin`): only dynident loaded the file",)


def test_a_joint_without_limits_is_said_once_and_not_by_the_parser_of_pinocchio(capfd):
    made = export(arm(re.sub("<limit[^>]*>", "", ARM)), Urdf(), STATES)
    assert made.ready
    (words,) = made.proof.skipped
    assert "has no <limit>" in words
    assert capfd.readouterr().err == ""
