"""The formats that a model is exported to."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import PurePath
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from dynident.export.exporter import Reader, States
from dynident.export.identified import Identified, drives
from dynident.export.mjcf import identified_mjcf
from dynident.export.numpy_module import identified_module
from dynident.export.parameters import identified_yaml
from dynident.export.placement import placed
from dynident.export.readers import by_dynident, by_mujoco, by_numpy, by_pinocchio, by_yaml
from dynident.export.urdf import identified_urdf
from dynident.export.written import Written
from dynident.models import remembered

__all__ = ["Mjcf", "Numpy", "Urdf", "Yaml"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Urdf:
    """The robot's own URDF with the identified inertias, damping and friction."""

    format: ClassVar[str] = "urdf"
    readers: ClassVar[Mapping[str, Reader]] = {"Pinocchio": by_pinocchio, "dynident": by_dynident}

    def file(self, identified: Identified) -> str:
        """Return the name of the robot's file, as that of an identified one."""
        return f"{_stem(identified)}.identified.urdf"

    def write(self, identified: Identified) -> Written:
        """Return the URDF."""
        return identified_urdf(identified)

    def torque(self, identified: Identified, states: States) -> Array:
        """Return the torque of bodies, damping and friction."""
        return _of_file(identified, states, armature=False)


@dataclass(frozen=True)
class Mjcf:
    """The robot's own MJCF with the identified inertias, damping, friction and armature."""

    format: ClassVar[str] = "mjcf"
    readers: ClassVar[Mapping[str, Reader]] = {"MuJoCo": by_mujoco, "dynident": by_dynident}

    def file(self, identified: Identified) -> str:
        """Return the name of the robot's file, as that of an identified one."""
        return f"{_stem(identified)}.identified.xml"

    def write(self, identified: Identified) -> Written:
        """Return the MJCF."""
        return identified_mjcf(identified)

    def torque(self, identified: Identified, states: States) -> Array:
        """Return the torque of bodies, damping, friction and armature."""
        return _of_file(identified, states, armature=True)


@dataclass(frozen=True)
class Numpy:
    """A Python module that needs only NumPy."""

    format: ClassVar[str] = "numpy"
    readers: ClassVar[Mapping[str, Reader]] = {"NumPy": by_numpy}

    def file(self, identified: Identified) -> str:  # noqa: ARG002
        """Return model.py."""
        return "model.py"

    def write(self, identified: Identified) -> Written:
        """Return the module."""
        return identified_module(identified)

    def torque(self, identified: Identified, states: States) -> Array:
        """Return the torque of all terms but those that remember more than the load."""
        held = identified.memoryless
        memory = remembered(held.model, np.zeros(len(states[0])), *states)
        return held.model.torque(*states, held.value, memory)


@dataclass(frozen=True)
class Yaml:
    """All parameters by name, with units and meanings."""

    format: ClassVar[str] = "yaml"
    readers: ClassVar[Mapping[str, Reader]] = {"YAML": by_yaml}

    def file(self, identified: Identified) -> str:  # noqa: ARG002
        """Return parameters.yaml."""
        return "parameters.yaml"

    def write(self, identified: Identified) -> Written:
        """Return the parameters."""
        return identified_yaml(identified)

    def torque(self, identified: Identified, states: States) -> Array:
        """Return the torque of all terms, of which those that remember have forgotten everything."""
        return identified.model.torque(*states, identified.value, np.zeros((len(states[0]), identified.model.memory)))


def _stem(identified: Identified) -> str:
    return PurePath(identified.robot.source if identified.robot else identified.model.name).stem


def _of_file(identified: Identified, states: States, *, armature: bool) -> Array:
    best = placed(identified, armature=armature)
    bodies, values = best.bodies
    names = tuple(joint.name for joint in bodies.joints)
    held = drives(best, armature=armature)
    return np.asarray(bodies.torque(*states, values.ravel()) + held.torque(names, *states[1:]))
