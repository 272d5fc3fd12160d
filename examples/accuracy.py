"""What accuracy could be reached, before a better sensor is bought."""

import numpy as np

import dynident as dy

arm, t = dy.two_link_arm(), np.arange(2001) * 0.005
motion = dy.simulate(arm, arm.values, lambda s: (4 * np.sin(2 * s), 3 * np.sin(4 * s)), t)
log = dy.record(motion, sigma_q=1e-3, sigma_tau=1e-2, rng=np.random.default_rng(0)).log

bound = dy.accuracy_bound(arm, log)  # the noise is estimated from the log
print(bound)
table = bound.frame()
print(table.select("parameter", "value", "std", "now", "bit", "torque", "longer"))
gain = (table["now"] / table["bit"]).max()
print(f"An encoder with one bit more makes the best standard error up to {gain:.2f} times smaller,")
print(f"a torque sensor with a tenth of the noise up to {(table['now'] / table['torque']).max():.2f} times.")
