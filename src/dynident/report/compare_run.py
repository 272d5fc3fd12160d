"""A comparison with its report: what ``dynident.compare`` calls."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path

import numpy as np

from dynident.estimators import Estimator
from dynident.io.results import json_text
from dynident.jobs import Limits
from dynident.ranking import NUMBERS, REPORT, Ranking, run_comparison
from dynident.report.ranking import ranking_dict
from dynident.report.ranking_page import ranking_page
from dynident.smoothers import Smoother

__all__ = ["compare"]


def compare(
    config: str | Path,
    out: str | Path | None = None,
    *,
    smoothers: Sequence[str | Smoother] | None = None,
    estimators: Sequence[str | Estimator] | None = None,
    truth: str | Path | Mapping[str, float] | None = None,
    folds: int = 5,
    executor: Executor | None = None,
    limits: Limits | None = None,
    rerun: bool = False,
    rng: np.random.Generator | None = None,
    progress: Callable[[str], None] | None = None,
) -> Ranking:
    """Try smoothers with estimators on the same logs, and rank them by the torque error on motion that was held out.

    ``config`` is a configuration; its own recipe chooses once what is the same for all: terms, time offset, tilt of the
    base, and which samples are fitted. ``smoothers`` and ``estimators`` are parts or kinds ("consistent+robust" makes
    one that is linear in the parameters consistent with physics), by default those of the section ``compare``, else
    all; those of the configuration are always among them. Without a held-out log the ranking is by cross-validation in
    so many ``folds`` (0: none). ``truth`` are true values of parameters by name, or a file of them: YAML, a robot file,
    or a result.

    The combinations are spread over ``executor``; ``limits`` hold for each of them. What fails is a row, and the rest
    goes on; what needs something that the logs lack is listed as not applicable. In the folder ``out`` are kept
    ``report.html``, ``compare.json`` and the table ``compare.parquet``: rows that are in it are not computed again,
    unless ``rerun`` or they failed. ``rng`` draws blocks of time, by default the same ones each time, to tell
    differences from chance. ``progress`` is called with a few words before each step.

    Raises ConfigError, ModelError and InputError where the configuration cannot be used or no smoother works.

    >>> import numpy as np
    >>> import dynident as dy
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> t, rng = np.arange(1501) * 0.01, np.random.default_rng(0)
    >>> def recorded(w):  # 5 kg, 8 N s/m
    ...     x = np.sin(w * t) + 1e-4 * rng.standard_normal(len(t))
    ...     return np.column_stack([t, x, -5 * w**2 * np.sin(w * t) + 8 * w * np.cos(w * t)])
    >>> text = '''
    ... model: gallery:slider
    ... time: { column: t, unit: s }
    ... position: { slider: { column: x, unit: m } }
    ... torque: { slider: { column: f, unit: N } }
    ... train: [{ file: monday.csv }]
    ... validation: [{ file: tuesday.csv }]
    ... smoother: { kind: spline }
    ... '''
    >>> with TemporaryDirectory() as folder:
    ...     for day, w in (("monday", 3), ("tuesday", 4)):
    ...         file = Path(folder, f"{day}.csv")
    ...         np.savetxt(file, recorded(w), delimiter=",", header="t,x,f", comments="")
    ...     _ = Path(folder, "robot.yaml").write_text(text)
    ...     found = dy.compare(Path(folder, "robot.yaml"), smoothers=["difference"], estimators=["least_squares"])
    >>> for one in found.ranked:
    ...     print(one.combination.name, one.worse)
    spline (rule constraint) / least_squares False
    difference / least_squares True
    """
    return run_comparison(
        config,
        out,
        smoothers=smoothers,
        estimators=estimators,
        truth=truth,
        folds=folds,
        files=_files,
        executor=executor,
        limits=limits,
        rerun=rerun,
        rng=rng,
        progress=progress,
    )


def _files(found: Ranking) -> dict[str, str]:
    """Return the files that are written beside the table."""
    return {NUMBERS: json_text(ranking_dict(found)), REPORT: ranking_page(found)}
