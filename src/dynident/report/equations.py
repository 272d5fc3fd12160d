"""The section of a report on its model: its equations, in symbols and with the values found."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import field
from html import escape

import numpy as np
from markupsafe import Markup

from dynident.estimators import Provenance
from dynident.identification import Identification
from dynident.models import CoupledFriction, CoupledMotor, Equation, Lagrangian, Model, RotorInertia, Term
from dynident.models.friction import Coulomb, Offset, Viscous
from dynident.report.mathml import (
    MINUS,
    ExactNumber,
    Substitutes,
    formula,
    inline,
    named_symbol,
    signed_summands,
    symbol,
    with_primes,
    with_symbol,
)
from dynident.report.page import PageBlock, PageSection, unit_text
from dynident.runtime import Noun, count, join_names
from dynident.runtime.families import TERMS

MASS = "mass, with that of the rotor"  # of a joint that slides
MOTOR = {"I_a": RotorInertia.title, "F_v": Viscous.title, "F_c": Coulomb.title, "tau_o": Offset.title}
DETERMINED = (Provenance.DATA, Provenance.PRIOR, Provenance.BOUND)
# of the summands: that of the table of terms; those of the user come before the constant torque
SUMMAND_ORDER = (MASS, *filter(None, (TERMS.get(kind).title for kind in TERMS.table)))
MAX_EQUATION_LENGTH = 600  # signs of the torque of one joint by energies that is written out
MAX_LISTED_JOINTS = 8  # joints that are named before their law
SPECIAL_SYMBOLS: Mapping[str, str] = {
    "load": "the torque of the bodies by a first fit",
    "z": "how far the contact is bent, 1 where it slides",
    "t": "the time since the recording began (s)",
}
_VALUES_NOTE = (
    "In numbers, SI units. What the data do not determine by itself stays a symbol; what is zero is left out."
)


def term_words(term: Term) -> str:
    """Return the name of a term; one of the user goes by its class."""
    cls = TERMS.get(term.law) if isinstance(term, CoupledFriction) else type(term)
    return str(vars(cls).get("title") or type(term).__name__)


def equation_words(term: Term, equation: Equation, unit: str) -> str:
    """Return the meaning of an equation's parameters; those of a motor are named as those of its joints."""
    words = MOTOR[equation.symbols[0]] if isinstance(term, CoupledMotor) else term_words(term)
    return MASS if words == RotorInertia.title and unit == "kg" else words


def parameter_meanings(model: Model) -> Iterator[tuple[str, str]]:
    """Yield the formula of each parameter: for bodies by the unknowns, else its part of the torque."""
    for term in model.terms:
        if isinstance(term, Lagrangian) or getattr(term, "expressions", None):
            yield from ((parameter.name, formula(parameter.expression)) for parameter in term.parameters)
        else:
            for equation in term.equations:
                words = equation_words(term, equation, "")
                for name, parameter in zip(equation.symbols, equation.parameters, strict=True):
                    yield parameter, _meaning_markup(words, name, parameter, equation)


def _meaning_markup(words: str, name: str, parameter: str, equation: Equation) -> Markup:
    substitutes = {name: symbol(parameter if len(parameter) == 1 else name)} | motor_symbols(equation)
    return Markup("{}: {}").format(words, inline(with_symbol(equation.torque, name), substitutes))


def motor_symbols(equation: Equation) -> dict[str, str]:
    """Return the symbols of a motor's motion, which replace those of the joint."""
    return {"q": symbol("phi"), "dq": symbol("dphi"), "ddq": symbol("ddphi")} if equation.motor else {}


class _Law(Noun):
    """What acts at one joint or in one motor beside the bodies.

    ``summands`` are equations with the words for their terms; ``extra_torques`` are names of motors with their
    factors, and of terms that have no equation.
    """

    name: str
    summands: list[tuple[str, Equation]] = field(default_factory=list)
    extra_torques: list[tuple[str, float]] = field(default_factory=list)

    def parts(self, values: Mapping[str, float] | None = None) -> Iterator[tuple[str, Substitutes]]:
        """Yield the texts of the summands with what stands for their symbols.

        ``values`` are by the names of the parameters; without them the symbols stay.
        """
        uses: dict[str, int] = {}
        for _, equation in self.summands:
            substitutes: dict[str, float | str] = {}
            pairs = list(zip(equation.symbols, equation.parameters, strict=True))
            short_names = {name: parameter for name, parameter in pairs if len(parameter) == 1}
            # A name that occurs again gets primes, which tell it from the first
            for name in (*equation.symbols, *(constant[0] for constant in equation.constants), *dict(equation.where)):
                uses[name] = uses.get(name, -1) + 1
                substitutes[name] = with_primes(symbol(short_names.get(name, name)), uses[name])
            if values is not None and not any(values.get(name, 1.0) for name in equation.parameters):
                continue  # found to be zero
            substitutes |= motor_symbols(equation)
            if values is not None:
                substitutes |= {name: ExactNumber(value) for name, value, _ in equation.constants}
                substitutes |= {name: values[parameter] for name, parameter in pairs if parameter in values}
            yield equation.torque, substitutes
        for name, factor in self.extra_torques:
            text = "other" if factor == 1 else "factor * other"
            yield text, {"factor": ExactNumber(factor), "other": named_symbol("tau", name)}


def model_section(identification: Identification) -> Iterator[PageSection]:
    """Yield the section of the model: the whole, the law of each joint, and the laws with the values found."""
    joints, motors = _laws(identification.model)
    lhs = symbol("tau_f" if any(term.loads for term in identification.model.terms) else "tau")
    blocks: list[PageBlock] = [*_body_blocks(identification.model, bool(joints))]
    if joints:
        laws = [*_symbolic_laws(identification.model, joints, lhs), *_motor_laws(motors)]
        blocks.append(_equation_box("Friction and other laws", laws))
        blocks.append(_legend(identification.model, [*joints, *motors]))
        values = _known_values(identification)
        efforts = {joint.name: unit_text(joint.effort) for joint in identification.model.joints}
        rows = [(law.name, _equation_markup(lhs, law.parts(values)), efforts[law.name]) for law in joints]
        blocks += [_VALUES_NOTE, _equation_box("Laws with the values found", [*rows, *_motor_laws(motors, values)])]
    if blocks:
        yield PageSection("Model", tuple(blocks))


def _laws(model: Model) -> tuple[list[_Law], list[_Law]]:
    """Return the laws of the joints at which something acts, and of the motors that are coupled to several joints."""
    laws = {joint.name: _Law(joint.name) for joint in model.joints}
    motors: dict[str, _Law] = {}
    unit_of = {parameter.name: parameter.unit for parameter in model.parameters}
    for term in model.terms:
        for equation in term.equations:
            if equation.motor and equation.motor not in motors:
                motors[equation.motor] = _Law(equation.motor)
                for name, factor in equation.on:
                    laws[name].extra_torques.append((equation.motor, factor))
            law = motors[equation.motor] if equation.motor else laws[equation.on[0][0]]
            law.summands.append((equation_words(term, equation, unit_of[equation.parameters[0]]), equation))
        # A term without equations is named by its class
        if not term.equations and not term.loads:
            for name in getattr(term, "acts_on", laws):
                laws[name].extra_torques.append((type(term).__name__, 1.0))
    places = {words: k for k, words in enumerate(SUMMAND_ORDER)}
    for law in (*laws.values(), *motors.values()):
        # Laws of the user come before the constant torque
        law.summands.sort(key=lambda pair: places.get(pair[0], len(SUMMAND_ORDER) - 1))
    return [law for law in laws.values() if law.summands or law.extra_torques], list(motors.values())


def _body_blocks(model: Model, with_friction: bool) -> Iterator[PageBlock]:
    """Yield the equation of the bodies and the meaning of its symbols."""
    terms = [term for term in model.terms if term.loads]
    if not terms:
        return
    text = "M(q) * ddq + C(q, dq) * dq + g(q)" + " + tau_f" * with_friction
    yield _equation_box("The model", [("of the arm", _equation_markup(symbol("tau"), [(text, {})]), "")])
    bodies = {parameter.body for term in terms for parameter in term.parameters if parameter.body}
    words = [f"{_math('M')}, {_math('C')} and {_math('g')}: mass matrix, Coriolis and centrifugal torques, gravity"]
    if bodies:
        words[0] += f" of {len(bodies)} {'body' if len(bodies) == 1 else 'bodies'}, by ten parameters each"
    words += [f"{_math('tau_f')}: friction and all else that acts at single joints or in motors"] * with_friction
    yield _paragraph(f"{'; '.join(words)}. All of it is linear in the {count(len(model.parameters), 'parameter')}.")
    for term in terms:
        if isinstance(term, Lagrangian):
            yield from _lagrangian_blocks(term, symbol("tau_b" if with_friction else "tau"))


def _lagrangian_blocks(term: Lagrangian, lhs: str) -> Iterator[PageBlock]:
    """Yield the torque of the bodies in full where it was derived from energies and is short enough."""
    rows, is_single = [], len(term.joints) == 1
    substitutes: dict[str, float | str] = {}
    for k in range(len(term.joints)):
        subscript = "" if is_single else f"_{k + 1}"
        substitutes |= {str(term.q[k]): symbol(f"q{subscript}"), str(term.dq[k]): symbol(f"dq{subscript}")}
        substitutes[f"ddq_{k + 1}"] = symbol(f"ddq{subscript}")
    for joint, texts in zip(term.joints, term.texts(), strict=True):
        acting = [(k, text) for k, text in enumerate(texts) if text != "0"]
        # One long equation fills the page: show none of them then
        if sum(len(text) for _, text in acting) > MAX_EQUATION_LENGTH:
            return
        coefficients = {f"p_{k}": symbol(term.parameters[k].name) for k, _ in acting}
        parts = [(f"p_{k} * ({text})", {**substitutes, **coefficients}) for k, text in acting]
        rows.append((joint.name, _equation_markup(lhs, parts), ""))
    yield _equation_box("The bodies", rows)


def _symbolic_laws(model: Model, joints: Sequence[_Law], lhs: str) -> Iterator[tuple[str, Markup, str]]:
    """Yield the laws in symbols; joints with the same law share a line."""
    groups: dict[object, list[_Law]] = {}
    for law in joints:
        symbols = tuple(equation.torque for _, equation in law.summands), tuple(law.extra_torques)
        groups.setdefault(symbols, []).append(law)
    for group in groups.values():
        all_of_them = len(group) == len(model.joints) > 1
        who = "each joint" if all_of_them else join_names((law.name for law in group), MAX_LISTED_JOINTS)
        yield who, _equation_markup(lhs, group[0].parts()), ""


def _motor_laws(motors: Sequence[_Law], values: Mapping[str, float] | None = None) -> Iterator[tuple[str, Markup, str]]:
    """Yield the law of each motor and, where it is in symbols, the motor's angle by those of its joints."""
    for motor in motors:
        equation, lhs = motor.summands[0][1], named_symbol("tau", motor.name)
        if values is None:
            positions = {f"q_{k}": named_symbol("q", name) for k, (name, _) in enumerate(equation.on)}
            factors = {f"c_{k}": ExactNumber(factor) for k, (_, factor) in enumerate(equation.on)}
            text = " + ".join(f"{f'c_{k} * ' * (factor != 1)}q_{k}" for k, (_, factor) in enumerate(equation.on))
            yield f"motor {motor.name}", _equation_markup(symbol("phi"), [(text, {**positions, **factors})]), ""
        yield ("" if values is None else f"motor {motor.name}"), _equation_markup(lhs, motor.parts(values)), ""


def _legend(model: Model, laws: Sequence[_Law]) -> Markup:
    """Return the meaning of each symbol, once: parameters, then constants and the states of terms with memory."""
    legend: dict[str, str] = {}
    unit_of = {parameter.name: parameter.unit for parameter in model.parameters}
    equations = [(words, equation) for law in laws for words, equation in law.summands]
    for words, equation in equations:
        units = ", ".join(dict.fromkeys(unit_of[name] for name in equation.parameters))
        pairs = zip(equation.symbols, equation.parameters, strict=True)
        shown = ", ".join(_math(parameter if len(parameter) == 1 else name) for name, parameter in pairs)
        legend.setdefault(shown, f"{escape(words)}{_unit_suffix(units)}")
    for _, equation in equations:
        for name, _, unit in equation.constants:
            legend.setdefault(_math(name), _constant_words(name, unit, [law for _, law in equations]))
        for name, text in equation.where:
            legend.setdefault(str(_equation_markup(symbol(name), [(text, {})])), "")
    texts = " ".join(" ".join((equation.torque, *dict(equation.where).values())) for _, equation in equations)
    names = set(re.findall(r"\w+", texts))
    legend |= {_math(name): words for name, words in SPECIAL_SYMBOLS.items() if name in names}
    # A sign with a dead zone needs its own line
    if "sign(dq, d_c)" in texts:
        legend[_math("sign(x, d_c)")] = f"the sign, 0 up to {_math('d_c')}"
    return _paragraph("; ".join(f"{math} {words}".strip() for math, words in legend.items()) + ".")


def _constant_words(name: str, unit: str, equations: Sequence[Equation]) -> str:
    """Return a constant's value with its unit where it is the same at all joints, else the unit."""
    values = {value for equation in equations for key, value, _ in equation.constants if key == name}
    suffix = "" if unit == "1" else f" {unit_text(unit)}"
    if len(values) > 1:
        return f"differs by joint{_unit_suffix(unit)}"
    return f"= {inline(repr(float(values.pop())))}{suffix}"


def _unit_suffix(unit: str) -> str:
    return "" if unit in ("1", "") else f" ({escape(unit_text(unit))})"


def _known_values(identification: Identification) -> dict[str, float]:
    """Return the values to show by parameter name: those that data, prior or a bound determine."""
    estimate, errors = identification.estimate, identification.errors.std
    is_known = np.isfinite(errors)
    if estimate.provenance:
        is_known = np.array([source in DETERMINED for source in estimate.provenance])
    return {name: float(x) for name, x, good in zip(estimate.names, estimate.value, is_known, strict=True) if good}


def _equation_markup(lhs: str, parts: Iterable[tuple[str, Substitutes]]) -> Markup:
    """Return an equation in pieces, between which a line may be broken."""
    summands = [piece for part in parts for piece in signed_summands(*part)] or signed_summands("0")
    beginning = inline(f'{lhs}<mo rspace="0">=</mo>', is_markup=True)
    markup = []
    for k, (sign, inner) in enumerate(summands):
        prefix = f'<mo form="prefix">{MINUS}</mo>' if sign == MINUS else ""
        markup.append(inline((f'<mo form="infix" lspace="0">{sign}</mo>' if k else prefix) + inner, is_markup=True))
    return Markup(" ").join([beginning, *markup])


def _math(text: str) -> str:
    return str(inline(text))


def _paragraph(html: str) -> Markup:
    return Markup(f"<p>{html}</p>")  # noqa: S704 -- of escaped parts


def _equation_box(title: str, rows: Iterable[tuple[str, Markup, str]]) -> Markup:
    """Return equations one below the other, each with its name and unit, in a box that scrolls by itself."""
    line = Markup('<div><span class="of">{}</span><span class="law">{} <span class="unit">{}</span></span></div>')
    inner = Markup("").join(line.format(*row) for row in rows)
    return Markup('<div class="equations" tabindex="0" role="group" aria-label="{}">{}</div>').format(title, inner)
