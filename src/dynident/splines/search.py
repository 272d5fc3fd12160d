"""Searches for p, as generators: each yields what it wants solved and is sent the solutions.

So those of several columns run side by side (``together``), each at its own p. p is searched on a logarithmic scale.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from itertools import pairwise
from math import copysign, exp, inf, isfinite, isnan, log, nan

import numpy as np

from dynident.splines.banded import TINY, IllConditionedError, Solution
from dynident.splines.compiled import Answer, Data, Solver, Trial
from dynident.splines.series import Series

__all__ = ["Search", "by_gcv", "by_likelihood", "by_reml", "constrained", "minimal", "once", "together"]

Search = Generator[Sequence[Trial], Sequence[Answer], Solution]
Criterion = Callable[[Series, Solution], tuple[float, float]]
Point = tuple[float, float, float]  # log p, a value, its slope
Bracket = tuple[Point, Point]
STAGNATION = 1e-6  # largest relative error of S allowed for rounding
NEAR = 1e-4  # relative error of S, or change of log p, from which on solutions are refined
CLOSING = 3e-4  # relative error of S from which the next step reaches that of the kernel's correction of p
ROUGH = 3e-3  # relative error of S of the middle of the data, which only says where to start
CURVED = 0.05  # relative error of S up to which a cubic describes log p
TAKEN = 5 / 2**3.5  # of the squares of white noise a spline takes this times p^(1/4)
FAR = 0.01  # change of log p from which on the slope has changed, too
GRID = 12  # values of p at which a criterion is looked at first
STEPS, CLOSE = 20, 1e-5  # of the search for the least value: at most so many, until log p is as close
SHARES = np.linspace(0.0, 1.0, 65)  # of the way between two points, at which a cubic is looked at
NARROWEST, WIDEST = 0.3, 2000.0  # bandwidths in samples between which they lie


def together(searches: Sequence[Search]) -> list[Solution]:
    """Run searches side by side and return what each finds, with an error of any of them."""
    solver = Solver.of_thread()
    found: dict[int, Solution] = {}
    wanted: dict[int, Sequence[Trial]] = {}

    def advance(k: int, answers: Sequence[Answer] | None) -> None:
        try:
            wanted[k] = next(searches[k]) if answers is None else searches[k].send(answers)
        except StopIteration as end:
            found[k] = end.value
            wanted.pop(k, None)

    for k in range(len(searches)):
        advance(k, None)
    while wanted:
        asked = list(wanted.items())
        least = min(map(_cost, (trials[0] for _, trials in asked)))
        asked = [one for one in asked if _cost(one[1][0]) == least]  # the others wait, to be computed side by side
        answers = iter(solver([trial for _, trials in asked for trial in trials]))
        for k, trials in asked:
            advance(k, [next(answers) for _ in trials])
    solver.tidy()
    return [found[k] for k in range(len(searches))]


def _cost(trial: Trial) -> tuple[bool, int]:
    return trial.refine, trial.series.system.size


def once(
    series: Data, p: float, *, refine: bool = True, trace: bool = False, aim: tuple[float, float] = (0.0, 0.0)
) -> Search:
    """Solve for one p (scaled); raises IllConditionedError."""
    (answer,) = yield [Trial(series, p, refine, trace, aim=aim)]
    if isinstance(answer, IllConditionedError):
        raise answer
    return answer


def p_of_bandwidth(m: float) -> float:
    """Return the scaled p whose bandwidth (lam / h^3)^(1/4) is m samples."""
    return 0.5 / m**4


def constrained(series: Series, target: float) -> Search:
    """Find rss(p) = target; of long data the middle says where to start."""
    p, chunk = p_of_bandwidth(20.0), series.central()
    if chunk is not None:
        share = target * len(chunk.data) / len(series.data)
        if chunk.straight_rss > share:
            try:
                p = (yield from _newton(chunk, share, p, ROUGH)).p
            except IllConditionedError:
                p = p_of_bandwidth(20.0)
    return (yield from _newton(series, target, p))


def _newton(series: Series, target: float, p: float, tolerance: float = 1e-10) -> Search:
    """Find rss(p) = target; rss falls with p."""
    low, high = -inf, inf  # bracket of the root in log p
    x, refine, aims = log(p), False, True
    before: Point | None = None
    best: tuple[float, Solution] | None = None
    whole = len(series.data) * series.noise**2 / target
    known = (inf, -1.0)  # where the slope was found last, and that
    for _ in range(200):
        now = yield from once(series, exp(x), refine=refine, aim=(target, known[1]) if refine and aims else (0.0, 0.0))
        x = log(now.p)
        if not isfinite(now.rss):
            raise IllConditionedError("the search for p left the range of numbers")
        error = log(max(now.rss, TINY) / target)
        if abs(error) <= tolerance and (refine or tolerance >= ROUGH):
            return now
        if refine:
            if best is None:  # what is not refined may be off by more than the tolerance, and so the bracket
                low, high = -inf, inf
            if best is not None and abs(error) >= abs(best[0]):  # rounding lets it improve no more
                if abs(best[0]) <= STAGNATION:
                    return best[1]
                if not aims:
                    raise IllConditionedError(f"S is reached no better than to {abs(best[0]):.0e}")
                aims = False  # p is corrected by what an unrefined solution misses, which rounding may decide
            else:
                best = (error, now)
        if not isnan(now.slope):
            known = (x, now.slope)
        elif abs(x - known[0]) > FAR:
            known = (x, (yield from once(series, exp(x), refine=False)).slope)
        low, high = (max(x, low), high) if error > 0 else (low, min(x, high))
        here = (x, error, known[1])
        new = _next(here, None if refine else before, low, high, whole)
        if not refine and tolerance < ROUGH and (abs(error) < CLOSING or abs(new - x) < NEAR):
            refine = True
            known = _slope_at(new, here, before)
        before, x = here, new
    raise IllConditionedError("the search for p does not converge")


def _slope_at(x: float, here: Point, before: Point | None) -> tuple[float, float]:
    """Return where the slope is known, and that: about, at x, by the last two points; else at the last of them."""
    if before is None or here[2] >= 0:
        return here[0], here[2]
    there = here[2] + (x - here[0]) * (here[2] - before[2]) / (here[0] - before[0])
    return x, min(max(there, 1.1 * here[2]), 0.9 * here[2])


def _next(here: Point, before: Point | None, low: float, high: float, whole: float) -> float:
    """Return the next log p: by interpolation of two points near the root, by a model of one, else bisection.

    ``whole`` is the rss expected of noise that is all smoothed away, over the target.
    """
    x, error, slope = here
    if slope < 0:
        new = x - error / slope
        if (
            before is not None
            and before[2] < 0
            and abs(before[1]) < CURVED
            and (before[1] * error < 0.0 or abs(error) < 0.3 * abs(before[1]))
        ):
            new = hermite(here, before)
        elif abs(error) > NEAR and slope > -2.0:
            new = _modelled(here, whole)
        new = min(max(new, x - 7.0), x + 7.0)
        if low < new < high:
            return new
    return 0.5 * (low + high) if isfinite(low + high) else x + copysign(3.0, error)


def _modelled(here: Point, whole: float) -> float:
    """Return log p by a model of rss: ``whole`` (1 - TAKEN p^(1/4)) of noise, and of the signal b p^-power.

    Where that cannot be, by power 2, which smooth signals have away from their ends, and noise of another size.
    """
    x, error, slope = here
    rss, lost = exp(error), TAKEN * exp(0.25 * x)
    rate = slope * rss
    signal, power = rss - whole * (1.0 - lost), 0.0
    if signal > 0.0:
        power = -(rate + 0.25 * whole * lost) / signal
    if not 0.8 < power < 2.2:
        whole, power = (2.0 * rss + rate) / (2.0 - 2.25 * lost), 2.0
        signal = rss - whole * (1.0 - lost)
    if not (signal > 0.0 and lost < 0.5):
        return x - error / slope
    new = 0.0  # of the change of log p, by Newton's method; the model is convex where signal is left
    for _ in range(20):
        left, gone = signal * exp(-power * new), whole * lost * exp(0.25 * new)
        change = (whole - gone + left - 1.0) / (0.25 * gone + power * left)
        new = min(max(new + min(max(change, -1.0), 1.0), -7.0), 7.0)
        if abs(change) < 1e-3:
            break
    return x + new


def hermite(a: Point, b: Point) -> float:
    """Return x(0) of the cubic x(error) through two points (x, error, slope)."""
    h = b[1] - a[1]
    s = -a[1] / h
    return (
        a[0] * (1 + 2 * s) * (1 - s) ** 2
        + b[0] * s * s * (3 - 2 * s)
        + h * (s * (1 - s) ** 2 / a[2] - s * s * (1 - s) / b[2])
    )


def by_gcv(series: Series, at: Solution) -> tuple[float, float]:
    """Return log of rss / (1 - edf / n)^2, and its slope by log p."""
    left = max(series.system.size - at.rise, 1e-3)
    return log(max(at.rss, TINY)) - 2 * log(left), at.slope + 2 * at.bend / left


def by_reml(series: Series, at: Solution) -> tuple[float, float]:
    """Return log(y' Q u) + log det / (n - 2), and its slope by log p."""
    whole = max(at.rss + at.p * at.energy, TINY)
    return log(whole) + at.log_det / series.system.size, at.rise / series.system.size - at.p * at.energy / whole


def by_likelihood(series: Series, at: Solution) -> tuple[float, float]:
    """Return (y' Q u / delta^2 + log det) / (n - 2) for a known delta, and its slope by log p."""
    unit = series.noise**2 * series.system.size
    whole, bent = (at.rss + at.p * at.energy) / unit, at.p * at.energy / unit
    return whole + at.log_det / series.system.size, at.rise / series.system.size - bent


def minimal(series: Series, criterion: Criterion) -> Search:
    """Minimise a criterion over x = log p: a grid (on the middle of long data), then the zero of its slope."""
    if series.is_straight:
        return series.straight()
    chunk = series.central()
    if chunk is None or chunk.is_straight:  # a middle part at rest is not representative
        chunk = series
    widest = min(float(len(chunk.data)), WIDEST)
    first, last = log(p_of_bandwidth(widest)), log(p_of_bandwidth(NARROWEST))
    grid = [first + (last - first) * k / (GRID - 1) for k in range(GRID)]
    points = yield from _points(chunk, criterion, grid)
    if not points:
        raise IllConditionedError("the criterion cannot be computed for any p")
    x, bracket = _lowest(points)
    if chunk is not series:
        x, bracket = yield from _bracket(series, criterion, x, (points[0][0], points[-1][0]))
    if bracket is not None:
        x = yield from _zero(series, criterion, *bracket)
    return (yield from once(series, float(np.exp(x))))


def _points(
    series: Series, criterion: Criterion, grid: Sequence[float]
) -> Generator[Sequence[Trial], Sequence[Answer], list[Point]]:
    """Return log p, the criterion and its slope where they can be computed."""
    answers = yield [Trial(series, exp(x), trace=True, determinant=criterion is not by_gcv) for x in grid]
    solved = [(float(x), at) for x, at in zip(grid, answers, strict=True) if isinstance(at, Solution)]
    return [point for x, at in solved if all(map(isfinite, point := (x, *criterion(series, at))))]


def _lowest(points: list[Point]) -> tuple[float, Bracket | None]:
    """Return about where the least minimum is, and the two points around it, None where that is at an end."""
    ends = [(points[0][1], points[0][0], None)] if points[0][2] >= 0 else []
    ends += [(points[-1][1], points[-1][0], None)] if points[-1][2] <= 0 else []
    between = [(*_cubic(a, b), (a, b)) for a, b in pairwise(points) if a[2] < 0 <= b[2]]
    _, x, bracket = min([*ends, *between], key=lambda one: one[0])
    return x, bracket


def _cubic(a: Point, b: Point) -> tuple[float, float]:
    """Return about the least value, and where, of the cubic with values and slopes of two points."""
    h, s = b[0] - a[0], SHARES
    value = a[1] * (1 + 2 * s) * (1 - s) ** 2 + b[1] * s * s * (3 - 2 * s)
    value += h * s * (1 - s) * (a[2] * (1 - s) - b[2] * s)
    least = int(np.argmin(value))
    return float(value[least]), float(a[0] + s[least] * h)


def _bracket(
    series: Series, criterion: Criterion, x: float, ends: tuple[float, float]
) -> Generator[Sequence[Trial], Sequence[Answer], tuple[float, Bracket | None]]:
    """Walk downhill from x until the slope changes its sign; None at an end of the range."""
    step, before = 1.0, None
    while True:
        points = yield from _points(series, criterion, [x])
        here = points[0] if points else (x, np.inf, -1.0)  # too ill-conditioned: less smoothing
        if before is not None and here[2] * before[2] <= 0:
            return x, (min(here, before), max(here, before))
        if (x <= ends[0] and here[2] >= 0) or (x >= ends[1] and here[2] <= 0):
            return x, None
        x, before = float(np.clip(x - np.copysign(step, here[2]), *ends)), here
        step *= 2


def _zero(
    series: Series, criterion: Criterion, a: Point, b: Point
) -> Generator[Sequence[Trial], Sequence[Answer], float]:
    """Return where the slope, negative at a and positive at b, is zero: inverse interpolation within a bracket."""
    known, x = [a, b], _cubic(a, b)[1]
    for _ in range(STEPS):
        points = yield from _points(series, criterion, [x])
        if not points:
            raise IllConditionedError("the criterion cannot be computed beside its minimum")
        known = [*known[-2:], points[0]]
        a, b = (points[0], b) if points[0][2] < 0 else (a, points[0])
        new = _inverse(known)
        new = new if a[0] < new < b[0] else 0.5 * (a[0] + b[0])
        if abs(new - x) * min(1.0, abs(new - known[1][0])) < CLOSE:  # more than what is left
            return new
        x = new
    return x


def _inverse(known: list[Point]) -> float:
    """Return where the slope is zero of the parabola x(slope) through three points."""
    (a, _, fa), (b, _, fb), (c, _, fc) = known
    if fa == fb or fb == fc or fc == fa:
        return nan
    return (
        a * fb * fc / ((fa - fb) * (fa - fc))
        + b * fc * fa / ((fb - fc) * (fb - fa))
        + c * fa * fb / ((fc - fa) * (fc - fb))
    )
