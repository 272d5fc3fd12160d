"""The terms a model is summed from: rigid bodies from symbolic energies, friction, and offsets."""

from dynident.terms.friction import Coulomb, Offset, Viscous
from dynident.terms.lagrangian import Lagrangian, Unknown
from dynident.terms.term import Joint, Parameter, Partials, Term

__all__ = ["Coulomb", "Joint", "Lagrangian", "Offset", "Parameter", "Partials", "Term", "Unknown", "Viscous"]
