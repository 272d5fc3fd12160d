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
from dynident.models.mass_matrix import MassMatrixCheck
from dynident.models.memory import remembered
from dynident.models.model import Model
from dynident.models.motor import CoupledMotor, RotorInertia
from dynident.models.rigid_bodies import RigidBodies
from dynident.models.simulation import Recording, record, simulate, simulate_many
from dynident.models.structure import Structure, random_states, structure_of
from dynident.models.term import (
    INERTIAL,
    HasGeometry,
    HasGravity,
    HasLimits,
    HasMassMatrix,
    HasMemory,
    HasNotes,
    HasNumpySource,
    HasRobotFile,
    HasSign,
    HasSupport,
    Joint,
    Loads,
    NeedsLoad,
    Parameter,
    Partials,
    Past,
    Recursive,
    Selective,
    Term,
    declares,
)

__all__ = [
    "INERTIAL",
    "Coulomb",
    "CoupledMotor",
    "HasGeometry",
    "HasGravity",
    "HasLimits",
    "HasMassMatrix",
    "HasMemory",
    "HasNotes",
    "HasNumpySource",
    "HasRobotFile",
    "HasSign",
    "HasSupport",
    "Joint",
    "Lagrangian",
    "Loads",
    "MassMatrixCheck",
    "Model",
    "NeedsLoad",
    "Offset",
    "Parameter",
    "Partials",
    "Past",
    "PerJoint",
    "Recording",
    "Recursive",
    "RigidBodies",
    "RotorInertia",
    "Selective",
    "Structure",
    "Term",
    "Unknown",
    "Viscous",
    "consistency_violations",
    "declares",
    "from_physical",
    "from_pseudo",
    "moved",
    "random_states",
    "record",
    "remembered",
    "simulate",
    "simulate_many",
    "smallest_eigenvalue",
    "structure_of",
    "to_physical",
    "to_pseudo",
]
