"""Small fits, smoothed motions and checks stay to four digits, part by part, whatever is moved in the code.

``test_numbers.py`` holds the whole method to twelve digits on few robots; here every part has its own small data.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from dynident.checks.channels import check_log_fully
from dynident.motion.log import Log
from dynident.testing.estimator import MODELS, close_loops, make_problem, multisine_motion
from dynident.testing.smoother import make_log, motion_for
from dynident.testing.term import random_memory, sample_states
from tests.kept import check_kept, digits, facts
from tests.laws.test_estimators import ESTIMATORS, SIMULATING
from tests.laws.test_models import TERMS
from tests.laws.test_smoothers import SMOOTHERS


@pytest.mark.parametrize("name", MODELS)
def test_estimates_stay(name: str) -> None:
    model, lines = MODELS[name](), list[str]()
    problem = make_problem(model, multisine_motion(model, noise=0.02, samples=600))
    looped = close_loops(problem) if name == "slider" else None
    for estimator in (*ESTIMATORS, *(SIMULATING if looped else ())):
        estimate = estimator(looped or problem)
        parts = {
            key: getattr(estimate, key) for key in ("value", "std", "determined", "residual", "notes", "consistency")
        }
        lines += [f"{estimator!r}", *facts(parts), *map(str, estimate.notes)]
    check_kept(f"estimates_{name}", "\n".join(lines))


def test_smoothed_motions_stay() -> None:
    lines = list[str]()
    for smoother in SMOOTHERS:
        made = smoother(make_log(1e-3, motion=motion_for(smoother)))
        rows = slice(None, None, max(1, len(made) // 4))
        parts = {key: getattr(made, key)[rows] for key in ("t", "q", "dq", "ddq", "tau")}
        kept = np.flatnonzero(made.mask)[[0, -1]] if made.mask.any() else ()
        lines += [f"{smoother!r}", *facts({**parts, "kept": kept, "smoothing": made.smoothing})]
    check_kept("smoothers", "\n".join(lines))


def test_terms_stay() -> None:
    lines = list[str]()
    for name, make in TERMS.items():
        term = make()
        states = sample_states(len(term.joints))
        lines += [f"{name}: {digits(term.regressor(*states, *random_memory(term)))}"]
        lines += [
            f"  {parameter.name} {parameter.unit} {parameter.role} {parameter.value}" for parameter in term.parameters
        ]
    check_kept("terms", "\n".join(lines))


KINDS = {"a": "revolute", "b": "prismatic"}
T = np.arange(1500) * 0.004
Q = np.column_stack([0.4 * np.sin(3 * T) + 0.2 * np.cos(5.1 * T), 0.3 * np.cos(2.2 * T)])
TAU = np.column_stack([5 * np.cos(3 * T) + 3 * np.sign(np.cos(3 * T)), 2 * np.sin(2.2 * T)])


def made_log(**changes: np.ndarray) -> Log:
    rng = np.random.default_rng(4)
    q, tau = Q + 1e-5 * rng.standard_normal(Q.shape), TAU + 0.02 * rng.standard_normal(Q.shape)
    return Log(**{"t": T, "q": q, "tau": tau, "joints": ("a", "b"), "source": "log"} | changes)


def with_rows(values: np.ndarray, rows: Any, new: Any) -> np.ndarray:
    out = values.copy()
    out[rows, 0] = new
    return out


def wrong_logs() -> Iterator[tuple[str, Log]]:
    right, rng, n = made_log(), np.random.default_rng(5), len(T)
    yield "right", right
    for share in (0.05, 0.2, 0.6):
        yield f"jitter {share}", replace(right, t=T + share * 0.004 * rng.uniform(-0.5, 0.5, n))
    for lost in (1, 3, 60):
        yield f"lost {lost}", replace(right, t=T + 0.004 * lost * (T > 3))
    for every in (2, 4):
        yield f"repeated {every}", replace(right, q=np.repeat(right.q[::every], every, axis=0)[:n])
    for step in (1e-4, 1e-2):
        yield f"quantised {step}", replace(right, q=np.round(right.q / step) * step)
    for unit in (57.3, 1000.0):
        yield f"unit {unit}", replace(right, q=unit * right.q)
    yield "milliseconds", replace(right, t=1000 * T)
    yield "wrapped", replace(right, q=(right.q + 8 * T[:, None] + np.pi) % (2 * np.pi) - np.pi)
    yield "still", replace(right, q=with_rows(right.q, slice(None), 0.2))
    yield "at rest", replace(right, q=with_rows(right.q, slice(400, 1100), right.q[400, 0]))
    yield "no torque", replace(right, tau=with_rows(right.tau, slice(None), 1.0))
    for rows in ((700,), (100, 400, 900)):
        yield f"spikes {rows}", replace(right, q=with_rows(right.q, list(rows), 2.0))
        yield f"torque spikes {rows}", replace(right, tau=with_rows(right.tau, list(rows), 80.0))
    yield "frozen", replace(right, q=with_rows(right.q, slice(300, 340), right.q[300, 0]))
    yield "frozen torque", replace(right, tau=with_rows(right.tau, slice(300, 340), right.tau[300, 0]))
    yield "clipped", replace(right, tau=np.clip(right.tau, -5.0, 5.0))
    yield "jump", replace(right, q=right.q + 0.3 * (T > 2)[:, None])
    yield "few", right.rows(slice(0, 20), "log")


def test_what_is_said_of_wrong_logs_stays() -> None:
    lines = [f"{name}: {finding}" for name, log in wrong_logs() for finding in check_log_fully(log, KINDS)]
    check_kept("wrong_logs", "\n".join(lines))
