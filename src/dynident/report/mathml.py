"""Equations as MathML, which browsers typeset by themselves.

An equation is a Python expression: it is parsed, and never evaluated. All that is written is escaped.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator, Mapping
from html import escape
from typing import TYPE_CHECKING

from dynident.report.page import number

if TYPE_CHECKING:
    from markupsafe import Markup

__all__ = [
    "MINUS",
    "Exact",
    "Known",
    "formula",
    "inline",
    "named",
    "pieces",
    "primed",
    "symbol",
    "valued",
    "with_symbol",
]

Known = Mapping[str, float | str]
"""What stands for a name: a number, or MathML that ``symbol`` or ``named`` has made; else the name itself."""

DOTS = {"d": "\u02d9", "dd": "\u00a8"}
MOVING = re.compile(r"(d{1,2})(q|z|phi)(.*)", re.DOTALL)
PARTS = re.compile(r"([^\W\d_]+)_?(.*)", re.DOTALL)
LETTERS = (
    *("alpha", "beta", "gamma", "delta", "epsilon", "zeta", "eta", "theta", "iota", "kappa", "lambda", "mu"),
    *("nu", "xi", "omicron", "pi", "rho", "", "sigma", "tau", "upsilon", "phi", "chi", "psi", "omega"),
)
GREEK = {name: chr(0x3B1 + k) for k, name in enumerate(LETTERS) if name}
SHORT = 3  # letters of a name of which the first is the symbol, as of lc1 and Ixx
WORDS = {"load": "tau_b"}  # of an equation, as a reader knows them
FUNCTIONS = {"sign": "sgn"}
TIMES, APPLIED = '<mo>\u2062</mo><mspace width="0.14em"></mspace>', "<mo>\u2061</mo>"
MINUS, PRIME = "\u2212", "\u2032"
LOWER = '<mpadded voffset="-0.12em">{}</mpadded>'  # where no font of mathematics is there, subscripts are too high
DIGITS = 3  # of a value


def inline(text: str, known: Known | None = None, ready: bool = False) -> Markup:
    """Return an expression, or MathML where ``ready``, as an element among words. Raises what ``pieces`` does."""
    from markupsafe import Markup

    if ready:
        return Markup(f"<math>{text}</math>")  # noqa: S704 -- made here, of escaped parts
    inner = _written(_parsed(text), known or {})
    return Markup(f'<math alttext="{escape(text)}">{inner}</math>')  # noqa: S704 -- likewise


def pieces(text: str, known: Known | None = None) -> list[tuple[str, str]]:
    """Return the summands of an expression, each with its sign, between which a line may end.

    Raises SyntaxError for a text that is no expression, ValueError for one that holds more than formulas do.
    """
    return [(sign, _product(node, known or {})) for sign, node in _summands(_parsed(text), known or {})]


def formula(text: str) -> str:
    """Return a text as an element where it is an expression, as it is where it is none."""
    try:
        return inline(text)
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return text


def with_symbol(text: str, name: str) -> str:
    """Return the summands of an expression that hold a name, as an expression."""
    holding = [
        ast.unparse(node)
        for _, node in _summands(_parsed(text), {})
        if any(isinstance(one, ast.Name) and one.id == name for one in ast.walk(node))
    ]
    return " + ".join(holding)


def symbol(name: str) -> str:
    """Return a name as a symbol: F_c has a subscript, as theta1 has; dq and ddq are q with dots."""
    name = WORDS.get(name, name).lstrip("_")
    if moving := MOVING.fullmatch(name):
        dots, base, below = moving.groups()
        over = f'<mover accent="true">{symbol(base)}<mo stretchy="false">{DOTS[dots]}</mo></mover>'
        return _below(over, below.lstrip("_"))
    parts = PARTS.fullmatch(name)
    base, below = parts.groups() if parts else (name, "")
    if base not in GREEK and 1 < len(base) <= SHORT:
        base, below = base[0], base[1:] + below
    return _below(f"<mi>{escape(GREEK.get(base, base))}</mi>", below)


def named(base: str, name: str) -> str:
    """Return the symbol of something with a name of the user, which stands below it as it is."""
    return f"<msub>{symbol(base)}{LOWER.format(f'<mtext>{escape(name)}</mtext>')}</msub>"


def primed(base: str, primes: int) -> str:
    """Return a symbol with so many primes, which tell it from others of the same name."""
    return f"<msup>{base}<mo>{PRIME * primes}</mo></msup>" if primes else base


class Exact(float):
    """A number that was given: it is shown without zeros at its end."""


def valued(value: float, digits: int = DIGITS) -> str:
    """Return the size of a number, to so many digits, with a power of ten where it needs one."""
    shown = f"{abs(value):.4g}" if isinstance(value, Exact) else number(abs(value), digits)
    plain, _, power = shown.partition("e")
    if not power:
        return f"<mn>{plain}</mn>"
    sign = f"<mo>{MINUS}</mo>" if power.startswith("-") else ""
    ten = f"<msup><mn>10</mn><mrow>{sign}<mn>{power.lstrip('-+0')}</mn></mrow></msup>"
    return f"<mrow><mn>{plain}</mn><mo>\u00d7</mo>{ten}</mrow>"


def _below(base: str, text: str) -> str:
    if not text:
        return base
    tag = "mn" if text.isdigit() else "mtext"
    return f"<msub>{base}{LOWER.format(f'<{tag}>{escape(text)}</{tag}>')}</msub>"


def _parsed(text: str) -> ast.expr:
    return ast.parse(text.strip(), mode="eval").body


def _value(node: ast.expr, known: Known) -> float | None:
    """Return the number that an expression is, as far as it is a mere one."""
    match node:
        case ast.Constant(value=int() | float() as given):
            return Exact(given)
        case ast.Name(id=name):
            value = known.get(name)
            return value if isinstance(value, float) else None
        case ast.UnaryOp(op=ast.USub(), operand=inner):
            turned = _value(inner, known)
            return None if turned is None else type(turned)(-turned)
    return None


def _summands(node: ast.expr, known: Known, sign: str = "+") -> Iterator[tuple[str, ast.expr]]:
    turned = {"+": MINUS, MINUS: "+"}[sign]
    match node:
        case ast.BinOp(left=left, op=ast.Add() | ast.Sub() as op, right=right):
            yield from _summands(left, known, sign)
            yield from _summands(right, known, sign if isinstance(op, ast.Add) else turned)
        case ast.UnaryOp(op=ast.USub(), operand=inner):
            yield from _summands(inner, known, turned)
        case _:
            first = _factors(node)[0]
            value = _value(first, known)
            negative = isinstance(first, ast.UnaryOp) if value is None else value < 0
            yield (turned if negative else sign), node


def _is_sum(node: ast.expr) -> bool:
    return isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add | ast.Sub)


def _factors(node: ast.expr) -> list[ast.expr]:
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Mult):
        return [*_factors(node.left), *_factors(node.right)]
    return [node]


def _written(node: ast.expr, known: Known) -> str:
    """Return an expression with the signs between its summands."""
    found = list(_summands(node, known))
    out = [_product(found[0][1], known)]
    if found[0][0] == MINUS:
        out.insert(0, f'<mo form="prefix">{MINUS}</mo>')
    for sign, one in found[1:]:
        out += [f"<mo>{sign}</mo>", _product(one, known)]
    return f"<mrow>{''.join(out)}</mrow>" if len(out) > 1 else out[0]


def _product(node: ast.expr, known: Known) -> str:
    """Return a summand without its sign."""
    factors = _factors(node)
    numbers = [_value(one, known) for one in factors]
    out = []
    for k, (factor, value) in enumerate(zip(factors, numbers, strict=True)):
        if k:
            both = value is not None and numbers[k - 1] is not None
            out.append("<mo>\u00b7</mo>" if both else TIMES)
        if value is not None:
            inner = valued(value)
            out.append(inner if value >= 0 or k == 0 else _bracketed(f"<mo>{MINUS}</mo>{inner}"))
            continue
        if k == 0 and isinstance(factor, ast.UnaryOp):
            factor = factor.operand  # its sign stands before the summand
        plain = len(factors) == 1 or not (_is_sum(factor) or isinstance(factor, ast.UnaryOp))
        out.append(_atom(factor, known) if plain else _bracketed(_written(factor, known)))
    return f"<mrow>{''.join(out)}</mrow>" if len(out) > 1 else out[0]


def _atom(node: ast.expr, known: Known) -> str:
    match node:
        case ast.Name(id=name):
            return str(known.get(name, symbol(name)))
        case ast.BinOp(left=base, op=ast.Pow(), right=exponent):
            return _power(base, _written(exponent, known), known)
        case ast.BinOp(left=above, op=ast.Div(), right=below):
            return _fraction(above, below, known)
        case ast.BinOp(op=ast.Add() | ast.Sub()) | ast.UnaryOp(op=ast.USub()):
            return _written(node, known)
        case ast.Call(func=ast.Name(id=name), args=[argument, *rest], keywords=[]):
            return _call(name, argument, rest, known)
    raise ValueError(f"no formula: {ast.dump(node)[:80]}")


def _fraction(above: ast.expr, below: ast.expr, known: Known) -> str:
    """Return a quotient in one line, as it stands among words and in exponents."""
    top, bottom = _written(above, known), _written(below, known)
    top = _bracketed(top) if _is_sum(above) else top
    bottom = bottom if isinstance(below, ast.Name | ast.Constant | ast.Call) else _bracketed(bottom)
    return f"<mrow>{top}<mo>/</mo>{bottom}</mrow>"


def _power(base: ast.expr, exponent: str, known: Known) -> str:
    match base:
        case ast.Call(func=ast.Name(id=name), args=[argument]) if name not in ("abs", "exp", "sqrt"):
            return _applied(f"<msup>{_function(name)}{exponent}</msup>", [argument], known)
        case ast.Name():
            whole = _atom(base, known)
        case ast.Call(func=ast.Name(id="abs")):
            whole = _atom(base, known)
        case _:
            value = _value(base, known)
            whole = valued(value) if value is not None and value >= 0 else _bracketed(_written(base, known))
    if isinstance(base, ast.Name) and whole.startswith("<msub>"):  # above its subscript
        return f"<msubsup>{whole.removeprefix('<msub>').removesuffix('</msub>')}{exponent}</msubsup>"
    return f"<msup>{whole}{exponent}</msup>"


def _call(name: str, argument: ast.expr, rest: list[ast.expr], known: Known) -> str:
    inner = _written(argument, known)
    if name == "exp" and not rest:
        return f"<msup><mi>e</mi>{inner}</msup>"
    if name == "sqrt" and not rest:
        return f"<msqrt>{inner}</msqrt>"
    if name == "abs" and not rest:
        bars = (f'<mo form="{form}" stretchy="false">|</mo>' for form in ("prefix", "postfix"))
        return f"<mrow>{inner.join(bars)}</mrow>"
    if name == "sign" and len(rest) == 1:
        return _applied(f"<msub>{_function(name)}{_written(rest[0], known)}</msub>", [argument], known)
    return _applied(_function(name), [argument, *rest], known)


def _function(name: str) -> str:
    return f"<mi>{escape(FUNCTIONS.get(name, name))}</mi>"


def _applied(function: str, arguments: list[ast.expr], known: Known) -> str:
    inner = "<mo>,</mo>".join(_written(one, known) for one in arguments)
    return f"<mrow>{function}{APPLIED}{_bracketed(inner)}</mrow>"


def _bracketed(inner: str) -> str:
    return f'<mrow><mo stretchy="false">(</mo>{inner}<mo stretchy="false">)</mo></mrow>'
