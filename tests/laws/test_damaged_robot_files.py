"""A damaged robot file is refused with a ModelError or read, and nothing else comes out; a few seconds of attempts."""

import copy
from contextlib import suppress
from xml.etree import ElementTree

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from dynident.checks import check_robot
from dynident.models import RigidBodies
from dynident.runtime import ModelError
from tests.robots import ARM, ARM_MJCF, joint, link, urdf

RICH_URDF = urdf(
    link("world"), link("base", 4.0), link("arm", 2.0, (0, 0, 0.1)), link("left", 0.1), link("right", 0.1),
    joint("root", "floating", "world", "base"), joint("elbow", "revolute", "base", "arm", axis=(0, 1, 0)),
    joint("finger", "prismatic", "arm", "left", axis=(0, 1, 0), inside='<dynamics damping="1" friction="2"/>'),
    joint("follower", "continuous", "arm", "right", inside='<mimic joint="finger" multiplier="2" offset="0.01"/>'),
)  # fmt: skip
RICH_MJCF = """<mujoco><compiler angle="degree" eulerseq="zyx" autolimits="true" boundmass="0.01" boundinertia="1e-4"
 balanceinertia="true" settotalmass="8" inertiagrouprange="0 3" inertiafromgeom="auto"/><option gravity="0 0 -9.8"/>
<default class="main"><geom density="800"/><default class="fine"><joint armature="0.1" damping="0.3 0.1"/>
<tendon stiffness="0"/><equality active="true"/></default></default><worldbody><geom type="plane" size="1 1 1"/>
<body name="base" childclass="fine"><freejoint/><geom type="box" size="0.1 0.2 0.3"/>
<frame pos="0 0 1" euler="10 20 30"><body><joint name="a" range="-90 90"/><joint name="b" type="slide" ref="0.1"/>
<geom type="capsule" size="0.1" fromto="0 0 0 1 1 1" mass="2"/><geom type="ellipsoid" size="1 2 3" shellinertia="true"/>
<body name="tip" zaxis="0 1 1"><joint name="c" axis="1 0 0" pos="0 0 0.1"/><geom size="0.1" group="2"/>
<inertial mass="1" pos="0 0 0" fullinertia="1 1 1 0 0 0"/></body></body></frame></body></worldbody>
<equality><joint joint1="b" joint2="a" polycoef="0.1 2"/>
<connect active="false" body1="base" anchor="0 0 0"/></equality>
<tendon><fixed name="t"><joint joint="a" coef="1"/></fixed></tendon></mujoco>"""
FILES = [ARM, ARM_MJCF, RICH_URDF, RICH_MJCF]
VALUES = ["", "0", "-1", "nan", "inf", "1e300", "1e-300", "0 0 0", "1 2 3 4 5 6", "x", "true", "fixed", "mesh", "None"]


def read_all(text: str) -> None:
    """Read it in all ways; numbers that come out are finite."""
    term = RigidBodies(text)
    assert term.notes is not None
    check_robot(term.file)
    assert np.isfinite(term.regressor(*np.ones((3, 1, len(term.joints))))).all()


def test_the_files_are_read() -> None:
    for text in FILES:
        read_all(text)


def names(root: ElementTree.Element) -> list[str]:
    return sorted({value for element in root.iter() for value in element.attrib.values()})


@settings(max_examples=200, deadline=None)
@given(st.data())
def test_a_file_with_damaged_elements_is_refused_or_read(data: st.DataObject) -> None:
    """Elements lost, repeated or moved, attributes lost or with values of others."""
    root = ElementTree.fromstring(data.draw(st.sampled_from(FILES)))
    for _ in range(data.draw(st.integers(1, 4))):
        parents = [element for element in root.iter() if len(element)]
        parent = data.draw(st.sampled_from(parents)) if parents else root
        child = data.draw(st.sampled_from(list(parent))) if len(parent) else root
        match data.draw(st.sampled_from(["lose", "repeat", "move", "value", "attribute", "tag"])):
            case "lose" if child is not root:
                parent.remove(child)
            case "repeat" if child is not root:
                parent.append(copy.deepcopy(child))
            case "move" if child is not root:
                data.draw(st.sampled_from(list(root.iter()))).append(copy.deepcopy(child))
            case "value" if child.attrib:
                values = st.sampled_from(VALUES + names(root)) | st.text(max_size=5)
                child.set(data.draw(st.sampled_from(sorted(child.attrib))), data.draw(values))
            case "attribute" if child.attrib:
                child.attrib.pop(data.draw(st.sampled_from(sorted(child.attrib))))
            case "tag":
                child.tag = data.draw(st.sampled_from(sorted({element.tag for element in root.iter()})))
    with suppress(ModelError):
        read_all(ElementTree.tostring(root, encoding="unicode"))


@settings(max_examples=75, deadline=None)
@given(st.sampled_from(FILES), st.data())
def test_a_file_with_damaged_characters_is_refused_or_read(text: str, data: st.DataObject) -> None:
    start = data.draw(st.integers(0, len(text)))
    stop = data.draw(st.integers(start, min(start + 40, len(text))))
    put = data.draw(st.sampled_from(["", "0", "-", "x", '"', "<a/>", "1e300", "\0", "é", "&amp;"]))
    with suppress(ModelError):
        read_all(text[:start] + put + text[stop:])
