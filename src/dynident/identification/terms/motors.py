"""Friction of a motor that several joints share: tried on the equations of all of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.identification.terms.candidates import EXPONENTS, STRIBECK_SIZES, WIDTHS, CandidateKind, TermGroup
from dynident.identification.terms.grams import JointGrams, SearchFolds
from dynident.identification.terms.samples import N_CLASSES, JointEquations, TermSamples
from dynident.identification.terms.search import JointSearch, TermEntry
from dynident.models import CoupledFriction, CoupledMotor, Model
from dynident.runtime.arrays import Array

WIDTH_STEP = 2  # width that is tried


def coupled_motors(model: Model) -> tuple[CoupledMotor, ...]:
    """Return the motors of a model that are coupled to several joints."""
    return tuple(term for term in model.terms if isinstance(term, CoupledMotor) and len(term.coefficients) > 1)


@dataclass(frozen=True, eq=False)
class MotorEquations:
    """The equations (``rows``) of the joints that a motor turns, with their ``columns`` (m, N) and ``weights``.

    ``block`` (N) is the block of each sample.
    """

    rows: Sequence[JointEquations]
    columns: Sequence[Array]
    weights: Array
    block: NDArray[np.intp]

    def grams(self, shapes: Array, label: NDArray[np.intp]) -> JointGrams:
        """Return the Gram matrices of all equations, each times the root of its weight.

        Their columns are those of each joint and the ``shapes`` (m, n, N) of all; ``label`` (N) is the class of each
        sample.
        """
        acts = np.flatnonzero(np.any([equations.maps.any(axis=0) for equations in self.rows], axis=0))
        total, start = sum(map(len, self.columns)), 0
        maps, joint_grams = np.eye(self.rows[0].maps.shape[1])[acts], []
        for equations, joint_columns, weight in zip(self.rows, self.columns, self.weights.tolist(), strict=True):
            # Each joint has its own columns, the motor acts on all of them: stack the equations by block columns.
            root = np.sqrt(weight)
            wide = np.zeros((total, joint_columns.shape[1]))
            wide[start : start + len(joint_columns)] = joint_columns
            start += len(joint_columns)
            weighted = JointEquations(
                equations.j,
                root * (equations.maps.T @ equations.entries)[acts],
                maps,
                root * equations.tau,
                equations.usable,
            )
            shape = int(self.block.max()) + 1, N_CLASSES
            joint_grams.append(weighted.grams([root * wide, root * shapes[:, equations.j]], self.block, label, shape))
        return JointGrams(np.add.reduce([grams.triangles for grams in joint_grams]), maps)


def motor_search(samples: TermSamples, motor: CoupledMotor, equations: MotorEquations) -> JointSearch:
    """Return the search for friction of a motor in the ``equations`` of its joints."""
    c = dict(motor.coefficients)
    share = np.array([c.get(joint.name, 0.0) for joint in samples.model.joints])
    # The motor turns by the combination of joint positions that its coefficients define.
    phi, dphi = (np.asarray(samples.states[key] @ share) for key in ("q", "dq"))
    shapes, groups, n_columns = list[Array](), [], sum(map(len, equations.columns))
    for kind, terms in _candidate_laws(motor, float(np.sqrt(np.mean(np.square(dphi)))) or 1e-9):
        groups.append(TermGroup(kind, terms, tuple((n_columns + len(shapes) + k,) for k in range(len(terms)))))
        for term in terms:
            Y = term.regressor(samples.states["q"], samples.states["dq"], samples.states["ddq"])[:, :, 0]
            size = float(np.sqrt(np.mean(np.square(Y)))) or 1.0
            shapes.append(Y.T / size)
    grams = equations.grams(np.stack(shapes), samples.classes(phi, dphi))
    joint_group = TermGroup(CandidateKind("own", lambda _: (), dry=True), (motor,), (tuple(range(n_columns)),))
    return JointSearch(
        samples.model.joints[equations.rows[0].j].name,
        grams,
        tuple(groups),
        SearchFolds.of(samples.of_block),
        1.0,
        entered=[TermEntry(joint_group, 0)],
    )


def _candidate_laws(motor: CoupledMotor, speed: float) -> list[tuple[CandidateKind, tuple[CoupledFriction, ...]]]:
    """Return the candidate laws with their sizes, for a motor with an rms ``speed``."""

    def friction_terms(law: str, *settings: dict[str, float]) -> tuple[CoupledFriction, ...]:
        return tuple(
            CoupledFriction(motor.joints, motor.coefficients, motor.name, law, setting)  # type: ignore[arg-type]
            for setting in settings
        )

    stribeck = ({"width": w * speed, "velocity": v * speed} for w, v in STRIBECK_SIZES)
    return [
        (
            CandidateKind("coupled coulomb", lambda _: (), dry=True),
            friction_terms("coulomb", *({"width": w * speed} for w in WIDTHS[::WIDTH_STEP])),
        ),
        (CandidateKind("coupled stribeck", lambda _: ()), friction_terms("stribeck", *stribeck)),
        (CandidateKind("coupled asymmetric_viscous", lambda _: ()), friction_terms("asymmetric_viscous", {})),
        (
            CandidateKind("coupled power", lambda _: (), strict=True),
            friction_terms("power", *({"exponent": exponent} for exponent in EXPONENTS)),
        ),
    ]
