"""What every worker of the article's study needs, made once in the process that all of them are forked from.

``local_workers`` imports it where it is named in ``preload``.
"""

from __future__ import annotations

import numpy as np

from dynident.studies.article import arm_to_identify

__all__: list[str] = []

arm_to_identify().regressor(*np.zeros((3, 1, 2)))  # SymPy finds its functions and compiles them
