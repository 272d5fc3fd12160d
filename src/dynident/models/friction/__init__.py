"""Friction laws of single joints."""

from dynident.models.friction.dahl_and_load import Dahl, LoadCoulomb, LoadDahl, LoadRipple, LoadViscous
from dynident.models.friction.dry_friction import (
    AsymmetricCoulomb,
    AsymmetricViscous,
    Coulomb,
    DryFriction,
    Power,
    Stribeck,
    WideCoulomb,
)
from dynident.models.friction.joint_term import Constant, JointTerm, PerJoint, Viscous
from dynident.models.friction.joint_torques import Counterbalance, Drift, Offset, Ripple, Spring
