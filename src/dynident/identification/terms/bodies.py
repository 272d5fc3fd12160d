"""The parameters of the model given while terms are chosen: least squares with a weak prior, which the samples of any
fold determine, also where they excite less than those judged by."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief
from dynident.estimators.constraints import bodies_of, scales
from dynident.identification.terms.grams import JointGrams, eliminated, ridged, weighed
from dynident.models import Parameter

__all__ = ["Prior", "normal_matrices", "others", "prior_of"]

Array = NDArray[np.float64]
Normal = tuple[Array, Array]


@dataclass(frozen=True, eq=False)
class Prior:
    """A prior of p parameters: ``mean`` (p), the robot file's values, and ``precision`` (p) per independent sample.

    Its standard deviation is the size of the parameter: what a body of the nominal mass and length has. Parameters
    that are not of bodies have none.
    """

    mean: Array
    precision: Array

    __repr__ = brief


def prior_of(parameters: Sequence[Parameter]) -> Prior:
    """Return the prior of the parameters of a model."""
    bodies = bodies_of(parameters)
    size = scales(parameters, bodies, np.ones(len(parameters)), 1.0)
    mean, precision = np.zeros(len(parameters)), np.zeros(len(parameters))
    for body in bodies:
        values = [parameters[k].value for k in body.columns]
        mean[body.columns] = [0.0 if value is None else value for value in values]
        precision[body.columns] = 1.0 / size[body.columns] ** 2
    return Prior(mean, precision)


def normal_matrices(one: JointGrams, chosen: Sequence[int], train: Array, weight: float) -> Normal:
    """Return normal matrices (S, p, p) and right sides (S, p) of the parameters from one joint, without its chosen
    columns; ``train`` (S, F) weighs its blocks."""
    b = len(one.maps)
    total = weight * weighed(train, one.grams.sum(axis=1))
    M, right = eliminated(total, b, [b + i for i in chosen])
    return one.maps.T @ M @ one.maps, right @ one.maps


def others(normals: Sequence[Normal], j: int, precision: Array, acts: NDArray[np.intp]) -> Normal:
    """Return normal matrices (S, k, k) and right sides of the parameters that act on joint j, from all other joints and
    the prior (p); what acts on the other joints only is eliminated."""
    M = np.add.reduce([one[0] for one in normals])
    diagonal = np.einsum("sii->si", M).max(axis=0)
    M, right = M - normals[j][0], np.add.reduce([one[1] for one in normals]) - normals[j][1]
    M = M + np.diag(precision + 1e-9 * diagonal + np.finfo(float).tiny)
    if not len(rest := np.setdiff1d(np.arange(len(precision)), acts)):
        return M, right
    cross = M[:, rest][:, :, acts]
    solved = np.linalg.solve(ridged(M[:, rest][:, :, rest]), np.concatenate([cross, right[:, rest, None]], axis=2))
    down = np.swapaxes(cross, 1, 2) @ solved
    return M[:, acts][:, :, acts] - down[..., :-1], right[:, acts] - down[..., -1]
