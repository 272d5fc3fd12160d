"""Friction of a motor that is coupled to several joints, tried on the equations of all of these together."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dynident.identification.terms.candidates import EXPONENTS, SHARP, VELOCITIES, WIDTHS, Kind
from dynident.identification.terms.grams import JointGrams
from dynident.identification.terms.samples import CLASSES, Rows, Samples
from dynident.identification.terms.search import Division, Entered, Group, JointSearch
from dynident.models import CoupledFriction, CoupledMotor, Model

__all__ = ["motor_search", "motors_of"]

Array = NDArray[np.float64]
EVERY = 2  # width that is tried


def motors_of(model: Model) -> tuple[CoupledMotor, ...]:
    """Return the motors of a model that are coupled to several joints."""
    return tuple(one for one in model.terms if isinstance(one, CoupledMotor) and len(one.coefficients) > 1)


def motor_search(
    samples: Samples,
    motor: CoupledMotor,
    rows: Sequence[Rows],
    columns: Sequence[Array],
    weights: Array,
    block: NDArray[np.intp],
) -> JointSearch:
    """Return the search for friction of a motor beside the ``columns`` (m, N) that its joints have.

    ``rows`` are the equations of these joints, of ``weights``, and ``block`` (N) is that of each sample.
    """
    c = dict(motor.coefficients)
    share = np.array([c.get(joint.name, 0.0) for joint in samples.model.joints])
    phi, dphi = (np.asarray(samples.states[key] @ share) for key in ("q", "dq"))
    shapes, groups, at = list[Array](), [], sum(map(len, columns))
    for kind, terms in _tried(motor, float(np.sqrt(np.mean(np.square(dphi)))) or 1e-9):
        groups.append(Group(kind, terms, tuple((at + len(shapes) + k,) for k in range(len(terms)))))
        for term in terms:
            Y = term.regressor(samples.states["q"], samples.states["dq"], samples.states["ddq"])[:, :, 0]
            size = float(np.sqrt(np.mean(np.square(Y)))) or 1.0
            shapes.append(Y.T / size)
    grams = _together(rows, columns, np.stack(shapes), weights, block, samples.classes_of(phi, dphi))
    own = Group(Kind("own", lambda _: (), dry=True), (motor,), (tuple(range(at)),))
    return JointSearch(
        samples.model.joints[rows[0].j].name,
        grams,
        tuple(groups),
        Division.of(samples.of_block),
        1.0,
        [Entered(own, 0)],
    )


def _tried(motor: CoupledMotor, speed: float) -> list[tuple[Kind, tuple[CoupledFriction, ...]]]:
    """Return the laws that are tried with their sizes, for a motor of an rms speed."""

    def made(law: str, *settings: dict[str, float]) -> tuple[CoupledFriction, ...]:
        return tuple(CoupledFriction(motor.joints, motor.coefficients, motor.name, law, one) for one in settings)  # type: ignore[arg-type]

    stribeck = ({"width": w * speed, "velocity": v * speed} for w in SHARP for v in VELOCITIES)
    return [
        (
            Kind("coupled coulomb", lambda _: (), dry=True),
            made("coulomb", *({"width": w * speed} for w in WIDTHS[::EVERY])),
        ),
        (Kind("coupled stribeck", lambda _: ()), made("stribeck", *stribeck)),
        (Kind("coupled asymmetric_viscous", lambda _: ()), made("asymmetric_viscous", {})),
        (Kind("coupled power", lambda _: (), strict=True), made("power", *({"exponent": one} for one in EXPONENTS))),
    ]


def _together(
    rows: Sequence[Rows],
    columns: Sequence[Array],
    shapes: Array,
    weights: Array,
    block: NDArray[np.intp],
    label: NDArray[np.intp],
) -> JointGrams:
    """Return the Gram matrices of the equations of several joints, with the columns of each and ``shapes`` (m, n, N)
    of all, each equation times the root of its weight."""
    acts = np.flatnonzero(np.any([one.maps.any(axis=0) for one in rows], axis=0))
    total, first = sum(map(len, columns)), 0
    maps, found = np.eye(rows[0].maps.shape[1])[acts], []
    for one, own, weight in zip(rows, columns, weights.tolist(), strict=True):
        root = np.sqrt(weight)
        wide = np.zeros((total, own.shape[1]))
        wide[first : first + len(own)] = own
        first += len(own)
        scaled = Rows(one.j, root * (one.maps.T @ one.entries)[acts], maps, root * one.tau, one.used)
        shape = int(block.max()) + 1, CLASSES
        found.append(scaled.grams(root * np.concatenate([wide, shapes[:, one.j]]), block, label, shape).grams)
    return JointGrams(np.add.reduce(found), maps)
