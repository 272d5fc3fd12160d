"""Settings that are tuned by hand, with their fit at once."""

from dynident.apps.tuning.bench import Bench
from dynident.apps.tuning.curve import DegreeCurve, SmoothedJoint
from dynident.apps.tuning.quick_fit import LogPrediction, QuickFit
from dynident.apps.tuning.server import serve_configuration
from dynident.apps.tuning.tuning import Tuning
