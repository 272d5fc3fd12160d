"""Output error: a simulation is fitted to the recording, in torque (DIDIM) or in position."""

from dynident.estimators.output_error.didim import Didim

__all__ = ["Didim"]
