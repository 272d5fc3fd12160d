"""A further friction term: does Stribeck friction explain a slider better on a motion that was held out?

$ .venv/bin/python examples/stribeck.py
slider: 11.1 % of tuesday's torque is left
slider with Stribeck friction: 1.1 % of tuesday's torque is left
"""

import numpy as np

import dynident as dy
from dynident.models import lagrangian as gallery
from dynident.models.friction import Stribeck

plain, logs, rng, t = gallery.slider(), {}, np.random.default_rng(0), np.arange(5001) * 0.002
rich = plain.with_terms(Stribeck(plain.joints, velocity=0.05))
for name, w in (("monday", 1.5), ("tuesday", 2.2)):  # the truth: 5 kg, 8 N s/m, 3 N, 0.5 N, 1.5 N
    q, dq, ddq = (0.1 * w**k * np.sin(w * t + k * np.pi / 2)[:, None] for k in range(3))
    tau = rich.torque(q, dq, ddq, np.array([5.0, 8.0, 3.0, 0.5, 1.5])) + 0.05 * rng.standard_normal(q.shape)
    logs[name] = dy.Log(t, q + 1e-6 * rng.standard_normal(q.shape), tau, ("slider",), name)
for name, model in {"slider": plain, "slider with Stribeck friction": rich}.items():
    found = dy.identify(model, {"monday": logs["monday"]}, {"tuesday": logs["tuesday"]})
    print(f"{name}: {found.validations[-1].errors.relative_error:.1f} % of tuesday's torque is left")
