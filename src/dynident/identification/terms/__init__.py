"""The choice of the terms beside the bodies, joint by joint, by what they predict of motion that was not fitted."""

from dynident.identification.terms.candidates import KINDS, PLAIN, Kind, Proposes, Seen, kind_of_class
from dynident.identification.terms.choice import NotChosen, Outcome, PlainTerms, TermChoice, Trial
from dynident.identification.terms.choose import choose_terms

__all__ = [
    "KINDS",
    "PLAIN",
    "Kind",
    "NotChosen",
    "Outcome",
    "PlainTerms",
    "Proposes",
    "Seen",
    "TermChoice",
    "Trial",
    "choose_terms",
    "kind_of_class",
]
