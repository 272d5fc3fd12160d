"""Torques of single joints: friction, springs, ripple and offsets, one file per term."""

from dynident.models.friction.asymmetric import AsymmetricCoulomb, AsymmetricViscous
from dynident.models.friction.coulomb import Coulomb, WideCoulomb
from dynident.models.friction.counterbalance import Counterbalance
from dynident.models.friction.dahl import Dahl
from dynident.models.friction.drift import Drift
from dynident.models.friction.dry_friction import DryFriction
from dynident.models.friction.joint_term import Constant, JointTerm
from dynident.models.friction.load import LoadCoulomb, LoadDahl, LoadRipple, LoadViscous, RemembersLoad
from dynident.models.friction.offset import Offset
from dynident.models.friction.per_joint import PerJoint
from dynident.models.friction.power import Power
from dynident.models.friction.ripple import Ripple
from dynident.models.friction.spring import Spring
from dynident.models.friction.stribeck import Stribeck
from dynident.models.friction.viscous import Viscous

__all__ = [
    "AsymmetricCoulomb",
    "AsymmetricViscous",
    "Constant",
    "Coulomb",
    "Counterbalance",
    "Dahl",
    "Drift",
    "DryFriction",
    "JointTerm",
    "LoadCoulomb",
    "LoadDahl",
    "LoadRipple",
    "LoadViscous",
    "Offset",
    "PerJoint",
    "Power",
    "RemembersLoad",
    "Ripple",
    "Spring",
    "Stribeck",
    "Viscous",
    "WideCoulomb",
]
