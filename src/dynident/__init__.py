"""dynident: dynamic parameters of robot arms from measured joint positions and torques.

    import dynident as dy

    found = dy.identify("arm.urdf", {"monday": monday}, {"tuesday": tuesday})

The names below are what a user calls; each is imported when it is first asked for. All others are in their packages.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dynident import errors
    from dynident.bounds import cramer_rao_bound
    from dynident.estimators import (
        AugmentedKalman,
        Didim,
        Estimate,
        GeneralisedLeastSquares,
        InstrumentalVariables,
        LeastSquares,
        MaximumLikelihood,
        OutputError,
        PhysicallyConsistent,
        Ridge,
        RobustLeastSquares,
        TotalLeastSquares,
        WeightedLeastSquares,
    )
    from dynident.identification import Identification, Recipe, bootstrap
    from dynident.io.model_files import export_model
    from dynident.io.project import run
    from dynident.io.saved import load
    from dynident.io.shortcuts import accuracy_bound, check, identify, read_log, read_robot
    from dynident.log import Log, Motion
    from dynident.models import (
        Coulomb,
        CoupledMotor,
        Joint,
        Lagrangian,
        Model,
        Offset,
        RigidBodies,
        RotorInertia,
        Viscous,
        record,
        simulate,
    )
    from dynident.models.gallery import two_link_arm
    from dynident.payload import find_payload
    from dynident.regression import ParallelFilter
    from dynident.report.compare_run import compare
    from dynident.report.excite_run import excite
    from dynident.report.fleet_run import fleet
    from dynident.smoothers import Butterworth, Difference, FourierSeries, KalmanSmoother, SavitzkyGolay, Spline
    from dynident.splines import smooth
    from dynident.validation import validate

__version__ = "0.1.0"

__all__ = [
    "AugmentedKalman",
    "Butterworth",
    "Coulomb",
    "CoupledMotor",
    "Didim",
    "Difference",
    "Estimate",
    "FourierSeries",
    "GeneralisedLeastSquares",
    "Identification",
    "InstrumentalVariables",
    "Joint",
    "KalmanSmoother",
    "Lagrangian",
    "LeastSquares",
    "Log",
    "MaximumLikelihood",
    "Model",
    "Motion",
    "Offset",
    "OutputError",
    "ParallelFilter",
    "PhysicallyConsistent",
    "Recipe",
    "Ridge",
    "RigidBodies",
    "RobustLeastSquares",
    "RotorInertia",
    "SavitzkyGolay",
    "Spline",
    "TotalLeastSquares",
    "Viscous",
    "WeightedLeastSquares",
    "accuracy_bound",
    "bootstrap",
    "check",
    "compare",
    "cramer_rao_bound",
    "errors",
    "excite",
    "export_model",
    "find_payload",
    "fleet",
    "identify",
    "load",
    "read_log",
    "read_robot",
    "record",
    "run",
    "simulate",
    "smooth",
    "two_link_arm",
    "validate",
]

_MODULES = {
    "AugmentedKalman": "dynident.estimators",
    "Butterworth": "dynident.smoothers",
    "Coulomb": "dynident.models",
    "CoupledMotor": "dynident.models",
    "Didim": "dynident.estimators",
    "Difference": "dynident.smoothers",
    "Estimate": "dynident.estimators",
    "FourierSeries": "dynident.smoothers",
    "GeneralisedLeastSquares": "dynident.estimators",
    "Identification": "dynident.identification",
    "InstrumentalVariables": "dynident.estimators",
    "Joint": "dynident.models",
    "KalmanSmoother": "dynident.smoothers",
    "Lagrangian": "dynident.models",
    "LeastSquares": "dynident.estimators",
    "Log": "dynident.log",
    "MaximumLikelihood": "dynident.estimators",
    "Model": "dynident.models",
    "Motion": "dynident.log",
    "Offset": "dynident.models",
    "OutputError": "dynident.estimators",
    "ParallelFilter": "dynident.regression",
    "PhysicallyConsistent": "dynident.estimators",
    "Recipe": "dynident.identification",
    "Ridge": "dynident.estimators",
    "RigidBodies": "dynident.models",
    "RobustLeastSquares": "dynident.estimators",
    "RotorInertia": "dynident.models",
    "SavitzkyGolay": "dynident.smoothers",
    "Spline": "dynident.smoothers",
    "TotalLeastSquares": "dynident.estimators",
    "Viscous": "dynident.models",
    "WeightedLeastSquares": "dynident.estimators",
    "accuracy_bound": "dynident.io.shortcuts",
    "bootstrap": "dynident.identification",
    "check": "dynident.io.shortcuts",
    "compare": "dynident.report.compare_run",
    "cramer_rao_bound": "dynident.bounds",
    "errors": "dynident",
    "excite": "dynident.report.excite_run",
    "export_model": "dynident.io.model_files",
    "find_payload": "dynident.payload",
    "fleet": "dynident.report.fleet_run",
    "identify": "dynident.io.shortcuts",
    "load": "dynident.io.saved",
    "read_log": "dynident.io.shortcuts",
    "read_robot": "dynident.io.shortcuts",
    "record": "dynident.models",
    "run": "dynident.io.project",
    "simulate": "dynident.models",
    "smooth": "dynident.splines",
    "two_link_arm": "dynident.models.gallery",
    "validate": "dynident.validation",
}


def __getattr__(name: str) -> Any:
    """Import a name of ``__all__`` when it is first asked for (PEP 562)."""
    module = _MODULES.get(name)
    if module is None:
        raise AttributeError(f"module 'dynident' has no attribute {name!r}", name=name, obj=import_module(__name__))
    found = import_module(f"dynident.{name}") if module == "dynident" else getattr(import_module(module), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*__all__, *(name for name in globals() if name.startswith("__"))})
