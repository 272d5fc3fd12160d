"""Triangular factors of rows without a known structure."""

import math
from collections.abc import Iterable

import numpy as np

from dynident.models import Structure
from dynident.regression import EntryBlock, RegressorBlock, TriangularFactors, factorise


def triangularise(blocks: Iterable[RegressorBlock], joints: int, parameters: int) -> TriangularFactors:
    structure = Structure((np.arange(parameters),) * joints, (np.eye(parameters),) * joints)
    return factorise(
        (
            EntryBlock(
                structure,
                block.Y.reshape(len(block.Y), math.prod(block.Y.shape[1:])).T,
                block.tau.T,
                None if block.keep is None else block.keep.T,
            )
            for block in blocks
        ),
        structure,
    )
