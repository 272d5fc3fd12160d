"""Robot models: sums of terms that are linear in their parameters, tau = Y(q, dq, ddq) theta."""

from dynident.models.capsules import Outline, outlines, solid_surface
from dynident.models.evaluation import MassMatrixCheck, drop_load_dependence, motion_memory
from dynident.models.geometry import (
    Box,
    Capsule,
    Cylinder,
    Distances,
    EmptySpace,
    Floor,
    Geometry,
    Mesh,
    Obstacle,
    ShapeSource,
    Solid,
    Space,
    rod_geometry,
)
from dynident.models.inertia import (
    change_frame,
    consistency_violations,
    from_physical,
    from_pseudo,
    smallest_eigenvalue,
    to_physical,
    to_pseudo,
)
from dynident.models.lagrangian import Lagrangian, Unknown
from dynident.models.model import Model
from dynident.models.motor import CoupledFriction, CoupledMotor, RotorInertia
from dynident.models.rigid_bodies import Placements, RigidBodies
from dynident.models.structure import Structure, common_structure, random_states
from dynident.models.term import FUNCTIONS, INERTIAL, Equation, Joint, Parameter, Partials, Past, Term
