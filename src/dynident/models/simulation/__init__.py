"""Free simulation of a model, in the loop of its controller or by a given torque."""

from dynident.models.simulation.controllers import PD, PID, CascadePD, DifferencingLoop, Function, HasTimes
from dynident.models.simulation.recording import Recording, record, simulate, simulate_many
from dynident.models.simulation.run import SimulatedRecording, Ticks, longest_stretch, simulate_recording, ticks
from dynident.models.simulation.sensitivity import Sensitivity, sensitivities
from dynident.models.simulation.trace import Broken, ControllerInput, ControllerSlopes, Failure, RunsAway, Singular
