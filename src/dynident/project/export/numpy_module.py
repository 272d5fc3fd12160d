"""The identified model as a stand-alone Python module that needs only NumPy: inverse dynamics, gravity, mass matrix."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dynident.models import CoupledMotor, Lagrangian, Model, RigidBodies, RotorInertia, Term
from dynident.models.friction import Coulomb, Offset, PerJoint, Viscous
from dynident.project.export.identified import IdentifiedModel, depends_on_past, omission_notes
from dynident.project.export.written import ExportText
from dynident.runtime import ModelError
from dynident.runtime.arrays import Array

COULOMB_INDEX = 2  # place of Coulomb friction among a motor's inertia, viscous, Coulomb and constant torque
HEAD = '''"""Inverse dynamics of an identified robot; needs only NumPy. Written by dynident.

q, dq, ddq are arrays (n,) or (N, n): one column per joint of JOINTS, rad or m, and seconds; torques are N m or N.
"""

import numpy as np

MODEL = @MODEL@
JOINTS = @JOINTS@
'''

MOTORS = """
# By motor: coefficients of the joints it is coupled to; rotor inertia, viscous friction, Coulomb friction, constant
# torque; width of tanh(dq / width) in place of the sign, and dead band of the sign.
MOTORS = [@ROWS@]
"""

BODIES = '''# Bodies, each after its parent: column in q, factor and offset of its position from there (1 and 0 except
# for a joint that mimics another), index of the parent (-1: the base), whether it slides, axis, rotation and position
# of its joint frame in the parent's; mass, first moment and inertia about its joint frame.
BODIES_@K@ = [
@ROWS@
]
GRAVITY_@K@ = @GRAVITY@  # m/s^2, in the frame of the base


def _turn(axis, angle):
    """Return the matrices (N, 3, 3) that turn by the angles (N) about an axis."""
    x, y, z = axis
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle)[:, None, None] * K + (1 - np.cos(angle))[:, None, None] * (K @ K)


def _bodies_@K@(q, dq, ddq):
    """Return the torque of the rigid bodies, by the recursion of Newton and Euler."""
    still = np.zeros((len(q), 3))
    moves, wrenches = [], []
    for column, factor, rest, parent, slides, axis, turn, place, mass, moment, inertia in BODIES_@K@:
        w, dw, a = moves[parent][2:] if parent >= 0 else (still, still, still - GRAVITY_@K@)
        s, ds, dds = (factor * x[:, column, None] for x in (q, dq, ddq))
        s = s + rest
        R = np.broadcast_to(turn, (len(q), 3, 3)) if slides else turn @ _turn(axis, s[:, 0])
        p = place + turn @ axis * s if slides else still + place
        a = np.einsum("nji,nj->ni", R, a + np.cross(dw, p) + np.cross(w, np.cross(w, p)))
        w, dw = np.einsum("nji,nj->ni", R, w), np.einsum("nji,nj->ni", R, dw)
        if slides:
            a = a + axis * dds + 2 * np.cross(w, axis * ds)
        else:
            dw = dw + axis * dds + np.cross(w, axis * ds)
            w = w + axis * ds
        force = mass * a + np.cross(dw, moment) + np.cross(w, np.cross(w, moment))
        torque = dw @ inertia + np.cross(w, w @ inertia) + np.cross(moment, a)
        moves.append((R, p, w, dw, a))
        wrenches.append((force, torque))
    out = np.zeros(q.shape)
    for k in reversed(range(len(BODIES_@K@))):
        column, factor, _, parent, slides, axis = BODIES_@K@[k][:6]
        force, torque = wrenches[k]
        out[:, column] += factor * ((force if slides else torque) @ axis)
        if parent >= 0:
            R, p = moves[k][:2]
            above, arm = wrenches[parent]
            force = np.einsum("nij,nj->ni", R, force)
            torque = np.einsum("nij,nj->ni", R, torque) + np.cross(p, force)
            wrenches[parent] = above + force, arm + torque
    return out
'''

FUNCTIONS = '''def _rigid(q, dq, ddq):
    return @RIGID@


def _others(q, dq, ddq):
    return @OTHERS@


def _motors(dq, ddq, parts):
    """Return the torque of inertia, viscous, Coulomb and constant parts of the motors, as far as chosen."""
    out = np.zeros(dq.shape)
    for c, (inertia, viscous, coulomb, offset), (width, dead_band) in MOTORS:
        rate = dq @ c
        sign = np.tanh(rate / width) if width else np.sign(rate) * (np.abs(rate) > dead_band)
        torques = inertia * (ddq @ c), viscous * rate, coulomb * sign, offset + 0 * rate
        out += sum(torque for torque, chosen in zip(torques, parts) if chosen)[:, None] * c
    return out


def _states(*states):
    """Return the arrays as (N, n) floats."""
    states = [np.asarray(state, dtype=float) for state in states]
    for state in states:
        if state.ndim not in (1, 2) or state.shape != states[0].shape or state.shape[-1] != len(JOINTS):
            raise ValueError(f"expected arrays ({len(JOINTS)},) or (N, {len(JOINTS)}), alike, got {state.shape}")
    return [np.atleast_2d(state) for state in states]


def inverse_dynamics(q, dq, ddq):
    """Return the torque of a motion, in the shape of q: bodies, friction, constant torques, rotor inertia, others."""
    states = _states(q, dq, ddq)
    return (_rigid(*states) + _motors(*states[1:], (1, 1, 1, 1)) + _others(*states)).reshape(np.shape(q))


def gravity(q):
    """Return the torque that holds the bodies at rest, without friction and constant torques."""
    (states,) = _states(q)
    return _rigid(states, 0 * states, 0 * states).reshape(np.shape(q))


def friction(dq):
    """Return viscous and Coulomb friction, of coupled motors too, in the shape of dq."""
    (states,) = _states(dq)
    return _motors(states, 0 * states, (0, 1, 1, 0)).reshape(np.shape(dq))


def mass_matrix(q):
    """Return the matrix (n, n) or (N, n, n) that multiplies ddq, with rotor inertia."""
    (states,) = _states(q)
    still = 0 * states
    static_torque = inverse_dynamics(states, still, still)
    columns = [inverse_dynamics(states, still, still + unit) - static_torque for unit in np.eye(len(JOINTS))]
    return np.stack(columns, axis=-1).reshape(np.shape(q) + (len(JOINTS),))
'''


def identified_module(identified: IdentifiedModel) -> ExportText:
    """Return the source of a module with ``inverse_dynamics``, ``gravity``, ``mass_matrix`` and ``friction``.

    Rigid bodies are computed by the recursive Newton-Euler algorithm (Featherstone 2008, "Rigid Body Dynamics
    Algorithms", ch. 5) from the ten identified parameters, physical or not; symbolic energies by their printed torques;
    friction, offset, rotor inertia and coupled motors as rows of motors; any other term by its ``numpy_source``, the
    load by the bodies of a first fit. Terms that remember more than the load are left out. Raises ModelError for
    another term without a ``numpy_source``: its formula is not known.
    """
    names = [joint.name for joint in identified.model.joints]
    motors, rigid_calls, other_calls = _MotorRows(names), ["0.0 * q"], ["0.0 * q"]
    blocks: list[str] = []
    left_out = [
        line for term, values in identified.parts if depends_on_past(term) for line in omission_notes(term, values)
    ]
    for k, (term, values) in enumerate(identified.memoryless.parts):
        # terms that rows of motors hold exactly need no function of their own
        if not motors.add(term, values):
            block, call = _term_function(term, values, k)
            blocks.append(block)
            (rigid_calls if isinstance(term, RigidBodies | Lagrangian) else other_calls).append(call)
    if identified.memoryless.model.memory:
        blocks += _load_functions(identified.model)
    head = _fill_template(HEAD, MODEL=repr(identified.model.name), JOINTS=repr(tuple(names)))
    functions = _fill_template(FUNCTIONS, RIGID=" + ".join(rigid_calls), OTHERS=" + ".join(other_calls))
    return ExportText("\n\n".join([head + motors.text(), *blocks, functions]), tuple(left_out))


class _MotorRows:
    """Rows of motors, each coupled to joints by coefficients, collected from friction, offset and rotor inertia."""

    def __init__(self, names: list[str]) -> None:
        self._names = names
        self._rows: list[tuple[Array, Array, tuple[float, float]]] = []

    def add(self, term: Term, values: Array) -> bool:
        """Add a term if rows of motors hold it exactly; return False for any other."""
        if isinstance(term, CoupledMotor):
            coefficients = dict(term.coefficients)
            vector = np.array([coefficients.get(name, 0.0) for name in self._names])
            parts = np.zeros(4)
            parts[[term.inertia, term.viscous, term.coulomb, term.offset]] = values
            self._gather(vector, parts, (term.width, term.dead_band))
            return True
        kinds: list[type[Term]] = [RotorInertia, Viscous, Coulomb, Offset]
        if not isinstance(term, PerJoint) or type(term) not in kinds:
            return False
        for name, value in zip(term.acts_on, values.tolist(), strict=True):
            sign = term.rule(name) if isinstance(term, Coulomb) else (0.0, 0.0)
            vector = np.array([float(name == joint_name) for joint_name in self._names])
            self._gather(vector, value * np.eye(4)[kinds.index(type(term))], sign)
        return True

    def _gather(self, vector: Array, parts: Array, sign: tuple[float, float]) -> None:
        """Add to the row of the same coefficients, unless both have Coulomb friction."""
        for k, (row_vector, sums, row_sign) in enumerate(self._rows):
            # two Coulomb terms may change their sign differently, so that they need rows of their own
            if (vector == row_vector).all() and not (parts[COULOMB_INDEX] and sums[COULOMB_INDEX]):
                self._rows[k] = (vector, sums + parts, sign if parts[COULOMB_INDEX] else row_sign)
                return
        self._rows.append((vector, parts, sign))

    def text(self) -> str:
        rows = [
            f"    ({_array_literal(vector)}, {tuple(parts.tolist())!r}, {tuple(map(float, sign))!r}),"
            for vector, parts, sign in self._rows
        ]
        return _fill_template(MOTORS, ROWS="".join(f"\n{row}" for row in rows) + ("\n" if rows else ""))


def _bodies_function(term: RigidBodies, values: Array, k: int) -> str:
    """Return the constants of the kinematics and the recursion over them."""
    arm = term.arm
    theta = np.zeros((len(arm.bodies), 10))
    theta[arm.parameter_bodies] = values.reshape(-1, 10)
    rows = []
    for body, inertial, coefficients, rest in zip(
        arm.bodies, theta.tolist(), arm.drive, arm.offset.tolist(), strict=True
    ):
        # each joint of the tree is driven by one coordinate: mimic joints by that of their master
        column = int(np.abs(coefficients).argmax())
        position = f"{column}, {float(coefficients[column])!r}, {rest!r}"
        parent = -1 if body.parent is None else body.parent
        slides = body.joint.kind == "prismatic"
        m, x, y, z, xx, xy, yy, xz, yz, zz = inertial
        tensor = [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]
        rows.append(
            f"    # {body.name!r}\n"
            f"    ({position}, {parent}, {slides}, {_array_literal(body.joint.axis)},\n"
            f"     {_array_literal(body.placement[:3, :3])}, {_array_literal(body.placement[:3, 3])},\n"
            f"     {m!r}, {_array_literal([x, y, z])}, {_array_literal(tensor)}),"
        )
    return _fill_template(BODIES, K=str(k), GRAVITY=_array_literal(term.gravity), ROWS="\n".join(rows))


def _term_function(term: Term, values: Array, k: int) -> tuple[str, str]:
    """Return a function of a term that rows of motors do not hold, and its call."""
    if isinstance(term, RigidBodies):
        return _bodies_function(term, values, k), f"_bodies_{k}(q, dq, ddq)"
    if isinstance(term, Lagrangian):
        return _lagrangian_function(term, values, k), f"_energies_{k}(q, dq, ddq)"
    return term.numpy_source(f"_term_{k}", values), f"_term_{k}(q, dq, ddq)"


def _load_functions(model: Model) -> list[str]:
    """Return the functions of the load, with the bodies of a preliminary model."""
    parts = IdentifiedModel(model.bodies, np.array(model.load)).parts if model.load else ()
    functions = [_term_function(term, values, len(model.terms) + k) for k, (term, values) in enumerate(parts)]
    calls = " + ".join(["0.0 * q", *(call for _, call in functions)])
    words = "Return the load of the joints: the torque of the bodies by a first fit."
    return [*(block for block, _ in functions), f'def _load(q, dq, ddq):\n    """{words}"""\n    return {calls}\n']


def _lagrangian_function(term: Lagrangian, values: Array, k: int) -> str:
    """Return the torques of symbolic energies as a function of NumPy."""
    import sympy as sp
    from sympy.printing.numpy import NumPyPrinter

    states, torques = term.torques(values)
    count = len(term.joints)
    plain = [sp.Symbol(f"{name}{i}") for name in ("q", "dq", "ddq") for i in range(count)]
    exact = dict(zip(states, plain, strict=True))
    # common subexpressions keep the code of large energies short
    replaced, results = sp.cse([sp.sympify(torque).xreplace(exact) for torque in torques], sp.numbered_symbols("x_"))
    printer: Any = NumPyPrinter({"strict": True, "allow_unknown_functions": False})
    try:
        steps = [f"    {symbol} = {printer.doprint(value)}" for symbol, value in replaced]
        outs = [printer.doprint(value) for value in results]
    except (NotImplementedError, TypeError, ValueError) as error:  # printers of SymPy raise any of them
        raise ModelError(
            f"model.py cannot hold this model: NumPy has no function for a part of it ({error})."
        ) from error
    unpack = [f"    {', '.join(f'{name}{i}' for i in range(count))}, = {name}.T" for name in ("q", "dq", "ddq")]
    stack = ", ".join(f"{out} + 0 * q0" for out in outs)
    lines = [f"def _energies_{k}(q, dq, ddq):", *unpack, *steps, f"    return np.stack([{stack}], axis=-1)"]
    return "\n".join(lines).replace("numpy.", "np.") + "\n"


def _fill_template(template: str, **parts: str) -> str:
    """Return a template with its ``@NAME@`` filled in one pass, so that names inside the parts are not filled again.

    The parts are Python: names of the data stand in them as literals, by ``repr``.
    """
    return re.sub("@([A-Z]+)@", lambda match: parts[match[1]], template)


def _array_literal(values: ArrayLike) -> str:
    return f"np.array({np.asarray(values, dtype=float).tolist()!r})"
