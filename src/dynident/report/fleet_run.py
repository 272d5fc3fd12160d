"""A fleet with its reports: what ``dynident.fleet`` calls."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dynident.fleets.run import run_fleet
from dynident.jobs import Limits
from dynident.report.fleet import fleet_page
from dynident.report.run_files import run_files

if TYPE_CHECKING:
    from dynident.fleets import FleetResult

__all__ = ["fleet"]


def fleet(
    config: str | Path,
    out: str | Path | None = None,
    *,
    executor: Executor | None = None,
    limits: Limits | None = None,
    rerun: bool = False,
    rng: np.random.Generator | None = None,
    progress: Callable[[str], None] | None = None,
) -> FleetResult:
    """Identify all logs of a fleet that are not known yet, and return what is known of all: parameters over time, what
    has changed, and what robots of one type share.

    ``config`` is the configuration of the fleet (YAML). In the folder ``out`` are kept: ``report.html``; the table
    ``fleet.parquet``, with a row for each log; ``recipe.yaml``, in which all that can be chosen is chosen, so that all
    logs have the same parameters; and below ``runs`` a folder for each log with its own report. A log that is in the
    table, with its file and its recipe as they are now, is not identified again, unless ``rerun`` or it failed. What
    fails is a row, and the rest goes on. The logs are spread over ``executor``; ``limits`` hold for each of them.
    ``rng`` draws fleets in which nothing changes, by default the same ones each time. ``progress`` is called with a few
    words before each step.

    Raises ConfigError and ModelError where the configuration or its recipe cannot be used, InputError where no log can.

    >>> import numpy as np
    >>> import dynident as dy
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> t = np.arange(1001) * 0.01
    >>> recipe = '''
    ... model: gallery:slider
    ... time: { column: t, unit: s }
    ... position: { slider: { column: x, unit: m } }
    ... torque: { slider: { column: f, unit: N } }
    ... '''
    >>> with TemporaryDirectory() as folder:
    ...     for robot, mass in (("old", 5), ("new", 6)):
    ...         table = np.column_stack([t, np.sin(3 * t), -9 * mass * np.sin(3 * t) + 24 * np.cos(3 * t)])
    ...         file = Path(folder, f"{robot}_2026-11-22.csv")
    ...         np.savetxt(file, table, delimiter=",", header="t,x,f", comments="")
    ...     _ = Path(folder, "robot.yaml").write_text(recipe)
    ...     _ = Path(folder, "fleet.yaml").write_text("recipe: robot.yaml\\nlogs: '{robot}_{date}.csv'")
    ...     found = dy.fleet(Path(folder, "fleet.yaml"))
    >>> for history in found.histories:
    ...     print(history.robot, found.base.names[0], round(history.value[0, 0], 2))
    new M 6.0
    old M 5.0
    """
    return run_fleet(
        config,
        out,
        run_files=run_files,
        page=fleet_page,
        executor=executor,
        limits=limits,
        rerun=rerun,
        rng=rng,
        progress=progress,
    )
