"""Searches for the smoothing parameter p, as generators that yield trials and receive their solutions.

The searches of several columns thus run side by side (``run_searches``), each at its own p. p is searched on
a logarithmic scale.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from itertools import pairwise
from math import copysign, exp, inf, isfinite, isnan, log, nan

import numpy as np

from dynident.motion.splines.banded import TINY, IllConditionedError, Solution
from dynident.motion.splines.compiled import Answer, Solver, SplineProblem, SplineTrial
from dynident.motion.splines.series import ScaledSeries

SplineSearch = Generator[Sequence[SplineTrial], Sequence[Answer], Solution]
Criterion = Callable[[ScaledSeries, Solution], tuple[float, float]]
SearchPoint = tuple[float, float, float]  # log p, a value, its slope
Bracket = tuple[SearchPoint, SearchPoint]
MAX_ROUNDING_ERROR = 1e-6  # largest relative error of S allowed for rounding
REFINEMENT_ERROR = 1e-4  # relative error of S, or change of log p, from which on solutions are refined
MAX_CORRECTABLE_ERROR = (
    3e-4  # relative error of S from which the next step reaches that of the kernel's correction of p
)
START_TOLERANCE = 3e-3  # relative error of S of the middle of the data, which only says where to start
MAX_CUBIC_ERROR = 0.05  # relative error of S up to which a cubic describes log p
NOISE_SHARE = 5 / 2**3.5  # of the squares of white noise a spline takes this times p^(1/4)
MAX_SLOPE_SHIFT = 0.01  # change of log p from which on the slope has changed, too
GRID_POINTS = 12  # values of p at which a criterion is looked at first
MAX_STEPS, TOLERANCE = 20, 1e-5  # of the search for the least value: at most so many, until log p is as close
CUBIC_SHARES = np.linspace(0.0, 1.0, 65)  # of the way between two points, at which a cubic is looked at
MIN_BANDWIDTH, MAX_BANDWIDTH = 0.3, 2000.0  # bandwidths in samples between which they lie


def run_searches(searches: Sequence[SplineSearch]) -> list[Solution]:
    """Run searches side by side and return the solution of each; an error of any of them is raised."""
    solver = Solver.of_thread()
    solutions: dict[int, Solution] = {}
    requests: dict[int, Sequence[SplineTrial]] = {}

    def advance(k: int, answers: Sequence[Answer] | None) -> None:
        try:
            requests[k] = next(searches[k]) if answers is None else searches[k].send(answers)
        except StopIteration as end:
            solutions[k] = end.value
            requests.pop(k, None)

    for k in range(len(searches)):
        advance(k, None)
    while requests:
        # solve the cheapest kind of trial of all searches together; the others wait until they can be batched, too
        min_cost = min(_cost(trials[0]) for trials in requests.values())
        batch = [(k, trials) for k, trials in requests.items() if _cost(trials[0]) == min_cost]
        answers = iter(solver([trial for _, trials in batch for trial in trials]))
        for k, trials in batch:
            advance(k, [next(answers) for _ in trials])
    solver.tidy()
    return [solutions[k] for k in range(len(searches))]


def _cost(trial: SplineTrial) -> tuple[bool, int]:
    return trial.refine, trial.series.system.size


def once(
    series: SplineProblem, p: float, *, refine: bool = True, trace: bool = False, aim: tuple[float, float] = (0.0, 0.0)
) -> SplineSearch:
    """Solve for one p (scaled); raises IllConditionedError."""
    (answer,) = yield [SplineTrial(series, p, refine, trace, aim=aim)]
    if isinstance(answer, IllConditionedError):
        raise answer
    return answer


def p_of_bandwidth(m: float) -> float:
    """Return the scaled p whose bandwidth (lam / h^3)^(1/4) is m samples."""
    return 0.5 / m**4


def search_constraint(series: ScaledSeries, target: float) -> SplineSearch:
    """Find rss(p) = target; for long data the middle part gives the start."""
    p, chunk = p_of_bandwidth(20.0), series.middle_part()
    if chunk is not None:
        share = target * len(chunk.data) / len(series.data)
        if chunk.straight_rss > share:
            try:
                p = (yield from _newton(chunk, share, p, START_TOLERANCE)).p
            except IllConditionedError:
                p = p_of_bandwidth(20.0)
    return (yield from _newton(series, target, p))


def _newton(series: ScaledSeries, target: float, p: float, tolerance: float = 1e-10) -> SplineSearch:
    """Find rss(p) = target by steps of ``_next_log_p`` within a bracket; rss falls with p."""
    low, high = -inf, inf  # bracket of the root in log p
    x, refine, may_aim = log(p), False, True
    previous: SearchPoint | None = None
    best: tuple[float, Solution] | None = None
    noise_ratio = len(series.data) * (series.noise * series.noise) / target
    known_slope = (inf, -1.0)  # where the slope was found last, and that
    # unrefined solutions first; near the root refined ones, for which the kernel also corrects p
    for _ in range(200):
        solution = yield from once(
            series, exp(x), refine=refine, aim=(target, known_slope[1]) if refine and may_aim else (0.0, 0.0)
        )
        x = log(solution.p)
        if not isfinite(solution.rss):
            raise IllConditionedError("the search for p left the range of numbers")
        error = log(max(solution.rss, TINY) / target)
        if abs(error) <= tolerance and (refine or tolerance >= START_TOLERANCE):
            return solution
        if refine:
            if best is None:  # what is not refined may be off by more than the tolerance, and so the bracket
                low, high = -inf, inf
            if best is not None and abs(error) >= abs(best[0]):  # rounding lets it improve no more
                if abs(best[0]) <= MAX_ROUNDING_ERROR:
                    return best[1]
                if not may_aim:
                    raise IllConditionedError(f"S is reached no better than to {abs(best[0]):.0e}")
                may_aim = False  # p is corrected by what an unrefined solution misses, which rounding may decide
            else:
                best = (error, solution)
        if not isnan(solution.slope):
            known_slope = (x, solution.slope)
        elif abs(x - known_slope[0]) > MAX_SLOPE_SHIFT:
            known_slope = (x, (yield from once(series, exp(x), refine=False)).slope)
        # rss falls with p: the sign of the error says on which side of the root x lies
        low, high = (max(x, low), high) if error > 0 else (low, min(x, high))
        point = (x, error, known_slope[1])
        new = _next_log_p(point, None if refine else previous, low, high, noise_ratio)
        if (
            not refine
            and tolerance < START_TOLERANCE
            and (abs(error) < MAX_CORRECTABLE_ERROR or abs(new - x) < REFINEMENT_ERROR)
        ):
            refine = True
            known_slope = _slope_at(new, point, previous)
        previous, x = point, new
    raise IllConditionedError("the search for p does not converge")


def _slope_at(x: float, point: SearchPoint, previous: SearchPoint | None) -> tuple[float, float]:
    """Return log p and the slope there: extrapolated to x from the last two points, else that of the last point."""
    if previous is None or point[2] >= 0:
        return point[0], point[2]
    slope = point[2] + (x - point[0]) * (point[2] - previous[2]) / (point[0] - previous[0])
    return x, min(max(slope, 1.1 * point[2]), 0.9 * point[2])


def _next_log_p(point: SearchPoint, previous: SearchPoint | None, low: float, high: float, noise_ratio: float) -> float:
    """Return the next log p: by a model of one point, by interpolation of two near the root, else by bisection.

    Within ``REFINEMENT_ERROR`` of the root one point alone gives Newton's step on log rss. ``noise_ratio`` is the rss
    expected of noise that is smoothed away completely, over the target.
    """
    x, error, slope = point
    # at most a factor of 1000 in p
    if slope < 0:
        new = x - error / slope
        if (
            previous is not None
            and previous[2] < 0
            and abs(previous[1]) < MAX_CUBIC_ERROR
            and (previous[1] * error < 0.0 or abs(error) < 0.3 * abs(previous[1]))
        ):
            new = hermite_root(point, previous)
        elif abs(error) > REFINEMENT_ERROR and slope > -2.0:
            new = _step_by_model(point, noise_ratio)
        new = min(max(new, x - 7.0), x + 7.0)
        if low < new < high:
            return new
    return 0.5 * (low + high) if isfinite(low + high) else x + copysign(3.0, error)


def _step_by_model(point: SearchPoint, noise_ratio: float) -> float:
    """Return log p by a model of rss: noise, ``noise_ratio`` (1 - NOISE_SHARE p^(1/4)), and signal, b p^-power.

    Where this gives no plausible power, it is 2, as of smooth signals away from their ends, and the noise is
    rescaled.
    """
    x, error, slope = point
    rss, lost_share = exp(error), NOISE_SHARE * exp(0.25 * x)
    rate = slope * rss
    signal, power = rss - noise_ratio * (1.0 - lost_share), 0.0
    if signal > 0.0:
        power = -(rate + 0.25 * noise_ratio * lost_share) / signal
    # an implausible power of the signal: assume a smooth signal, and noise of another size
    if not 0.8 < power < 2.2:
        noise_ratio, power = (2.0 * rss + rate) / (2.0 - 2.25 * lost_share), 2.0
        signal = rss - noise_ratio * (1.0 - lost_share)
    if not (signal > 0.0 and lost_share < 0.5):
        return x - error / slope
    shift = 0.0  # of the change of log p, by Newton's method; the model is convex where signal is left
    for _ in range(20):
        remaining_signal, spline_noise = signal * exp(-power * shift), noise_ratio * lost_share * exp(0.25 * shift)
        change = (noise_ratio - spline_noise + remaining_signal - 1.0) / (
            0.25 * spline_noise + power * remaining_signal
        )
        shift = min(max(shift + min(max(change, -1.0), 1.0), -7.0), 7.0)
        if abs(change) < 1e-3:
            break
    return x + shift


def hermite_root(a: SearchPoint, b: SearchPoint) -> float:
    """Return x(0) of the cubic x(error) through two points (x, error, slope)."""
    h = b[1] - a[1]
    s = -a[1] / h
    other = 1 - s
    return (
        a[0] * (1 + 2 * s) * (other * other)
        + b[0] * s * s * (3 - 2 * s)
        + h * (s * (other * other) / a[2] - s * s * other / b[2])
    )


def gcv_criterion(series: ScaledSeries, at: Solution) -> tuple[float, float]:
    """Return log of rss / (1 - edf / n)^2, and its slope by log p."""
    residual_degrees = max(series.system.size - at.rise, 1e-3)
    return log(max(at.rss, TINY)) - 2 * log(residual_degrees), at.slope + 2 * at.bend / residual_degrees


def reml_criterion(series: ScaledSeries, at: Solution) -> tuple[float, float]:
    """Return log(y' Q u) + log det / (n - 2), and its slope by log p."""
    penalised_rss = max(at.rss + at.p * at.energy, TINY)
    return log(
        penalised_rss
    ) + at.log_det / series.system.size, at.rise / series.system.size - at.p * at.energy / penalised_rss


def likelihood_criterion(series: ScaledSeries, at: Solution) -> tuple[float, float]:
    """Return (y' Q u / delta^2 + log det) / (n - 2) for a known delta, and its slope by log p."""
    unit = series.noise**2 * series.system.size
    penalised_rss, penalty = (at.rss + at.p * at.energy) / unit, at.p * at.energy / unit
    return penalised_rss + at.log_det / series.system.size, at.rise / series.system.size - penalty


def search_minimum(series: ScaledSeries, criterion: Criterion) -> SplineSearch:
    """Minimise a criterion over x = log p: a grid (on the middle of long data), then the zero of its slope."""
    if series.is_straight:
        return series.straight_solution()
    chunk = series.middle_part()
    # the criterion of the middle part says where to look, at a fraction of the cost
    if chunk is None or chunk.is_straight:  # a middle part at rest is not representative
        chunk = series
    widest = min(float(len(chunk.data)), MAX_BANDWIDTH)
    lowest, highest = log(p_of_bandwidth(widest)), log(p_of_bandwidth(MIN_BANDWIDTH))
    grid = [lowest + (highest - lowest) * k / (GRID_POINTS - 1) for k in range(GRID_POINTS)]
    points = yield from _points(chunk, criterion, grid)
    if not points:
        raise IllConditionedError("the criterion cannot be computed for any p")
    x, bracket = _lowest_minimum(points)
    if chunk is not series:
        x, bracket = yield from _bracket(series, criterion, x, (points[0][0], points[-1][0]))
    if bracket is not None:
        x = yield from _zero_slope(series, criterion, *bracket)
    return (yield from once(series, exp(x)))


def _points(
    series: ScaledSeries, criterion: Criterion, grid: Sequence[float]
) -> Generator[Sequence[SplineTrial], Sequence[Answer], list[SearchPoint]]:
    """Return log p, the criterion and its slope at those points of a grid where they can be computed."""
    answers = yield [SplineTrial(series, exp(x), trace=True, determinant=criterion is not gcv_criterion) for x in grid]
    solved = [(float(x), at) for x, at in zip(grid, answers, strict=True) if isinstance(at, Solution)]
    return [point for x, at in solved if all(map(isfinite, point := (x, *criterion(series, at))))]


def _lowest_minimum(points: list[SearchPoint]) -> tuple[float, Bracket | None]:
    """Return the approximate place of the lowest minimum, and the two points around it; None at an end of the range."""
    # candidates: a range end towards which the criterion falls, and each pair of points with a minimum between them
    ends = [(points[0][1], points[0][0], None)] if points[0][2] >= 0 else []
    ends += [(points[-1][1], points[-1][0], None)] if points[-1][2] <= 0 else []
    between = [(*_cubic_minimum(a, b), (a, b)) for a, b in pairwise(points) if a[2] < 0 <= b[2]]
    _, x, bracket = min([*ends, *between], key=lambda candidate: candidate[0])
    return x, bracket


def _cubic_minimum(a: SearchPoint, b: SearchPoint) -> tuple[float, float]:
    """Return the approximate minimum, and its place, of the cubic with the values and slopes of two points."""
    h, s = b[0] - a[0], CUBIC_SHARES
    value = a[1] * (1 + 2 * s) * (1 - s) ** 2 + b[1] * s * s * (3 - 2 * s)
    value += h * s * (1 - s) * (a[2] * (1 - s) - b[2] * s)
    best = int(np.argmin(value))
    return float(value[best]), float(a[0] + s[best] * h)


def _bracket(
    series: ScaledSeries, criterion: Criterion, x: float, ends: tuple[float, float]
) -> Generator[Sequence[SplineTrial], Sequence[Answer], tuple[float, Bracket | None]]:
    """Walk downhill from x until the slope changes its sign; None at an end of the range."""
    step, previous = 1.0, None
    while True:
        points = yield from _points(series, criterion, [x])
        point = points[0] if points else (x, np.inf, -1.0)  # too ill-conditioned: less smoothing
        if previous is not None and point[2] * previous[2] <= 0:
            return x, (min(point, previous), max(point, previous))
        if (x <= ends[0] and point[2] >= 0) or (x >= ends[1] and point[2] <= 0):
            return x, None
        x, previous = float(np.clip(x - np.copysign(step, point[2]), *ends)), point
        step *= 2


def _zero_slope(
    series: ScaledSeries, criterion: Criterion, a: SearchPoint, b: SearchPoint
) -> Generator[Sequence[SplineTrial], Sequence[Answer], float]:
    """Return where the slope, negative at a and positive at b, is zero: inverse interpolation within a bracket."""
    history, x = [a, b], _cubic_minimum(a, b)[1]
    for _ in range(MAX_STEPS):
        points = yield from _points(series, criterion, [x])
        if not points:
            raise IllConditionedError("the criterion cannot be computed beside its minimum")
        # the parabola takes the last three points; the bracket around the zero is kept beside them
        history = [*history[-2:], points[0]]
        a, b = (points[0], b) if points[0][2] < 0 else (a, points[0])
        new = _parabola_zero(history)
        new = new if a[0] < new < b[0] else 0.5 * (a[0] + b[0])
        if abs(new - x) * min(1.0, abs(new - history[1][0])) < TOLERANCE:  # more than what is left
            return new
        x = new
    return x


def _parabola_zero(points: list[SearchPoint]) -> float:
    """Return where the slope is zero of the parabola x(slope) through three points."""
    (a, _, fa), (b, _, fb), (c, _, fc) = points
    if fa == fb or fb == fc or fc == fa:
        return nan
    return (
        a * fb * fc / ((fa - fb) * (fa - fc))
        + b * fc * fa / ((fb - fc) * (fb - fa))
        + c * fa * fb / ((fc - fa) * (fc - fb))
    )
