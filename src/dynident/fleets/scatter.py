"""How much the parameters of a robot scatter from log to log beyond their standard errors, as the whole fleet shows.

Friction follows the temperature, sensors their offset, and what the model lacks shows differently in each motion:
standard errors of single logs say nothing of this. Without it every second log would be a change.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.errors import InputError, brief
from dynident.fleets.components import Components, Measured, components, measured
from dynident.fleets.history import History
from dynident.regression import Group, GroupKind

__all__ = ["Scatter", "blocks_of", "scatter_of"]

Array = NDArray[np.float64]
MOST = 400  # logs, taken from robots at random, of which the scatter is estimated
FEW = 5  # robots, below which one that changes weighs too much


@dataclass(frozen=True, eq=False)
class Scatter:
    """The scatter from log to log: covariance (b, b), and the factor s^2 on the covariances of the estimates.

    ``dof`` says how many logs it rests on, less what was estimated from them.
    """

    parts: Components
    dof: float

    __repr__ = brief

    @property
    def covariance(self) -> Array:
        """The covariance (b, b) of what one log's parameters differ from another's, beyond their standard errors."""
        return self.parts.covariance

    @property
    def inflation(self) -> float:
        """By how much standard errors are too small, as model errors make them: s."""
        return float(np.sqrt(self.parts.inflation))

    def with_scatter(self, information: Array) -> Array:
        """Return what a log says of the robot (b, b), not of the day: the inverse of its covariance and the scatter."""
        G = measured(np.zeros((1, len(information))), information[None]).factor[0]
        covariance = self.parts.inflation * np.eye(len(G)) + G @ self.parts.covariance @ G.T
        return np.asarray(G.T @ np.linalg.solve(covariance, G))


def blocks_of(groups: Sequence[Group], b: int) -> tuple[NDArray[np.intp], ...]:
    """Return the base parameters that scatter together: friction of a joint, a ripple; each other one by itself."""
    label = np.arange(b)
    for group in groups:
        if group.kind is not GroupKind.PAYLOAD:
            touched = np.isin(label, label[group.directions.any(axis=1)])
            label[touched] = label[touched].min(initial=b)
    return tuple(np.flatnonzero(label == one) for one in np.unique(label))


def scatter_of(
    histories: Sequence[History],
    groups: Sequence[Group],
    rng: np.random.Generator,
    designs: Sequence[Array] | None = None,
    start: Scatter | None = None,
) -> Scatter:
    """Return the scatter of robots of one type, robust against few that change.

    ``designs`` (K, b, q each) say what is known to have changed, by default nothing: then each of few robots is taken
    in runs of three logs with a mean of their own, because one that changes would hide it in its own scatter. ``rng``
    draws robots where there are more than 400 logs. Raises InputError where the robots do not have the same base
    parameters.
    """
    sizes = {history.value.shape[1] for history in histories}
    if len(sizes) > 1:
        raise InputError(f"the robots have {sorted(sizes)} base parameters; give robots of one type, with one recipe.")
    b = sizes.pop() if sizes else 0
    known = designs or [np.broadcast_to(np.eye(b), history.information.shape) for history in histories]
    sets, dof = list[Measured](), 0.0
    for k in rng.permutation(len(histories)):
        if dof < MOST:
            for run in _runs(len(known[k]), len(histories) < FEW and designs is None):
                sets.append(measured(histories[k].value[run], histories[k].information[run], known[k][run]))
                dof += max(len(known[k][run]) - known[k].shape[2] / b, 0.0)
    blocks = blocks_of(groups, b) if b else ()
    sets = [one for one in sets if len(one.value) > 1]
    if not sets:
        return Scatter(Components(blocks, np.zeros((b, b))), 0.0)
    return Scatter(components(sets, blocks, inflate=True, start=None if start is None else start.parts), dof)


def _runs(logs: int, apart: bool) -> list[slice]:
    """Return which logs share a mean: all of a robot, or runs of three, the last one of up to five."""
    starts = range(0, max(logs - 2, 1), 3) if apart else range(1)
    ends = [*starts[1:], logs]
    return [slice(start, end) for start, end in zip(starts, ends, strict=True)]
