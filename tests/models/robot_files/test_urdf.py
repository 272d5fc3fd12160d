"""URDF files that are refused, and why."""

import numpy as np
import pytest

from dynident.models import RigidBodies
from dynident.runtime import ModelError
from tests.robots import ARM, GRIPPER, joint, link, urdf

TWO = (link("a"), link("b", 1.0))
J = joint("j", "revolute", "a", "b")
BOMB = '<!DOCTYPE r [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;">]><robot name="&b;"/>'
EXTERNAL = '<!DOCTYPE r [<!ENTITY x SYSTEM "file:///etc/hostname">]><robot name="&x;"/>'
BAD_URDF = {
    "malformed": ("<robot>\n<link>\n</robot>", {}, "not well-formed XML: mismatched tag: line 3"),
    "empty": ("", {}, "not well-formed XML: no element found"),
    "surrogate": ("<robot name='\udc80'/>", {}, "is not text"),
    "entity bomb": (BOMB, {}, "line 1: a DOCTYPE with its entities is not read"),
    "external entity": (EXTERNAL, {}, "a DOCTYPE with its entities is not read"),
    "deep": ("<a>" * 400 + "</a>" * 400, {}, "nested deeper than 300 levels"),
    "xacro": ('<robot><xacro:macro name="m"/></robot>', {}, "needs xacro; let the file.s name end in .xacro"),
    "xacro value": ('<robot><link name="${prefix}base"/></robot>', {}, "<link> needs xacro"),
    "other format": ("<collada/>", {}, "root element is <collada>; a URDF begins with <robot>, an MJCF .*>.$"),
    "sdf": ("<sdf version='1.7'/>", {}, "root element is <sdf>; .* SDF is not read: export the robot as a URDF"),
    "no link": (urdf(), {}, "the file has no <link>"),
    "no joint": (urdf(link("a")), {}, "no joint is left to move; the file has none"),
    "nameless link": (urdf(link("")), {}, "a link has no name; give it one"),
    "same links": (urdf(*TWO, link("a")), {}, "the name 'a' is given to more than one link"),
    "same joints": (urdf(*TWO, link("c"), J, joint("j", "fixed", "b", "c")), {}, "'j' is given to more than one joint"),
    "unknown parent": (urdf(*TWO, joint("j", "revolute", "aa", "b")), {}, "<parent>: no link 'aa'; did you mean 'a'"),
    "no parent": (urdf(*TWO, J.replace('<parent link="a"/>', "")), {}, "joint 'j': it has no <parent link="),
    "unknown type": (urdf(*TWO, J.replace("revolute", "rotary")), {}, "type 'rotary'; .*hoose from 'revolute'"),
    "floating": (urdf(*TWO, link("c"), J, joint("k", "floating", "b", "c")), {}, "it is a floating joint, which has"),
    "only floating": (urdf(*TWO, J.replace("revolute", "floating")), {}, "no joint is left to move; the file has j"),
    "locked floating": (
        urdf(*TWO, link("c"), J, joint("f", "floating", "b", "c")), {"locked": {"f": 1.0}},
        "'f' cannot be locked at 1.0"
    ),
    "two parents": (
        urdf(*TWO, link("c"), J, joint("k", "fixed", "a", "c"), joint("l", "fixed", "c", "b")), {},
        "link 'b' has two parents, by the joints 'j' and 'l': a closed loop",
    ),
    "cycle": (urdf(*TWO, J, joint("k", "fixed", "b", "a")), {}, "the links .* form a cycle"),
    "cycle aside": (
        urdf(link("r"), link("s"), *TWO, joint("i", "fixed", "r", "s"), J, joint("k", "fixed", "b", "a")), {},
        "form a cycle",
    ),
    "itself": (urdf(link("a"), link("b"), joint("j", "revolute", "b", "b")), {}, "the links b -> b form a cycle"),
    "two roots": (urdf(*TWO, link("c"), J), {}, r"2 links have no parent \('a', 'c'\)"),
    "no axis": (urdf(*TWO, joint("j", "revolute", "a", "b", axis=(0, 0, 0))), {}, "no direction"),
    "comma": (urdf(*TWO, J.replace('xyz="0.0 0.0 0.0"', 'xyz="0,1 0 0"')), {}, "xyz = '0,1 0 0', expected 3 numbers"),
    "nan": (urdf(link("a"), link("b", 1.0).replace("1.0", "nan"), J), {}, "of link 'b': value = 'nan'"),
    "huge": (urdf(*TWO, joint("j", "revolute", "a", "b", (1e200, 0, 0))), {}, "expected 3 numbers below 1e.30"),
    "no mass": (urdf(link("a"), link("b", 1.0).replace('<mass value="1.0"/>', ""), J), {}, "needs both <mass> and"),
    "no ixy": (urdf(link("a"), link("b", 1.0).replace("ixy", "iyx"), J), {}, "ixy = '', expected a number below 1e"),
    "unknown used": (ARM, {"joints_used": ("rial",)}, "no joint that can move 'rial'; did you mean 'rail'"),
    "used and locked": (ARM, {"joints_used": ("rail",), "locked": {"rail": 0}}, "'rail' is listed twice"),
    "locked at nan": (ARM, {"locked": {"rail": np.nan}}, "'rail' cannot be locked at nan"),
    "gravity": (ARM, {"gravity": (0.0, -9.81)}, "give three numbers in m/s"),
    "mimic": (GRIPPER, {"joints_used": ("elbow", "follower")}, "'follower' mimics 'finger' and moves with it"),
    "mimic unknown": (
        GRIPPER.replace('mimic joint="finger"', 'mimic joint="fin"'), {}, "the file has no joint 'fin': did you mean"
    ),
    "mimic circle": (
        GRIPPER.replace('mimic joint="finger"', 'mimic joint="follower"'), {"joints_used": ("elbow",)},
        "follower -> follower mimic each other in a circle",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("text", "options", "message"), BAD_URDF.values(), ids=BAD_URDF)
def test_bad_robot_files(text, options, message):
    with pytest.raises(ModelError, match=message):
        RigidBodies(text, **options)
