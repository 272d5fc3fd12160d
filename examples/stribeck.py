"""A friction term of one's own: does Stribeck friction explain a slider better on held-out motion?"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Gt

import dynident as dy
from dynident.models import PerJoint
from dynident.models.gallery import slider


@dataclass(frozen=True)
class Stribeck(PerJoint):
    """Friction that falls as motion begins: Fs sign(dq) exp(-(dq / velocity)^2), in N m or N."""

    velocity: Annotated[float, Gt(0)] = 0.05
    symbol = "Fs"

    def meaning(self):
        return f"Stribeck friction: torque per sign(dq) exp(-(dq/{self.velocity:g})^2)"

    def shape(self, dq):
        return np.sign(dq) * np.exp(-((dq / self.velocity) ** 2))

    def slope(self, dq):
        return -2 * np.abs(dq) / self.velocity**2 * np.exp(-((dq / self.velocity) ** 2))


plain = slider()
rich = dy.Model((*plain.terms, Stribeck(plain.joints)), name="slider with Stribeck friction")
truth = np.array([5.0, 8.0, 3.0, 0.5, 1.5])  # kg, N s/m, N, N, N
t, rng, logs = np.arange(5001) * 0.002, np.random.default_rng(0), {}
for name, rate in (("monday", 1.5), ("tuesday", 2.2)):
    q, dq, ddq = (x[:, None] for x in (np.sin(rate * t), rate * np.cos(rate * t), -(rate**2) * np.sin(rate * t)))
    q, dq, ddq = 0.1 * q, 0.1 * dq, 0.1 * ddq
    tau = rich.torque(q, dq, ddq, truth)
    noise = rng.standard_normal((2, *q.shape))
    logs[name] = dy.Log(t, q + 1e-5 * noise[0], tau + 0.05 * noise[1], ("slider",), name)

for model in (plain, rich):
    found = dy.identify(model, logs["monday"], logs["tuesday"])
    held_out = found.validations[-1]
    print(f"{model.name}: torque error on tuesday {held_out.errors.relative_error:.1f} %")
