"""Torques of single joints: friction and offsets, one file per term."""

from dynident.models.friction.coulomb import Coulomb
from dynident.models.friction.offset import Offset
from dynident.models.friction.per_joint import PerJoint
from dynident.models.friction.viscous import Viscous

__all__ = ["Coulomb", "Offset", "PerJoint", "Viscous"]
