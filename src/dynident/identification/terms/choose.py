"""The choice of the terms of all joints, repeated with the load that follows from the terms chosen before."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from dynident.identification.recipe import held_joints
from dynident.identification.terms.candidates import (
    KINDS,
    PLAIN_KINDS,
    CandidateKind,
    JointExcitation,
    TermChoice,
    TermGroup,
    TermTrial,
    TooFewSamplesError,
    combine_terms,
    fixed_terms,
)
from dynident.identification.terms.grams import (
    CandidateGrams,
    Folds,
    JointGrams,
    Normal,
    Prior,
    SearchFolds,
    add_ridge,
    gain_share,
    normal_matrices,
    other_joint_normals,
    prior_of,
    try_groups,
)
from dynident.identification.terms.motors import MotorEquations, coupled_motors, motor_search
from dynident.identification.terms.ripples import ripple_kinds
from dynident.identification.terms.samples import (
    N_CLASSES,
    JointEquations,
    TermSamples,
    columns_of,
    correlation_length,
    select_samples,
)
from dynident.identification.terms.search import MIN_STRICT_GAIN_ERRORS, JointSearch, TermEntry, renumber_columns
from dynident.models import CoupledMotor, Model, Term
from dynident.models.friction import Dahl, LoadDahl
from dynident.motion.log import Motion
from dynident.regression import EVERYTHING, Selection
from dynident.runtime import Step, report_progress
from dynident.runtime.arrays import Array

PASSES, MAX_RIPPLES = 3, 3  # of the search, by the load of the terms found before; rates of one joint
TRIAL_SPEEDS = (0.01, 0.02, 0.03, 0.05, 0.1, 0.2)  # of the rms speed, tried as minimum speed
# of the largest rms speed: a joint that is slower keeps the plain set, of which it shows nothing
MAX_STILL_SHARE = 1e-4
# rad, m: range of a joint that never moves; rad/s, m/s: of an arm at rest
MIN_REACH, MIN_ARM_SPEED = 1e-9, 1e-6
MIN_BLOCK_SAMPLES = 50  # samples in a block


def choose_terms(
    model: Model,
    motions: Sequence[Motion],
    selection: Selection = EVERYTHING,
    *,
    kinds: Sequence[CandidateKind] = KINDS,
) -> TermChoice:
    """Choose the terms to be added to a ``model`` of bodies, joint by joint, by what they predict of the motions.

    Forward selection among ``kinds``, by blocked cross-validation: the blocks are contiguous in time, with gaps
    of the residual's correlation length between them. A kind enters where it removes at least 1 % of the squared
    error of its joint, and more than ``MIN_GAIN_ERRORS`` of its standard errors over the blocks, a strict one
    ``MIN_STRICT_GAIN_ERRORS``, fewer where most other joints have it, too (``MIN_POOL``); where it does not fail on
    the fast samples with its coefficients from the slow ones, or on another recording; and where no coefficient is
    negative that must not be. Offset and rotor inertia always stay, viscous and Coulomb friction unless they have
    demonstrably no effect; Coulomb friction also where a joint moves one way only, if no other dry friction entered.

    ``min_speed`` (n), where not given, is chosen by the same folds; which signs are sharp, by ``JointSearch.sharpen``.

    Raises TooFewSamplesError where there are too few samples, and the errors of the terms.
    """
    return _TermSelection.of(model, motions, selection, kinds).select_terms()


@dataclass(eq=False, repr=False)
class _TermSelection:
    """The state of the choice of terms."""

    samples: TermSamples
    rows: tuple[JointEquations, ...]
    prior: Prior
    excitations: tuple[JointExcitation, ...]
    kinds: Sequence[CandidateKind]
    division: SearchFolds
    weights: Array  # (n) of the rows: one over the squared deviation of the residual
    block: NDArray[np.intp]  # (N), -1 in the gaps
    theta: Array  # (p) of the model given
    # found at each joint, and friction of motors coupled to it
    ripples: list[list[CandidateKind]]
    trials: list[dict[str, TermTrial]]  # of these
    independent: float = 1.0  # samples per independent one
    shares: dict[int, dict[str, float]] = field(default_factory=dict)  # of the other joints that have a kind
    _cached_columns: dict[tuple[int, Term], Array] = field(default_factory=dict)

    @classmethod
    def of(
        cls, model: Model, motions: Sequence[Motion], selection: Selection, kinds: Sequence[CandidateKind]
    ) -> _TermSelection:
        """Return the state before the first search, with the plain set fitted."""
        samples = select_samples(model, motions, selection)
        if len(samples) < MIN_BLOCK_SAMPLES * samples.blocks:
            raise TooFewSamplesError(
                f"{', '.join(motion.source for motion in motions)}: {len(samples)} usable samples are too few to "
                "choose the terms by; record longer, or name the terms."
            )
        prior = prior_of(model.parameters)
        rows = tuple(JointEquations.of(samples, j, prior.mean) for j in range(len(model.joints)))
        scale = np.array([np.mean(np.square(equations.tau)) for equations in rows])
        weights = 1.0 / np.where(scale > 0, scale, 1.0)
        reach, speed = np.ptp(samples.states["q"], axis=0), np.sqrt(np.mean(samples.states["dq"] ** 2, axis=0))
        duration = max(float(np.ptp(motion.t)) for motion in samples.motions)
        excitations = tuple(
            JointExcitation(model.joints, joint, max(float(v), 1e-9), max(float(r), MIN_REACH), duration)
            for joint, v, r in zip(model.joints, speed, reach, strict=True)
        )
        division, trials = SearchFolds.of(samples.of_block), [dict[str, TermTrial]() for _ in rows]
        ripples = [list[CandidateKind]() for _ in rows]
        search = cls(
            samples, rows, prior, excitations, kinds, division, weights, samples.block, prior.mean, ripples, trials
        )
        search._fit_plain_set()
        return search

    def _fit_plain_set(self) -> None:
        """Fit the plain set for the weights, the correlation length of the residual and the first load."""
        kinds, loads = [kind for kind in KINDS if kind.name in PLAIN_KINDS], self.samples.loads(None)
        plain = [
            np.concatenate([columns_of(self.samples, kind.sizes(excitation)[0], j, loads) for kind in kinds])
            for j, excitation in enumerate(self.excitations)
        ]
        # Twice: the correlation length needs weights, and the prior needs the number of independent samples.
        for _ in range(2):
            residuals = self._refit(plain)
            lengths = [correlation_length(residual, len(residual) // self.samples.blocks) for residual in residuals]
            self.independent = float(np.median(lengths))
        inside = self.samples.is_inside(2 * int(self.independent))
        # Gaps between blocks as wide as the residual correlates, so that a fold does not predict its own noise.
        self.block = np.where(inside, self.samples.block, -1)

    def _refit(self, used_columns: Sequence[Array]) -> list[Array]:
        """Fit all joints with their columns (m, N); set theta and weights, and return the residuals (N)."""
        no_labels = np.zeros(len(self.samples), dtype=np.intp)
        # Eliminate the columns of each joint, then solve for the parameters that all joints share.
        grams = [rows.grams([C], no_labels, no_labels, (1, 1)) for rows, C in zip(self.rows, used_columns, strict=True)]
        normals = [
            normal_matrices(joint_grams, np.ones((1, 1)), w)
            for joint_grams, w in zip(grams, self.weights.tolist(), strict=True)
        ]
        M, right = (np.add.reduce([normal[k][0] for normal in normals]) for k in range(2))
        theta = np.linalg.solve(add_ridge(M) + np.diag(self._precision + np.finfo(float).tiny), right)
        residuals = []
        for rows, C, gram in zip(self.rows, used_columns, grams, strict=True):
            b, G = len(rows.maps), gram.weighted(np.ones((1, 1, 1)))[0]
            # Back-substitution: the values of the eliminated columns, with the shared parameters known.
            values = np.linalg.solve(add_ridge(G[b:-1, b:-1]), G[b:-1, -1] - G[b:-1, :b] @ rows.maps @ theta)
            residuals.append(np.where(rows.usable, rows.residual(theta, C, values), 0.0))
        size = np.array([np.mean(residual[rows.usable] ** 2) if rows.usable.any() else 0.0
                         for residual, rows in zip(residuals, self.rows, strict=True)])  # fmt: skip
        # A floor relative to the torque, so that a joint that is fitted exactly does not outweigh all others.
        floor = 1e-12 * np.array([np.mean(rows.tau**2) for rows in self.rows])
        self.weights = 1.0 / np.where(size > 0, np.maximum(size, floor), 1.0)
        self.theta = self.prior.mean + theta
        return residuals

    @property
    def _precision(self) -> Array:
        return self.prior.precision * self.independent

    def select_terms(self) -> TermChoice:
        """Search the terms of all joints in turn, each beside the current terms of the others."""
        n, plain, uncertain_speeds = len(self.rows), list[float](), [0.0] * len(self.rows)
        entered = [list[tuple[int, int]]() for _ in range(n)]
        for turn in range(PASSES):
            # The load changes with the terms, which depend on it: a few passes settle both.
            load = self.samples.model.with_load(self.theta).load if self.samples.model.load_mask.any() else None
            loads = self.samples.loads(load)
            # the matrices of the last pass are freed before those of the next one are made
            searches = list[JointSearch]()
            searches = self._make_searches(loads)
            ripples = [[kind.name for kind in joint_ripples] for joint_ripples in self.ripples]
            for j, search in enumerate(searches):
                previous = [TermEntry(search.groups[g], size) for g, size in entered[j]]
                search.entered = previous + search.entries(ripples[j]) if turn else search.entries(PLAIN_KINDS)
            plain = plain or self._errors(searches)
            normals = [search.normal for search in searches]
            for j, search in enumerate(searches):
                report_progress(Step("choosing the terms", (turn + (turn == PASSES - 1)) * n + j, (PASSES + 1) * n))
                if self._is_still(j):
                    search.entered = search.entries(PLAIN_KINDS)
                    continue
                # Dry friction and offset first, the rest anew: sizes of an earlier pass were chosen with another load.
                search.entered = search.entries([*PLAIN_KINDS[:3], *ripples[j]])
                candidates = search.beside(other_joint_normals(normals, j, self._precision, search.grams.acts))
                search.forward(candidates)
                search.backward(candidates)
                search.exchange(candidates)
                uncertain_speeds[j] = search.sharpen(candidates, self.samples.turning_step(j))
                if not self.samples.moves_both_ways(j):
                    search.keep_dry_friction(candidates)
                normals[j] = search.normal
            entered = [[(search.groups.index(x.group), x.size) for x in search.entered] for search in searches]
            self._pool(searches)
            residuals = self._update_weights(searches, loads)
            for j in range(n if turn == PASSES - 2 else 0):
                report_progress(Step("choosing the terms", (turn + 1) * n + j, (PASSES + 1) * n))
                # Ripples are searched in the last but one pass, so that the last weighs them against all other kinds.
                self._find_ripples(searches, residuals, j, loads)
            for motor in coupled_motors(self.samples.model) if turn == PASSES - 2 else ():
                self._find_friction(searches, loads, motor)
        joints = self.samples.model.joints
        trials = [earlier | search.trials for earlier, search in zip(self.trials, searches, strict=True)]
        return TermChoice(
            tuple(joint.name for joint in joints),
            combine_terms(joints, [[x.term for x in search.entered] for search in searches]),
            tuple(trial for joint_trials in trials for trial in joint_trials.values()),
            tuple(plain),
            tuple(self._errors(searches)),
            tuple(self._min_speed(searches, loads, j, uncertain_speeds[j]) for j in range(n)),
            load,
        )

    def _pool(self, searches: Sequence[JointSearch]) -> None:
        """Keep on what share of the other moving joints each kind has entered, for the next pass."""
        moving = [j for j in range(len(searches)) if not self._is_still(j)]
        kinds = {j: {x.group.kind.name for x in searches[j].entered} for j in moving}
        for j in moving if len(moving) > 2 else ():
            others = [kinds[i] for i in moving if i != j]
            names = {group.kind.name for group in searches[j].groups}
            self.shares[j] = {name: float(np.mean([name in entered for entered in others])) for name in names}

    def _errors(self, searches: Sequence[JointSearch]) -> list[float]:
        """Return the cross-validated errors (%) of the joints."""
        normals, errors = [search.normal for search in searches], list[float]()
        for j, search in enumerate(x.without_candidates for x in searches):
            candidates = search.beside(other_joint_normals(normals, j, self._precision, search.grams.acts))
            squared_error = max(float(search.errors(candidates).sum()), 0.0)  # of nothing
            used = self.rows[j].usable & (self.block >= 0)
            squared_torque = float(np.square(self.samples.tau[used, j]).sum()) or 1.0
            errors.append(100.0 * (squared_error / squared_torque) ** 0.5)
        return errors

    def _update_weights(self, searches: Sequence[JointSearch], loads: Sequence[Array]) -> list[Array]:
        """Fit all joints with their chosen terms, set the weights of the searches, and return the residuals (N)."""
        residuals = self._refit([self._entered_columns(search, j, loads) for j, search in enumerate(searches)])
        for search, weight in zip(searches, self.weights.tolist(), strict=True):
            search.weight = weight
        return residuals

    def _make_searches(self, loads: Sequence[Array]) -> list[JointSearch]:
        """Return the search of each joint with the groups of all kinds."""
        searches = []
        for j, rows in enumerate(self.rows):
            groups, group_columns = list[TermGroup](), list[Array]()
            still_kinds, has_load = PLAIN_KINDS[: 1 if self._is_held(j) else None], self.samples.model.load_mask.any()
            kinds = [kind for kind in self.kinds if not self._is_still(j) or kind.name in still_kinds]
            for kind in (*kinds, *self.ripples[j]):
                terms = tuple(kind.sizes(self.excitations[j])) if has_load or not kind.needs_load else ()
                names = {parameter.name for term in terms for parameter in term.parameters}
                if terms and not names & set(self.samples.model.names):
                    groups.append(self._group(kind, terms, j, loads, group_columns))
            grams = self._grams(rows, group_columns)
            name = self.samples.model.joints[j].name
            searches.append(
                JointSearch(name, grams, tuple(groups), self.division, float(self.weights[j]), self.shares.get(j, {}))
            )
        return searches

    def _group(
        self, kind: CandidateKind, terms: tuple[Term, ...], j: int, loads: Sequence[Array], group_columns: list[Array]
    ) -> TermGroup:
        """Return a group of columns, which are appended to ``group_columns``."""
        places = []
        for term in terms:
            term_columns = self._scaled_columns(term, j, loads)
            start = sum(map(len, group_columns))
            places.append(tuple(range(start, start + len(term_columns))))
            group_columns.append(term_columns)
        return TermGroup(kind, terms, tuple(places))

    def _entered_columns(self, search: JointSearch, j: int, loads: Sequence[Array]) -> Array:
        """Return the columns (m, N) that have entered at a joint, computed anew: those of all candidates are large."""
        columns = [self._scaled_columns(entry.term, j, loads) for entry in search.entered]
        return np.concatenate([np.zeros((0, len(self.samples))), *columns])

    def _scaled_columns(self, term: Term, j: int, loads: Sequence[Array]) -> Array:
        """Return the columns (w, N) of a term, each with a mean square of one."""
        columns = self._columns(term, j, loads)
        size = np.sqrt(np.mean(np.square(columns), axis=1, keepdims=True))
        return np.asarray(columns / np.where(size > 0, size, 1.0))

    def _columns(self, term: Term, j: int, loads: Sequence[Array]) -> Array:
        """Return the columns (w, N) of a term; those that remember the motion, and not the load, are cached."""
        if isinstance(term, LoadDahl):
            load = [load[rows, j] for load, rows in zip(loads, self.samples.rows, strict=True)]
            without_load = Dahl(term.joints, term.on, length=term.length)
            return np.asarray(np.abs(np.concatenate(load)) * self._columns(without_load, j, loads))
        if term.needs_load or not term.memory:
            return columns_of(self.samples, term, j, loads)
        if (j, term) not in self._cached_columns:
            self._cached_columns[j, term] = columns_of(self.samples, term, j, loads)
        return self._cached_columns[j, term]

    def _grams(self, rows: JointEquations, columns: Sequence[Array]) -> JointGrams:
        q, dq = (self.samples.states[name][:, rows.j] for name in ("q", "dq"))
        return rows.grams(columns, self.block, self.samples.classes(q, dq), (self.samples.blocks, N_CLASSES))

    def _is_still(self, j: int) -> bool:
        """Return whether the friction of a joint cannot be seen: it hardly moves, or its torque is not fitted."""
        fastest = max(excitation.speed for excitation in self.excitations)
        slow = self.excitations[j].speed < max(MAX_STILL_SHARE * fastest, MIN_ARM_SPEED)
        return slow or self._is_held(j) or not self.rows[j].usable.any()

    def _is_held(self, j: int) -> bool:  # a controller holds it, so that it gives way a little: that is no friction
        reach = np.array([joint.reach for joint in self.excitations])
        return bool(reach[j] > MIN_REACH and held_joints(reach, [joint.kind for joint in self.samples.model.joints])[j])

    def _other_normals(self, searches: Sequence[JointSearch], j: int) -> Normal:
        return other_joint_normals([search.normal for search in searches], j, self._precision, searches[j].grams.acts)

    def _find_ripples(
        self, searches: list[JointSearch], residuals: list[Array], j: int, loads: Sequence[Array]
    ) -> None:
        """Add ripples to a joint one by one, also by the load, at the largest lines in the residual of other terms."""
        rows, excitation = self.rows[j], self.excitations[j]
        block = np.where(rows.usable, self.block, -1)
        for _ in range(0 if self._is_still(j) else MAX_RIPPLES):
            kinds = ripple_kinds(self.samples, excitation, residuals[j], block, self.ripples[j])
            if not kinds:
                return
            # Columns that have entered come first; those of other candidates are no longer needed.
            group_columns = [self._entered_columns(searches[j], j, loads)]
            groups = [self._group(kind, tuple(kind.sizes(excitation)), j, loads, group_columns) for kind in kinds]
            entered = renumber_columns(searches[j].entered)
            grams = self._grams(rows, group_columns)
            searches[j] = search = replace(
                searches[j], grams=grams, groups=tuple(groups), entered=list(entered), trials={}
            )
            search.forward(search.beside(self._other_normals(searches, j)))
            self.trials[j] |= search.trials
            if len(search.entered) == len(entered):
                return
            entry = search.entered[-1]
            self.ripples[j].append(replace(entry.group.kind, sizes=partial(fixed_terms, (entry.term,))))
            residuals[:] = self._update_weights(searches, loads)

    def _find_friction(self, searches: Sequence[JointSearch], loads: Sequence[Array], motor: CoupledMotor) -> None:
        """Add friction of a motor that is coupled to several joints, judged by the equations of all of these."""
        on = [j for j, joint in enumerate(self.samples.model.joints) if joint.name in dict(motor.coefficients)]
        joint_columns = [self._entered_columns(searches[j], j, loads) for j in on]
        equations = MotorEquations([self.rows[j] for j in on], joint_columns, self.weights[on], self.block)
        coupled_search = motor_search(self.samples, motor, equations)
        # The other joints enter by their normal matrices; those of the motor are in its own search.
        others = [search for j, search in enumerate(searches) if j not in on]
        n_before = len(coupled_search.entered)
        coupled_search.forward(coupled_search.beside(self._other_normals([coupled_search, *others], 0)))
        self.trials[on[0]] |= coupled_search.trials
        for j in on:
            self.ripples[j] += [
                replace(x.group.kind, sizes=partial(fixed_terms, (x.term,))) for x in coupled_search.entered[n_before:]
            ]

    def _min_speed(self, searches: Sequence[JointSearch], loads: Sequence[Array], j: int, least: float) -> float:
        """Return the speed, at least ``least``, below which a joint is left out as this predicts all samples better."""
        joint_search, rows = searches[j], self.rows[j]
        if self.samples.selection.min_speed is not None or self._is_still(j):
            return 0.0
        speed = np.abs(self.samples.states["dq"][:, j]) / self.excitations[j].speed
        # Samples fall into classes by speed, so that every trial speed is a choice of Gram matrices.
        label = np.digitize(speed, TRIAL_SPEEDS)
        F, C = self.samples.blocks, len(TRIAL_SPEEDS) + 1
        grams = rows.grams([self._entered_columns(joint_search, j, loads)], self.block, label, (F, C))
        candidates = CandidateGrams(grams, self._other_normals(searches, j), joint_search.weight)
        eye, errors = np.eye(F), []
        for k in range(C):
            # All samples are predicted, also the slow ones that are left out of the fit.
            folds = Folds((1.0 - eye)[:, :, None] * (np.arange(C) >= k), eye[:, :, None] * np.ones(C), np.arange(F))
            errors.append(try_groups(candidates, folds, range(len(joint_search.columns)), ()).before)
        gains = [gain_share(errors[0] - error, errors[0]) for error in errors]
        best, (gain, std) = max(enumerate(gains), key=lambda pair: pair[1][0])
        is_sure = best > 0 and gain > max(MIN_STRICT_GAIN_ERRORS * std, 0.5)
        return max(TRIAL_SPEEDS[best - 1] * self.excitations[j].speed if is_sure else 0.0, least)
