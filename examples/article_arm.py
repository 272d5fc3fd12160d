"""The article's arm: simulate two motions with noise, identify on one, validate on the other."""

import numpy as np

import dynident as dy

arm, t, rng = dy.two_link_arm(), np.arange(4001) * 0.0025, np.random.default_rng(0)
logs = {}
for name, rate in (("monday", 2.0), ("tuesday", 3.0)):  # rad/s
    motion = dy.simulate(arm, arm.values, lambda s, w=rate: (4 * np.sin(w * s), 3 * np.sin(2 * w * s)), t)
    logs[name] = dy.record(motion, sigma_q=1e-4, sigma_tau=1e-2, rng=rng).log

method = dy.Recipe(dy.Spline(sigma=1e-4))  # the article's: S = n, then least squares
found = dy.identify(arm, {"monday": logs["monday"]}, {"tuesday": logs["tuesday"]}, method)
print(found)
print(found.frame())
