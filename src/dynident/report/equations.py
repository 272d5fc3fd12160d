"""The section of a report on its model: what it is made of, as equations, with the values that were found."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from typing import TYPE_CHECKING

import numpy as np

from dynident.estimators import Provenance
from dynident.models import Equation, HasEquations, Lagrangian, Loads, declares
from dynident.report.mathml import MINUS, Exact, Known, inline, named, pieces, primed, symbol
from dynident.report.page import PageBlock, PageSection
from dynident.report.term_words import KINDS, MASS, equation_words, turning
from dynident.report.typography import unit_text
from dynident.report.words import count, listed

if TYPE_CHECKING:
    from collections.abc import Iterable

    from markupsafe import Markup

    from dynident.identification import Identification
    from dynident.models import Model, Term

__all__ = ["model_section"]

DETERMINED = (Provenance.DATA, Provenance.PRIOR, Provenance.BOUND)
ORDER = (MASS, *KINDS.values())  # of the summands; those of the user come before the constant torque
LONGEST = 600  # signs of the torque of one joint by energies that is written out
FEW = 8  # joints that are named before their law
SPECIAL: Mapping[str, str] = {
    "load": "the torque of the bodies by a first fit",
    "z": "how far the contact is bent, 1 where it slides",
    "t": "the time since the recording began (s)",
}
_FOUND = "In numbers, SI units. What the data do not determine by itself stays a symbol; what is zero is left out."


@dataclass(frozen=True)
class _Law:
    """What acts at one joint or in one motor beside the bodies.

    ``summands`` are equations with the words for their terms; ``others`` the names of motors with their factors, and of
    terms that have no equation.
    """

    name: str
    summands: list[tuple[str, Equation]] = field(default_factory=list)
    others: list[tuple[str, float]] = field(default_factory=list)

    @property
    def shape(self) -> tuple[object, ...]:
        """What laws of the same symbols have in common."""
        return tuple(one.torque for _, one in self.summands), tuple(self.others)

    def parts(self, values: Mapping[str, float] | None = None) -> Iterator[tuple[str, Known]]:
        """Yield the texts of the summands with what stands for their symbols; ``values`` by the parameters' names."""
        used: dict[str, int] = {}
        for _, one in self.summands:
            known: dict[str, float | str] = {}
            own = {name: of for name, of in zip(one.symbols, one.parameters, strict=True) if len(of) == 1}
            for name in (*one.symbols, *(name for name, _, _ in one.constants), *(name for name, _ in one.where)):
                used[name] = used.get(name, -1) + 1
                known[name] = primed(symbol(own.get(name, name)), used[name])
            if values is not None and not any(values.get(name, 1.0) for name in one.parameters):
                continue  # found to be zero
            known |= turning(one)
            if values is not None:
                known |= {name: Exact(value) for name, value, _ in one.constants}
                paired = zip(one.symbols, one.parameters, strict=True)
                known |= {name: values[parameter] for name, parameter in paired if parameter in values}
            yield one.torque, known
        for name, factor in self.others:
            yield ("other" if factor == 1 else "factor * other"), {"factor": Exact(factor), "other": named("tau", name)}


def model_section(found: Identification) -> Iterator[PageSection]:
    """Yield the section of the model: the whole, the law of each joint, and the laws with the values found."""
    joints, motors = _laws(found.model)
    left = symbol("tau_f" if any(map(_is_body, found.model.terms)) else "tau")
    blocks: list[PageBlock] = [*_whole(found.model, bool(joints))]
    if joints:
        blocks.append(_box("Friction and other laws", [*_in_symbols(found.model, joints, left), *_of_motors(motors)]))
        blocks.append(_legend(found.model, [*joints, *motors]))
        values = _values(found)
        rows = [(law.name, _sum(left, law.parts(values)), _effort(found.model, law.name)) for law in joints]
        blocks += [_FOUND, _box("Laws with the values found", [*rows, *_of_motors(motors, values)])]
    if blocks:
        yield PageSection("Model", tuple(blocks))


def _is_body(term: Term) -> bool:
    return isinstance(term, Loads) and term.loads


def _laws(model: Model) -> tuple[list[_Law], list[_Law]]:
    """Return the laws of the joints, of those where something acts, and of the motors that are coupled to several."""
    laws = {joint.name: _Law(joint.name) for joint in model.joints}
    motors: dict[str, _Law] = {}
    unit_of = {one.name: one.unit for one in model.parameters}
    for term in model.terms:
        said = term.equations if isinstance(term, HasEquations) and declares(term, "equations") else ()
        for one in said:
            if one.motor and one.motor not in motors:
                motors[one.motor] = _Law(one.motor)
                for name, factor in one.on:
                    laws[name].others.append((one.motor, factor))
            law = motors[one.motor] if one.motor else laws[one.on[0][0]]
            law.summands.append((equation_words(term, one, unit_of[one.parameters[0]]), one))
        if not said and not _is_body(term):
            for name in getattr(term, "acts_on", laws):
                laws[name].others.append((type(term).__name__, 1.0))
    for law in (*laws.values(), *motors.values()):
        law.summands.sort(key=lambda pair: ORDER.index(pair[0]) if pair[0] in ORDER else len(ORDER) - 1)
    return [law for law in laws.values() if law.summands or law.others], list(motors.values())


def _whole(model: Model, more: bool) -> Iterator[PageBlock]:
    """Yield the equation of the bodies, and the words for its symbols."""
    terms = [term for term in model.terms if _is_body(term)]
    if not terms:
        return
    text = "M(q) * ddq + C(q, dq) * dq + g(q)" + " + tau_f" * more
    yield _box("The model", [("of the arm", _sum(symbol("tau"), [(text, {})]), "")])
    bodies = {one.body for term in terms for one in term.parameters if one.body}
    words = [f"{_math('M')}, {_math('C')} and {_math('g')}: mass matrix, Coriolis and centrifugal torques, gravity"]
    if bodies:
        words[0] += f" of {len(bodies)} {'body' if len(bodies) == 1 else 'bodies'}, by ten parameters each"
    words += [f"{_math('tau_f')}: friction and all else that acts at single joints or in motors"] * more
    yield _paragraph(f"{'; '.join(words)}. All of it is linear in the {count(len(model.parameters), 'parameter')}.")
    for term in terms:
        if isinstance(term, Lagrangian):
            yield from _written_out(term, symbol("tau_b" if more else "tau"))


def _written_out(term: Lagrangian, left: str) -> Iterator[PageBlock]:
    """Yield the torque of the bodies where it was derived from energies, and is not too long."""
    rows, one = [], len(term.joints) == 1
    known: dict[str, float | str] = {}
    for k in range(len(term.joints)):
        at = "" if one else f"_{k + 1}"
        known |= {str(term.q[k]): symbol(f"q{at}"), str(term.dq[k]): symbol(f"dq{at}")}
        known[f"ddq_{k + 1}"] = symbol(f"ddq{at}")
    for joint, texts in zip(term.joints, term.texts(), strict=True):
        acting = [(k, text) for k, text in enumerate(texts) if text != "0"]
        if sum(len(text) for _, text in acting) > LONGEST:
            return
        own = {f"p_{k}": symbol(term.parameters[k].name) for k, _ in acting}
        parts = [(f"p_{k} * ({text})", {**known, **own}) for k, text in acting]
        rows.append((joint.name, _sum(left, parts), ""))
    yield _box("The bodies", rows)


def _in_symbols(model: Model, joints: Sequence[_Law], left: str) -> Iterator[tuple[str, Markup, str]]:
    """Yield the laws in symbols, joints with the same one together."""
    groups: dict[object, list[_Law]] = {}
    for law in joints:
        groups.setdefault(law.shape, []).append(law)
    for group in groups.values():
        all_of_them = len(group) == len(model.joints) > 1
        who = "each joint" if all_of_them else listed((law.name for law in group), FEW)
        yield who, _sum(left, group[0].parts()), ""


def _of_motors(motors: Sequence[_Law], values: Mapping[str, float] | None = None) -> Iterator[tuple[str, Markup, str]]:
    """Yield for each motor how it turns with its joints, where the laws are in symbols, and its law."""
    for motor in motors:
        one, left = motor.summands[0][1], named("tau", motor.name)
        if values is None:
            known = {f"q_{k}": named("q", name) for k, (name, _) in enumerate(one.on)}
            factors = {f"c_{k}": Exact(factor) for k, (_, factor) in enumerate(one.on)}
            text = " + ".join(f"q_{k}" if factor == 1 else f"c_{k} * q_{k}" for k, (_, factor) in enumerate(one.on))
            yield f"motor {motor.name}", _sum(symbol("phi"), [(text, {**known, **factors})]), ""
        yield ("" if values is None else f"motor {motor.name}"), _sum(left, motor.parts(values)), ""


def _legend(model: Model, laws: Sequence[_Law]) -> Markup:
    """Return what the symbols are, each once: parameters, then constants and what a term remembers."""
    said: dict[str, str] = {}
    unit_of = {one.name: one.unit for one in model.parameters}
    equations = [(words, one) for law in laws for words, one in law.summands]
    for words, one in equations:
        units = ", ".join(dict.fromkeys(unit_of[name] for name in one.parameters))
        own = [of if len(of) == 1 else name for name, of in zip(one.symbols, one.parameters, strict=True)]
        said.setdefault(", ".join(map(_math, own)), f"{escape(words)}{_in(units)}")
    for _, one in equations:
        for name, _, unit in one.constants:
            said.setdefault(_math(name), _constant(name, unit, [law for _, law in equations]))
        for name, text in one.where:
            said.setdefault(str(_sum(symbol(name), [(text, {})])), "")
    texts = " ".join(text for _, one in equations for text in (one.torque, *(text for _, text in one.where)))
    said |= {_math(name): words for name, words in SPECIAL.items() if name in _names(texts)}
    if "sign(dq, d_c)" in texts:
        said[_math("sign(x, d_c)")] = f"the sign, 0 up to {_math('d_c')}"
    return _paragraph("; ".join(f"{math} {words}".strip() for math, words in said.items()) + ".")


def _constant(name: str, unit: str, equations: Sequence[Equation]) -> str:
    """Return a constant's value with its unit, where it is the same at all joints; else the unit."""
    values = {value for one in equations for key, value, _ in one.constants if key == name}
    shown = "" if unit == "1" else f" {unit_text(unit)}"
    return f"= {inline(repr(float(values.pop())))}{shown}" if len(values) == 1 else f"differs by joint{_in(unit)}"


def _in(unit: str) -> str:
    return "" if unit in ("1", "") else f" ({escape(unit_text(unit))})"


def _names(text: str) -> set[str]:
    return set("".join(sign if sign.isalnum() or sign == "_" else " " for sign in text).split())


def _values(found: Identification) -> dict[str, float]:
    """Return the values to show by the parameters' names: those that something has determined."""
    estimate, errors = found.estimate, found.errors.best
    known = np.isfinite(errors)
    if estimate.provenance:
        known = np.array([one in DETERMINED for one in estimate.provenance])
    return {name: float(x) for name, x, good in zip(estimate.names, estimate.value, known, strict=True) if good}


def _effort(model: Model, joint: str) -> str:
    return next(unit_text(one.effort) for one in model.joints if one.name == joint)


def _sum(left: str, parts: Iterable[tuple[str, Known]]) -> Markup:
    """Return an equation in pieces, between which a line may end."""
    from markupsafe import Markup

    found = [piece for text, known in parts for piece in pieces(text, known)] or pieces("0")
    first = inline(f'{left}<mo rspace="0">=</mo>', ready=True)
    shown = []
    for k, (sign, inner) in enumerate(found):
        before = f'<mo form="prefix">{MINUS}</mo>' if sign == MINUS else ""
        shown.append(inline((f'<mo form="infix" lspace="0">{sign}</mo>' if k else before) + inner, ready=True))
    return Markup(" ").join([first, *shown])


def _math(text: str) -> str:
    return str(inline(text))


def _paragraph(html: str) -> Markup:
    from markupsafe import Markup

    return Markup(f"<p>{html}</p>")  # noqa: S704 -- of escaped parts


def _box(title: str, rows: Iterable[tuple[str, Markup, str]]) -> Markup:
    """Return equations below each other, each with what it holds for and its unit, in a box that scrolls by itself."""
    from markupsafe import Markup

    inner = Markup("").join(
        Markup('<div><span class="of">{}</span><span class="law">{} <span class="unit">{}</span></span></div>').format(
            *row
        )
        for row in rows
    )
    return Markup('<div class="equations" tabindex="0" role="group" aria-label="{}">{}</div>').format(title, inner)
