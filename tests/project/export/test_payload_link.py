"""A payload as a link of its own."""

import numpy as np
import pytest

from dynident.models import RigidBodies
from dynident.models.robot_files import parse, read_urdf
from dynident.project.export import check_payload_link, with_payload_link
from dynident.runtime import ModelError
from tests.apps.payload.arms import CARRIED, SIX, arm
from tests.robots import ARM_MJCF

BODY = (3.0, np.array([0.02, -0.03, 0.08]), np.diag([0.012, 0.015, 0.006]))


def added() -> np.ndarray:
    from dynident.apps.payload import mount_of

    return (mount_of(arm()[0]).transform @ CARRIED)[:60]


def test_the_torque_is_that_of_the_arm_with_the_payload() -> None:
    text = with_payload_link(SIX, "arm_tool0", *BODY)
    assert check_payload_link(SIX, text, RigidBodies(SIX), added()) < 1e-9
    with pytest.raises(ModelError, match="loaded again, has another torque"):
        check_payload_link(SIX, text, RigidBodies(SIX), 1.01 * added())


def test_all_else_is_preserved_and_names_are_free_ones() -> None:
    text = with_payload_link(SIX, "arm_tool0", *BODY)
    again = with_payload_link(text, "arm_tool0", *BODY)
    links = read_urdf(parse(again, "a"), "a").links
    assert {"payload", "payload_2"} <= links.keys()
    start, stop = text.index('<link name="payload">'), text.index("</joint>") + len("</joint>")
    assert text[:start] + text[stop:] == SIX


def test_any_name_is_escaped_and_found_whatever_stands_before_it() -> None:
    text = SIX.replace('<link name="arm_tool0"', '<link rename="other" name="a &amp; &quot;b\'&quot;"')
    text = text.replace('"arm_tool0"', '"a &amp; &quot;b\'&quot;"')
    after = with_payload_link(text, 'a & "b\'"', *BODY)
    parents = [joint.parent for joint in read_urdf(parse(after, "a"), "a").joints if joint.child == "payload"]
    assert parents == ['a & "b\'"']
    assert check_payload_link(text, after, RigidBodies(text), added()) < 1e-9


def test_what_is_no_urdf_or_has_no_such_link_is_refused() -> None:
    with pytest.raises(ModelError, match="is an MJCF"):
        with_payload_link(ARM_MJCF, "wrist", *BODY)
    with pytest.raises(ModelError, match="'hand' is no link"):
        with_payload_link(SIX, "hand", *BODY)
