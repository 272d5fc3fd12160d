"""Models: an ordered sum of terms, tau = Y(q, dq, ddq) theta; robot files, friction, motors, inertia, simulation."""

from dynident.models.friction import Coulomb, Offset, PerJoint, Viscous
from dynident.models.inertia import (
    consistency_violations,
    from_physical,
    from_pseudo,
    moved,
    smallest_eigenvalue,
    to_physical,
    to_pseudo,
)
from dynident.models.lagrangian import Lagrangian, Unknown
from dynident.models.model import MassMatrixCheck, Model
from dynident.models.motor import CoupledMotor, RotorInertia
from dynident.models.rigid_bodies import RigidBodies
from dynident.models.simulation import Recording, record, simulate, simulate_many
from dynident.models.term import (
    INERTIAL,
    HasGeometry,
    HasGravity,
    HasLimits,
    HasMassMatrix,
    HasNotes,
    HasNumpySource,
    HasRobotFile,
    HasSign,
    Joint,
    Parameter,
    Partials,
    Recursive,
    Term,
)

__all__ = [
    "INERTIAL",
    "Coulomb",
    "CoupledMotor",
    "HasGeometry",
    "HasGravity",
    "HasLimits",
    "HasMassMatrix",
    "HasNotes",
    "HasNumpySource",
    "HasRobotFile",
    "HasSign",
    "Joint",
    "Lagrangian",
    "MassMatrixCheck",
    "Model",
    "Offset",
    "Parameter",
    "Partials",
    "PerJoint",
    "Recording",
    "Recursive",
    "RigidBodies",
    "RotorInertia",
    "Term",
    "Unknown",
    "Viscous",
    "consistency_violations",
    "from_physical",
    "from_pseudo",
    "moved",
    "record",
    "simulate",
    "simulate_many",
    "smallest_eigenvalue",
    "to_physical",
    "to_pseudo",
]
