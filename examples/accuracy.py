"""The bound: what accuracy any method could reach with a recording, before a better sensor is bought.

$ .venv/bin/python examples/accuracy.py
theta1 0.0340: standard error 7.5e-05, at best 4.5e-05
theta2 0.0030: standard error 1.8e-05, at best 1.3e-05
theta3 0.0045: standard error 1.5e-05, at best 1.0e-05
theta4 0.1329: standard error 1.0e-04, at best 6.3e-05
theta5 0.0170: standard error 5.3e-05, at best 3.9e-05
theta6 0.6190: standard error 1.2e-04, at best 7.2e-05
theta7 0.6189: standard error 1.0e-04, at best 8.2e-05
They would be up to 1.06 times smaller by an encoder with one bit more, 5.43 times
by a tenth of the torque noise, and 2.00 times by a recording four times as long.
"""

import numpy as np

import dynident as dy

arm, t = dy.two_link_arm(), np.arange(2001) * 0.005
motion = dy.simulate(arm, arm.values, lambda s: (4 * np.sin(2 * s), 3 * np.sin(4 * s)), t)
log = dy.record(motion, sigma_q=1e-3, sigma_tau=1e-2, rng=np.random.default_rng(0)).log

bound = dy.accuracy_bound(arm, log)  # the noise is estimated from the log
table = bound.frame()  # standard errors: of least squares, least possible now, and with better sensors
for name, value, std, now, *_ in table.select("parameter", "value", "std", "now").rows():
    print(f"{name} {value:.4f}: standard error {std:.1e}, at best {now:.1e}")
times = {what: (table["now"] / table[what]).max() for what in ("bit", "torque", "longer")}
print(
    f"They would be up to {times['bit']:.2f} times smaller by an encoder with one bit more, {times['torque']:.2f} times"
)
print(f"by a tenth of the torque noise, and {times['longer']:.2f} times by a recording four times as long.")
