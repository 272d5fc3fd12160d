"""The terms a model is summed from: rigid bodies from files or symbolic energies, friction, offsets, and motors."""

from dynident.terms.bodies import Bodies
from dynident.terms.friction import Coulomb, Offset, PerJoint, Viscous
from dynident.terms.lagrangian import Lagrangian, Unknown
from dynident.terms.motor import Coupling, RotorInertia
from dynident.terms.term import Joint, Parameter, Partials, Term

__all__ = [
    "Bodies",
    "Coulomb",
    "Coupling",
    "Joint",
    "Lagrangian",
    "Offset",
    "Parameter",
    "Partials",
    "PerJoint",
    "RotorInertia",
    "Term",
    "Unknown",
    "Viscous",
]
