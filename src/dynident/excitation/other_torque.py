"""The torque of a model by another program: Pinocchio, with its own reader of the robot file."""

from __future__ import annotations

from dataclasses import replace
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from dynident.export import declared, joints_alone
from dynident.models import RigidBodies

if TYPE_CHECKING:
    from dynident.models import Model

__all__ = ["pinocchio_torque"]

Array = NDArray[np.float64]


def pinocchio_torque(model: Model, theta: Array, q: Array, dq: Array, ddq: Array) -> Array | None:
    """Return the torque (N, n) at parameters theta (p), that of the bodies by Pinocchio's regressor, that of all other
    terms by the model; None where Pinocchio is not installed or cannot read the joints, or the bodies are not those of
    a URDF as it stands."""
    bodies = next((term for term in model.terms if isinstance(term, RigidBodies)), None)
    if bodies is None or bodies.format != "urdf" or bodies.displacements or find_spec("pinocchio") is None:
        return None
    widths = np.cumsum([0, *(len(term.parameters) for term in model.terms)])
    place = next(k for k, term in enumerate(model.terms) if term is bodies)
    mine = slice(int(widths[place]), int(widths[place + 1]))
    others = tuple(term for term in model.terms if term is not bodies)
    peer = _read(bodies)
    if peer is None:
        return None
    out = _by_bodies(peer, bodies, theta[mine].reshape(-1, 10), q, dq, ddq)
    if others:
        out += replace(model, terms=others, load=None).regressor(q, dq, ddq) @ np.delete(theta, mine)
    return out


def _read(bodies: RigidBodies) -> Any:
    """Return the arm as Pinocchio reads it; None where it does not."""
    import pinocchio as pin

    try:
        peer = pin.buildModelFromXML(declared(joints_alone(bodies.xml), bodies.file.root))
    except (ValueError, RuntimeError):  # of names and structures that it does not take
        return None
    return peer if all(peer.existJointName(body.joint.name) for body in bodies.arm.bodies) else None


def _by_bodies(peer: Any, bodies: RigidBodies, theta: Array, q: Array, dq: Array, ddq: Array) -> Array:
    """Return the torque (N, n) of the bodies with parameters (B, 10)."""
    import pinocchio as pin

    data, arm = peer.createData(), bodies.arm
    peer.gravity = pin.Motion(np.array(bodies.gravity), np.zeros(3))
    ids = [peer.getJointId(body.joint.name) for body in arm.bodies]
    columns = [peer.joints[one].idx_v for one in ids]
    wide = np.zeros((peer.njoints, 10))
    wide[[ids[k] for k in arm.listed]] = theta
    standing = {peer.getJointId(name): x for name, x in arm.standing.items() if peer.existJointName(name)}
    out = np.empty((len(q), len(ids)))
    for row, now, speed, change in zip(out, *arm.moved(q, dq, ddq), strict=True):
        full = np.zeros((2, peer.nv))
        full[:, columns] = speed, change
        place = _configuration(peer, standing | dict(zip(ids, now, strict=True)))
        regressor = np.reshape(pin.computeJointTorqueRegressor(peer, data, place, *full), (peer.nv, -1))
        row[:] = (regressor @ wide[1:].ravel())[columns]
    return np.asarray(out @ arm.drive)


def _configuration(peer: Any, positions: dict[int, float]) -> Array:
    """Return the configuration of Pinocchio, in which a continuous joint is a point of a circle."""
    import pinocchio as pin

    out: Array = pin.neutral(peer)
    for k, x in positions.items():
        joint = peer.joints[k]
        if joint.nv == 1:
            out[joint.idx_q : joint.idx_q + joint.nq] = x if joint.nq == 1 else (np.cos(x), np.sin(x))
    return out
