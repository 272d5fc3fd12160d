"""The robot files of two published packages: each is read, with the torque of Pinocchio or MuJoCo, or refused.

The packages are installed by ``python3 dev.py robots``; nothing of them is copied.
"""

import importlib.metadata
import importlib.util
import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio
import pytest

from dynident.models import RigidBodies, change_frame, from_physical
from dynident.models.robot_files import exact_angle
from dynident.project.config import robot_text
from dynident.runtime import ModelError
from tests.laws.test_rigid_bodies import states

Follow = list[tuple[str, str, float, float]]  # a joint, the joint that it follows (itself), factor and offset
mujoco = pytest.importorskip("mujoco", reason="torques are compared with MuJoCo: python3 dev.py robots")
CLOSE = 1e-12  # of the largest torque
EARTH = (0.0, 0.0, -9.81)


def urdfs() -> list[Path]:
    try:
        package = importlib.metadata.distribution("example-robot-data")
    except importlib.metadata.PackageNotFoundError:
        return []
    return sorted(Path(str(package.locate_file("cmeel.prefix/share/example-robot-data/robots"))).rglob("*.urdf"))


def mjcfs(*folders: str) -> list[Path]:
    spec = importlib.util.find_spec("robosuite")  # not imported: it needs much that is not installed
    assets = Path(str(spec.origin)).parent / "models" / "assets" if spec else Path("missing")
    return sorted(path for folder in folders for path in (assets / folder).glob("**/*.xml"))


URDFS, ROBOTS, PARTS = urdfs(), mjcfs("robots"), mjcfs("arenas", "bases", "grippers", "objects")
needs_urdfs = pytest.mark.skipif(not URDFS, reason="example-robot-data is not installed: python3 dev.py robots")
needs_mjcfs = pytest.mark.skipif(not ROBOTS, reason="robosuite is not installed: python3 dev.py robots")


def short(path: Path) -> str:
    return f"{path.parent.name}/{path.name}"


REFUSED_URDFS = {
    "alex_psyonic_hands.urdf": r"it mimics 'index_q1', and the file has no joint 'index_q1'",
    "quadrotor_base.urdf": "no joint is left to move; the file has none",
    "iris_simple.urdf": "no joint is left to move; the file has none",
    "ur3.urdf": "the file has no <link>",
}
REFUSED_PARTS = {
    "jaco_three_finger_gripper.xml": "<tendon> <fixed> 'thumb_cpl' binds it to",
    "robotiq_gripper_140.xml": "<equality> <tendon> 'finger2_12_cpl' binds it to",
    "robotiq_gripper_85.xml": "<tendon> <fixed> 'finger2_12_cpl' binds it to",
    "robotiq_gripper_s.xml": "<equality> <tendon> 'finger1_12_cpl' binds it to",
    "xarm7_gripper.xml": "it has a spring",
    "door_lock.xml": "it has a spring",
}
WEIGHTLESS = "null_mobile_base.xml"  # MuJoCo itself refuses it: it is a part of a robot


def exactly(text: str) -> str:
    """The text with its angles as they are read: rounded multiples of 15 degrees made exact."""

    def turned(found: re.Match[str]) -> str:
        words = found[2].split()
        if "$" in found[2]:  # in a comment
            return found[0]
        count = 1 if found[1] == "axisangle" else 3
        return f'{found[1]}="{" ".join([*words[:-count], *(repr(exact_angle(word)) for word in words[-count:])])}"'

    in_radians = "<mujoco" not in text or re.search(r'angle\s*=\s*"radian"', text)
    return re.sub(r'\b(rpy|euler|axisangle)\s*=\s*"([^"]*)"', turned, text) if in_radians else text


def assert_same(result: np.ndarray, expected: np.ndarray) -> None:
    assert np.isfinite(result).all()
    assert np.abs(result - expected).max() <= CLOSE * np.abs(expected).max()


@needs_urdfs
@pytest.mark.parametrize("path", URDFS, ids=short)
def test_a_urdf_has_the_torque_of_pinocchio_or_is_refused(path: Path) -> None:
    text = robot_text(path)
    if path.name in REFUSED_URDFS:
        with pytest.raises(ModelError, match=REFUSED_URDFS[path.name]):
            RigidBodies(text, source=path.name)
        return
    term = RigidBodies(text, source=path.name)
    state = states(np.random.default_rng(0), len(term.joints))
    model = pinocchio.buildModelFromXML(exactly(text))
    moving = [(joint.get("name"), *mimicked(text, joint.get("name"))) for joint in ElementTree.fromstring(text)
              if joint.tag == "joint" and joint.get("type") in ("revolute", "continuous", "prismatic")]  # fmt: skip
    torque = by_pinocchio(model, moving, [joint.name for joint in term.joints], state)
    assert_same(term.regressor(*state) @ np.array([p.value for p in term.parameters]), torque)


def mimicked(text: str, name: str) -> tuple[str, float, float]:
    """The joint that one follows in the end, with factor and offset."""
    (joint,) = (x for x in ElementTree.fromstring(text) if x.tag == "joint" and x.get("name") == name)
    mimic = joint.find("mimic")
    if mimic is None:
        return name, 1.0, 0.0
    factor, offset = float(mimic.get("multiplier", "1")), float(mimic.get("offset", "0"))
    master, outer, shift = mimicked(text, mimic.get("joint"))
    return master, factor * outer, factor * shift + offset


def by_pinocchio(model: pinocchio.Model, moving: Follow, names: list[str], state: tuple[np.ndarray, ...]) -> np.ndarray:
    """Pinocchio's inverse dynamics; the torque of a mimic joint acts on its master."""
    data = model.createData()
    model.gravity = pinocchio.Motion(np.array(EARTH), np.zeros(3))
    out = np.zeros(state[0].shape)
    for row, q, dq, ddq in zip(out, *state, strict=True):
        full, rates = pinocchio.neutral(model), np.zeros((2, model.nv))
        for name, master, factor, offset in moving:
            joint, k = model.joints[model.getJointId(name)], names.index(master)
            x = factor * q[k] + offset
            full[joint.idx_q : joint.idx_q + joint.nq] = x if joint.nq == 1 else (np.cos(x), np.sin(x))
            rates[:, joint.idx_v] = factor * dq[k], factor * ddq[k]
        tau = pinocchio.rnea(model, data, full, *rates)
        for name, master, factor, _ in moving:
            row[names.index(master)] += factor * tau[model.joints[model.getJointId(name)].idx_v]
    return out


@needs_mjcfs
@pytest.mark.parametrize("path", [*ROBOTS, *PARTS], ids=short)
def test_an_mjcf_has_the_torque_of_mujoco_or_is_refused(path: Path, tmp_path: Path) -> None:
    text = robot_text(path)
    refusal = REFUSED_PARTS.get(path.name)
    if path in PARTS and ElementTree.fromstring(text).find("worldbody//joint") is None:
        refusal = "no joint is left to move; the file has none"
    if refusal:
        with pytest.raises(ModelError, match=refusal):
            RigidBodies(text, source=path.name)
        return
    term = RigidBodies(text, source=path.name)
    text = re.sub(r'\b(file|meshdir|texturedir)\s*=\s*"([^"/][^"]*)"', lambda x: _beside(x, path), exactly(text))
    (tmp_path / "robot.xml").write_text(text, encoding="utf-8")
    if path.name == WEIGHTLESS:
        with pytest.raises(ValueError, match="mass and inertia of moving bodies must be larger"):
            mujoco.MjModel.from_xml_path(str(tmp_path / "robot.xml"))
        return
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "robot.xml"))
    state = states(np.random.default_rng(0), len(term.joints))
    torque = by_mujoco(model, term, state)
    assert_same(term.regressor(*state) @ known_values(term, model), torque)


def _beside(match: re.Match[str], path: Path) -> str:
    """A file of the package, by its path: the copy with exact angles lies elsewhere."""
    return f'{match[1]}="{(path.parent / match[2]).resolve()}"'


def known_values(term: RigidBodies, model: mujoco.MjModel) -> np.ndarray:
    """The values of the file, and MuJoCo's for the bodies whose meshes are not read."""
    out = []
    for body in term.arm.bodies_with_parameters:
        missing = np.isnan(body.theta).any()
        assert not missing or "mesh" in term.xml
        parts = (
            change_frame(of_mujoco(term, model, link), at) for link, at in zip(body.links, body.frames, strict=True)
        )
        out.append(sum(parts) if missing else body.theta)
    return np.concatenate(out)


def of_mujoco(term: RigidBodies, model: mujoco.MjModel, link: str) -> np.ndarray:
    """The inertia of a body as MuJoCo has compiled it, about the anchor of its joint."""
    number = re.fullmatch(r"body (\d+)", link)
    body = model.body(int(number[1]) if number else link)
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, body.iquat)
    turn = turn.reshape(3, 3)
    tensor = turn * body.inertia @ turn.T
    return from_physical(body.mass[0], body.ipos - term.file.origins[link], (tensor + tensor.T) / 2)


def by_mujoco(model: mujoco.MjModel, term: RigidBodies, state: tuple[np.ndarray, ...]) -> np.ndarray:
    """MuJoCo's inverse dynamics, of the rigid bodies alone; a joint that follows by an equality is moved with it."""
    off = mujoco.mjtDisableBit
    model.opt.disableflags |= off.mjDSBL_CONSTRAINT | off.mjDSBL_ACTUATION | off.mjDSBL_SPRING | off.mjDSBL_DAMPER
    model.opt.gravity[:] = EARTH
    model.opt.density = model.opt.viscosity = 0.0
    model.body_gravcomp[:] = 0.0
    model.dof_armature[:] = 0.0
    data = mujoco.MjData(model)
    followers = {joint.name: joint.follows for joint in term.file.joints if joint.follows}
    moving = [(joint.name, joint.name, 1.0, 0.0) for joint in term.joints]
    moving += [(name, *follows) for name, follows in followers.items()]
    columns = {joint.name: k for k, joint in enumerate(term.joints)}
    out = np.zeros(state[0].shape)
    for row, q, dq, ddq in zip(out, *state, strict=True):
        data.qpos[:] = model.qpos0
        for name, master, factor, offset in moving:
            joint, k = model.joint(name), columns[master]
            data.qpos[joint.qposadr[0]] = factor * q[k] + offset
            data.qvel[joint.dofadr[0]], data.qacc[joint.dofadr[0]] = factor * dq[k], factor * ddq[k]
        mujoco.mj_inverse(model, data)
        for name, master, factor, _ in moving:
            row[columns[master]] += factor * data.qfrc_inverse[model.joint(name).dofadr[0]]
    return out
