"""Equations as MathML, which browsers typeset by themselves.

An equation is a Python expression: it is parsed, and never evaluated. All that is written is escaped.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator, Mapping
from html import escape

from markupsafe import Markup

from dynident.runtime import number

Substitutes = Mapping[str, float | str]
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


def inline(text: str, substitutes: Substitutes | None = None, is_markup: bool = False) -> Markup:
    """Return an expression, or MathML where ``is_markup``, as an element among words. Raises what
    ``signed_summands`` does.
    """
    if is_markup:
        return Markup(f"<math>{text}</math>")  # noqa: S704 -- made here, of escaped parts
    inner = _expression(_parse(text), substitutes or {})
    return Markup(f'<math alttext="{escape(text)}">{inner}</math>')  # noqa: S704 -- likewise


def signed_summands(text: str, substitutes: Substitutes | None = None) -> list[tuple[str, str]]:
    """Return the summands of an expression, each with its sign, between which a line may end.

    Raises SyntaxError for a text that is no expression, ValueError for one that holds more than formulas do.
    """
    values = substitutes or {}
    return [(sign, _product_markup(node, values)) for sign, node in _summands(_parse(text), values)]


def formula(text: str) -> str:
    """Return a text as a formula where it is an expression, unchanged where it is none."""
    try:
        return inline(text)
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return text


def with_symbol(text: str, name: str) -> str:
    """Return the summands of an expression that hold a name, as an expression."""
    holding = [
        ast.unparse(node)
        for _, node in _summands(_parse(text), {})
        if any(isinstance(part, ast.Name) and part.id == name for part in ast.walk(node))
    ]
    return " + ".join(holding)


def symbol(name: str) -> str:
    """Return a name as a symbol: F_c has a subscript, as theta1 has; dq and ddq are q with dots."""
    name = WORDS.get(name, name).lstrip("_")
    if moving := MOVING.fullmatch(name):
        dots, base, below = moving.groups()
        over = f'<mover accent="true">{symbol(base)}<mo stretchy="false">{DOTS[dots]}</mo></mover>'
        return _with_subscript(over, below.lstrip("_"))
    parts = PARTS.fullmatch(name)
    base, below = parts.groups() if parts else (name, "")
    # In a short name such as lc1 or Ixx the first letter is the symbol, the rest its subscript
    if base not in GREEK and 1 < len(base) <= SHORT:
        base, below = base[0], base[1:] + below
    return _with_subscript(f"<mi>{escape(GREEK.get(base, base))}</mi>", below)


def named_symbol(base: str, name: str) -> str:
    """Return a symbol with a name given by the user as its subscript."""
    return f"<msub>{symbol(base)}{LOWER.format(f'<mtext>{escape(name)}</mtext>')}</msub>"


def with_primes(base: str, primes: int) -> str:
    """Return a symbol with ``primes`` primes, which tell it from others of the same name."""
    return f"<msup>{base}<mo>{PRIME * primes}</mo></msup>" if primes else base


class ExactNumber(float):
    """A given number, which is shown without trailing zeros."""


def number_markup(value: float) -> str:
    """Return the magnitude of a number to three digits, with a power of ten where it needs one."""
    text = f"{abs(value):.4g}" if isinstance(value, ExactNumber) else number(abs(value), DIGITS)
    plain, _, power = text.partition("e")
    if not power:
        return f"<mn>{plain}</mn>"
    sign = f"<mo>{MINUS}</mo>" if power.startswith("-") else ""
    ten = f"<msup><mn>10</mn><mrow>{sign}<mn>{power.lstrip('-+0')}</mn></mrow></msup>"
    return f"<mrow><mn>{plain}</mn><mo>\u00d7</mo>{ten}</mrow>"


def _with_subscript(base: str, text: str) -> str:
    if not text:
        return base
    tag = "mn" if text.isdigit() else "mtext"
    return f"<msub>{base}{LOWER.format(f'<{tag}>{escape(text)}</{tag}>')}</msub>"


def _parse(text: str) -> ast.expr:
    return ast.parse(text.strip(), mode="eval").body


def _numeric_value(node: ast.expr, substitutes: Substitutes) -> float | None:
    """Return the number that an expression stands for, None where it is more than a number."""
    match node:
        case ast.Constant(value=int() | float() as given):
            return ExactNumber(given)
        case ast.Name(id=name):
            value = substitutes.get(name)
            return value if isinstance(value, float) else None
        case ast.UnaryOp(op=ast.USub(), operand=inner):
            operand = _numeric_value(inner, substitutes)
            return None if operand is None else type(operand)(-operand)
    return None


def _summands(node: ast.expr, substitutes: Substitutes, sign: str = "+") -> Iterator[tuple[str, ast.expr]]:
    opposite = {"+": MINUS, MINUS: "+"}[sign]
    match node:
        case ast.BinOp(left=left, op=ast.Add() | ast.Sub() as op, right=right):
            yield from _summands(left, substitutes, sign)
            yield from _summands(right, substitutes, sign if isinstance(op, ast.Add) else opposite)
        case ast.UnaryOp(op=ast.USub(), operand=inner):
            yield from _summands(inner, substitutes, opposite)
        case _:
            # The sign of a product is that of its first factor
            factor = _factors(node)[0]
            value = _numeric_value(factor, substitutes)
            negative = isinstance(factor, ast.UnaryOp) if value is None else value < 0
            yield (opposite if negative else sign), node


def _is_sum(node: ast.expr) -> bool:
    return isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add | ast.Sub)


def _factors(node: ast.expr) -> list[ast.expr]:
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Mult):
        return [*_factors(node.left), *_factors(node.right)]
    return [node]


def _expression(node: ast.expr, substitutes: Substitutes) -> str:
    """Return an expression with the signs between its summands."""
    summands = list(_summands(node, substitutes))
    out = [_product_markup(summands[0][1], substitutes)]
    if summands[0][0] == MINUS:
        out.insert(0, f'<mo form="prefix">{MINUS}</mo>')
    for sign, summand in summands[1:]:
        out += [f"<mo>{sign}</mo>", _product_markup(summand, substitutes)]
    return f"<mrow>{''.join(out)}</mrow>" if len(out) > 1 else out[0]


def _product_markup(node: ast.expr, substitutes: Substitutes) -> str:
    """Return a summand without its sign."""
    factors = _factors(node)
    numbers = [_numeric_value(candidate, substitutes) for candidate in factors]
    out = []
    for k, (factor, value) in enumerate(zip(factors, numbers, strict=True)):
        if k:
            is_numeric = value is not None and numbers[k - 1] is not None
            out.append("<mo>\u00b7</mo>" if is_numeric else TIMES)
        if value is not None:
            inner = number_markup(value)
            out.append(inner if value >= 0 or k == 0 else _in_brackets(f"<mo>{MINUS}</mo>{inner}"))
            continue
        if k == 0 and isinstance(factor, ast.UnaryOp):
            factor = factor.operand  # its sign stands before the summand
        plain = len(factors) == 1 or not (_is_sum(factor) or isinstance(factor, ast.UnaryOp))
        out.append(_atom(factor, substitutes) if plain else _in_brackets(_expression(factor, substitutes)))
    return f"<mrow>{''.join(out)}</mrow>" if len(out) > 1 else out[0]


def _atom(node: ast.expr, substitutes: Substitutes) -> str:
    match node:
        case ast.Name(id=name):
            return str(substitutes.get(name, symbol(name)))
        case ast.BinOp(left=base, op=ast.Pow(), right=exponent):
            return _power_markup(base, _expression(exponent, substitutes), substitutes)
        case ast.BinOp(left=above, op=ast.Div(), right=below):
            return _fraction(above, below, substitutes)
        case ast.BinOp(op=ast.Add() | ast.Sub()) | ast.UnaryOp(op=ast.USub()):
            return _expression(node, substitutes)
        case ast.Call(func=ast.Name(id=name), args=[argument, *rest], keywords=[]):
            return _call_markup(name, argument, rest, substitutes)
    raise ValueError(f"no formula: {ast.dump(node)[:80]}")


def _fraction(above: ast.expr, below: ast.expr, substitutes: Substitutes) -> str:
    """Return a quotient in one line, as it stands among words and in exponents."""
    top, bottom = _expression(above, substitutes), _expression(below, substitutes)
    top = _in_brackets(top) if _is_sum(above) else top
    bottom = bottom if isinstance(below, ast.Name | ast.Constant | ast.Call) else _in_brackets(bottom)
    return f"<mrow>{top}<mo>/</mo>{bottom}</mrow>"


def _power_markup(base: ast.expr, exponent: str, substitutes: Substitutes) -> str:
    match base:
        case ast.Call(func=ast.Name(id=name), args=[argument]) if name not in ("abs", "exp", "sqrt"):
            return _application(f"<msup>{_function(name)}{exponent}</msup>", [argument], substitutes)
        case ast.Name() | ast.Call(func=ast.Name(id="abs")):
            base_markup = _atom(base, substitutes)
        case _:
            value = _numeric_value(base, substitutes)
            base_markup = number_markup(value or 0.0)
            if value is None or value < 0:
                base_markup = _in_brackets(_expression(base, substitutes))
    # An exponent stands above the subscript, not beside it
    if isinstance(base, ast.Name) and base_markup.startswith("<msub>"):  # above its subscript
        return f"<msubsup>{base_markup.removeprefix('<msub>').removesuffix('</msub>')}{exponent}</msubsup>"
    return f"<msup>{base_markup}{exponent}</msup>"


def _call_markup(name: str, argument: ast.expr, others: list[ast.expr], substitutes: Substitutes) -> str:
    inner = _expression(argument, substitutes)
    if name == "exp" and not others:
        return f"<msup><mi>e</mi>{inner}</msup>"
    if name == "sqrt" and not others:
        return f"<msqrt>{inner}</msqrt>"
    if name == "abs" and not others:
        bars = (f'<mo form="{form}" stretchy="false">|</mo>' for form in ("prefix", "postfix"))
        return f"<mrow>{inner.join(bars)}</mrow>"
    if name == "sign" and len(others) == 1:
        function = f"<msub>{_function(name)}{_expression(others[0], substitutes)}</msub>"
        return _application(function, [argument], substitutes)
    return _application(_function(name), [argument, *others], substitutes)


def _function(name: str) -> str:
    return f"<mi>{escape(FUNCTIONS.get(name, name))}</mi>"


def _application(function: str, arguments: list[ast.expr], substitutes: Substitutes) -> str:
    inner = "<mo>,</mo>".join(_expression(argument, substitutes) for argument in arguments)
    return f"<mrow>{function}{APPLIED}{_in_brackets(inner)}</mrow>"


def _in_brackets(inner: str) -> str:
    return f'<mrow><mo stretchy="false">(</mo>{inner}<mo stretchy="false">)</mo></mrow>'
