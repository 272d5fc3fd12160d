"""A walk through an identification, cell by cell, for an editor that knows `# %%` or as a notebook."""

# %% A robot: of a file by dy.read_robot("arm.urdf"), or made of terms; here the article's arm
import numpy as np

import dynident as dy

arm = dy.two_link_arm()
arm

# %% Recordings: read by dy.read_log("monday.csv", time=("t", "ms"), position=..., torque=...); here simulated
t, rng = np.arange(2001) * 0.005, np.random.default_rng(0)
logs = {}
for name, rate in (("monday", 2.0), ("tuesday", 3.0), ("wednesday", 2.5)):
    truth = dy.simulate(arm, arm.values, lambda s, w=rate: (4 * np.sin(w * s), 3 * np.sin(2 * w * s)), t)
    logs[name] = dy.record(truth, sigma_q=1e-4, sigma_tau=1e-2, rng=rng, source=name).log
logs["monday"]

# %% Their numbers as a table (Polars; pandas by `.to_pandas()`)
logs["monday"].frame().head()

# %% What is wrong with them, before any fit
dy.check(arm, logs["monday"], logs["tuesday"])

# %% Parameters from monday, judged on tuesday; smoothing and time offset are chosen by the torque
found = dy.identify(arm, {"monday": logs["monday"]}, {"tuesday": logs["tuesday"]})
found

# %% The parameters with their standard errors, and the errors on the other motion
print(found.frame())
print(found.validations[1].frame())

# %% The report's figures, one by one
found.plot.parameters()

# %%
found.plot.torque("tuesday", "joint2")

# %%
found.plot.smoothing("tuesday", "joint2")

# %%
found.plot.errors()

# %% Another method: the article's, or maximum likelihood; a recipe has all settings
plain = dy.identify(arm, logs["monday"], logs["tuesday"], dy.Recipe(dy.Spline(sigma=1e-4)))
for method in (plain, found):
    print(method.recipe, np.abs(method.estimate.value / arm.values - 1).max())

# %% The torque of a third motion
prediction = found.predict(logs["wednesday"])
print(prediction)

# %% How accurate could any method be, and what would a better encoder give?
bound = dy.accuracy_bound(arm, logs["monday"])
print(bound.frame().select("parameter", "value", "now", "bit", "torque"))
