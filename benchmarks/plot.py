"""Curves over two logarithmic axes as SVG, with colours that are readable on white and on black."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import ceil, floor, log10

Curve = tuple[str, str, Sequence[tuple[float, float]]]  # name, colour, points
WIDTH, HEIGHT, LEFT, RIGHT, TOP, BOTTOM = 720, 330, 62, 190, 34, 46
LINE = 17  # height of a line of text


def curves(title: str, x: str, y: str, lines: Sequence[Curve]) -> str:
    """Return the picture; each curve is named at its right end."""
    points = [point for _, _, curve in lines for point in curve]
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}"',
        'font-family="sans-serif" font-size="13" fill="#7d7d7d">',
        f'<text x="{LEFT}" y="18">{title}: {y} over {x}</text>',
    ]
    if points:
        across = Axis([point[0] for point in points], LEFT, WIDTH - RIGHT)
        up = Axis([point[1] for point in points], HEIGHT - BOTTOM, TOP)
        parts += [*grid(across, up), *drawn(lines, across, up)]
        parts.append(f'<text x="{(LEFT + WIDTH - RIGHT) / 2}" y="{HEIGHT - 8}" text-anchor="middle">{x}</text>')
    return "\n".join([*parts, "</svg>", ""])


class Axis:
    """A logarithmic axis from ``first`` to ``last`` pixels that holds all values."""

    def __init__(self, values: Sequence[float], first: float, last: float) -> None:
        self.first, self.last = first, last
        low, high = log10(min(values)), log10(max(values))
        self.steps = (1, 2, 5) if high - low < 2.5 else (1,)
        every = [10.0**k * step for k in range(floor(low) - 1, ceil(high) + 1) for step in self.steps]
        self.low = max((log10(x) for x in every if log10(x) <= low + 0.02), default=low)
        self.high = min((log10(x) for x in every if log10(x) >= high - 0.02), default=high)
        self.ticks = [x for x in every if self.low - 1e-9 <= log10(x) <= self.high + 1e-9]

    def at(self, value: float) -> float:
        """Return the pixel of a value."""
        span = self.high - self.low or 1.0
        return round(self.first + (log10(value) - self.low) / span * (self.last - self.first), 1)


def grid(across: Axis, up: Axis) -> Iterator[str]:
    thin = 'stroke="#7d7d7d" stroke-opacity="0.3"'
    for tick in across.ticks:
        at = across.at(tick)
        yield f'<path {thin} d="M{at} {up.first}V{up.last}"/>'
        yield f'<text x="{at}" y="{up.first + LINE}" text-anchor="middle">{number(tick)}</text>'
    for tick in up.ticks:
        at = up.at(tick)
        yield f'<path {thin} d="M{across.first} {at}H{across.last}"/>'
        yield f'<text x="{across.first - 6}" y="{at + 4}" text-anchor="end">{number(tick)}</text>'


def number(value: float) -> str:
    return f"{value:g}" if value < 1e5 else f"1e{log10(value):.0f}"


def drawn(lines: Sequence[Curve], across: Axis, up: Axis) -> Iterator[str]:
    """Yield the curves, and their names where they do not cover each other."""
    ends = sorted((up.at(curve[-1][1]), name, colour, curve) for name, colour, curve in lines)
    last = -float(LINE)
    for end, name, colour, curve in ends:
        places = [(across.at(a), up.at(b)) for a, b in curve]
        path = "L".join(f"{a} {b}" for a, b in places)
        yield f'<path fill="none" stroke="{colour}" stroke-width="2" d="M{path}"/>'
        yield from (f'<circle cx="{a}" cy="{b}" r="3" fill="{colour}"/>' for a, b in places)
        last = max(end, last + LINE)
        yield f'<text x="{places[-1][0] + 9}" y="{last + 4}" fill="{colour}">{name}</text>'
