"""The section ``compare`` of a configuration: which smoothers and estimators are compared, and what is true."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from dynident.io.families import ESTIMATORS, SMOOTHERS
from dynident.io.fields import FEW, Name, Number, Section
from dynident.io.parts import PartReader

__all__ = ["CompareSettings"]


class CompareSettings(Section):
    """Parts to compare, each a kind or the settings of one; None: all that apply, with their default settings.

    ``truth`` are the true values of parameters by name, or the file that has them.
    """

    smoothers: Annotated[tuple[Annotated[Any, PartReader(SMOOTHERS, plain=True)], ...], FEW] | None = None
    estimators: Annotated[tuple[Annotated[Any, PartReader(ESTIMATORS, plain=True)], ...], FEW] | None = None
    truth: Mapping[Name, Number] | Name | None = None
