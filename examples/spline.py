"""The smoothing spline alone: velocity and acceleration of a noisy position."""

import numpy as np

import dynident as dy

t = np.linspace(0.0, 10.0, 2001)
q = np.sin(t) + 1e-3 * np.random.default_rng(1).standard_normal(t.size)

spline = dy.smooth(t, q, sigma=1e-3)  # the noise decides how much: S = n
print(spline)
print(f"{spline.edf:.0f} degrees of freedom, noise left {spline.noise:.2g} rad")
inner = slice(100, -100)  # the natural spline's acceleration vanishes at the ends
for order, true in ((1, np.cos(t)), (2, -np.sin(t))):
    error = np.std((spline.derivative(order) - true)[inner])
    plain = np.std((np.gradient(q, t) if order == 1 else np.gradient(np.gradient(q, t), t) - true)[inner])
    print(f"derivative {order}: rms error {error:.3g}, of differences {plain:.3g}")
