"""dynident: dynamic parameters of robot arms from measured joint positions and torques."""

__version__ = "0.1.0"
