"""A new friction term: does Stribeck friction explain a slider better on a motion that was held out?

$ .venv/bin/python examples/stribeck.py
slider: 11.1 % of tuesday's torque is left
slider with Stribeck friction: 1.1 % of tuesday's torque is left
"""

from dataclasses import dataclass

import numpy as np

import dynident as dy
from dynident.models import PerJoint, gallery


@dataclass(frozen=True)
class Stribeck(PerJoint):
    velocity: float = 0.05  # rad/s or m/s
    symbol = "Fs"

    def meaning(self):
        return f"Stribeck friction: torque per sign(dq) exp(-(dq/{self.velocity:g})^2)"

    def shape(self, dq):
        return np.sign(dq) * np.exp(-((dq / self.velocity) ** 2))

    def slope(self, dq):
        return -2 * dq / self.velocity**2 * self.shape(dq)


plain, logs, rng, t = gallery.slider(), {}, np.random.default_rng(0), np.arange(5001) * 0.002
rich = dy.Model((*plain.terms, Stribeck(plain.joints)), name="slider with Stribeck friction")
for name, w in (("monday", 1.5), ("tuesday", 2.2)):  # the truth: 5 kg, 8 N s/m, 3 N, 0.5 N, 1.5 N
    q, dq, ddq = (0.1 * w**k * np.sin(w * t + k * np.pi / 2)[:, None] for k in range(3))
    tau = rich.torque(q, dq, ddq, np.array([5.0, 8.0, 3.0, 0.5, 1.5])) + 0.05 * rng.standard_normal(q.shape)
    logs[name] = dy.Log(t, q + 1e-6 * rng.standard_normal(q.shape), tau, ("slider",), name)
for model in (plain, rich):
    found = dy.identify(model, {"monday": logs["monday"]}, {"tuesday": logs["tuesday"]})
    print(f"{model.name}: {found.validations[-1].errors.relative_error:.1f} % of tuesday's torque is left")
