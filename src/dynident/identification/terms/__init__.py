"""The choice of the terms beside the bodies, joint by joint, by what they predict of motion that was not fitted."""

from dynident.identification.terms.candidates import (
    MIN_DRIFT_DURATION,
    CandidateKind,
    JointExcitation,
    NotChosen,
    PlainTerms,
    Proposes,
    TermChoice,
    TermTrial,
    TrialOutcome,
    kind_of_class,
    library_kinds,
)
from dynident.identification.terms.choose import choose_terms
