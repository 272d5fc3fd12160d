"""Smooth only: velocity and acceleration of a noisy position by the smoothing spline, beside plain differences.

$ .venv/bin/python examples/spline.py
<SmoothingSpline of 1 series: 2001 samples, 0 to 10; cut-off 1.76 Hz>
50 degrees of freedom, noise left 0.001 rad
derivative 1: rms error 0.000989, of differences 0.144
derivative 2: rms error 0.0143, of differences 25
"""

import numpy as np

import dynident as dy

t = np.linspace(0.0, 10.0, 2001)
q = np.sin(t) + 1e-3 * np.random.default_rng(1).standard_normal(t.size)

spline = dy.smooth(t, q, sigma=1e-3)  # the noise decides how much: S = n; without sigma it is estimated
print(spline)
print(f"{spline.edf:.0f} degrees of freedom, noise left {spline.noise:.2g} rad")
inner = slice(100, -100)  # the natural spline's acceleration vanishes at the ends
differences = q
for order, true in ((1, np.cos(t)), (2, -np.sin(t))):
    differences = np.gradient(differences, t)
    error, plain = (np.std((one - true)[inner]) for one in (spline.derivative(order), differences))
    print(f"derivative {order}: rms error {error:.3g}, of differences {plain:.3g}")
