"""One configuration's logs and model on a bench: any tuning of them smoothed, fitted and judged, what is known kept."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from dynident.checks import with_findings
from dynident.errors import ConfigError, choices, listed
from dynident.estimators import Estimator, Problem
from dynident.identification import Identification, Recipe, identify, mounted
from dynident.identification.load import with_load
from dynident.identification.role_logs import Motions, RoleLogs
from dynident.identification.smoother_choice import excerpts
from dynident.log import Log, Motion
from dynident.models import Model, unloaded
from dynident.regression import Regression, TriangularFactors, merged, one_thread
from dynident.smoothers import Smoother, Spline, TimeShifted, motion_of, unshifted
from dynident.splines import Constraint
from dynident.tuning.cache import Cache
from dynident.tuning.curve import DegreeCurve, degree_curve, rule_degrees
from dynident.tuning.factors import columns_in, digest, fold_factors, of_columns, opened, without
from dynident.tuning.offered import Offers
from dynident.tuning.quick_fit import QuickFit, quick_fit
from dynident.tuning.smoothed import Smoothed, smoothed
from dynident.tuning.start import estimators_of, noise_of, start_of
from dynident.tuning.switches import Switches
from dynident.tuning.tuning import Tuning

__all__ = ["Bench"]

Array = NDArray[np.float64]
Logs = Mapping[str, Mapping[str, Log]]
VALUES = 4e6  # samples times joints of all results that are kept together: about a gigabyte


@dataclass(frozen=True, eq=False)
class _Caches:
    """What is known of tunings: two tabs ask at once, and someone who goes back waits for nothing."""

    logs: Cache[RoleLogs]
    motions: Cache[Motions]
    joints: Cache[Motion]
    factors: Cache[tuple[TriangularFactors, ...]]
    fits: Cache[QuickFit]
    curves: Cache[DegreeCurve]
    marks: Cache[dict[str, tuple[float, ...]]]
    wholes: Cache[Identification]

    @classmethod
    def of(cls, values: int) -> _Caches:
        """Return empty ones for logs of so many values (samples times joints): of long logs less is kept."""
        most = int(np.clip(VALUES / max(values, 1), 2, 12))
        return cls(
            logs=Cache(most),
            motions=Cache(most),
            joints=Cache(5 * most),
            factors=Cache(16),
            fits=Cache(most),
            curves=Cache(64),
            marks=Cache(8),
            wholes=Cache(most),
        )


@dataclass(frozen=True, eq=False)
class Bench:
    """Logs, a model, and what a first identification found: everything that can be asked of a ``Tuning``.

    ``logs`` are by role ("train", "validation") and name, without exclusions; ``found`` is the first identification,
    ``start`` the tuning that it is of. All methods may be called from several threads at once, and keep their last
    results. They raise ConfigError, InputError and ModelError for a tuning that cannot be used.
    """

    switches: Switches
    logs: Logs
    found: Identification
    start: Tuning
    estimators_by_kind: Mapping[str, Estimator]
    multi_turn: frozenset[str] = frozenset()
    _known: _Caches = field(init=False, repr=False)

    def __post_init__(self) -> None:
        values = sum(log.q.size for some in self.logs.values() for log in some.values())
        object.__setattr__(self, "_known", _Caches.of(values))

    def __repr__(self) -> str:
        roles = "; ".join(f"{role} {listed(some, 3) or 'none'}" for role, some in self.logs.items())
        return f"<Bench of {self.switches.model.name!r}: {len(self.joints)} joints; {roles}>"

    @classmethod
    def of(
        cls,
        model: Model,
        logs: Logs,
        found: Identification,
        *,
        switchable: bool = True,
        multi_turn: frozenset[str] = frozenset(),
        estimator: str = "",
    ) -> Bench:
        """Return the bench of a model as a configuration builds it (terms that are chosen are not in it, its base is
        level), logs by role and name as they are read, and their identification.

        ``switchable`` says whether terms can be switched: those of a model that is built of a robot file can.
        ``multi_turn`` are joints that may make any number of turns; ``estimator`` is the kind of the estimator, by
        default the name of its class.
        """
        joints = tuple(joint.name for joint in model.joints)
        read = {role: {name: log.select(joints) for name, log in some.items()} for role, some in logs.items()}
        motions = [one.motion for one in found.validations if one.role == "train"]
        offers = Offers.of(found.model, found.estimate.value, motions) if switchable else None
        whole = replace(model, terms=(*model.terms, *found.model.terms[len(model.terms) :]))
        switches = Switches.of(whole, offers)
        kind, estimators = estimators_of(found.recipe.estimator, estimator)
        plain = {role: {name: log.including() for name, log in some.items()} for role, some in read.items()}
        return cls(switches, plain, found, start_of(found, switches.start, read, kind), estimators, multi_turn)

    @cached_property
    def joints(self) -> tuple[str, ...]:
        """Names of the n joints."""
        return tuple(joint.name for joint in self.switches.model.joints)

    @cached_property
    def log_names(self) -> tuple[str, ...]:
        """Names of all logs, those of the training first."""
        return tuple(name for some in self.logs.values() for name in some)

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds of terms that can be switched on a joint; none where the model is not built of a robot file."""
        return self.switches.kinds

    @property
    def estimators(self) -> tuple[str, ...]:
        """Kinds of estimators to choose from, the configured one first."""
        return tuple(self.estimators_by_kind)

    @property
    def smoother(self) -> Smoother:
        """The smoother as it was first used, without a time offset."""
        return unshifted(self.found.recipe.smoothers[0])

    @cached_property
    def has_degree(self) -> bool:
        """Whether the smoother is the spline with S in terms of n. Of another one ``start.degree`` is what it left of
        the positions; with any other degree this spline takes its place."""
        own = self.smoother
        return isinstance(own, Spline) and own.rule == Constraint()

    def check(self, tuning: Tuning) -> None:
        """Raise ConfigError where a tuning does not fit this bench."""
        tuning.check(self.joints, self.log_names, self.kinds, self.estimators)

    def model(self, tuning: Tuning) -> Model:
        """Return the model of a tuning, on a level base, as a configuration with its settings builds it."""
        return self.switches.with_terms(tuning.terms)

    def recipe(self, tuning: Tuning) -> Recipe:
        """Return the recipe of a tuning, with nothing left to choose."""
        speeds = {name: one for name, one in zip(self.joints, tuning.min_speed, strict=True) if one}
        alike = len(speeds) == len(self.joints) and len(set(speeds.values())) == 1
        return replace(
            self.found.recipe,
            smoother=self._spline(tuning.degree),
            estimator=self.estimators_by_kind[tuning.estimator],
            filter=tuning.filter,
            min_speed=tuning.min_speed[0] if alike else speeds or None,
            time_offset=tuning.time_offset,
            terms=None,
            proposed=(),
            unfitted=tuning.unfitted,
        )

    def smoothed(self, tuning: Tuning, log: str, joint: str) -> Smoothed:
        """Return a joint of a log as it is smoothed."""
        self.check(tuning)
        role = next((role for role, some in self.logs.items() if log in some), None)
        if role is None or joint not in self.joints:
            raise ConfigError(f"there is no log {log!r} with a joint {joint!r}.")
        logs, j = self._role_logs(tuning), self.joints.index(joint)
        repaired = logs.repaired[role][log]
        noise = float(self._noise(repaired)[j])

        def made() -> Motion:
            spline = replace(self._plain_spline, sigma=noise, factor=10.0 ** (tuning.degree[j] / 2.0))
            return motion_of(spline, repaired.select((joint,)))

        if self._is_tuned(tuning.degree):
            motion = self._known.joints((tuning.excluded, log, joint, tuning.degree[j]), made)
        else:
            motion = self._motions(tuning, 0.0)[role][log]
        return smoothed(logs.trimmed[role][log], repaired, motion, joint, noise)

    def fitted(self, tuning: Tuning) -> QuickFit:
        """Return the quick fit: what ``whole`` gives but for the bias by errors of the motion."""
        self.check(tuning)
        return self._known.fits(tuning, lambda: self._fitted(tuning))

    def curve(self, tuning: Tuning, joint: str | None = None) -> DegreeCurve:
        """Return the cross-validated error over the degree of smoothing of all joints, or of one alone."""
        self.check(tuning)
        if joint is not None and joint not in self.joints:
            raise ConfigError(f"there is no joint {joint!r}; {choices(joint, self.joints)}")
        at = tuning.with_degree(0.0, None if joint is None else self.joints.index(joint))  # it is moved anyway
        key = replace(at, estimator="", min_speed=(), filter=None)
        return self._known.curves((key, joint), lambda: self._curve(at, joint))

    def whole(self, tuning: Tuning, progress: Callable[[str], None] = lambda _: None) -> Identification:
        """Return the identification of a tuning, with the findings of the checks: of the ``start`` that which was
        ``found``, of another that which a configuration with these settings gives.

        ``progress`` is called with each step; what it raises ends the work.
        """
        self.check(tuning)
        if tuning == self.start:
            return self.found
        return self._known.wholes(tuning, lambda: self._whole(tuning, progress))

    def _whole(self, tuning: Tuning, progress: Callable[[str], None]) -> Identification:
        model, recipe, logs = self.model(tuning), self.recipe(tuning), self._role_logs(tuning).recorded
        found = identify(model, logs["train"], logs["validation"], recipe, progress=progress)
        return with_findings(found, model, logs, recipe, multi_turn=self.multi_turn, progress=progress)

    def _fitted(self, tuning: Tuning) -> QuickFit:
        begun = perf_counter()
        with one_thread():
            recipe, logs, whole = self.recipe(tuning), self._role_logs(tuning), self.model(tuning)
            early, speeds = unloaded(whole), recipe.min_speeds(self.joints)
            motions, _ = logs.kept(early, self._motions(tuning, tuning.time_offset), recipe)
            fitted = tuple(motions["train"].values())
            model = self._mounted(early)
            model = with_load(whole, model, fitted, recipe.estimator, recipe.filter, speeds)
            folds = self._folds(tuning, model, motions, logs)
            factors = merged(folds)
            fitted = tuple(map(model.remembering, fitted))
            regression = Regression(model, fitted, recipe.filter, speeds).with_factors(factors)
            problem = Problem(model, fitted, regression, logs.fitted(motions), tuning.time_offset)
            found = quick_fit(problem, recipe.estimator, folds, factors, motions)
        return replace(found, seconds=perf_counter() - begun)

    def _folds(self, tuning: Tuning, model: Model, motions: Motions, logs: RoleLogs) -> tuple[TriangularFactors, ...]:
        """Return the factors of a model in folds: some columns of those of all terms, where it remembers nothing."""
        superset = self._mounted(self.switches.superset)
        columns = None if model.memory else columns_in(superset, model)
        wide = model if columns is None else superset
        speeds = tuning.min_speed if any(tuning.min_speed) else None
        fitted = tuple(opened(motion, tuning.unfitted) for motion in motions["train"].values())
        train = tuple(logs.repaired["train"].values())
        key = (tuning.excluded, tuning.degree, tuning.time_offset, speeds, tuning.filter, digest(fitted, train))
        own = None if columns is not None else (tuning.terms, model.load)

        def made() -> tuple[TriangularFactors, ...]:
            return fold_factors(Regression(wide, tuple(map(wide.remembering, fitted)), tuning.filter, speeds))

        found = self._known.factors((key, own), made)
        found = without(found, [self.joints.index(name) for name in tuning.unfitted])
        return found if columns is None else of_columns(found, columns)

    def _curve(self, tuning: Tuning, joint: str | None) -> DegreeCurve:
        with one_thread():
            logs = excerpts(list(self._role_logs(tuning).repaired["train"].values()))
            model = self._mounted(unloaded(self.model(tuning)))
            ends = self._plain_spline.ends

            def marks() -> dict[str, tuple[float, ...]]:
                return rule_degrees(logs, [self._noise(log) for log in logs], ends)

            def spline(degree: tuple[float, ...]) -> Smoother:
                return _shifted(self._tuned_spline(degree), tuning.time_offset)

            known = self._known.marks((tuning.excluded, tuning.unfitted), marks)
            return degree_curve(
                model, logs, spline, tuning.degree, None if joint is None else self.joints.index(joint), known
            )

    def _mounted(self, model: Model) -> Model:
        """Return a model on its base as it was found to be tilted."""
        tilt = self.found.recipe.base_tilt
        return mounted(model, *tilt) if isinstance(tilt, tuple) else model

    def _role_logs(self, tuning: Tuning) -> RoleLogs:
        """Return the logs by role, without what is excluded."""

        def made() -> RoleLogs:
            roles = {
                role: {name: log.excluding(tuning.windows(name)) for name, log in some.items()}
                for role, some in self.logs.items()
            }
            recipe = replace(self.found.recipe, unfitted=tuning.unfitted)
            return RoleLogs.of(roles["train"], roles["validation"], recipe, self.joints)

        return self._known.logs((tuning.excluded, tuning.unfitted), made)

    def _motions(self, tuning: Tuning, time_offset: float) -> Motions:
        key = (tuning.excluded, tuning.unfitted, tuning.degree, time_offset)
        smoother = _shifted(self._spline(tuning.degree), time_offset)
        return self._known.motions(key, lambda: self._role_logs(tuning).smoothed(smoother))

    def _spline(self, degree: tuple[float, ...]) -> Smoother:
        """Return the smoother of these degrees: the configured one at the start."""
        return self._tuned_spline(degree) if self._is_tuned(degree) else self.smoother

    def _is_tuned(self, degree: tuple[float, ...]) -> bool:
        """Whether the spline of these degrees smooths, and not another smoother that is configured."""
        return self.has_degree or degree != self.start.degree

    def _tuned_spline(self, degree: tuple[float, ...]) -> Spline:
        factors = [10.0 ** (one / 2.0) for one in degree]
        alike = len(set(factors)) == 1
        return replace(self._plain_spline, factor=factors[0] if alike else dict(zip(self.joints, factors, strict=True)))

    @cached_property
    def _plain_spline(self) -> Spline:
        own = self.smoother
        return Spline(Constraint(), own.sigma, own.ends) if isinstance(own, Spline) else Spline()

    def _noise(self, log: Log) -> Array:
        return noise_of(self._plain_spline, log)


def _shifted(smoother: Smoother, time_offset: float) -> Smoother:
    return TimeShifted(smoother, time_offset) if time_offset else smoother
