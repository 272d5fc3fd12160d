"""The result of an identification: parameters, standard errors, base parameters, validations and sources."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, overload

import numpy as np
from numpy.typing import ArrayLike

from dynident._version import __version__, package_version
from dynident.estimators import Estimate, Provenance
from dynident.identification.calibration import Calibration
from dynident.identification.recipe import Recipe
from dynident.models import MassMatrixCheck, Model, motion_memory
from dynident.motion.log import Log, Motion
from dynident.regression import BaseParameters, UnexcitedParameters
from dynident.runtime import OMITTED, Axes, Finding, InputError, KeepsFacts, Messages, Note, Noun, brief, choices
from dynident.runtime.arrays import Array
from dynident.runtime.families import action
from dynident.runtime.kernel import kernel
from dynident.validation import SEED, FreeRun, LogValidation, validate

if TYPE_CHECKING:
    import polars as pl

    from dynident.identification.verdict import Verdict
    from dynident.report.terminal import Plot


class StandardErrors(Noun):
    """Standard errors of the parameters, ``std`` (p), and of the base parameters on the data, ``base_std`` (r).

    They allow for correlated residuals, for the noise left in the motion and for the error of a time offset:
    intervals of 1.96 of them hold 95 %. ``std_independent`` (p) and ``base_std_independent`` (r) hold for
    independent residuals alone; where no others can be had, ``std`` is the same. Of the base parameters None
    where the data determine all parameters.

    ``base_covariance`` (r, r) is that of the base parameters, for correlated residuals too. ``base_by_joint`` (r,
    n) is the contribution of the torque of each joint to their values by least squares, and with it the effect of
    an error of its gain; ``base_shares`` (n) are the shares of its torque in their errors, with sum one.
    ``base_by_load`` (r, n) is what friction of each joint as large as its load, the torque of the bodies, would
    add to them. Where all p parameters are determined, these are of the parameters. None in results of older
    versions; the last one also for logs in pieces.
    """

    std: Annotated[Array, OMITTED]
    std_independent: Annotated[Array, OMITTED]
    base_std: Annotated[Array | None, OMITTED] = None
    base_std_independent: Annotated[Array | None, OMITTED] = None
    base_covariance: Annotated[Array, Axes("r", "r")] | None = None
    base_by_joint: Annotated[Array, Axes("r", "n")] | None = None
    base_shares: Annotated[Array, Axes("n")] | None = None
    base_by_load: Annotated[Array, Axes("r", "n")] | None = None

    @property
    def allows_correlation(self) -> bool:
        """Whether the standard errors are more than those for independent residuals."""
        if self.base_std is not None and self.base_std_independent is not None:
            return not np.array_equal(self.base_std, self.base_std_independent)
        return not np.array_equal(self.std, self.std_independent)


class Identifiability(Noun):
    """Which base parameters there are; all empty where the data determine every parameter.

    ``on_data`` are those that the training data show, ``structural`` those that any motion could show,
    ``unexcited`` the others, with the motion that would show them.
    """

    on_data: BaseParameters | None = None
    structural: BaseParameters | None = None
    unexcited: tuple[UnexcitedParameters, ...] = ()


@dataclass(frozen=True)
class SourceFile:
    """A file that was read: its ``path``, its SHA-256 in hexadecimal digits, the ``text`` of a configuration or robot
    file, and of a recording when it was last ``modified`` (ISO 8601, UTC; "" where that is not known)."""

    path: str
    sha256: str = ""
    text: str = ""
    modified: str = ""

    __repr__ = brief


@dataclass(frozen=True)
class Sources:
    """What a result was made from: the files, those of a run from Python without the first two, and versions.

    ``seed`` is that of the random poses in which the mass matrix is looked at. ``identified`` is when (ISO 8601, UTC).
    """

    configuration: SourceFile | None = None
    model: SourceFile | None = None
    logs: tuple[SourceFile, ...] = ()
    versions: Mapping[str, str] = field(default_factory=dict)
    seed: int = SEED
    identified: str = ""

    __repr__ = brief


class IdentifiedParameter(NamedTuple):
    """A parameter of a result: ``value``, standard errors (of ``StandardErrors``), and what determined the value."""

    name: str
    value: float
    std: float
    std_independent: float
    unit: str
    determined_by: Provenance | None


class ParametersByName(dict[str, IdentifiedParameter]):
    """The parameters of a result by name."""

    def __missing__(self, name: str) -> IdentifiedParameter:
        raise InputError(f"there is no parameter {name!r}; {choices(name, self)}")


@dataclass(frozen=True, eq=False)
class Identification(KeepsFacts):
    """Everything that one run found: what reports and exports read.

    ``model`` and ``recipe`` are as used: the model on its base as it is tilted, one smoother, numbers where something
    was sought, so that ``recipe.motion`` makes of a new log what the fit has seen. ``mass`` is the mass matrix over all
    logs and random poses. ``warnings`` are notes, and the findings of the checks, where these were run
    beside the fit; printed, each is a line.
    """

    model: Model
    recipe: Recipe
    estimate: Estimate
    errors: StandardErrors
    base: Identifiability
    validations: tuple[LogValidation, ...]
    mass: MassMatrixCheck | None = None
    calibration: Calibration = field(default_factory=Calibration)
    provenance: Sources = Sources()
    warnings: tuple[Note | Finding, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "warnings", Messages(self.warnings))

    def __repr__(self) -> str:
        return str(action("summary")(self))

    def _repr_html_(self) -> str:
        return str(action("summary_html")(self))

    @property
    def plot(self) -> Plot:
        """The figures of the report, one by one: ``plot.torque("tuesday", "elbow")``, ``plot.parameters()``, ..."""
        plot: Plot = action("plot")(self)
        return plot

    @property
    def verdict(self) -> Verdict | None:
        """What the model is good for, and why not for more; None of a result that was saved without."""
        verdict: Verdict | None = action("verdict")(self)
        return verdict

    @cached_property
    def parameters(self) -> Mapping[str, IdentifiedParameter]:
        """The parameters by name: ``parameters["Fc_elbow"].value``, ``.std``, ``.unit``; InputError for other names."""
        determined_by = self.estimate.provenance or (None,) * len(self.model.parameters)
        columns = (self.estimate.value.tolist(), self.errors.std.tolist(), self.errors.std_independent.tolist())
        rows = zip(self.estimate.names, *columns, self.estimate.units, determined_by, strict=True)
        return ParametersByName({row[0]: IdentifiedParameter(*row) for row in rows})

    def frame(self) -> pl.DataFrame:
        """Return a table, one row per parameter: parameter, value, std, std_independent (of ``StandardErrors``),
        unit, determined_by, and the value that the model knows, true or nominal; null where nothing is known.
        """
        import polars as pl

        schema = {"name": pl.String, **dict.fromkeys(("value", "std", "std_independent"), pl.Float64)}
        schema |= dict.fromkeys(("unit", "determined_by"), pl.String)
        known_values = pl.Series("known", [parameter.value for parameter in self.model.parameters], pl.Float64)
        rows = pl.DataFrame(list(self.parameters.values()), schema, orient="row")
        return rows.rename({"name": "parameter"}).with_columns(known_values)

    @property
    def findings(self) -> Messages[Finding]:
        """The findings of the checks among the warnings: errors, warnings and advice."""
        return Messages(warning for warning in self.warnings if isinstance(warning, Finding))

    @property
    def notes(self) -> Messages[Note]:
        """The notes among the warnings."""
        return Messages(warning for warning in self.warnings if isinstance(warning, Note))

    def of_role(self, role: str) -> tuple[LogValidation, ...]:
        """Return the logs of the training, or the held-out ones."""
        return tuple(validation for validation in self.validations if validation.role == role)

    @property
    def training_motions(self) -> tuple[Motion, ...]:
        """The motions that were fitted."""
        return tuple(validation.motion for validation in self.of_role("train"))

    @property
    def runs(self) -> tuple[FreeRun, ...]:
        """The free simulations."""
        return tuple(validation.free_run for validation in self.validations if validation.free_run is not None)

    @overload
    def predict(self, log: Log, /) -> LogValidation: ...

    @overload
    def predict(self, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike, t: ArrayLike | None = None, /) -> Array: ...

    def predict(self, log: Any, /, *states: Any) -> LogValidation | Array:
        """Return the torque of a log by the model, beside the measured one; or the torque (N, n) of arrays q, dq, ddq.

        A model with terms that depend on the motion before (``Dahl``, friction by the load) also needs the times t (N)
        of these samples. Raises InputError where there is no log, ModelError for arrays that do not fit the model, and
        the errors of the smoother.
        """
        if len(states) >= 2:
            dq, ddq, *times = states
            memory = motion_memory(self.model, *map(np.asarray, (times[0], log, dq, ddq))) if times else None
            return self.model.torque(log, dq, ddq, self.estimate.value, memory)
        if not isinstance(log, Log):
            raise InputError(f"predict: a {type(log).__name__} is given; give q, dq, ddq, or a Log, as of `read_log`.")
        joints = tuple(joint.name for joint in self.model.joints)
        return validate(self.model, self.estimate.value, self.recipe.motion(log.select(joints)))

    def save(self, path: str | Path) -> Path:
        """Write all but the signals as JSON, which ``dynident.project.saved.load`` reads again; return the path.

        The file never is half written. Raises InputError where it cannot be written, ConfigError where a part has
        settings without a plain form.
        """
        saved_path: Path = action("save")(self, path)
        return saved_path


def versions() -> dict[str, str]:
    """Return the versions of what computes the numbers, which way the kernel takes, and the platform.

    Raises ConfigError, as ``dynident.runtime.kernel.kernel``.
    """
    computing = {"dynident": __version__, "kernel": str(kernel()), "python": platform.python_version()}
    packages = {name: package_version(name) for name in ("numpy", "scipy", "clarabel", "polars")}
    return {**computing, **packages, "platform": platform.platform()}
