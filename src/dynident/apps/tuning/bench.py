"""A bench for the logs and the model of one configuration: smooths, fits and validates any tuning, with caches."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from dynident.apps.tuning.curve import DegreeCurve, SmoothedJoint, degree_curve, rule_degrees, smoothed_joint
from dynident.apps.tuning.quick_fit import QuickFit, fold_factors, quick_fit
from dynident.apps.tuning.switches import Offers, Switches, estimators_of, noise_of, start_of
from dynident.apps.tuning.tuning import Tuning
from dynident.checks import with_findings
from dynident.estimators import Estimator, Problem
from dynident.identification import Identification, Recipe, cut_excerpts, identify, tilt_base
from dynident.identification.calibration import with_load
from dynident.identification.dataset import Dataset, Motions
from dynident.models import Model, drop_load_dependence
from dynident.motion.log import Log, Motion
from dynident.motion.smoothers import Smoother, Spline, TimeShifted, smooth_log, strip_time_offset
from dynident.motion.splines import Constraint
from dynident.regression import Regression, merge_factors, one_thread
from dynident.runtime import ConfigError, choices, join_names
from dynident.runtime.arrays import Array
from dynident.runtime.cache import Cache

Logs = Mapping[str, Mapping[str, Log]]
Columns = tuple[Array, Mapping[str, Array]]  # stamps (N, s), and columns (N) by name
T = TypeVar("T")
MAX_CACHED_VALUES = 4e6  # samples times joints of all results that are kept together: about a gigabyte


@dataclass(frozen=True, eq=False)
class Bench:
    """Logs, a model and a first identification: everything that can be asked of a ``Tuning``.

    ``logs`` are by role ("train", "validation") and name, without exclusions; ``identification`` is the first one, and
    ``start`` its tuning; ``multi_turn`` are joints that may make any number of turns; ``read_others`` reads the columns
    of a log's recording that are not used. All methods may be called from
    several threads at once, and keep their last results. They raise ConfigError, InputError and ModelError for a
    tuning that cannot be used.
    """

    switches: Switches
    logs: Logs
    identification: Identification
    start: Tuning
    estimators_by_kind: Mapping[str, Estimator]
    multi_turn: frozenset[str] = frozenset()
    read_others: Callable[[str], Columns] = lambda _: (np.zeros(0), {})
    _caches: Mapping[str, Cache[Any]] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        # results are kept by tuning: two tabs ask at once, and someone who goes back waits for nothing
        values = sum(log.q.size for by_name in self.logs.values() for log in by_name.values())
        size = int(np.clip(MAX_CACHED_VALUES / max(values, 1), 2, 12))  # of long logs less is kept
        sizes = dict.fromkeys(("log", "motion", "fit", "identification"), size)
        sizes |= {"joint": 5 * size, "curve": 64, "mark": 8, "columns": 2}
        object.__setattr__(self, "_caches", {name: Cache(count) for name, count in sizes.items()})

    def _keep(self, cache: str, key: Hashable, compute: Callable[[], T]) -> T:
        """Return a result that is kept, else computed."""
        value: T = self._caches[cache](key, compute)
        return value

    def __repr__(self) -> str:
        roles = "; ".join(f"{role} {join_names(by_name, 3) or 'none'}" for role, by_name in self.logs.items())
        return f"<Bench of {self.switches.model.name!r}: {len(self.joints)} joints; {roles}>"

    @classmethod
    def of(
        cls, model: Model, logs: Logs, identification: Identification, *, switchable: bool = True, estimator: str = ""
    ) -> Bench:
        """Return the bench of a model as a configuration builds it (terms that are chosen are not in it, its base is
        level), logs by role and name as they are read, and their identification.

        ``switchable`` says whether terms can be switched: those of a model that is built of a robot file can.
        ``estimator`` is the kind of the estimator, by default the name of its class.
        """
        joints = tuple(joint.name for joint in model.joints)
        read_logs = _map_logs(logs, lambda _, log: log.select(joints))
        motions = [validation.motion for validation in identification.validations if validation.role == "train"]
        offers = Offers.of(identification.model, identification.estimate.value, motions) if switchable else None
        # Chosen terms are at the end of the identified model; the configured model lacks them.
        full_model = replace(model, terms=(*model.terms, *identification.model.terms[len(model.terms) :]))
        switches = Switches.of(full_model, offers)
        kind, estimators = estimators_of(identification.recipe.estimator, estimator)
        full_logs = _map_logs(read_logs, lambda _, log: log.include_all())
        start = start_of(identification, switches.start, read_logs, kind)
        return cls(switches, full_logs, identification, start, estimators)

    @cached_property
    def joints(self) -> tuple[str, ...]:
        """Names of the n joints."""
        return tuple(joint.name for joint in self.switches.model.joints)

    @cached_property
    def log_names(self) -> tuple[str, ...]:
        """Names of all logs, those of the training first."""
        return tuple(name for by_name in self.logs.values() for name in by_name)

    @property
    def estimators(self) -> tuple[str, ...]:
        """Kinds of estimators to choose from, the configured one first."""
        return tuple(self.estimators_by_kind)

    @property
    def smoother(self) -> Smoother:
        """The smoother as it was first used, without a time offset."""
        return strip_time_offset(self.identification.recipe.smoothers[0])

    @cached_property
    def has_degree(self) -> bool:
        """Whether the smoother is the spline with S in terms of n.

        Of another smoother ``start.degree`` is what it left of the positions; with any other degree this spline takes
        its place.
        """
        smoother = self.smoother
        return isinstance(smoother, Spline) and smoother.rule == Constraint()

    def check(self, tuning: Tuning) -> None:
        """Raise ConfigError where a tuning does not fit this bench."""
        tuning.check(self.joints, self.log_names, self.switches.kinds, self.estimators)

    def model(self, tuning: Tuning) -> Model:
        """Return the model of a tuning, on a level base, as a configuration with its settings builds it."""
        return self.switches.with_terms(tuning.terms)

    def recipe(self, tuning: Tuning) -> Recipe:
        """Return the recipe of a tuning, with nothing left to choose."""
        speeds = {name: speed for name, speed in zip(self.joints, tuning.min_speed, strict=True) if speed}
        alike = len(speeds) == len(self.joints) and len(set(speeds.values())) == 1
        return replace(
            self.identification.recipe,
            smoother=self._spline(tuning.degree),
            estimator=self.estimators_by_kind[tuning.estimator],
            filter=tuning.filter,
            min_speed=tuning.min_speed[0] if alike else speeds or None,
            time_offset=tuning.time_offset,
            terms=None,
            proposed=(),
            unfitted=tuning.unfitted,
        )

    def smooth(self, tuning: Tuning, log: str, joint: str) -> SmoothedJoint:
        """Return a joint of a log as the tuning smooths it."""
        self.check(tuning)
        role = next((role for role, by_name in self.logs.items() if log in by_name), None)
        if role is None or joint not in self.joints:
            raise ConfigError(f"there is no log {log!r} with a joint {joint!r}.")
        logs, j = self._role_logs(tuning), self.joints.index(joint)
        repaired = logs.repaired[role][log]
        noise = float(noise_of(self._plain_spline, repaired)[j])

        def make_motion() -> Motion:
            spline = replace(self._plain_spline, sigma=noise, factor=10.0 ** (tuning.degree[j] / 2.0))
            return smooth_log(spline, repaired.select((joint,)))

        if self._is_tuned(tuning.degree):
            motion = self._keep("joint", (tuning.excluded, log, joint, tuning.degree[j]), make_motion)
        else:
            motion = self._motions(tuning, 0.0)[role][log]
        return smoothed_joint(logs.trimmed[role][log], repaired, motion, joint, noise)

    def other_columns(self, log: str) -> tuple[str, ...]:
        """Return the names of the columns of a log's recording that are not used."""
        return tuple(self._keep("columns", log, lambda: self.read_others(log))[1])

    def other_column(self, log: str, name: str, t: Array) -> Array:
        """Return such a column at times t (N, s) of the log; ConfigError where there is none of that name."""
        stamps, columns = self._keep("columns", log, lambda: self.read_others(log))
        if name not in columns:
            raise ConfigError(f"{log}: there is no other column {name!r}; {choices(name, list(columns))}")
        return np.interp(t, stamps, columns[name])

    def fit(self, tuning: Tuning) -> QuickFit:
        """Return the quick fit: that of ``identify`` without the correction of the bias by errors of the motion."""
        self.check(tuning)
        return self._keep("fit", tuning, lambda: self._fit(tuning))

    def curve(self, tuning: Tuning, joint: str | None = None) -> DegreeCurve:
        """Return the cross-validated error over the degree of smoothing of all joints, or of one alone."""
        self.check(tuning)
        if joint is not None and joint not in self.joints:
            raise ConfigError(f"there is no joint {joint!r}; {choices(joint, self.joints)}")
        # The degree that the curve is over is not part of the key.
        at = tuning.with_degree(0.0, None if joint is None else self.joints.index(joint))  # it is moved anyway
        key = replace(at, estimator="", min_speed=(), filter=None)
        return self._keep("curve", (key, joint), lambda: self._curve(at, joint))

    def identify(self, tuning: Tuning) -> Identification:
        """Return the identification of a tuning, with the findings of the checks.

        For the ``start`` it is the first identification, for another tuning that of a configuration with these
        settings.
        """
        self.check(tuning)
        if tuning == self.start:
            return self.identification
        return self._keep("identification", tuning, lambda: self._identify(tuning))

    def _identify(self, tuning: Tuning) -> Identification:
        model, recipe, logs = self.model(tuning), self.recipe(tuning), self._role_logs(tuning).recorded
        identification = identify(model, logs["train"], logs["validation"], recipe)
        return with_findings(identification, model, logs, recipe, multi_turn=self.multi_turn)

    def _fit(self, tuning: Tuning) -> QuickFit:
        with one_thread():
            recipe, logs, full_model = self.recipe(tuning), self._role_logs(tuning), self.model(tuning)
            preliminary_model, selection = drop_load_dependence(full_model), recipe.selection(full_model.joints)
            motions = logs.prepare_motions(preliminary_model, self._motions(tuning, tuning.time_offset), recipe)
            tilted_model = self._tilt_base(preliminary_model)
            model = with_load(full_model, tilted_model, motions.train, recipe.estimator, selection)
            train_motions = tuple(map(model.remembering, motions.train))
            regression = Regression(model, train_motions, selection)
            folds = fold_factors(regression)
            regression = regression.with_factors(merge_factors(folds))
            problem = Problem(model, train_motions, regression, logs.fitted_logs(motions), tuning.time_offset)
            return quick_fit(problem, recipe.estimator, folds, motions.by_role)

    def _curve(self, tuning: Tuning, joint: str | None) -> DegreeCurve:
        with one_thread():
            logs = cut_excerpts(list(self._role_logs(tuning).repaired["train"].values()))
            model = self._tilt_base(drop_load_dependence(self.model(tuning)))
            plain = self._plain_spline

            def marks() -> dict[str, tuple[float, ...]]:
                return rule_degrees(logs, [noise_of(plain, log) for log in logs], plain.ends)

            def spline(degree: tuple[float, ...]) -> Smoother:
                return _with_time_offset(self._tuned_spline(degree), tuning.time_offset)

            rule_marks = self._keep("mark", (tuning.excluded, tuning.unfitted), marks)
            j = None if joint is None else self.joints.index(joint)
            torque_curve = degree_curve(model, logs, spline, tuning.degree, j)
            return replace(torque_curve, marks={**rule_marks, **torque_curve.marks})

    def _tilt_base(self, model: Model) -> Model:
        """Return a model on the base tilt of the first identification."""
        tilt = self.identification.recipe.base_tilt
        return tilt_base(model, *tilt) if isinstance(tilt, tuple) else model

    def _role_logs(self, tuning: Tuning) -> Dataset:
        """Return the logs by role, without the excluded windows."""

        def make_logs() -> Dataset:
            roles = _map_logs(self.logs, lambda name, log: log.exclude(tuning.windows(name)))
            recipe = replace(self.identification.recipe, unfitted=tuning.unfitted)
            return Dataset.of(roles["train"], roles["validation"], recipe, self.joints)

        return self._keep("log", (tuning.excluded, tuning.unfitted), make_logs)

    def _motions(self, tuning: Tuning, time_offset: float) -> Motions:
        key = (tuning.excluded, tuning.unfitted, tuning.degree, time_offset)
        smoother = _with_time_offset(self._spline(tuning.degree), time_offset)
        return self._keep("motion", key, lambda: self._role_logs(tuning).smooth(smoother))

    def _spline(self, degree: tuple[float, ...]) -> Smoother:
        """Return the smoother with these degrees: the configured one at the start."""
        return self._tuned_spline(degree) if self._is_tuned(degree) else self.smoother

    def _is_tuned(self, degree: tuple[float, ...]) -> bool:
        """Return whether a spline with these degrees smooths, and not another smoother that is configured."""
        return self.has_degree or degree != self.start.degree

    def _tuned_spline(self, degree: tuple[float, ...]) -> Spline:
        factors = [10.0 ** (joint_degree / 2.0) for joint_degree in degree]
        alike = len(set(factors)) == 1
        return replace(self._plain_spline, factor=factors[0] if alike else dict(zip(self.joints, factors, strict=True)))

    @cached_property
    def _plain_spline(self) -> Spline:
        smoother = self.smoother
        return Spline(Constraint(), smoother.sigma, smoother.ends) if isinstance(smoother, Spline) else Spline()


def _map_logs(logs: Logs, change: Callable[[str, Log], Log]) -> dict[str, dict[str, Log]]:
    """Return logs by role and name, each changed."""
    return {role: {name: change(name, log) for name, log in by_name.items()} for role, by_name in logs.items()}


def _with_time_offset(smoother: Smoother, time_offset: float) -> Smoother:
    return TimeShifted(smoother, time_offset) if time_offset else smoother
