"""The choice of the terms of all joints, again with the load of the bodies that the terms chosen first leave."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from dynident.errors import Step, brief
from dynident.identification.rests import hardly_moving
from dynident.identification.terms.bodies import Normal, Prior, normal_matrices, others, prior_of
from dynident.identification.terms.candidates import KINDS, PLAIN, Kind, Seen, these
from dynident.identification.terms.choice import TermChoice, TooFewSamplesError, Trial
from dynident.identification.terms.combined import combined
from dynident.identification.terms.grams import Folds, JointGrams, ridged, tried
from dynident.identification.terms.motors import motor_search, motors_of
from dynident.identification.terms.ripple import Residual, peaks
from dynident.identification.terms.samples import CLASSES, Rows, Samples, columns_of, correlation, samples_of
from dynident.identification.terms.search import Division, Entered, Group, JointSearch, renumbered, share
from dynident.log import Motion
from dynident.models import CoupledMotor, Loads, Model, Ripple, Term

__all__ = ["choose_terms"]

Array = NDArray[np.float64]
PASSES, RIPPLES = 3, 3  # of the search, by the load of the terms found before; rates of one joint
SPEEDS = (0.01, 0.02, 0.03)  # of the rms speed, tried as minimum speed
MEMORIES = ("dahl", "load_dahl")  # kinds that describe the motion near a reversal
STILL = 1e-4  # of the largest rms speed: a joint that is slower keeps the plain set, of which it shows nothing
LEAST, SLOWEST = 1e-9, 1e-6  # rad, m: range of a joint that never moves; rad/s, m/s: as STILL, of an arm at rest
FEWEST = 50  # samples in a block


def choose_terms(
    model: Model,
    motions: Sequence[Motion],
    min_speed: tuple[float, ...] | None = None,
    *,
    kinds: Sequence[Kind] = KINDS,
    progress: Callable[[str], None] = lambda _: None,
) -> TermChoice:
    """Return the terms to be added to a ``model`` of bodies, joint by joint, by what they predict of motions.

    Forward selection among ``kinds``, by blocked cross-validation: the blocks are contiguous in time, with gaps of the
    residual's correlation length between them. A kind enters where it removes at least 1 % of the squared error of its
    joint, and more than 1.5 standard errors of the blocks, a strict one two; where it does not fail on the fast samples
    when the slow ones are fitted, or on another recording; and where no coefficient is negative that must not be.
    Offset and rotor inertia always stay, viscous and Coulomb friction unless they are seen to do nothing.

    ``min_speed`` (n) is that of the fit, where it is given; else it is chosen by the same folds, except where
    presliding was.

    Raises TooFewSamplesError where there are too few samples, and the errors of the terms.
    """
    return _Choosing.of(model, motions, min_speed, kinds, progress).result()


@dataclass(eq=False)
class _Choosing:
    """The state of the choice."""

    samples: Samples
    rows: tuple[Rows, ...]
    prior: Prior
    seen: tuple[Seen, ...]
    kinds: Sequence[Kind]
    progress: Callable[[str], None]
    division: Division
    weights: Array  # (n) of the rows: one over the squared deviation of the residual
    block: NDArray[np.intp]  # (N), -1 in the gaps
    theta: Array  # (p) of the model given
    independent: float = 1.0  # samples per independent one
    given_speed: bool = False
    ripples: list[list[Kind]] = field(default_factory=list)  # found at each joint, and friction of motors coupled to it
    trials: list[dict[str, Trial]] = field(default_factory=list)  # of these
    _known: dict[tuple[int, str, Term], Array] = field(default_factory=dict)

    __repr__ = brief

    @classmethod
    def of(
        cls,
        model: Model,
        motions: Sequence[Motion],
        min_speed: tuple[float, ...] | None,
        kinds: Sequence[Kind],
        progress: Callable[[str], None],
    ) -> _Choosing:
        """Return the state before the first search, with the plain set fitted."""
        samples = samples_of(model, motions, min_speed)
        if len(samples) < FEWEST * samples.blocks:
            raise TooFewSamplesError(
                f"{', '.join(one.source for one in motions)}: {len(samples)} usable samples are too few to choose the "
                "terms by; record longer, or name the terms."
            )
        prior = prior_of(model.parameters)
        rows = tuple(Rows.of(samples, j, prior.mean) for j in range(len(model.joints)))
        scale = np.array([np.mean(np.square(one.tau)) for one in rows])
        weights = 1.0 / np.where(scale > 0, scale, 1.0)
        reach, speed = np.ptp(samples.states["q"], axis=0), np.sqrt(np.mean(samples.states["dq"] ** 2, axis=0))
        duration = max(float(np.ptp(one.t)) for one in samples.motions)
        seen = tuple(
            Seen(model.joints, joint, max(float(v), 1e-9), max(float(r), LEAST), duration)
            for joint, v, r in zip(model.joints, speed, reach, strict=True)
        )
        division = Division.of(samples.of_block)
        made = cls(samples, rows, prior, seen, kinds, progress, division, weights, samples.block, prior.mean)
        made.given_speed = min_speed is not None
        made.ripples, made.trials = [[] for _ in rows], [{} for _ in rows]
        made._start()
        return made

    def _start(self) -> None:
        """Fit the plain set for weights, the correlation of the residual, and the first load."""
        plain = [self._plain(j) for j in range(len(self.rows))]
        for _ in range(2):
            residuals = self._refit(plain, [list(range(len(one))) for one in plain])
            lengths = [correlation(one, len(one) // self.samples.blocks) for one in residuals]
            self.independent = float(np.median(lengths))
        inside = self.samples.inside(2 * int(self.independent))
        self.block = np.where(inside, self.samples.block, -1)

    def _plain(self, j: int) -> Array:
        """Return the columns (m, N) of offset, viscous and Coulomb friction of a joint."""
        kinds = [kind for kind in KINDS if kind.name in PLAIN]
        terms = [kind.sizes(self.seen[j])[0] for kind in kinds]
        return np.concatenate([columns_of(self.samples, term, j, self.samples.loads(None)) for term in terms])

    def _refit(self, columns: Sequence[Array], chosen: Sequence[Sequence[int]]) -> list[Array]:
        """Fit all joints with their chosen columns; set theta and weights, and return the residuals (N)."""
        whole = np.zeros(len(self.samples), dtype=np.intp)
        some = [one[list(index)] for one, index in zip(columns, chosen, strict=True)]
        grams = [rows.grams(C, whole, whole, (1, 1)) for rows, C in zip(self.rows, some, strict=True)]
        normals = [
            normal_matrices(one, range(len(C)), np.ones((1, 1)), w)
            for one, C, w in zip(grams, some, self.weights, strict=True)
        ]
        M, right = (np.add.reduce([one[k][0] for one in normals]) for k in range(2))
        theta = np.linalg.solve(ridged(M) + np.diag(self._precision + np.finfo(float).tiny), right)
        residuals = []
        for rows, C, gram in zip(self.rows, some, grams, strict=True):
            b, G = len(rows.maps), gram.grams[0, 0]
            values = np.zeros(len(C))
            if len(C):
                values = np.linalg.solve(ridged(G[b:-1, b:-1]), G[b:-1, -1] - G[b:-1, :b] @ rows.maps @ theta)
            residuals.append(np.where(rows.used, rows.residual(theta, C, values), 0.0))
        size = np.array([np.mean(one[rows.used] ** 2) if rows.used.any() else 0.0
                         for one, rows in zip(residuals, self.rows, strict=True)])  # fmt: skip
        floor = 1e-12 * np.array([np.mean(rows.tau**2) for rows in self.rows])
        self.weights = 1.0 / np.where(size > 0, np.maximum(size, floor), 1.0)
        self.theta = self.prior.mean + theta
        return residuals

    @property
    def _precision(self) -> Array:
        return self.prior.precision * self.independent

    def result(self) -> TermChoice:
        """Search all joints, each with the others as they are."""
        n, plain = len(self.rows), list[float]()
        entered = [list[tuple[int, int]]() for _ in range(n)]
        for turn in range(PASSES):
            load = self.samples.model.loaded(self.theta).load if self._has_load else None
            loads = self.samples.loads(load)
            searches, columns = self._searches(loads)
            for j, one in enumerate(searches):
                again = [Entered(one.groups[g], size) for g, size in entered[j]]
                one.entered = again + self._ripples_of(j, one) if turn else self._of_names(one, PLAIN)
            plain = plain or self._errors(searches)
            normals = list(map(self._normal, searches))
            for j, one in enumerate(searches):
                self.progress(Step("choosing the terms", (turn + (turn == PASSES - 1)) * n + j, (PASSES + 1) * n))
                if self._still(j):
                    one.entered = self._of_names(one, PLAIN)
                    continue
                one.entered = self._of_names(one, PLAIN[:3]) + self._ripples_of(j, one)
                rest = others(normals, j, self._precision, one.grams.acts)
                one.forward(rest)
                one.backward(rest)
                one.exchange(rest)
                normals[j] = self._normal(one)
            entered = [[(one.groups.index(x.group), x.size) for x in one.entered] for one in searches]
            residuals = self._weighed(searches, columns)
            for j in range(n if turn == PASSES - 2 else 0):
                self.progress(Step("choosing the terms", (turn + 1) * n + j, (PASSES + 1) * n))
                self._find_ripples(searches, columns, residuals, j)
            for motor in motors_of(self.samples.model) if turn == PASSES - 2 else ():
                self._find_friction(searches, columns, motor)
        joints = self.samples.model.joints
        return TermChoice(
            tuple(joint.name for joint in joints),
            combined(joints, [[x.term for x in one.entered] for one in searches]),
            tuple(x for one, trials in zip(searches, self.trials, strict=True) for x in (trials | one.trials).values()),
            tuple(plain),
            tuple(self._errors(searches)),
            tuple(self._min_speed(searches, columns, j) for j in range(n)),
            load,
        )

    def _ripples_of(self, j: int, one: JointSearch) -> list[Entered]:
        """Return the groups of the ripples that were found at a joint."""
        return self._of_names(one, [kind.name for kind in self.ripples[j]])

    def _normal(self, one: JointSearch) -> Normal:
        """Return the normal matrices of the model's parameters from one joint."""
        return normal_matrices(one.grams, one.columns, self.division.train, one.weight)

    def _errors(self, searches: Sequence[JointSearch]) -> list[float]:
        """Return the cross-validated errors (%) of the joints."""
        normals, found = list(map(self._normal, searches)), []
        for j, one in enumerate(searches):
            wrong = max(float(one.errors(others(normals, j, self._precision, one.grams.acts)).sum()), 0.0)  # of nothing
            found.append(100.0 * (wrong / self._torque(self.rows[j])) ** 0.5)
        return found

    def _weighed(self, searches: Sequence[JointSearch], columns: Sequence[Array]) -> list[Array]:
        """Fit all joints with what has entered; set the weights of the searches, and return the residuals (N)."""
        residuals = self._refit(columns, [one.columns for one in searches])
        for one, weight in zip(searches, self.weights.tolist(), strict=True):
            one.weight = weight
        return residuals

    def _torque(self, rows: Rows) -> float:
        """Return the sum of squares of the torque of a joint in the blocks."""
        used = rows.used & (self.block >= 0)
        return float(np.square(self.samples.tau[used, rows.j]).sum()) or 1.0

    @property
    def _has_load(self) -> bool:
        return any(isinstance(term, Loads) and term.loads for term in self.samples.model.terms)

    def _searches(self, loads: Sequence[Array]) -> tuple[list[JointSearch], list[Array]]:
        """Return the search of each joint with the groups of all kinds, and their columns (m, N)."""
        made, columns = [], []
        for j, rows in enumerate(self.rows):
            groups: list[Group] = []
            found: list[Array] = []
            every = [x for x in self.kinds if not self._still(j) or x.name in PLAIN[: 1 if self._held(j) else None]]
            for kind in (*every, *self.ripples[j]):
                terms = () if kind.needs_load and not self._has_load else tuple(kind.sizes(self.seen[j]))
                names = {one.name for term in terms for one in term.parameters}
                if terms and not names & set(self.samples.model.names):
                    groups.append(self._group(kind, terms, j, loads, found))
            columns.append(np.concatenate(found) if found else np.zeros((0, len(self.samples))))
            grams = self._grams(rows, columns[-1])
            name = self.samples.model.joints[j].name
            made.append(JointSearch(name, grams, tuple(groups), self.division, float(self.weights[j])))
        return made, columns

    def _group(self, kind: Kind, terms: tuple[Term, ...], j: int, loads: Sequence[Array], found: list[Array]) -> Group:
        """Return a group, whose columns it appends to those found."""
        at = []
        for term in terms:
            own = self._columns(kind, term, j, loads)
            first = sum(map(len, found))
            at.append(tuple(range(first, first + len(own))))
            size = np.sqrt(np.mean(np.square(own), axis=1, keepdims=True))
            found.append(own / np.where(size > 0, size, 1.0))
        return Group(kind, terms, tuple(at))

    def _columns(self, kind: Kind, term: Term, j: int, loads: Sequence[Array]) -> Array:
        """Return the columns (w, N) of a term; those that the load does not change are kept for the second pass."""
        if kind.needs_load:
            return columns_of(self.samples, term, j, loads)
        key = j, kind.name, term
        if key not in self._known:
            self._known[key] = columns_of(self.samples, term, j, loads)
        return self._known[key]

    def _grams(self, rows: Rows, columns: Array) -> JointGrams:
        return rows.grams(columns, self.block, self.samples.classes(rows.j), (self.samples.blocks, CLASSES))

    def _still(self, j: int) -> bool:
        """Return whether nothing is seen of the friction of a joint: it hardly moves, or its torque is not fitted."""
        slow = self.seen[j].speed < max(STILL * max(one.speed for one in self.seen), SLOWEST)
        return slow or self._held(j) or not self.rows[j].used.any()

    def _held(self, j: int) -> bool:  # a controller holds it, so that it gives way a little: that is no friction
        kinds, reach = [one.kind for one in self.samples.model.joints], np.array([one.reach for one in self.seen])
        return bool(reach[j] > LEAST and hardly_moving(reach, kinds)[j])

    @staticmethod
    def _of_names(one: JointSearch, names: Sequence[str]) -> list[Entered]:
        """Return the groups of kinds by name, each in its first size."""
        return [Entered(group, 0) for group in one.groups if group.kind.name in names]

    def _rest(self, searches: Sequence[JointSearch], j: int) -> Normal:
        return others(list(map(self._normal, searches)), j, self._precision, searches[j].grams.acts)

    def _find_ripples(self, searches: list[JointSearch], columns: list[Array], residuals: list[Array], j: int) -> None:
        """Let ripples enter at a joint, one by one, at the largest lines of what the other terms leave."""
        rows, joints = self.rows[j], self.samples.model.joints
        step = float(np.median(np.diff(self.samples.motions[0].t)))
        q, dq = (self.samples.states[name][:, j] for name in ("q", "dq"))
        block, turns = np.where(rows.used, self.block, -1), joints[j].kind == "revolute"
        for turn in range(0 if self._still(j) else RIPPLES):
            left = Residual(q, dq, residuals[j], block, self.samples.blocks, turns)
            lines = peaks(left, 0.5 * np.pi / step / self.seen[j].speed)
            terms = tuple(Ripple(joints, on=(joints[j].name,), cycles=(k,), delay=d) for k, d in lines)
            if not terms:
                return
            kind = Kind(f"ripple {turn + 1}" if turn else "ripple", partial(these, terms), strict=True, reaches=True)
            found = [columns[j][searches[j].columns]]
            group = self._group(kind, terms, j, self.samples.loads(None), found)
            columns[j] = np.concatenate(found)
            entered = renumbered(searches[j].entered)
            grams = self._grams(rows, columns[j])
            searches[j] = one = replace(searches[j], grams=grams, groups=(group,), entered=list(entered), trials={})
            one.forward(self._rest(searches, j))
            self.trials[j] |= one.trials
            if len(one.entered) == len(entered):
                return
            self.ripples[j].append(replace(kind, sizes=partial(these, (one.entered[-1].term,))))
            residuals[:] = self._weighed(searches, columns)

    def _find_friction(self, searches: Sequence[JointSearch], columns: Sequence[Array], motor: CoupledMotor) -> None:
        """Let friction of a motor that is coupled to several joints enter, judged by the equations of all of these."""
        on = [j for j, joint in enumerate(self.samples.model.joints) if joint.name in dict(motor.coefficients)]
        own = [columns[j][searches[j].columns] for j in on]
        one = motor_search(self.samples, motor, [self.rows[j] for j in on], own, self.weights[on], self.block)
        normals = [self._normal(search) for j, search in enumerate(searches) if j not in on]
        alone = normal_matrices(one.grams, one.columns, self.division.train, one.weight)
        had = len(one.entered)
        one.forward(others([alone, *normals], 0, self._precision, one.grams.acts))
        self.trials[on[0]] |= one.trials
        for j in on:
            self.ripples[j] += [replace(x.group.kind, sizes=partial(these, (x.term,))) for x in one.entered[had:]]

    def _min_speed(self, searches: Sequence[JointSearch], columns: Sequence[Array], j: int) -> float:
        """Return the speed below which samples of a joint are left out: one that predicts all samples better."""
        one, rows = searches[j], self.rows[j]
        if self.given_speed or self._still(j) or any(x.group.kind.name in MEMORIES for x in one.entered):
            return 0.0
        speed = np.abs(self.samples.states["dq"][:, j]) / self.seen[j].speed
        label = np.digitize(speed, SPEEDS)
        F, C = self.samples.blocks, len(SPEEDS) + 1
        grams = rows.grams(columns[j][one.columns], self.block, label, (F, C))
        rest, eye = self._rest(searches, j), np.eye(F)
        errors = []
        for k in range(C):
            fast = (np.arange(C) >= k).astype(float)
            folds = Folds((1.0 - eye)[:, :, None] * fast, eye[:, :, None] * np.ones(C), np.arange(F))
            errors.append(tried(grams, folds, rest, range(len(one.columns)), (), one.weight).before)
        gains = [share(errors[0] - error, errors[0]) for error in errors]
        best = int(np.argmax([gain for gain, _ in gains]))
        gain, std = gains[best]
        return SPEEDS[best - 1] * self.seen[j].speed if best and gain > max(std, 0.5) else 0.0
