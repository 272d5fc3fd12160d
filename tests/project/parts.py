"""A Python file with smoothers of a user, of which one is right."""

SAVITZKY = '''
from dataclasses import dataclass

from scipy.signal import savgol_filter

from dynident.motion.log import Log, Motion
from dynident.motion.smoothers import Smoother, ends_mask


@dataclass(frozen=True)
class SavitzkyGolay(Smoother):
    """Polynomials of ``order`` over ``width`` (s)."""

    width: float = 0.1
    order: int = 4

    def __call__(self, log):
        step = (log.t[-1] - log.t[0]) / (len(log) - 1)
        size = 2 * round(self.width / step / 2) + 1
        q, dq, ddq = (savgol_filter(log.q, size, self.order, k, step, axis=0) for k in range(3))
        mask = ends_mask(log, self.width, self.width)
        return Motion(log.t, q, dq, ddq, log.tau, log.joints, mask, log.source, {"method": "Savitzky-Golay"})


@dataclass(frozen=True)
class Silent:
    width: float = 0.1


@dataclass
class Thawed(Smoother):
    width: float = 0.1

    def __call__(self, log): ...


@dataclass(frozen=True)
class Odd(Smoother):
    width: complex = 0.1

    def __call__(self, log): ...


def function(log): ...


@dataclass(frozen=True)
class Reserved(Smoother):
    kind: str = "x"

    def __call__(self, log): ...


@dataclass(frozen=True)
class Private(Smoother):
    _width: float = 0.1

    def __call__(self, log): ...
'''
