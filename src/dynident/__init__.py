"""dynident: dynamic parameters of robot arms from measured joint positions and torques.

    import dynident as dy

    result = dy.identify("arm.urdf", {"monday": monday}, {"tuesday": tuesday})

The names below are what a user calls; each is imported when it is first asked for. All others are in their packages.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from dynident._version import __version__ as __version__

if TYPE_CHECKING:  # the table below, for type checkers, which know only what is imported
    from dynident import runtime as errors  # the room that holds them
    from dynident.apps.excitation.run import excite as excite
    from dynident.apps.fleets.run import fleet as fleet
    from dynident.apps.payload import find_payload as find_payload
    from dynident.apps.ranking.run import compare as compare
    from dynident.apps.servo import identify_servos as identify_servos
    from dynident.estimators import AugmentedKalman as AugmentedKalman
    from dynident.estimators import Didim as Didim
    from dynident.estimators import Estimate as Estimate
    from dynident.estimators import GeneralisedLeastSquares as GeneralisedLeastSquares
    from dynident.estimators import InstrumentalVariables as InstrumentalVariables
    from dynident.estimators import LeastSquares as LeastSquares
    from dynident.estimators import OutputError as OutputError
    from dynident.estimators import PhysicallyConsistent as PhysicallyConsistent
    from dynident.estimators import Ridge as Ridge
    from dynident.estimators import RobustLeastSquares as RobustLeastSquares
    from dynident.estimators import TotalLeastSquares as TotalLeastSquares
    from dynident.estimators import WeightedLeastSquares as WeightedLeastSquares
    from dynident.estimators.maximum_likelihood import MaximumLikelihood as MaximumLikelihood
    from dynident.identification import Identification as Identification
    from dynident.identification import Recipe as Recipe
    from dynident.identification import bootstrap as bootstrap
    from dynident.identification import cramer_rao_bound as cramer_rao_bound
    from dynident.models import CoupledMotor as CoupledMotor
    from dynident.models import Joint as Joint
    from dynident.models import Lagrangian as Lagrangian
    from dynident.models import Model as Model
    from dynident.models import RigidBodies as RigidBodies
    from dynident.models import RotorInertia as RotorInertia
    from dynident.models.friction import Coulomb as Coulomb
    from dynident.models.friction import Offset as Offset
    from dynident.models.friction import Viscous as Viscous
    from dynident.models.lagrangian import two_link_arm as two_link_arm
    from dynident.models.simulation import record as record
    from dynident.models.simulation import simulate as simulate
    from dynident.motion.log import Log as Log
    from dynident.motion.log import Motion as Motion
    from dynident.motion.smoothers import Butterworth as Butterworth
    from dynident.motion.smoothers import Difference as Difference
    from dynident.motion.smoothers import FourierSeries as FourierSeries
    from dynident.motion.smoothers import KalmanSmoother as KalmanSmoother
    from dynident.motion.smoothers import SavitzkyGolay as SavitzkyGolay
    from dynident.motion.smoothers import Spline as Spline
    from dynident.motion.splines import smooth as smooth
    from dynident.project.export.proof import export_model as export_model
    from dynident.project.project import run as run
    from dynident.project.saved import load as load
    from dynident.project.shortcuts import accuracy_bound as accuracy_bound
    from dynident.project.shortcuts import check as check
    from dynident.project.shortcuts import identify as identify
    from dynident.project.shortcuts import read_log as read_log
    from dynident.project.shortcuts import read_robot as read_robot
    from dynident.regression import ParallelFilter as ParallelFilter
    from dynident.validation import validate as validate

_NAMES = {  # by the module that defines them
    "dynident": "errors",
    "dynident.apps.excitation.run": "excite",
    "dynident.apps.fleets.run": "fleet",
    "dynident.apps.payload": "find_payload",
    "dynident.apps.ranking.run": "compare",
    "dynident.apps.servo": "identify_servos",
    "dynident.estimators": (
        "AugmentedKalman Didim Estimate GeneralisedLeastSquares InstrumentalVariables LeastSquares "
        "OutputError PhysicallyConsistent Ridge RobustLeastSquares TotalLeastSquares WeightedLeastSquares"
    ),
    "dynident.estimators.maximum_likelihood": "MaximumLikelihood",
    "dynident.identification": "Identification Recipe bootstrap cramer_rao_bound",
    "dynident.models": "CoupledMotor Joint Lagrangian Model RigidBodies RotorInertia",
    "dynident.models.friction": "Coulomb Offset Viscous",
    "dynident.models.lagrangian": "two_link_arm",
    "dynident.models.simulation": "record simulate",
    "dynident.motion.log": "Log Motion",
    "dynident.motion.smoothers": "Butterworth Difference FourierSeries KalmanSmoother SavitzkyGolay Spline",
    "dynident.motion.splines": "smooth",
    "dynident.project.export.proof": "export_model",
    "dynident.project.project": "run",
    "dynident.project.saved": "load",
    "dynident.project.shortcuts": "accuracy_bound check identify read_log read_robot",
    "dynident.regression": "ParallelFilter",
    "dynident.validation": "validate",
}
_MODULES = dict(sorted((name, module) for module, names in _NAMES.items() for name in names.split()))
__all__ = list(_MODULES)


def __getattr__(name: str) -> Any:
    """Import a name of ``__all__`` when it is first asked for (PEP 562)."""
    module = _MODULES.get(name)
    if module is None:
        raise AttributeError(f"module 'dynident' has no attribute {name!r}", name=name, obj=import_module(__name__))
    value = import_module("dynident.runtime") if name == "errors" else getattr(import_module(module), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*__all__, *(name for name in globals() if name.startswith("__"))})
