"""Published parameters of measured robots: the torque that they give on any motion.

EMPS: A. Janot, M. Gautier and M. Brunot (2019), "Data set and reference models of EMPS". Panda: C. Gaz, M. Cognetti, A.
Oliva, P. Robuffo Giordano and A. De Luca (2019), "Dynamic identification of the Franka Emika Panda robot with retrieval
of feasible parameters using penalty-based optimization"; of another arm of this type, without a hand.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from dynident.models import Model, from_physical
from dynident.motion.log import Motion

Array = np.ndarray

EMPS = (95.1089, 203.5034, 20.3935, -3.1648)  # kg, N s/m, N, N: mass, viscous and Coulomb friction, offset
# of each link: mass in kg; centre of mass in m; Ixx, Ixy, Iyy, Ixz, Iyz, Izz about it in kg m^2
PANDA_LINKS = (
    (4.970684, (3.875e-3, 2.081e-3, -0.175), (0.70337, -1.39e-4, 0.70661, 6.772e-3, 1.9169e-2, 9.117e-3)),
    (0.646926, (-3.141e-3, -2.872e-2, 3.495e-3), (7.962e-3, -3.925e-3, 2.811e-2, 1.0254e-2, 7.04e-4, 2.5995e-2)),
    (3.228604, (2.7518e-2, 3.9252e-2, -6.6502e-2), (3.7242e-2, -4.761e-3, 3.6155e-2, -1.1396e-2, -1.2805e-2, 1.083e-2)),
    (3.587895, (-5.317e-2, 0.104419, 2.7454e-2), (2.5853e-2, 7.796e-3, 1.9552e-2, -1.332e-3, 8.641e-3, 2.8323e-2)),
    (1.225946, (-1.1953e-2, 4.1065e-2, -3.8437e-2), (3.5549e-2, -2.117e-3, 2.9474e-2, -4.037e-3, 2.29e-4, 8.627e-3)),
    (1.666555, (6.0149e-2, -1.4117e-2, -1.0517e-2), (1.964e-3, 1.09e-4, 4.354e-3, -1.158e-3, 3.41e-4, 5.433e-3)),
    (0.735522, (1.0517e-2, -4.252e-3, 6.1597e-2), (1.2516e-2, -4.28e-4, 1.0027e-2, -1.196e-3, -7.41e-4, 4.815e-3)),
)
# friction a / (1 + exp(-b (dq + c))), less its value at rest: a in N m, b in s/rad, c in rad/s
PANDA_FRICTION = np.array(
    [
        (0.54615, 0.87224, 0.64068, 1.2794, 0.83904, 0.30301, 0.56489),
        (5.1181, 9.0657, 10.136, 5.5903, 8.3469, 17.133, 10.336),
        (0.039533, 0.025882, -0.04607, 0.036194, 0.026226, -0.021047, 0.0035526),
    ]
)


def emps_torque(_: Model, motion: Motion) -> Array:
    """Return the force (N, 1) of the drive."""
    mass, viscous, coulomb, offset = EMPS
    return mass * motion.ddq + viscous * motion.dq + coulomb * np.sign(motion.dq) + offset


def panda_torque(bodies: Model, motion: Motion) -> Array:
    """Return the torque (N, 7) of the arm, by the kinematics of ``bodies``."""
    rows = [from_physical(mass, centre, _tensor(moments)) for mass, centre, moments in PANDA_LINKS]
    a, b, c = PANDA_FRICTION
    friction = a / (1.0 + np.exp(-b * (motion.dq + c))) - a / (1.0 + np.exp(-b * c))
    return np.asarray(bodies.torque(motion.q, motion.dq, motion.ddq, np.concatenate(rows)) + friction)


def _tensor(moments: tuple[float, ...]) -> Array:
    xx, xy, yy, xz, yz, zz = moments
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


PUBLISHED: Mapping[str, tuple[str, Callable[[Model, Motion], Array]]] = {
    "emps": ("Janot 2019", emps_torque),
    "panda": ("Gaz 2019", panda_torque),
}
