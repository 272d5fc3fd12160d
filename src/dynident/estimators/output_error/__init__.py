"""Output error: a simulation is fitted to the recording, in torque (DIDIM) or in position."""

from dynident.estimators.output_error.didim import Didim
from dynident.estimators.output_error.output_error import OutputError

__all__ = ["Didim", "OutputError"]
