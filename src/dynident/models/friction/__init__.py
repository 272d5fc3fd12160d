"""Torques of single joints: friction and offsets, one file per term."""

from dynident.models.friction.coulomb import Coulomb
from dynident.models.friction.dry_friction import DryFriction
from dynident.models.friction.joint_term import Constant, JointTerm
from dynident.models.friction.offset import Offset
from dynident.models.friction.per_joint import PerJoint
from dynident.models.friction.viscous import Viscous

__all__ = ["Constant", "Coulomb", "DryFriction", "JointTerm", "Offset", "PerJoint", "Viscous"]
