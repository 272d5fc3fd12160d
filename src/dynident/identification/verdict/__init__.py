"""The verdict on an identification, as data: is the model fit for use, and if not, why? ``report`` makes the text.

``verdict``, ``reasons`` and ``steps`` hold the nouns, ``rules`` decides.
"""

from dynident.identification.verdict.reasons import Reason
from dynident.identification.verdict.rules import judge
from dynident.identification.verdict.steps import Remedy, Step
from dynident.identification.verdict.verdict import HeldOut, LargestResidual, Use, Verdict, WorstRun

__all__ = ["HeldOut", "LargestResidual", "Reason", "Remedy", "Step", "Use", "Verdict", "WorstRun", "judge"]
