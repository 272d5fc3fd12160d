"""A study: three methods of the article on its two-link arm, 20 recordings with other noise each.

$ .venv/bin/python examples/study.py
rms error of a parameter, in % of its value: median and largest; in standard errors of the bound: largest
raw        26.56 108.62    563.3
filtered    0.84  37.50      6.6
spline      1.32  41.32      8.7
"""

import numpy as np

import dynident as dy
from dynident.apps.article import METHODS, SCENARIOS, run_study, statistics

arm, scenario, level = dy.two_link_arm(), SCENARIOS["tabulated"], 1e-6  # variance of the position noise, rad^2
methods = [METHODS[name] for name in ("raw", "filtered", "spline")]
table = run_study([scenario], methods, [level], runs=20)  # a row per fit; path="study.parquet" would keep them

bound, true = np.sqrt(scenario.bound(level)), np.array(arm.values)
print("rms error of a parameter, in % of its value: median and largest; in standard errors of the bound: largest")
for (name,), rows in table.group_by("method", maintain_order=True):
    estimates = statistics(rows, true.size).estimates
    rms = np.sqrt(np.mean((estimates - true) ** 2, axis=0))
    percent = 100 * rms / np.abs(true)
    print(f"{name:9} {np.median(percent):6.2f} {percent.max():6.2f} {(rms / bound).max():8.1f}")
